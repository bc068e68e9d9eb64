"""What a study will cost, measured on this machine before it is run."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.elites import LEAST
from eiwa.core.evaluation import Setup, ergonomic_grid
from eiwa.core.memory import memory, require_memory
from eiwa.core.optimum import pilot_points
from eiwa.core.outcome import bounds, candidates, evaluate
from eiwa.core.spec import StudySpec, check
from eiwa.core.tree import replaced
from eiwa.study.converge import bare
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
    setups = [s for scenario in spec.scenarios for s in candidates(spec.design(scenario.overrides), spec.study.seed)]
    boxes = [bounds(s) for s in setups]
    grids = [ergonomic_grid(boxes, setup.r) for setup in setups]
    for grid, setup in zip(grids, setups, strict=True):
        require_memory(grid.cells, setup.backend, setup.r)
    needed = max(memory(g.cells, s.backend) for g, s in zip(grids, setups, strict=True))
    return Cost(max(grid.cells for grid in grids), needed, _per_trial(spec, setups[0]), search_size(spec))


COARSE, SEARCHED, SPENT = 0.02, 0.05, 1 << 24
"""A last doubling that still moves F by more than this; then elites are asked, to this tolerance, with so many at most."""


@dataclass(frozen=True)
class Shortfall:
    """How far F of the study's own design lies below the true F on its grid, and what it takes to come near.

    ``F`` with the study's samples; ``error`` relative to the true F; ``evaluations`` of elites that reach ``tolerance``.
    """

    F: float
    error: float
    evaluations: int
    tolerance: float


@dataclass(frozen=True)
class Apart:
    """Boxes in W [m], each its low and its high corner: where hands are comfortable, and where each arm's tip comes."""

    hands: NDArray[np.float64]
    right: NDArray[np.float64]
    left: NDArray[np.float64]


def apart(spec: StudySpec, overrides: Mapping[str, Any]) -> Apart:
    """Where hands and masters are, for a design whose F is 0."""
    setup = candidates(spec.design(overrides), spec.study.seed)[0]
    postures = setup.arm.postures(pilot_points(setup.arm.dof)).solved
    tips = [postures.tips @ T[:3, :3].T + T[:3, 3] for T in setup.layout.Ts_world_base]
    right, left = (np.array([t.min(axis=0), t.max(axis=0)]) for t in tips)
    return Apart(bounds(setup), right, left)


def shortfall(
    spec: StudySpec, coarse: float = COARSE, found: Mapping[str, float | None] | None = None
) -> Shortfall | None:
    """What the voxels ask of the samples; None where the last doubling moved F by at most ``coarse`` of it.

    Only maxima are judged: a mean per voxel has no such limit. ``found`` are the numbers of the study's own design, where
    they are known.
    """
    found = own_numbers(spec) if found is None else found
    sampling, F = spec.resolved["sampling"], found["F"] or 0.0
    if spec.resolved["voxels"].get("aggregate") != "max":
        return None
    if sampling["estimator"] == "elites":
        error, tolerance = (found["F_remaining"] or 0.0) / max(F, LEAST), sampling["tolerance"]
        spent = int(found["evaluations"] or 0)
        # What remains has fallen as the power -0.8 of the evaluations (docs/explanation/engine.md).
        return Shortfall(F, error, int(spent * (error / tolerance) ** 1.25), tolerance) if error > tolerance else None
    if abs(found["F_drift"] or 0.0) <= coarse * max(F, LEAST):
        return None
    elites = {"sampling.estimator": "elites", "sampling.samples": SPENT, "sampling.tolerance": SEARCHED}
    refined = _numbers(spec, elites)
    true_F = max((refined["F"] or 0.0) + (refined["F_remaining"] or 0.0) / 2, LEAST)
    return Shortfall(F, 1 - F / true_F, int(refined["evaluations"] or 0), SEARCHED)


def own_numbers(spec: StudySpec) -> Mapping[str, float | None]:
    """F and what comes with it, of the design that the file itself writes, under the reference scenario."""
    return _numbers(spec, {})


def _numbers(spec: StudySpec, settings: Mapping[str, Any]) -> Mapping[str, float | None]:
    return evaluate(bare(spec, {}, settings, {}), {}).scenarios[""]


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
