"""Finds plugins and keeps their records: built-ins by module name, installed ones by entry point, local ones by file."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

import pluggy

from eiwa.core import hookspecs
from eiwa.core.errors import EiwaError, PluginError, SpecError, finding, line_in
from eiwa.core.findings import validated
from eiwa.core.hookspecs import PROJECT, Parameters, Plugin
from eiwa.core.parts import Part
from eiwa.core.tree import Tree, did_you_mean
from eiwa.core.version import __version__

KINDS = {
    "arm": "eiwa_arms",
    "dexterity": "eiwa_dexterities",
    "human": "eiwa_humans",
    "voxels": "eiwa_voxels",
    "metrics": "eiwa_metrics",
}
"""Section of the study file -> hook."""

BUILT_IN = (
    "eiwa.plugins.arms.delta",
    "eiwa.plugins.arms.dh",
    "eiwa.plugins.arms.urdf",
    "eiwa.plugins.dexterity.extended",
    "eiwa.plugins.dexterity.joint_limits",
    "eiwa.plugins.dexterity.product",
    "eiwa.plugins.dexterity.singular",
    "eiwa.plugins.dexterity.yoshikawa",
    "eiwa.plugins.humans.ehem",
    "eiwa.plugins.humans.ehem_comfort",
    "eiwa.plugins.humans.free_arm",
    "eiwa.plugins.humans.points",
    "eiwa.plugins.metrics.conditioning",
    "eiwa.plugins.metrics.interaction",
    "eiwa.plugins.metrics.size",
    "eiwa.plugins.voxels.stores",
)


@dataclass(frozen=True)
class Entry:
    """A plugin record and where it comes from."""

    kind: str
    plugin: Plugin
    provider: str
    version: str


@dataclass(frozen=True)
class Broken:
    """An installed plugin that could not be loaded."""

    provider: str
    reason: str


@dataclass
class Registry:
    """Every plugin that a study can name."""

    entries: dict[tuple[str, str], Entry] = field(default_factory=dict)
    broken: list[Broken] = field(default_factory=list)
    digests: dict[str, str] = field(default_factory=dict)
    """Local files -> hash of their bytes."""
    files: dict[Path, str] = field(default_factory=dict)
    """Where local files lie -> the name that the study gives them."""
    folder: Path = Path()
    """Where files that the study names are looked for: the study file's folder."""
    located: dict[str, Path] = field(default_factory=dict)
    """Files that the study names -> where they lie."""

    def find(self, kind: str, name: str, path: str) -> Plugin:
        """The record of a kind and name, asked for at a TOML path.

        Raises
        ------
        SpecError
            No such plugin: names the nearest, and any plugin that is broken.
        """
        if (kind, name) in self.entries:
            return self.entries[kind, name].plugin
        problem = f"no {kind} plugin has this name{did_you_mean(name, self.names(kind))}"
        broken = "; ".join(f"{b.provider}: {b.reason}" for b in self.broken)
        raise SpecError(finding(path, problem, value=name, remedy=f"Could not be loaded: {broken}." if broken else ""))

    @property
    def context(self) -> dict[str, Any]:
        """What parameters that name files or other plugins are validated with."""
        return {"locate": self.locate, "part": self.part}

    def locate(self, name: str) -> Path:
        """Where a file lies that the study names."""
        return self.located.setdefault(name, self.folder / name)

    def part(self, kind: str, table: Tree) -> Part:
        """The plugin of a table inside another plugin's parameters.

        Raises
        ------
        SpecError
            With paths that begin at the table.
        """
        name = table.get("kind")
        if not isinstance(name, str):
            problem = f"is required. Known: {', '.join(self.names(kind))}."
            raise SpecError(finding("kind", problem if name is None else f"must be a plugin's name, not {name!r}."))
        plugin = self.find(kind, name, "kind")
        parameters = {k: v for k, v in table.items() if k != "kind"}
        return Part(plugin, validated(plugin.parameters, parameters, "", self.context))

    def names(self, kind: str) -> list[str]:
        """Known names of a kind, sorted."""
        return sorted(name for k, name in self.entries if k == kind)

    def of_kind(self, kind: str) -> list[Entry]:
        """Entries of a kind, sorted by name."""
        return [self.entries[kind, name] for name in self.names(kind)]

    def numbers(self) -> dict[str, tuple[str, hookspecs.Number]]:
        """Every number that a metric yields: name -> (metric plugin, number)."""
        return {n.name: (e.plugin.name, n) for e in self.of_kind("metrics") for n in e.plugin.numbers}

    def versions(self) -> dict[str, str]:
        """Provider -> version, for provenance."""
        return {entry.provider: entry.version for entry in self.entries.values()}

    def add(self, module: Any, provider: str, version: str) -> None:
        """Register a module's hooks and records.

        Raises
        ------
        PluginError
            A hook that does not exist, a record that is not one, a name that is taken.
        """
        manager = pluggy.PluginManager(PROJECT)
        manager.add_hookspecs(hookspecs)
        try:
            manager.register(module, name=provider)
            for hook in _unknown_hooks(manager, module):
                known = [name for name in vars(hookspecs) if name.startswith("eiwa_")]
                raise PluginError(f"plugin {provider}: {hook}: there is no such hook{did_you_mean(hook, known)}")
        except pluggy.PluginValidationError as error:
            raise PluginError(f"plugin {provider}: {error}") from error
        found = (
            Entry(kind, record, provider, version)
            for kind, hook in KINDS.items()
            for records in getattr(manager.hook, hook)()
            for record in _checked(records, provider, hook)
        )
        before = dict(self.entries)
        try:
            for entry in found:
                self._refuse_duplicate(entry)
                self.entries[entry.kind, entry.plugin.name] = entry
        except PluginError:
            self.entries = before
            raise

    def _refuse_duplicate(self, entry: Entry) -> None:
        other = self.entries.get((entry.kind, entry.plugin.name))
        if other:
            taken = f"the {entry.kind} plugin {entry.plugin.name!r}"
        else:
            clash = [n.name for n in entry.plugin.numbers if entry.kind == "metrics" and n.name in self.numbers()]
            if not clash:
                return
            other = self.entries["metrics", self.numbers()[clash[0]][0]]
            taken = f"the metric number {clash[0]!r}"
        if entry.provider == other.provider:
            raise PluginError(f"{entry.provider} provides {taken} twice: remove one of them")
        raise PluginError(f"{entry.provider} and {other.provider} both provide {taken}: rename one of them")

    def add_file(self, name: str, where: str) -> None:
        """Register a local plugin file, by the name that the study gives it at a TOML path.

        Raises
        ------
        SpecError
            The file does not exist.
        PluginError
            It raises on import, or :meth:`add` refuses it.
        """
        path = self.locate(name)
        if not path.is_file():
            raise SpecError(finding(where, "there is no such plugin file.", value=name, remedy=f"Looked for {path}."))
        if path.resolve() in self.files:
            raise SpecError(finding(where, "is named twice.", value=name, remedy="Remove one of them."))
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()[:16]
        module = _import_file(path, f"eiwa_local_{path.stem}_{digest}")
        self.digests[name] = digest
        self.files[path.resolve()] = name
        self.add(module, name, f"sha256:{digest}")


