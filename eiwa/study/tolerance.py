"""What is left of a design once it is made: its objectives under errors of manufacture, and with values of a catalogue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any
from zlib import crc32

import numpy as np

from eiwa.core.errors import EiwaError, SpecError
from eiwa.core.interfaces import Array
from eiwa.core.interval import Difference
from eiwa.core.outcome import Outcome, evaluate
from eiwa.core.spec import StudySpec
from eiwa.core.tree import lookup
from eiwa.study.probe import Told, difference

TAIL = 0.05
"""The quantile that is told: so few of the devices made are worse."""
RESAMPLES = 999
NEIGHBOURS = 32
"""The most combinations of catalogue values that are evaluated."""


@dataclass(frozen=True)
class Estimate:
    """A number from random draws, and its standard error."""

    value: float
    error: float


@dataclass(frozen=True)
class Effect:
    """How much of an objective's scatter an error at a path makes.

    ``per_deviation`` is the change for an error of one standard deviation, from a linear fit over all draws; ``share`` is
    its part of the objective's variance.
    """

    path: str
    per_deviation: Estimate
    share: float


@dataclass(frozen=True)
class Spread:
    """One objective over the draws; ``worst`` is the quantile on its bad side; ``linear`` the share that a line explains."""

    label: str
    nominal: float
    mean: Estimate
    deviation: Estimate
    worst: Estimate
    effects: Sequence[Effect]
    linear: float | None


@dataclass(frozen=True)
class Made:
    """A design made many times."""

    draws: int
    invalid: int
    """Draws that are no design: limits that cross, or an arm without dexterity."""
    broken: Mapping[str, int]
    """Constraint -> draws that break it; without inequalities of variables, which say nothing about a made device."""
    any_broken: int
    """Draws that break some constraint, or are invalid."""
    spreads: Sequence[Spread]


def errors(spec: StudySpec, draws: int) -> Array:
    """Errors at every path, (draws, paths): a path's depend on the seed and its name alone, so more draws add to them."""
    columns = [
        tolerance.errors(np.random.default_rng([spec.study.seed, crc32(path.encode())]), draws)
        for path, tolerance in spec.tolerance.items()
    ]
    return np.column_stack(columns)


def made(spec: StudySpec, alone: StudySpec, design: Mapping[str, Any], draws: int, told: Told) -> Made:
    """Evaluate a design with random errors of manufacture, all on the random streams of replicate 0.

    Parameters
    ----------
    spec
        The study, for its tolerances.
    alone
        What to evaluate (:func:`eiwa.study.probe.lean`).
    design
        Values at paths.
    draws
        How many devices are made.
    told
        Called after every evaluation: ``draws`` + 1 times.

    Raises
    ------
    SpecError
        A path of ``[tolerance]`` does not exist in the design.
    EiwaError
        The design itself cannot be evaluated, or hardly any draw can.
    """
    nominal = at_paths(alone, design, spec.tolerance, "tolerance")
    middle = evaluate(alone, design)
    told()
    drawn = errors(spec, draws)
    outcomes = []
    for row in drawn:
        strayed = {path: value + float(e) for (path, value), e in zip(nominal.items(), row, strict=True)}
        outcomes.append(_outcome(alone, {**design, **strayed}))
        told()
    valid = [k for k, outcome in enumerate(outcomes) if outcome is not None]
    if len(valid) < 2:
        raise EiwaError(
            f"{draws - len(valid)} of {draws} draws are no valid design: make the errors of [tolerance] smaller."
        )
    kept = [outcome for outcome in outcomes if outcome is not None]
    deviations = np.array([t.deviation for t in spec.tolerance.values()])
    spreads = [
        _spread(
            alone, k, middle, np.array([o.objectives[k] for o in kept], float), drawn[valid] / deviations, list(nominal)
        )
        for k in range(len(alone.objectives))
        if middle.objectives[k] is not None
    ]
    told_of = [(i, c) for i, c in enumerate(alone.constraints) if middle.violations[i] is not None]
    broken = {c.label: sum((o.violations[i] or 0.0) > 0 for o in kept) for i, c in told_of}
    unmet = sum(not o.feasible for o in kept)
    return Made(draws, draws - len(valid), broken, draws - len(valid) + unmet, spreads)


def at_paths(spec: StudySpec, design: Mapping[str, Any], paths: Mapping[str, Any], table: str) -> dict[str, float]:
    """The numbers that a design has at some paths.

    Raises
    ------
    SpecError
        The design has no such path.
    """
    resolved = spec.design(design).resolved()
    try:
        return {path: float(lookup(resolved, path)) for path in paths}
    except SpecError as error:
        raise SpecError(*(f"{table}: {line}" for line in error.findings)) from None


