"""What is tested: a plugin's record with parameters to build it from."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

from eiwa.core.errors import PluginError, SpecError
from eiwa.core.findings import validated
from eiwa.core.hookspecs import Parameters, Plugin
from eiwa.core.registry import KINDS, Entry, Registry, load
from eiwa.core.tree import did_you_mean


@dataclass(frozen=True, eq=False)
class Subject:
    """A plugin of a kind (``arm``, ``dexterity``, ``human``, ``voxels``, ``metrics``) with valid parameters."""

    kind: str
    plugin: Plugin
    parameters: Parameters
    folder: Path = Path()
    """Where files that the parameters name are looked for."""

    def __str__(self) -> str:
        return f"{self.kind} {self.plugin.name}"

    def build(self) -> Any:
        """A part, built anew."""
        return self.plugin.build(self.parameters)

    @cached_property
    def part(self) -> Any:
        """The part that the contracts look at."""
        return self.build()

    @property
    def file(self) -> str:
        """The file that the plugin's parameters are written in."""
        return file_of(self.plugin)


def subject(
    target: str | Path | ModuleType,
    parameters: Mapping[str, Any] | None = None,
    *,
    kind: str | None = None,
    name: str | None = None,
) -> Subject:
    """The subject of a test.

    Parameters
    ----------
    target
        A plugin file (``"my_device.py"``), a module with hooks, or the name of an installed plugin.
    parameters
        Its table as a study would write it. What is missing is taken from the parameters' defaults and, where the
        model has none, from the ``examples`` of its fields.
    kind, name
        Choose where the target holds more than one plugin.

    Raises
    ------
    SpecError
        There is no such plugin, or more than one; the parameters are not valid.
    """
    if isinstance(target, ModuleType):
        registry = Registry()
        registry.add(target, target.__name__, "")
        entries = list(registry.entries.values())
    else:
        entries = matching(load(), str(target))
    entries = chosen(entries, kind, name)
    if len(entries) != 1:
        found = ", ".join(f"{e.kind} {e.plugin.name}" for e in entries) or "no plugin"
        raise SpecError(f"{target}: holds {found}. Choose one by kind and name.")
    return of_entry(entries[0], parameters or {})


def of_entry(entry: Entry, parameters: Mapping[str, Any], folder: Path = Path()) -> Subject:
    """The subject of an entry; files that the parameters name are looked for in ``folder``."""
    path = f"metrics.{entry.plugin.name}" if entry.kind == "metrics" else entry.kind
    model = entry.plugin.parameters
    context = load(folder=folder).context
    try:
        valid = validated(model, dict(parameters), path, context)
    except SpecError:
        valid = validated(model, {**examples(model, besides=parameters), **parameters}, path, context)
    return Subject(entry.kind, entry.plugin, valid, folder)


def examples(model: type[Parameters], besides: Mapping[str, Any]) -> dict[str, Any]:
    """The first example of every parameter that has one and is not given."""
    return {n: field.examples[0] for n, field in model.model_fields.items() if field.examples and n not in besides}


def starting_values(model: type[Parameters]) -> dict[str, Any]:
    """Every parameter's first example, or its default: what a path into the table may pass through."""
    fields = model.model_fields.items()
    defaults = {name: field.get_default(call_default_factory=True) for name, field in fields if not field.is_required()}
    return {**defaults, **examples(model, besides={})}


def matching(registry: Registry, target: str) -> list[Entry]:
    """The entries of a plugin file, or those that bear a name in any kind.

    Raises
    ------
    SpecError
        There is no such file or name.
    PluginError
        The file cannot be loaded, has no hooks, or provides a name that is taken.
    """
    if target.endswith(".py") or Path(target).is_file():
        return _in_file(registry, Path(target))
    entries = [e for k in KINDS for e in registry.of_kind(k) if e.plugin.name == target]
    if not entries and Path(target).is_dir():
        raise SpecError(f"{target}: is a folder, not a plugin. Name one Python file, or an installed plugin.")
    if not entries:
        names = {e.plugin.name for e in registry.entries.values()}
        broken = "".join(f" Could not be loaded: {b.provider}: {b.reason}." for b in registry.broken)
        raise SpecError(f"{target}: no plugin has this name{did_you_mean(target, names)}{broken}")
    return entries


def chosen(entries: list[Entry], kind: str | None, name: str | None) -> list[Entry]:
    """Those of a kind and of a name, where these are given.

    Raises
    ------
    SpecError
        There is no such kind.
    """
    if kind is not None and kind not in KINDS:
        raise SpecError(f"{kind}: no such kind of plugin{did_you_mean(kind, KINDS)}")
    return [e for e in entries if kind in (None, e.kind) and name in (None, e.plugin.name)]


def _in_file(registry: Registry, path: Path) -> list[Entry]:
    """Entries of a file, which may be one of the registry's study or of an installed package."""
    if path.resolve() not in registry.files:
        installed = [
            e
            for e in registry.entries.values()
            if path.exists() and Path(file_of(e.plugin)).resolve() == path.resolve()
        ]
        if installed:
            return installed
        registry.add_file(str(path), "plugin file")
    entries = [e for e in registry.entries.values() if e.provider == registry.files[path.resolve()]]
    if not entries:
        raise PluginError(f"{path}: has no hooks. Mark a function {', '.join(KINDS.values())} with @hookimpl.")
    return entries


def file_of(plugin: Plugin) -> str:
    """The file that a plugin's parameters are written in."""
    return str(getattr(sys.modules.get(plugin.parameters.__module__), "__file__", ""))
