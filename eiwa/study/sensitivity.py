"""Which variables an objective depends on: over the search, around a design, and shares of its variance."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from scipy.stats import qmc, sobol_indices

from eiwa.core.errors import EiwaError
from eiwa.core.interfaces import Array
from eiwa.core.interval import LEVEL, Difference
from eiwa.core.outcome import Outcome, evaluate
from eiwa.core.sections import RangeSection
from eiwa.core.spec import StudySpec
from eiwa.study import journal
from eiwa.study.leaders import parameters
from eiwa.study.probe import Told, difference
from eiwa.study.rows import Row
from eiwa.study.sampler import distributions

TOP = 0.1
"""PED-ANOVA asks what tells this share of the trials, the best, from all."""
LEAST_TRIALS = 20
STEP = 0.02
"""How far to both sides of the design a slope is measured, as a share of the variable's range."""
LEVELS = 5
RESAMPLES = 999


def importances(spec: StudySpec, rows: Sequence[Row], objective: int) -> dict[str, float] | None:
    """PED-ANOVA over the feasible trials: how much each variable tells the best tenth from all, shares of 1.

    None where there are too few trials. Optuna's evaluator ranks for low values, so a maximised objective is negated.

    References
    ----------
    S. Watanabe, A. Bansal and F. Hutter, "PED-ANOVA: Efficiently quantifying hyperparameter importance in arbitrary
    subspaces", IJCAI 2023.
    """
    sign = -1.0 if spec.objectives[objective].direction == "maximize" else 1.0
    trials = [r for r in rows if r["kind"] == "trial" and r["state"] == "COMPLETE" and r["feasible"]]
    if len(trials) < LEAST_TRIALS:
        return None
    known = distributions(spec)
    journal.quiet()
    study = optuna.create_study(direction="minimize")
    for row in trials:
        value = sign * row[f"objectives.{objective}"]
        study.add_trial(optuna.trial.create_trial(params=parameters(row), distributions=known, value=value))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        found = get_param_importances(study, evaluator=PedAnovaImportanceEvaluator(target_quantile=TOP))
    return {name: float(found.get(name, 0.0)) for name in spec.ranges}


@dataclass(frozen=True)
class Effect:
    """One variable moved, all others kept: per objective what changes against the design.

    ``changes`` belong to ``levels``; ``slopes`` are per unit of the variable, at the design. A change is None where an
    objective has no replicates to compare.
    """

    variable: str
    value: float
    levels: Sequence[float]
    changes: Sequence[Sequence[Difference]]
    feasible: Sequence[bool]
    slopes: Sequence[Difference]


def box(spec: StudySpec, variables: Mapping[str, float], share: float | None) -> dict[str, tuple[float, float]]:
    """Where each variable may go: its range, or so large a share of it to both sides of its value."""
    if share is None:
        return {name: (r.low, r.high) for name, r in spec.ranges.items()}
    return {name: _beside(r, variables[name], share) for name, r in spec.ranges.items()}


def _beside(r: RangeSection, value: float, share: float) -> tuple[float, float]:
    """So large a share of the range to both sides of a value, within the range; of its logarithm where that is searched."""
    if r.log:
        factor = (r.high / r.low) ** share
        return max(r.low, value / factor), min(r.high, value * factor)
    reach = share * (r.high - r.low)
    return max(r.low, value - reach), min(r.high, value + reach)


def one_at_a_time(
    spec: StudySpec,
    base: Mapping[str, Any],
    variables: Mapping[str, float],
    limits: Mapping[str, tuple[float, float]],
    replicates: int,
    told: Told,
) -> list[Effect]:
    """Each variable at levels over its limits, and a little to both sides, on the random streams of the design itself.

    Parameters
    ----------
    spec
        The study, whose every objective is looked at.
    base
        Values that the design has beside those of its variables.
    variables, limits
        The design's variables, and where each may go.
    replicates
        Shared random streams; the error of a change comes from two or more.
    told
        Called after every evaluation, of which there are :func:`cost_of_one_at_a_time`.
    """

    def at(**moved: float) -> Outcome:
        values = {**variables, **moved}
        found = _evaluated(spec, base, values, replicates)
        told()
        return found

    middle, effects = at(), []
    for name, r in spec.ranges.items():
        levels = _levels(r, limits[name])
        outcomes = [at(**{name: level}) for level in levels]
        ends = _beside(r, variables[name], STEP)
        below, above = (at(**{name: end}) for end in ends)
        slopes = [difference(spec, k, above, below, 1 / (ends[1] - ends[0])) for k in range(len(spec.objectives))]
        changes = [[difference(spec, k, o, middle) for k in range(len(spec.objectives))] for o in outcomes]
        effects.append(
            Effect(name, variables[name], levels, changes, [outcome.feasible for outcome in outcomes], slopes)
        )
    return effects