def load(
    files: Sequence[tuple[str, str]] = (), folder: Path = Path(), located: Mapping[str, Path] | None = None
) -> Registry:
    """The registry of built-ins, installed plugins, and local files given as (name, TOML path)."""
    registry = Registry(folder=folder, located=dict(located or {}))
    for name in BUILT_IN:
        registry.add(importlib.import_module(name), name, __version__)
    for entry_point in sorted(entry_points(group=PROJECT), key=lambda e: e.name):
        provider = f"{entry_point.name} ({entry_point.value})"
        version = entry_point.dist.version if entry_point.dist else "unknown"
        try:
            registry.add(entry_point.load(), provider, version)
        # Whatever an installed plugin raises must not take down a study that does not use it.
        except Exception as error:
            registry.broken.append(Broken(provider, _one_line(error)))
    for name, where in files:
        registry.add_file(name, where)
    return registry


def _unknown_hooks(manager: pluggy.PluginManager, module: object) -> list[str]:
    """Names of hooks that a plugin's functions are marked as, and that there are none of."""
    marked = ((name, manager.parse_hookimpl_opts(module, name)) for name in dir(module))
    hooks = [options["specname"] or name for name, options in marked if options is not None]
    return [name for name in hooks if not hasattr(hookspecs, name)]


def _checked(records: Any, provider: str, hook: str) -> list[Plugin]:
    found: list[Plugin] = list(records) if isinstance(records, list | tuple) else [records]
    for record in found:
        if not isinstance(record, Plugin):
            raise PluginError(
                f"plugin {provider}: {hook} must return a list of Plugin records, not a {type(record).__name__}"
            )
        if not (isinstance(record.parameters, type) and issubclass(record.parameters, Parameters)):
            raise PluginError(f"plugin {provider}: parameters of {record.name!r} must be a subclass of Parameters")
        if hook == "eiwa_metrics" and not record.numbers:
            raise PluginError(f"plugin {provider}: metric {record.name!r} declares no numbers")
    return found


def _import_file(path: Path, name: str) -> ModuleType:
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise PluginError(f"plugin file {path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    # A user's file may raise anything; the message names it instead of a traceback.
    except Exception as error:
        del sys.modules[name]
        if isinstance(error, EiwaError):
            raise
        raised = _one_line(error) + ("" if isinstance(error, SyntaxError) else line_in(spec.origin, error))
        raise PluginError(f"plugin file {path} raises on import: {raised}") from error
    return module


def _one_line(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}".replace("\n", " ")[:300]
