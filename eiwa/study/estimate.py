"""What a study will cost, measured on this machine before it is run."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

from eiwa.core.evaluation import Setup, ergonomic_grid
from eiwa.core.memory import memory, require_memory
from eiwa.core.outcome import bounds, evaluate
from eiwa.core.spec import StudySpec, check
from eiwa.core.tree import replaced
from eiwa.study.sampler import search_size

SMALL, LARGE = 1 << 16, 1 << 18


@dataclass(frozen=True)
class Cost:
    """Cells of E's grid, bytes to fill it, and seconds for one trial and for the whole search."""

    cells: int
    memory: int
    seconds_per_trial: float
    trials: int

    @property
    def seconds(self) -> float:
        """The whole search."""
        return self.trials * self.seconds_per_trial

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "seconds": self.seconds}


def estimate(spec: StudySpec) -> Cost:
    """Measure short evaluations of the study file's own design, and extrapolate to its number of samples.

    Elites stop when they have converged, so one of their evaluations is measured as it is.
    """
    setups = [spec.design(s.overrides).setup(spec.study.seed) for s in spec.scenarios]
    boxes = [bounds(s) for s in setups]
    grids = [ergonomic_grid(boxes, setup.r) for setup in setups]
    for grid, setup in zip(grids, setups, strict=True):
        require_memory(grid.cells, setup.backend, setup.r)
    needed = max(memory(g.cells, s.backend) for g, s in zip(grids, setups, strict=True))
    return Cost(max(grid.cells for grid in grids), needed, _per_trial(spec, setups[0]), search_size(spec))


def _per_trial(spec: StudySpec, setup: Setup) -> float:
    samples = setup.sampling.samples
    if setup.estimator == "elites" or samples <= LARGE:
        return _seconds(spec, samples)
    small, large = _seconds(spec, SMALL), _seconds(spec, LARGE)
    slope = max(0.0, large - small) / (LARGE - SMALL)
    return small + slope * (samples - SMALL)


def _seconds(spec: StudySpec, samples: int) -> float:
    short = check(replaced(spec.tree, {"sampling.samples": samples}), spec.path)
    evaluate(short, {})
    start = time.perf_counter()
    evaluate(short, {})
    return time.perf_counter() - start
