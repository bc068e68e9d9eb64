"""Samplers that depend on (seed, trial number) and on the trials of earlier batches alone: see :mod:`eiwa.study.batch`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from importlib.util import find_spec
from itertools import product
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from scipy.stats import qmc

from eiwa.core import samplers
from eiwa.core.errors import SpecError, finding
from eiwa.core.samplers import grid_size, steps
from eiwa.core.sections import RangeSection
from eiwa.core.spec import StudySpec
from eiwa.study.batch import BatchSampler
from eiwa.study.generations import CmaEs, Nsga2, Nsga3
from eiwa.study.ranges import distribution, scaled

NEEDS = {"cmaes": "cmaes", "gp": "torch"}
"""Samplers of an extra (of the same name), and the package that they need."""


def distributions(spec: StudySpec) -> dict[str, BaseDistribution]:
    """Optuna's distribution of every searched variable."""
    return {name: distribution(r) for name, r in spec.ranges.items()}


def sampler_of(spec: StudySpec, number: int) -> BaseSampler:
    """A fresh sampler for one trial."""
    kind = spec.sampler.kind
    if kind == "grid":
        return TableSampler(grid_points(spec.ranges)[number])
    if kind == "qmc":
        return TableSampler(_sobol_points(spec)[number])
    return BatchSampler(_inner(spec, number), distributions(spec), number, spec.study.batch)


def require(spec: StudySpec) -> None:
    """Refuse a sampler whose package is not installed.

    Raises
    ------
    SpecError
        With the command that installs it.
    """
    kind = spec.sampler.kind
    if kind in NEEDS and find_spec(NEEDS[kind]) is None:
        problem = f"needs the package {NEEDS[kind]}, which is not installed."
        raise SpecError(finding("study.sampler", problem, value=kind, remedy=f"Install it: pip install 'eiwa[{kind}]'"))


def announced(spec: StudySpec) -> str:
    """What ``auto`` has chosen and why; empty where the study names its sampler."""
    if not isinstance(spec.study.sampler, samplers.Auto) or not spec.study.trials:
        return ""
    chosen, reason = samplers.automatic(spec)
    return f"Sampler: auto is {chosen.kind}, for {reason}."


def _inner(spec: StudySpec, number: int) -> BaseSampler:
    options, seed, batch = spec.sampler, seeded(spec, number), spec.study.batch
    match options:
        case samplers.Tpe():
            return optuna.samplers.TPESampler(
                seed=seed,
                n_startup_trials=options.startup_trials,
                n_ei_candidates=options.candidates,
                multivariate=options.multivariate,
            )
        case samplers.Nsga3():
            return Nsga3(options, batch, partial(seeded, spec), number)
        case samplers.Nsga2():
            return Nsga2(options, batch, partial(seeded, spec), number)
        case samplers.Cmaes():
            return CmaEs(options, batch, spec.ranges, partial(seeded, spec), number)
        case samplers.Gp():
            return optuna.samplers.GPSampler(
                seed=seed, n_startup_trials=options.startup_trials, deterministic_objective=options.deterministic
            )
    return optuna.samplers.RandomSampler(seed=seed)


def seeded(spec: StudySpec, number: int) -> int:
    """Seed of a trial."""
    return int(np.random.SeedSequence([spec.study.seed, number]).generate_state(1)[0])


def search_size(spec: StudySpec) -> int:
    """Trials that the study asks for: a grid ends when it is complete."""
    if spec.sampler.kind == "grid":
        return min(spec.study.trials, grid_size(spec.ranges))
    return spec.study.trials


class TableSampler(BaseSampler):
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
        axes.append([min(r.high, r.low + k * r.step) for k in range(steps(r) + 1)])
    return [dict(zip(ranges, values, strict=True)) for values in product(*axes)]


def _sobol_points(spec: StudySpec) -> Sequence[dict[str, float]]:
    bits = max(3, int(np.ceil(np.log2(max(1, spec.study.trials)))))
    unit = _sobol(len(spec.ranges), bits, spec.study.seed)
    return [{n: scaled(r, v) for (n, r), v in zip(spec.ranges.items(), row, strict=True)} for row in unit]


@lru_cache(maxsize=4)
def _sobol(dimensions: int, bits: int, seed: int) -> Any:
    return qmc.Sobol(dimensions, scramble=True, rng=seed).random_base2(bits)