def _outcome(spec: StudySpec, overrides: Mapping[str, Any]) -> Outcome | None:
    try:
        return evaluate(spec, overrides)
    except EiwaError:
        return None


def _spread(spec: StudySpec, k: int, middle: Outcome, values: Array, standard: Array, paths: Sequence[str]) -> Spread:
    objective, nominal = spec.objectives[k], middle.objectives[k]
    assert nominal is not None
    bad = TAIL if objective.direction == "maximize" else 1 - TAIL
    rng = np.random.default_rng([spec.study.seed, k])
    resampled = values[rng.integers(len(values), size=(RESAMPLES, len(values)))]
    effects, linear = _linear(values, standard, paths)
    return Spread(
        objective.label,
        nominal,
        Estimate(float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))),
        Estimate(float(values.std(ddof=1)), float(resampled.std(axis=1, ddof=1).std())),
        Estimate(float(np.quantile(values, bad)), float(np.quantile(resampled, bad, axis=1).std())),
        effects,
        linear,
    )


def _linear(values: Array, standard: Array, paths: Sequence[str]) -> tuple[list[Effect], float | None]:
    """Least squares of the values on the errors in units of their deviations; nothing where draws are too few."""
    n, p = standard.shape
    total = float(np.sum((values - values.mean()) ** 2))
    if n < 2 * (p + 1) or total == 0:
        return [], None
    X = np.column_stack([np.ones(n), standard])
    slopes, *_ = np.linalg.lstsq(X, values)
    residual = float(np.sum((values - X @ slopes) ** 2))
    covariance = residual / (n - p - 1) * np.linalg.pinv(X.T @ X)
    found = [
        Effect(path, Estimate(float(b), float(np.sqrt(v))), float(b * b * np.sum((x - x.mean()) ** 2) / total))
        for path, b, v, x in zip(paths, slopes[1:], np.diag(covariance)[1:], standard.T, strict=True)
    ]
    return sorted(found, key=lambda effect: -abs(effect.per_deviation.value)), 1 - residual / total


@dataclass(frozen=True)
class Choice:
    """A design with values of the catalogue, evaluated with all replicates.

    ``change`` is its first objective less that of the design itself; ``tied`` says that it cannot be told from the best
    choice.
    """

    values: Mapping[str, float]
    outcome: Outcome
    change: Difference
    tied: bool


def neighbours(at: Mapping[str, float], catalogue: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Combinations of the catalogue's values next to a design's, below and above, the nearest first.

    Of more than :data:`NEIGHBOURS` combinations the nearest are kept, by the sum of squared distances in units of the gap
    between the two neighbours.
    """
    pairs = {path: _beside(at[path], values) for path, values in catalogue.items()}
    gaps = {path: max(max(pair) - min(pair), abs(at[path] - pair[0]), 1e-12) for path, pair in pairs.items()}
    found = [dict(zip(pairs, values, strict=True)) for values in product(*pairs.values())]
    found.sort(key=lambda values: sum(((v - at[p]) / gaps[p]) ** 2 for p, v in values.items()))
    return found[:NEIGHBOURS]


def _beside(value: float, offered: Sequence[float]) -> list[float]:
    """The offered values next to a value: one where it is offered itself, or lies beyond the ends."""
    below = [v for v in offered if v <= value]
    above = [v for v in offered if v >= value]
    return sorted({*below[-1:], *above[:1]})


def choices(
    spec: StudySpec, alone: StudySpec, design: Mapping[str, Any], replicates: int, told: Told
) -> tuple[Outcome, list[Choice]]:
    """The design itself, and its neighbours in the catalogue: feasible ones first, by the first objective.

    Every one is evaluated with so many replicates (2 or more), on the same random streams.
    """

    def at(values: Mapping[str, float]) -> Outcome:
        found = evaluate(alone, {**design, **values}, replicates)
        told()
        return found

    itself = at({})
    beside = neighbours(at_paths(alone, design, spec.catalogue, "catalogue"), spec.catalogue)
    found = [(values, at(values)) for values in beside]
    sign = -1.0 if alone.objectives[0].direction == "maximize" else 1.0
    found.sort(key=lambda item: (not item[1].feasible, sign * (item[1].objectives[0] or 0.0)))
    best = found[0][1]
    return itself, [
        Choice(values, outcome, difference(alone, 0, outcome, itself), not difference(alone, 0, outcome, best).real)
        for values, outcome in found
    ]
