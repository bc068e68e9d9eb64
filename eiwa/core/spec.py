"""The study file: read, checked as a whole, and turned into designs."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from eiwa.core import consistency
from eiwa.core import registry as plugins
from eiwa.core.design import SECTIONS, Design, design
from eiwa.core.errors import EiwaError, SpecError, finding
from eiwa.core.expressions import Expression, in_order
from eiwa.core.findings import validated
from eiwa.core.manufacture import ToleranceSection, catalogue, tolerances
from eiwa.core.named import named_design, parted, pinned, refuse_unquoted
from eiwa.core.objectives import ConstraintSection, ObjectiveSection
from eiwa.core.registry import Registry
from eiwa.core.samplers import Auto, Chosen, automatic
from eiwa.core.scenarios import Scenario, scenarios
from eiwa.core.sections import (
    DesignSection,
    ExecutionSection,
    RangeSection,
    StudySection,
)
from eiwa.core.tree import Tree, did_you_mean, exists, leaves, lookup, replaced

TABLES = (
    "study", "plugins", *SECTIONS, "variables", "search", "scenarios", "objectives", "constraints", "designs",
    "tolerance", "catalogue", "assumptions", "execution",
)  # fmt: skip
M = TypeVar("M", ObjectiveSection, ConstraintSection)


@dataclass(frozen=True, eq=False)
class StudySpec:
    """A validated study file."""

    path: Path
    tree: Tree
    registry: Registry
    study: StudySection
    ranges: Mapping[str, RangeSection]
    expressions: Mapping[str, Expression]
    searched: Mapping[str, str]
    """Path -> name of the variable that drives it."""
    scenarios: Sequence[Scenario]
    objectives: Sequence[ObjectiveSection]
    constraints: Sequence[ConstraintSection]
    designs: Mapping[str, DesignSection]
    tolerance: Mapping[str, ToleranceSection]
    catalogue: Mapping[str, Sequence[float]]
    assumptions: Mapping[str, str]
    execution: ExecutionSection
    defaults: Tree
    """The design tables with every default written out."""

    @cached_property
    def needed(self) -> frozenset[str]:
        """Metric numbers that objectives, constraints and published values read."""
        named = {number for o in self.objectives for number in o.numbers}
        named |= {c.metric for c in self.constraints if c.metric}
        return frozenset(named | {metric for d in self.designs.values() for metric in d.published})

    @cached_property
    def sampler(self) -> Chosen:
        """How the search proposes designs, ``auto`` decided."""
        named = self.study.sampler
        return automatic(self)[0] if isinstance(named, Auto) else named

    @cached_property
    def _order(self) -> list[str]:
        return in_order(self.expressions, frozenset(self.ranges))

    def design(self, overrides: Mapping[str, Any]) -> Design:
        """The design with other values at some paths, validated as if the user had written it."""
        return design(self.replaced(overrides), self.registry, self.needed)

    def replaced(self, overrides: Mapping[str, Any]) -> Tree:
        """The study file with other values at some paths; paths lead into whole tables that are replaced first."""
        tables, values = parted(overrides)
        return replaced({**self.tree, **tables}, values, self.defaults_with(tables))

    def defaults_with(self, tables: Tree) -> Tree:
        """:attr:`defaults`, where some tables are replaced."""
        if not tables:
            return self.defaults
        return {**self.defaults, **design({**self.tree, **tables}, self.registry).resolved()}

    def values(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Values of all variables, from those that the sampler chose.

        Raises
        ------
        SpecError
            An expression has no finite value there.
        """
        values = dict(parameters)
        for name in self._order:
            values[name] = self.expressions[name].evaluate(values)
        return values

    def overrides(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Values at the searched paths, from the sampler's parameters; raises as :meth:`values`."""
        values = self.values(parameters)
        return {path: values[name] for path, name in self.searched.items()}

    def inequalities(self, overrides: Mapping[str, Any], parameters: Mapping[str, float]) -> list[float | None]:
        """Violation of every constraint that is an inequality; None for others, and where a variable has no value.

        A named design gives its overrides alone, so an inequality that reads variables says nothing about it.
        """
        known: dict[str, Any] = {**self.values(parameters), **overrides} if parameters else dict(overrides)
        resolved = self.defaults_with(parted(overrides)[0])
        found: list[float | None] = []
        for inequality in (c.inequality for c in self.constraints):
            names = inequality.names if inequality else frozenset()
            known |= {n: lookup(resolved, n) for n in names if n not in known and exists(resolved, n)}
            found.append(inequality.violation(known) if inequality and names <= known.keys() else None)
        return found

    @cached_property
    def resolved(self) -> Tree:
        """All that the study says, defaults written out."""
        tree = self.design({}).resolved()
        tree["study"] = self.study.model_dump(mode="json") | {"sampler": self.sampler.model_dump(mode="json")}
        tree["variables"] = {n: r.model_dump(mode="json") for n, r in self.ranges.items()}
        tree["variables"] |= {n: e.text for n, e in self.expressions.items()}
        tree["search"] = dict(self.searched)
        tree["scenarios"] = {s.label or s.title: dict(s.overrides) for s in self.scenarios}
        tree["objectives"] = [o.model_dump(mode="json") for o in self.objectives]
        tree["constraints"] = [c.model_dump(mode="json") for c in self.constraints]
        tree["designs"] = {name: d.model_dump(mode="json") for name, d in self.designs.items()}
        tree["plugin files"] = dict(self.registry.digests)
        tree["execution"] = self.execution.model_dump(mode="json")
        return tree

    @cached_property
    def identity(self) -> Tree:
        """The part of :attr:`resolved` that changes a trial's numbers."""
        tree = {k: v for k, v in self.resolved.items() if k not in ("designs", "execution")}
        tree["study"] = {k: v for k, v in tree["study"].items() if k not in ("name", "trials")}
        if any(o.over == "designs" for o in self.objectives):
            tree["designs"] = self.resolved["designs"]
        return tree

    @cached_property
    def hash(self) -> str:
        """Hash of :attr:`identity`."""
        return digest(self.identity)


def digest(value: Any) -> str:
    """A short hash of plain values."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def load(path: Path, settings: Mapping[str, Any] | None = None) -> StudySpec:
    """Read and check a study file.

    Parameters
    ----------
    path
        The TOML file.
    settings
        Values to put at some paths first (``--set``).

    Raises
    ------
    SpecError
        The file cannot be read or says something that cannot be.
    """
    tree = read(path)
    if settings:
        tree = replaced(tree, settings, _defaults(tree, path))
    return check(tree, path)


def read(path: Path) -> Tree:
    """A study file as it is written.

    Raises
    ------
    SpecError
        The file cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise SpecError(f"{path}: cannot be read: {error.strerror}. Give the path of a study file.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SpecError(f"{path}: is not TOML: {error}.") from None


def registry_of(tree: Tree, path: Path, located: Mapping[str, Path] | None = None) -> Registry:
    """The plugins that a study file can name, its own files among them."""
    return plugins.load(_plugin_files(tree), path.parent, located)


def _defaults(tree: Tree, path: Path) -> Tree:
    """What the file alone resolves to; nothing where it is not valid by itself."""
    try:
        return check(tree, path).resolved
    except EiwaError:
        return {}


def check(tree: Tree, path: Path, located: Mapping[str, Path] | None = None) -> StudySpec:
    """Check a study file's tree.

    The files that it names are looked for beside ``path``, but for those that were ``located`` elsewhere.
    """
    unknown = [finding(key, f"unknown table{did_you_mean(key, TABLES)}") for key in tree if key not in TABLES]
    if unknown:
        raise SpecError(*unknown)
    registry = registry_of(tree, path, located)
    findings: list[str] = []
    base: Design | None = None
    try:
        base = design(tree, registry)
    except SpecError as error:
        findings.extend(error.findings)
    defaults = {**base.resolved(), "metrics": _metric_defaults(registry, base)} if base is not None else {}
    try:
        spec = StudySpec(
            path, tree, registry, validated(StudySection, tree.get("study", {}), "study"), *_search(tree),
            scenarios=scenarios(_table(tree, "scenarios"), tree, defaults, registry),
            objectives=_list(tree, "objectives", ObjectiveSection),
            constraints=_list(tree, "constraints", ConstraintSection),
            designs={n: named_design(n, t, registry) for n, t in _table(tree, "designs").items()},
            tolerance=tolerances(_table(tree, "tolerance")),
            catalogue=catalogue(_table(tree, "catalogue")),
            assumptions=_assumptions(tree),
            execution=validated(ExecutionSection, tree.get("execution", {}), "execution"),
            defaults=defaults,
        )  # fmt: skip
    except SpecError as error:
        raise SpecError(*findings, *error.findings) from None
    if base is None:
        raise SpecError(*findings)
    if findings := consistency.findings(spec, base):
        raise SpecError(*findings)
    return _pinned(spec)


def _pinned(spec: StudySpec) -> StudySpec:
    """The study with the files that it names known by their content: one that changes later is told."""
    tree = {**spec.tree, **{s: pinned(spec.tree[s], spec.defaults.get(s)) for s in SECTIONS if s in spec.tree}}

    def at(overrides: Mapping[str, Any]) -> dict[str, Any]:
        resolved = spec.design(overrides).resolved()
        return {p: pinned(v, lookup(resolved, p) if exists(resolved, p) else None) for p, v in overrides.items()}

    designs = {n: d.model_copy(update={"overrides": at(d.overrides)}) for n, d in spec.designs.items()}
    return replace(
        spec, tree=tree, designs=designs, scenarios=[replace(s, overrides=at(s.overrides)) for s in spec.scenarios]
    )


def _plugin_files(tree: Tree) -> list[tuple[str, str]]:
    files = tree.get("plugins", [])
    if not (isinstance(files, list) and all(isinstance(f, str) for f in files)):
        raise SpecError(finding("plugins", "must be a list of file names.", value=files, remedy='plugins = ["my.py"]'))
    return [(name, f"plugins.{i}") for i, name in enumerate(files)]


def _table(tree: Tree, name: str) -> Mapping[str, Any]:
    table = tree.get(name, {})
    if not isinstance(table, dict):
        raise SpecError(finding(name, f"must be a table: write [{name}].", value=table))
    return table


def _list(tree: Tree, name: str, model: type[M]) -> list[M]:
    items = tree.get(name, [])
    if not isinstance(items, list):
        raise SpecError(finding(name, f"must be a list of tables: write [[{name}]].", value=items))
    return [validated(model, item, f"{name}.{i}") for i, item in enumerate(items)]


def _search(tree: Tree) -> tuple[dict[str, RangeSection], dict[str, Expression], dict[str, str]]:
    """Ranges and expressions by variable name, and which variable drives which path.

    A range or expression written directly at a path is a variable that bears the path's name.
    """
    ranges: dict[str, RangeSection] = {}
    expressions: dict[str, Expression] = {}
    for table in ("variables", "search"):
        for name, value in _table(tree, table).items():
            path = f"{table}.{name}" if table == "variables" else f'search."{name}"'
            if table == "variables" and not name.isidentifier():
                raise SpecError(finding(path, "a variable's name has letters, digits and _ only."))
            if isinstance(value, str):
                expressions[name] = Expression(path, value)
            elif isinstance(value, dict) and (table == "variables" or "low" in value or "high" in value):
                ranges[name] = validated(RangeSection, value, path)
            else:
                remedy = 'Write { low = 0.1, high = 0.2 } or an expression such as "reach * split"; quote the path.'
                raise SpecError(finding(path, "must be a range or an expression.", value=value, remedy=remedy))
    in_order(expressions, frozenset(ranges))
    return ranges, expressions, {path: path for path in _table(tree, "search")}


def _metric_defaults(registry: Registry, base: Design) -> Tree:
    """Parameters of every metric: as the study has them, or the defaults of one that it does not ask for."""
    tree: Tree = dict(base.resolved()["metrics"])
    for entry in registry.of_kind("metrics"):
        model = entry.plugin.parameters
        if not any(field.is_required() for field in model.model_fields.values()):
            tree.setdefault(entry.plugin.name, model().model_dump(mode="json"))
    return tree


def _assumptions(tree: Tree) -> Mapping[str, str]:
    for path, reason in _table(tree, "assumptions").items():
        refuse_unquoted("assumptions", path, reason)
        if not isinstance(reason, str):
            raise SpecError(finding(f'assumptions."{path}"', "must be a text that says why.", value=reason))
    return _table(tree, "assumptions")


def differences(old: Tree, new: Tree) -> list[str]:
    """Paths at which two identities differ, with both values."""
    before, after = dict(leaves(old)), dict(leaves(new))
    changed = [p for p in {**before, **after} if before.get(p) != after.get(p)]
    return [f"{p}: {before.get(p, 'absent')} -> {after.get(p, 'absent')}" for p in changed]
