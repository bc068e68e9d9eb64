"""One design under all scenarios of a study: metrics, objectives and constraints."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.design import Design
from eiwa.core.errors import PluginError, SpecError, blaming, finding, name_of
from eiwa.core.evaluation import Measurement, Setup, ergonomic_grid, field_stream, measure, metrics
from eiwa.core.interfaces import ErgonomicField, HumanModel, Operator
from eiwa.core.memory import require_memory
from eiwa.core.objectives import Aggregated, ObjectiveSection
from eiwa.core.scenarios import REFERENCE, Scenario
from eiwa.core.spec import StudySpec
from eiwa.core.workspace import Grid

MISFIT_FLOOR = 1e-4
"""Added to both sides of a misfit's ratio, so that F = 0 is far but not infinitely far."""

Numbers = Mapping[str, float | None]


@dataclass(frozen=True)
class Outcome:
    """What one design came to, by scenario label (the reference's is empty) and number, and in every replicate."""

    scenarios: Mapping[str, Numbers]
    objectives: Sequence[float | None]
    violations: Sequence[float | None]
    """Of every constraint, <= 0 where it is met; None where it says nothing about this design."""
    replicates: int
    operators: Mapping[str, Operator]
    """How the operator sat, by scenario label: what they adjusted is in here."""
    replicated: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    """Scenario label -> number -> its value in every replicate: what paired comparisons need; empty for one replicate."""
    replicated_objectives: Sequence[Sequence[float] | None] = ()

    @property
    def feasible(self) -> bool:
        """Whether no constraint is broken."""
        return all(v is None or v <= 0 for v in self.violations)


def evaluate(
    spec: StudySpec,
    overrides: Mapping[str, Any],
    replicates: int = 1,
    *,
    parameters: Mapping[str, float] | None = None,
    named: bool = False,
) -> Outcome:
    """Evaluate a design under every scenario, then its objectives and constraints.

    ``parameters`` are the variables that gave the overrides. ``named`` says that the overrides are a named design's own:
    an objective over all named designs then has no value.

    Raises
    ------
    SpecError
        The overrides do not make a valid design, or an objective has no value there.
    """
    measured = {s.label: m for s, m in measurements(spec, overrides, spec.scenarios, replicates)}
    scenarios = {label: declared(spec, metrics(m), m.setup) for label, m in measured.items()}
    alone = _alone(measured) if replicates > 1 else []
    objectives: list[float | None] = []
    spread: list[list[float] | None] = []
    for objective in spec.objectives:
        if objective.formula is None:
            objectives.append(None if named else misfit(spec, overrides))
            spread.append(None)
        else:
            objectives.append(_objective(objective, scenarios))
            spread.append([_objective(objective, numbers) for numbers in alone] or None)
    return Outcome(
        scenarios,
        objectives,
        _violations(spec, scenarios, spec.inequalities(overrides, parameters or {})),
        replicates,
        {label: m.setup.operator for label, m in measured.items()},
        _by_number(alone),
        spread,
    )


def _alone(measured: Mapping[str, Measurement]) -> list[dict[str, Numbers]]:
    """The numbers under every scenario of each replicate by itself."""
    count = len(measured[REFERENCE.label].replicates)
    return [
        {label: metrics(replace(m, replicates=[m.replicates[k]])) for label, m in measured.items()}
        for k in range(count)
    ]


def _by_number(alone: Sequence[Mapping[str, Numbers]]) -> dict[str, dict[str, list[float]]]:
    """Scenario label -> number -> values, of the numbers that every replicate has by itself."""
    result: dict[str, dict[str, list[float]]] = {}
    for label, first in alone[0].items() if alone else ():
        columns = {name: [numbers[label][name] for numbers in alone] for name in first}
        result[label] = {n: [v for v in values if v is not None] for n, values in columns.items() if None not in values}
    return result


def _violations(
    spec: StudySpec, scenarios: Mapping[str, Numbers], inequalities: Sequence[float | None]
) -> list[float | None]:
    found = []
    for constraint, violation in zip(spec.constraints, inequalities, strict=True):
        if constraint.metric is not None:
            violation = constraint.violation(
                [_number(numbers, constraint.metric, "constraints") for numbers in _seen(constraint, scenarios)]
            )
        found.append(violation)
    return found


def _seen(what: Aggregated, scenarios: Mapping[str, Numbers]) -> list[Numbers]:
    """The numbers of the scenarios that an objective or constraint looks at."""
    return list(scenarios.values()) if what.over == "scenarios" else [scenarios[REFERENCE.label]]


def _objective(objective: ObjectiveSection, scenarios: Mapping[str, Numbers]) -> float:
    needed = [
        {n: _number(numbers, n, "objectives") for n in objective.numbers} for numbers in _seen(objective, scenarios)
    ]
    return objective.value(needed)


def candidates(design: Design, seed: int) -> list[Setup]:
    """The design's setup, once for every way in which its operator may sit."""
    setup, adjust = design.setup(seed), design.adjust
    armrests = adjust.armrest.values if adjust.armrest else [setup.operator.armrest]
    seats = adjust.seat.values if adjust.seat else [setup.operator.seat]
    return [replace(setup, operator=Operator(armrest, seat)) for seat in seats for armrest in armrests]


