"""One design under all scenarios of a study: metrics, objectives and constraints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.errors import PluginError, SpecError, blaming, finding, name_of
from eiwa.core.evaluation import Measurement, Setup, ergonomic_grid, field_stream, measure, metrics
from eiwa.core.interfaces import ErgonomicField, HumanModel
from eiwa.core.memory import require_memory
from eiwa.core.sections import ObjectiveSection
from eiwa.core.spec import REFERENCE, Scenario, StudySpec
from eiwa.core.workspace import Grid

MISFIT_FLOOR = 1e-4
"""Added to both sides of a misfit's ratio, so that F = 0 is far but not infinitely far."""

Numbers = Mapping[str, float | None]


@dataclass(frozen=True)
class Outcome:
    """What one design came to: numbers per scenario label (the reference's is empty), values, violations (<= 0: met)."""

    scenarios: Mapping[str, Numbers]
    objectives: Sequence[float | None]
    violations: Sequence[float]
    replicates: int
    replicated: Mapping[str, Sequence[float]]
    """Number -> its value in every replicate, at the reference: what paired comparisons need."""

    @property
    def feasible(self) -> bool:
        """Whether every constraint is met."""
        return all(v <= 0 for v in self.violations)


def evaluate(spec: StudySpec, overrides: Mapping[str, Any], replicates: int = 1, *, named: bool = False) -> Outcome:
    """Evaluate a design under every scenario, then its objectives and constraints.

    ``named`` says that the overrides are a named design's own: an objective over all named designs then has no value.

    Raises
    ------
    SpecError
        The overrides do not make a valid design, or an objective has no value there.
    """
    measured = {s.label: m for s, m in measurements(spec, overrides, spec.scenarios, replicates)}
    scenarios = {label: declared(spec, metrics(m), m.setup) for label, m in measured.items()}
    reference = scenarios[REFERENCE.label]
    violations = []
    for constraint in spec.constraints:
        violations.append(constraint.violation(_number(reference, constraint.metric, "constraints")))
    objectives = [
        None if named and objective.over == "designs" else _objective(spec, objective, scenarios, overrides)
        for objective in spec.objectives
    ]
    replicated = {"F": replicate_values(measured[REFERENCE.label])} if replicates > 1 else {}
    return Outcome(scenarios, objectives, violations, replicates, replicated)


def replicate_values(measurement: Measurement) -> list[float]:
    """F of every replicate."""
    metric = measurement.setup.metrics["F"]
    alone = [metric(replace(measurement, replicates=[replicate]))["F"] for replicate in measurement.replicates]
    return [value for value in alone if value is not None]


def measurements(
    spec: StudySpec,
    overrides: Mapping[str, Any],
    scenarios: Sequence[Scenario] = (REFERENCE,),
    replicates: int = 1,
) -> list[tuple[Scenario, Measurement]]:
    """The design's measurement under each scenario, on one grid per voxel size that covers E of all of them.

    Scenarios that differ in the dexterity index alone share samples and kinematics.
    """
    designs = [spec.design({**overrides, **s.overrides}) for s in scenarios]
    setups = [d.setup(spec.study.seed) for d in designs]
    boxes = [bounds(s) for s in setups]
    families: dict[str, list[int]] = {}
    for number, design in enumerate(designs):
        families.setdefault(design.kinematics, []).append(number)
    result: dict[int, Measurement] = {}
    for numbers in families.values():
        first = setups[numbers[0]]
        grid = ergonomic_grid(boxes, first.r)
        require_memory(grid.cells, first.backend, first.r)
        fields = [ergonomic_field(first, grid, k) for k in range(replicates)]
        result.update(zip(numbers, measure([setups[n] for n in numbers], grid, fields), strict=True))
    return [(scenario, result[number]) for number, scenario in enumerate(scenarios)]


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


def _objective(
    spec: StudySpec,
    objective: ObjectiveSection,
    scenarios: Mapping[str, Numbers],
    overrides: Mapping[str, Any],
) -> float:
    if objective.over == "designs":
        return misfit(spec, overrides)
    assert objective.metric is not None
    labels = list(scenarios) if objective.over == "scenarios" else [REFERENCE.label]
    values = [_number(scenarios[label], objective.metric, "objectives") for label in labels]
    if objective.aggregate == "mean":
        return sum(values) / len(values)
    return min(values) if objective.aggregate == "min" else max(values)


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


_fields: dict[Any, ErgonomicField] = {}
KEPT_FIELDS = 32


def ergonomic_field(setup: Setup, grid: Grid, replicate: int) -> ErgonomicField:
    """E of one replicate, computed once per operator, grid and stream."""
    stream = field_stream(setup.seed, replicate)
    key = (setup.human_key, setup.operator, grid, stream)
    if key not in _fields:
        if len(_fields) >= KEPT_FIELDS:
            del _fields[next(iter(_fields))]
        with blaming(setup.human):
            field = setup.human.field(grid, setup.operator, stream)
        _refuse_field(setup.human, field, grid)
        _fields[key] = field
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
