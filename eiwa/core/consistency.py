"""What must hold between the tables of a study file, once each is valid by itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from eiwa.core.design import SECTIONS, Design
from eiwa.core.errors import SpecError, finding
from eiwa.core.named import parted
from eiwa.core.samplers import Cmaes, Grid
from eiwa.core.tree import Tree, did_you_mean, exists, lookup

if TYPE_CHECKING:
    from eiwa.core.spec import StudySpec


def findings(spec: StudySpec, base: Design) -> list[str]:
    """Everything that is wrong; variants of the design are tried only when all else is right."""
    first = [line for check in (_paths, _numbers, _budget, _sampler) for line in check(spec, base)]
    return list(dict.fromkeys(first or _variants(spec)))


def _paths(spec: StudySpec, base: Design) -> Iterable[str]:
    """Every path that something changes must exist; searched ones must hold a number."""
    resolved = spec.defaults
    axes = [path for path in spec.tree.get("scenarios", {}) if "." in path]
    uses = [(f'search."{p}"', p, True) for p in spec.searched]
    uses += [(f'{table}."{p}"', p, True) for table in ("tolerance", "catalogue") for p in getattr(spec, table)]
    uses += [(f'scenarios."{p}"', p, False) for p in axes]
    for path in spec.assumptions:
        if not exists(spec.resolved, path):
            yield finding(f'assumptions."{path}"', "the study has no such path.")
    yield from _missing(resolved, uses)
    variants: list[tuple[str, Mapping[str, Any]]] = [
        (f"designs.{name}", d.overrides) for name, d in spec.designs.items()
    ]
    variants += [(f"scenarios.{s.label}", s.overrides) for s in spec.scenarios if s.overrides.keys() - axes]
    yield from _contested(spec, axes)
    for where, overrides in variants:
        tables, values = parted(overrides)
        try:
            known = spec.defaults_with(tables)
        except SpecError as error:
            yield from (f"{where}: {line}" for line in error.findings)
            continue
        yield from _missing(known, [(f'{where}."{path}"', path, False) for path in values if path not in axes])


def _contested(spec: StudySpec, axes: Iterable[str]) -> Iterable[str]:
    """One value has one master: the search, the scenarios, or the operator who adjusts it."""
    for path in axes:
        if path in spec.searched:
            remedy = "Take it out of [search], or out of [scenarios]."
            yield finding(f'scenarios."{path}"', "the search chooses this value already.", remedy=remedy)
    for scenario in spec.scenarios:
        try:
            adjust = spec.design(scenario.overrides).adjust
        except SpecError:
            continue
        for what in ("armrest", "seat"):
            path = f"operator.{what}"
            if getattr(adjust, what) and (path in spec.searched or path in scenario.overrides):
                where = "search" if path in spec.searched else "scenarios"
                remedy = f"Take it out of [{where}], or out of operator.adjust."
                yield finding(f'{where}."{path}"', "the operator adjusts this value already.", remedy=remedy)


def _missing(resolved: Tree, uses: Iterable[tuple[str, str, bool]]) -> Iterable[str]:
    for where, path, numeric in uses:
        table = path.split(".")[0]
        if table not in SECTIONS:
            yield finding(where, f"nothing of {table!r} can change here{did_you_mean(table, SECTIONS)}")
            continue
        try:
            value = lookup(resolved, path)
        except SpecError as error:
            yield f"{where}: {error.findings[0].split(': ', 1)[1]}"
            continue
        if numeric and (isinstance(value, bool) or not isinstance(value, int | float)):
            yield finding(where, f"the path holds {value!r}, not a number.", remedy="Name one number at a time.")


def _numbers(spec: StudySpec, base: Design) -> Iterable[str]:
    """Metrics that something reads must exist, and constraints must be possible."""
    numbers = spec.registry.numbers()
    uses = [
        (f"objectives.{i}.{'metric' if o.metric else 'expression'}", number)
        for i, o in enumerate(spec.objectives)
        for number in ([o.metric] if o.metric is not None else sorted(o.numbers))
    ]
    uses += [(f"constraints.{i}.metric", c.metric) for i, c in enumerate(spec.constraints) if c.metric]
    uses += [(f"designs.{n}.published.{m}", m) for n, d in spec.designs.items() for m in d.published]
    for where, name in uses:
        if name not in numbers:
            yield finding(where, f"no metric yields {name!r}{did_you_mean(name, numbers)}")
    for i, constraint in enumerate(spec.constraints):
        if constraint.metric in numbers:
            number = numbers[constraint.metric][1]
            what, least, most = number.name, number.low, number.high
            if constraint.level is not None:
                what, least, most = "a share", 0.0, 1.0
            low = -float("inf") if constraint.min is None else constraint.min
            high = float("inf") if constraint.max is None else constraint.max
            if low > most or high < least:
                allowed = f"{what} lies between {least:g} and {most:g}."
                yield finding(f"constraints.{i}", f"nothing can meet {constraint.label}: {allowed}")
    yield from _inequalities(spec)
    yield from _aggregated(spec)
    seen: dict[str, int] = {}
    for i, objective in enumerate(spec.objectives):
        if (first := seen.setdefault(objective.label, i)) != i:
            problem = f"is called {objective.label!r}, as objectives.{first} is."
            yield finding(f"objectives.{i}", problem, remedy='Remove one, or give it another name = "...".')
    published = [n for n, d in spec.designs.items() if d.published]
    if any(o.aggregate == "misfit" for o in spec.objectives) and not published:
        yield finding("objectives", "misfit needs a named design with published values.")
    if any(o.aggregate == "misfit" for o in spec.objectives):
        for name, d in spec.designs.items():
            for metric, value in d.published.items():
                if value < 0:
                    problem = "misfit takes logarithms: the value must not be negative."
                    yield finding(f"designs.{name}.published.{metric}", problem, value=value)


def _inequalities(spec: StudySpec) -> Iterable[str]:
    """Inequalities read variables, and paths that hold a number."""
    variables = {*spec.ranges, *spec.expressions}
    for i, constraint in enumerate(spec.constraints):
        where = f"constraints.{i}.expression"
        for name in sorted(constraint.inequality.names - variables) if constraint.inequality else ():
            value = lookup(spec.defaults, name) if exists(spec.defaults, name) else None
            if isinstance(value, bool) or not isinstance(value, int | float):
                yield finding(where, _unreadable(spec, name, variables), value=constraint.expression)


def _unreadable(spec: StudySpec, name: str, variables: Iterable[str]) -> str:
    """Why an inequality cannot read a name."""
    known = did_you_mean(name, (v for v in variables if v.isidentifier()))
    if name in spec.registry.numbers():
        return f'{name} is a metric, not a parameter: write metric = "{name}" with min or max instead.'
    if name.split(".")[0] in SECTIONS and "." in name:
        try:
            known = f", but {lookup(spec.defaults, name)!r}."
        except SpecError as error:
            known = f": {error.findings[0].partition(': ')[2]}"
        return f"{name} holds no number{known}"
    return f"{name} is neither a variable nor a path that holds a number{known}"


def _aggregated(spec: StudySpec) -> Iterable[str]:
    """What aggregates over scenarios needs some."""
    for table in ("objectives", "constraints"):
        for i, what in enumerate(getattr(spec, table)):
            if what.over == "scenarios" and not spec.tree.get("scenarios"):
                remedy = 'Add [scenarios] with "dexterity.K" = [50, 12270], say.'
                yield finding(f"{table}.{i}.over", "the study has no scenarios.", value="scenarios", remedy=remedy)


def _sampler(spec: StudySpec, base: Design) -> Iterable[str]:
    """CMA-ES follows one objective."""
    if isinstance(spec.sampler, Cmaes) and len(spec.objectives) > 1:
        remedy = "Use 'tpe', 'nsga2' or 'gp', or one objective."
        yield finding(
            "study.sampler", f"follows one objective, not {len(spec.objectives)}.", value="cmaes", remedy=remedy
        )


def _variants(spec: StudySpec) -> Iterable[str]:
    """Named designs and scenarios must be designs; so must the corners of the search."""
    variants: list[tuple[str, Mapping[str, Any]]] = [(f"designs.{n}", d.overrides) for n, d in spec.designs.items()]
    variants += [(f"scenarios {s.label}", s.overrides) for s in spec.scenarios]
    for end in ("low", "high"):
        corner = {name: getattr(r, end) for name, r in spec.ranges.items()}
        try:
            variants.append((f"search, every variable at its {end} end", spec.overrides(corner)))
            spec.inequalities(variants[-1][1], corner)
        except SpecError as error:
            yield from error.findings
    for where, overrides in variants:
        try:
            spec.design(overrides)
        except SpecError as error:
            yield from (f"{where}: {line}" for line in error.findings)


def _budget(spec: StudySpec, base: Design) -> Iterable[str]:
    """A search needs something to vary and something to optimise."""
    if spec.study.trials and not spec.ranges:
        yield finding("study.trials", "there is nothing to vary.", value=spec.study.trials, remedy="Add [search].")
    if spec.study.trials and not spec.objectives:
        remedy = 'Add [[objectives]] with metric = "F" and direction = "maximize".'
        yield finding("study.trials", "there is no objective.", value=spec.study.trials, remedy=remedy)
    if spec.defaults["sampling"]["estimator"] == "elites" and spec.defaults["voxels"].get("aggregate") != "max":
        remedy = 'Use estimator = "plain" or "sobol", or aggregate = "max".'
        yield finding("sampling.estimator", "elites search the largest value per voxel.", value="elites", remedy=remedy)
    unused = set(spec.ranges) - set(spec.searched)
    unused -= {name for e in spec.expressions.values() for name in e.names}
    for name in sorted(unused):
        yield finding(f"variables.{name}", "no expression reads it.", remedy="Use it in [search], or remove it.")
    if isinstance(spec.sampler, Grid):
        for name, r in spec.ranges.items():
            if r.step is None:
                where = f"variables.{name}" if name in spec.tree.get("variables", {}) else f'search."{name}"'
                yield finding(where, "sampler = 'grid' needs a step.", remedy="Add step = ... to it.")