def measurements(
    spec: StudySpec,
    overrides: Mapping[str, Any],
    scenarios: Sequence[Scenario] = (REFERENCE,),
    replicates: int = 1,
) -> list[tuple[Scenario, Measurement]]:
    """The design's measurement under each scenario, on one grid per voxel size that covers E of all of them.

    Scenarios that differ in the operator, or in the parameters of the dexterity index alone, share samples and kinematics;
    so do the ways in which an operator may sit, of which the one with the largest F of replicate 0 is taken.
    """
    designs = [spec.design({**overrides, **s.overrides}) for s in scenarios]
    setups = [candidates(d, spec.study.seed) for d in designs]
    boxes = [bounds(setup) for options in setups for setup in options]
    families: dict[str, list[int]] = {}
    for number, design in enumerate(designs):
        families.setdefault(design.masters, []).append(number)
    result: dict[int, Measurement] = {}
    for numbers in families.values():
        family = [setup for n in numbers for setup in setups[n]]
        grid = ergonomic_grid(boxes, family[0].r)
        require_memory(grid.cells, family[0].backend, family[0].r)
        fields = [[ergonomic_field(setup, grid, k) for k in range(replicates)] for setup in family]
        measured = iter(measure(family, grid, fields))
        for n in numbers:
            options = [next(measured) for _ in setups[n]]
            result[n] = max(options, key=_F) if len(options) > 1 else options[0]
    return [(scenario, result[number]) for number, scenario in enumerate(scenarios)]


def _F(measurement: Measurement) -> float:
    """F of replicate 0."""
    first = replace(measurement, replicates=measurement.replicates[:1])
    return measurement.setup.metrics["F"](first)["F"] or 0.0


def misfit(spec: StudySpec, overrides: Mapping[str, Any]) -> float:
    """Root mean square of ln((value + 1e-4) / (published + 1e-4)) over the named designs, overrides on top."""
    squares = []
    for design in spec.designs.values():
        if design.published:
            ((_, measurement),) = measurements(spec, {**design.overrides, **overrides})
            numbers = metrics(measurement)
            for name, published in design.published.items():
                value = _number(numbers, name, "designs")
                squares.append(math.log((value + MISFIT_FLOOR) / (published + MISFIT_FLOOR)) ** 2)
    return math.sqrt(sum(squares) / len(squares))


def _number(numbers: Numbers, name: str, table: str) -> float:
    value = numbers[name]
    if value is None or not math.isfinite(value):
        remedy = "F_se needs more than one replicate, so it cannot steer a search." if name == "F_se" else ""
        raise SpecError(finding(f"{table}: {name}", "has no value for this design.", value=value, remedy=remedy))
    return value


def declared(spec: StudySpec, numbers: Numbers, setup: Setup) -> Numbers:
    """The numbers of a setup's metrics, when they are what the metrics' records declare.

    Raises
    ------
    PluginError
        A number is missing, undeclared, not finite, or outside its declared bounds.
    """
    records = [spec.registry.find("metrics", name, f"metrics.{name}") for name in setup.metrics]
    known = {number.name: (record.name, number) for record in records for number in record.numbers}
    problems = [
        f"metric {m} did not return {name!r}, which it declares"
        for name, (m, _) in known.items()
        if name not in numbers
    ]
    problems += [f"a metric returned {name!r}, which none declares" for name in numbers if name not in known]
    if problems:
        raise PluginError("; ".join(problems))
    for name, (metric, number) in known.items():
        value = numbers[name]
        if value is not None and not number.low - 1e-9 <= value <= number.high + 1e-9:
            allowed = f"between {number.low:g} and {number.high:g}, or None where it does not apply"
            raise PluginError(f"metric {metric} returned {name} = {value}: it declares a number {allowed}")
    return numbers


def bounds(setup: Setup) -> NDArray[np.float64]:
    """The box in W that holds E > 0 of a setup's operator."""
    with blaming(setup.human):
        box = np.asarray(setup.human.bounds(setup.operator))
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
        raise PluginError(f"{name_of(setup.human)}: bounds must be [[low x, y, z], [high x, y, z]], not {box.tolist()}")
    return box


_fields: OrderedDict[Any, ErgonomicField] = OrderedDict()
FIELDS = 256 << 20
"""Bytes of ergonomic fields that are kept; those of the evaluation at hand are kept by itself."""


def ergonomic_field(setup: Setup, grid: Grid, replicate: int) -> ErgonomicField:
    """E of one replicate, computed once per operator, grid and stream."""
    stream = field_stream(setup.seed, replicate)
    key = (setup.human_key, setup.operator, grid, stream)
    if key not in _fields:
        with blaming(setup.human):
            found = setup.human.field(grid, setup.operator, stream)
        _refuse_field(setup.human, found, grid)
        _fields[key] = found
        while len(_fields) > 1 and sum(E.right.nbytes + E.left.nbytes for E in _fields.values()) > FIELDS:
            _fields.popitem(last=False)
    _fields.move_to_end(key)
    return _fields[key]


def _refuse_field(human: HumanModel, field: ErgonomicField, grid: Grid) -> None:
    for hand, E in (("right", field.right), ("left", field.left)):
        if np.shape(E) != grid.shape:
            raise PluginError(
                f"{name_of(human)}: E of the {hand} hand must have the grid's shape {grid.shape}, not {np.shape(E)}"
            )
        if not (np.min(E) >= 0 and np.max(E) <= 1):
            seen = f"{np.min(E):g} to {np.max(E):g}"
            raise PluginError(f"{name_of(human)}: E of the {hand} hand must lie in [0, 1], not {seen}")
