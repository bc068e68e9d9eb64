"""Samplers that depend on (seed, trial number) and on finished trials alone, so that a resumed study does not diverge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from scipy.stats import qmc

from eiwa.core.sections import RangeSection
from eiwa.core.spec import StudySpec


def distributions(spec: StudySpec) -> dict[str, BaseDistribution]:
    """Optuna's distribution of every searched variable."""
    return {n: FloatDistribution(r.low, _last(r), log=r.log, step=r.step) for n, r in spec.ranges.items()}


def _last(r: RangeSection) -> float:
    """The largest value that the steps reach."""
    return r.high if r.step is None else min(r.high, r.low + _steps(r) * r.step)


def _steps(r: RangeSection) -> int:
    assert r.step is not None
    return int(np.floor((r.high - r.low) / r.step + 1e-9))


def sampler_of(spec: StudySpec, number: int) -> optuna.samplers.BaseSampler:
    """A fresh sampler for one trial."""
    seed = int(np.random.SeedSequence([spec.study.seed, number]).generate_state(1)[0])
    if spec.study.sampler == "tpe":
        return optuna.samplers.TPESampler(multivariate=True, seed=seed)
    if spec.study.sampler == "random":
        return optuna.samplers.RandomSampler(seed=seed)
    points = grid_points(spec.ranges) if spec.study.sampler == "grid" else _sobol_points(spec)
    return TableSampler(points[number])


def search_size(spec: StudySpec) -> int:
    """Trials that the study asks for: a grid ends when it is complete."""
    if spec.study.sampler == "grid":
        return min(spec.study.trials, len(grid_points(spec.ranges)))
    return spec.study.trials


class TableSampler(optuna.samplers.BaseSampler):
    """Gives every variable its value from a table."""

    def __init__(self, values: Mapping[str, float]) -> None:
        self._values = values

    def infer_relative_search_space(self, study: Any, trial: Any) -> dict[str, BaseDistribution]:
        """Nothing is sampled jointly."""
        return {}

    def sample_relative(self, study: Any, trial: Any, search_space: Any) -> dict[str, Any]:
        """Nothing is sampled jointly."""
        return {}

    def sample_independent(self, study: Any, trial: Any, param_name: str, param_distribution: Any) -> float:
        """The value in the table."""
        return self._values[param_name]


def grid_points(ranges: Mapping[str, RangeSection]) -> list[dict[str, float]]:
    """Every combination of the stepped values, the last variable moving fastest."""
    axes = []
    for r in ranges.values():
        assert r.step is not None
        axes.append([min(r.high, r.low + k * r.step) for k in range(_steps(r) + 1)])
    return [dict(zip(ranges, values, strict=True)) for values in product(*axes)]


def _sobol_points(spec: StudySpec) -> Sequence[dict[str, float]]:
    bits = max(3, int(np.ceil(np.log2(max(1, spec.study.trials)))))
    unit = _sobol(len(spec.ranges), bits, spec.study.seed)
    return [{n: _scaled(r, v) for (n, r), v in zip(spec.ranges.items(), row, strict=True)} for row in unit]


@lru_cache(maxsize=4)
def _sobol(dimensions: int, bits: int, seed: int) -> Any:
    return qmc.Sobol(dimensions, scramble=True, rng=seed).random_base2(bits)


def _scaled(r: RangeSection, unit: float) -> float:
    if r.log:
        return float(np.exp(np.log(r.low) + unit * (np.log(r.high) - np.log(r.low))))
    value = r.low + unit * (r.high - r.low)
    return value if r.step is None else min(_last(r), r.low + int(unit * (_steps(r) + 1)) * r.step)
