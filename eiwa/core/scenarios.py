"""Settings under which every design is evaluated: combinations of listed values, and named tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

from eiwa.core.design import SECTIONS, design
from eiwa.core.errors import SpecError, finding
from eiwa.core.findings import validated
from eiwa.core.named import named_design, parted
from eiwa.core.registry import Registry
from eiwa.core.sections import GridSection
from eiwa.core.tree import Tree, exists, lookup

MOST = 64


@dataclass(frozen=True)
class Scenario:
    """A setting under which every design is evaluated.

    The reference is the study file as it is: it has no overrides and an empty label, but a ``title`` where the file
    names it.
    """

    label: str
    overrides: Mapping[str, Any]
    title: str = ""


REFERENCE = Scenario("", {})


def scenarios(table: Mapping[str, Any], tree: Tree, defaults: Tree, registry: Registry) -> list[Scenario]:
    """The reference, then every combination of a named scenario (or none) and the listed values that differs from it.

    Raises
    ------
    SpecError
        The table [scenarios] says something that cannot be.
    """
    axes = {path: _axis(path, values) for path, values in table.items() if _is_path(path)}
    named: dict[str, dict[str, Any]] = {"": {}} | {
        n: _named(n, t, registry, tree, defaults) for n, t in table.items() if not _is_path(n)
    }
    for name, settings in named.items():
        for path in settings.keys() & axes.keys():
            remedy = "Take one of them out."
            raise SpecError(finding(f'scenarios.{name}."{path}"', "[scenarios] lists this path too.", remedy=remedy))
    if (count := sum(not n or bool(s) for n, s in named.items()) * prod(map(len, axes.values()))) > MOST:
        raise SpecError(finding("scenarios", f"{count} combinations; at most {MOST} are allowed."))
    found = {REFERENCE.label: REFERENCE}
    for name, settings in named.items():
        if name and not settings:
            found[REFERENCE.label] = Scenario(REFERENCE.label, {}, title=name)
    for name, settings in named.items():
        current = _values(settings, axes, tree, defaults, registry)
        for combination in product(*axes.values()):
            differing = {p: v for p, v in zip(axes, combination, strict=True) if v != current[p]}
            parts = [name] if settings else []
            label = " ".join([*parts, *(f"{p}={v}" for p, v in differing.items())])
            found.setdefault(label, Scenario(label, {**settings, **differing}))
    return list(found.values())


def _values(
    settings: Mapping[str, Any], paths: Iterable[str], tree: Tree, defaults: Tree, registry: Registry
) -> dict[str, Any]:
    """What a named scenario by itself has at some paths; None where it has none, which is told of later."""
    tables, resolved = parted(settings)[0], defaults
    with suppress(SpecError):
        resolved = design({**tree, **tables}, registry).resolved() if tables else defaults
    return {path: lookup(resolved, path) if exists(resolved, path) else None for path in paths}


def _is_path(key: str) -> bool:
    return "." in key


def _axis(path: str, values: Any) -> list[Any]:
    """The values of a list, or of evenly spaced ones."""
    where = f'scenarios."{path}"'
    if isinstance(values, dict) and "low" in values:
        return list(validated(GridSection, values, where).values)
    if not (isinstance(values, list) and values):
        remedy = 'Write "dexterity.K" = [50, 12270] or { low = 0.0, high = 0.1, step = 0.05 }; quote the path.'
        raise SpecError(finding(where, "must be a list of values.", value=values, remedy=remedy))
    if any(isinstance(value, dict) for value in values):
        raise SpecError(finding(where, "must be a list of plain values.", remedy="Name tables: [scenarios.NAME]."))
    return values


def _named(name: str, table: Any, registry: Registry, tree: Tree, defaults: Tree) -> dict[str, Any]:
    """What a table [scenarios.NAME] changes; nothing where it says what the study file says."""
    where = f"scenarios.{name}"
    if name in SECTIONS or not isinstance(table, dict):
        remedy = 'Write "dexterity.K" = [50, 12270]; quote the path. Or name a table of settings: [scenarios.NAME].'
        raise SpecError(finding(f'scenarios."{name}"', "must be a list of values.", value=table, remedy=remedy))
    if "published" in table:
        raise SpecError(finding(f"{where}.published", "only designs have published values."))
    overrides = named_design(name, table, registry, "scenarios").overrides
    return dict(overrides) if any(_changes(overrides, tree, defaults, registry)) else {}


def _changes(overrides: Mapping[str, Any], tree: Tree, defaults: Tree, registry: Registry) -> Iterator[bool]:
    """Whether each path and table differs from the study file; one that is wrong does, and is told of later."""
    tables, values = parted(overrides)
    for path, value in values.items():
        yield not (exists(defaults, path) and lookup(defaults, path) == value)
    for section, table in tables.items():
        try:
            yield design({**tree, section: table}, registry).resolved()[section] != defaults[section]
        except (SpecError, KeyError):
            yield True