def _evaluated(
    spec: StudySpec, base: Mapping[str, Any], variables: Mapping[str, float], replicates: int = 1
) -> Outcome:
    try:
        return evaluate(spec, {**base, **spec.overrides(variables)}, replicates, parameters=variables)
    except EiwaError as error:
        where = ", ".join(f"{name} = {value:.4g}" for name, value in variables.items())
        remedy = "Stay nearer to the design with --share, or narrow [variables] and [search]."
        raise EiwaError(f"{where}: this design cannot be evaluated: {error} {remedy}") from None


def cost_of_one_at_a_time(spec: StudySpec) -> int:
    """Evaluations with all replicates."""
    return 1 + len(spec.ranges) * (LEVELS + 2)


def _levels(r: RangeSection, limits: tuple[float, float]) -> list[float]:
    spaced = np.geomspace if r.log else np.linspace
    return [float(level) for level in spaced(*limits, LEVELS)]


@dataclass(frozen=True)
class Index:
    """A Sobol index with its bootstrap confidence interval (95 %)."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Sobol:
    """Of one output: the variance, and for every variable its share alone (first order) and in all (total order)."""

    variance: float
    first: Sequence[Index]
    total: Sequence[Index]


def sobol(
    function: Callable[[Array], Array], limits: Sequence[tuple[float, float]], n: int, seed: int
) -> list[Sobol | None]:
    """Sobol indices of a function of independent, uniform variables; None for an output that does not vary.

    Parameters
    ----------
    function
        From points (k, d) to outputs (k, s); called once, with n (d + 2) points.
    limits
        Lower and upper end of each of the d variables.
    n
        A power of two.
    seed
        Of the scrambled Sobol points and of the bootstrap.

    References
    ----------
    A. Saltelli et al., "Variance based sensitivity analysis of model output. Design and estimator for the total
    sensitivity index", Computer Physics Communications 181 (2010).
    """
    d, ends = len(limits), np.array(limits)
    points = qmc.Sobol(2 * d, scramble=True, rng=np.random.default_rng([seed, 0])).random(n)
    A, B = (ends[:, 0] + u * (ends[:, 1] - ends[:, 0]) for u in (points[:, :d], points[:, d:]))
    AB = np.repeat(A[None], d, axis=0)
    AB[np.arange(d), :, np.arange(d)] = B.T
    values = function(np.concatenate([A, B, *AB]))
    f_A, f_B, *f_AB = values.reshape(d + 2, n, -1).transpose(0, 2, 1)
    rng = np.random.default_rng([seed, 1])
    resamples = [np.arange(n), *(rng.integers(n, size=n) for _ in range(RESAMPLES))]
    return [_indices(f_A[k], f_B[k], np.stack(f_AB)[:, k], resamples) for k in range(values.shape[1])]


def _indices(f_A: Array, f_B: Array, f_AB: Array, resamples: Sequence[Any]) -> Sobol | None:
    variance = float(np.var([f_A, f_B]))
    if variance <= 1e-24 * max(1.0, float(np.mean(f_A)) ** 2):
        return None
    first, total = [], []
    pages = np.concatenate([f_AB, f_AB[:1]])  # SciPy fails for one variable alone
    for chosen in resamples:
        picked = {"f_A": f_A[None, chosen], "f_B": f_B[None, chosen], "f_AB": pages[:, None, chosen]}
        with np.errstate(all="ignore"):  # a resample may hold equal values only
            found = sobol_indices(func=picked, n=len(f_A))
        first.append(found.first_order[:-1])
        total.append(found.total_order[:-1])
    return Sobol(variance, _with_interval(np.array(first)), _with_interval(np.array(total)))


def _with_interval(resampled: Array) -> list[Index]:
    """The first row's values, with quantiles of the others."""
    low, high = np.nanquantile(resampled[1:], [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    return [Index(*map(float, index)) for index in zip(resampled[0], low, high, strict=True)]


def sobol_of_objectives(
    spec: StudySpec, base: Mapping[str, Any], limits: Mapping[str, tuple[float, float]], n: int, told: Told
) -> list[Sobol | None]:
    """Sobol indices of every objective over the box of the variables, with replicate 0 for every design.

    A variable that is searched by its logarithm is uniform in that.
    """
    logs = np.array([r.log for r in spec.ranges.values()])
    ends = np.array([limits[name] for name in spec.ranges])
    ends[logs] = np.log(ends[logs])

    def function(points: Array) -> Array:
        rows = []
        points[:, logs] = np.exp(points[:, logs])
        for point in points:
            values = dict(zip(spec.ranges, map(float, point), strict=True))
            found = _evaluated(spec, base, values)
            rows.append([np.nan if value is None else value for value in found.objectives])
            told()
        return np.array(rows)

    return sobol(function, [(float(low), float(high)) for low, high in ends], n, spec.study.seed)


def cost_of_sobol(spec: StudySpec, n: int) -> int:
    """Evaluations with one replicate.

    Raises
    ------
    EiwaError
        n is no power of two.
    """
    if n & (n - 1):
        near = 1 << (n.bit_length() - 1)
        raise EiwaError(f"--sobol {n}: must be a power of two, such as {near} or {2 * near}; 0 leaves the indices out.")
    return n * (len(spec.ranges) + 2)
