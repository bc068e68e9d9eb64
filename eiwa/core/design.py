"""One design as validated tables, and the parts that are built from them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from eiwa.core.errors import SpecError, blaming, finding
from eiwa.core.evaluation import Layout, Setup
from eiwa.core.filling import Sampling
from eiwa.core.findings import validated
from eiwa.core.hookspecs import Parameters, Plugin
from eiwa.core.interfaces import HumanModel, Operator
from eiwa.core.registry import Registry
from eiwa.core.sections import (
    AdjustSection,
    DexteritySection,
    LayoutSection,
    OperatorSection,
    SamplingSection,
    VoxelsSection,
)
from eiwa.core.tree import Tree, did_you_mean

SECTIONS = ("arm", "layout", "operator", "human", "dexterity", "voxels", "sampling", "metrics")
ALWAYS = ("F", "singletons", "valid_share")
"""Metrics that are part of every row, for trust."""


@dataclass(frozen=True)
class Design:
    """The tables that make up a design, validated, defaults filled in."""

    tables: Mapping[str, Parameters]
    plugins: Mapping[str, tuple[Plugin, Parameters]]
    metrics: Mapping[str, tuple[Plugin, Parameters]]

    def resolved(self) -> Tree:
        """The design as plain values with every default written out, in the study file's shape."""
        tree: Tree = {name: table.model_dump(mode="json") for name, table in self.tables.items()}
        for name, (plugin, parameters) in self.plugins.items():
            tree[name] = {"kind": plugin.name, **parameters.model_dump(mode="json"), **tree.get(name, {})}
        tree["metrics"] = {name: parameters.model_dump(mode="json") for name, (_, parameters) in self.metrics.items()}
        return tree

    @property
    def masters(self) -> str:
        """Equal for designs that differ in the operator, metrics, and parameters of the dexterity alone."""
        tree = {name: table for name, table in self.resolved().items() if name not in ("operator", "human", "metrics")}
        tree["dexterity"] = tree["dexterity"]["kind"]
        return json.dumps(tree, sort_keys=True)

    @property
    def adjust(self) -> AdjustSection:
        """What the operator adjusts."""
        operator = self.tables["operator"]
        assert isinstance(operator, OperatorSection)
        return operator.adjust

    def setup(self, seed: int) -> Setup:
        """Build the parts."""
        layout, operator = self.tables["layout"], self.tables["operator"]
        dexterity, voxels, sampling = self.tables["dexterity"], self.tables["voxels"], self.tables["sampling"]
        assert isinstance(layout, LayoutSection) and isinstance(operator, OperatorSection)
        assert isinstance(dexterity, DexteritySection) and isinstance(voxels, VoxelsSection)
        assert isinstance(sampling, SamplingSection)
        parts = [self.plugins[section] for section in ("arm", "dexterity", "voxels")]
        arm, index, backend = (_built(plugin, parameters) for plugin, parameters in parts)
        human_key, human = _human(*self.plugins["human"])
        roll, pitch, yaw = (float(angle) for angle in np.deg2rad(layout.orientation))
        x, y, z = layout.offset
        return Setup(
            arm=arm,
            index=index,
            index_key=json.dumps(self.resolved()["dexterity"], sort_keys=True),
            normaliser=None if dexterity.normaliser == "max" else float(dexterity.normaliser),
            threshold=dexterity.threshold,
            layout=Layout(layout.spacing, (x, y, z), (roll, pitch, yaw), layout.second, layout.alpha),
            human=human,
            human_key=human_key,
            operator=Operator(operator.armrest, operator.seat),
            backend=backend,
            r=voxels.size,
            sampling=Sampling(
                sampling.samples, np.float64 if sampling.precision == "f64" else np.float32, sampling.tolerance
            ),
            estimator=sampling.estimator,
            seed=seed,
            metrics={name: _built(plugin, parameters) for name, (plugin, parameters) in self.metrics.items()},
        )


PLUGGED = ("arm", "dexterity", "human", "voxels")
_humans: dict[str, HumanModel] = {}


def _built(plugin: Plugin, parameters: Parameters) -> Any:
    with blaming(plugin.build):
        return plugin.build(parameters)


def _human(plugin: Plugin, parameters: Parameters) -> tuple[str, HumanModel]:
    """A human model and what tells it from others; kept, because a search over arms builds the same one every time."""
    key = f"{plugin.name} {plugin.build!r} {parameters.model_dump_json()}"
    if key not in _humans:
        if len(_humans) >= 32:
            del _humans[next(iter(_humans))]
        _humans[key] = _built(plugin, parameters)
    return key, _humans[key]


OWN: dict[str, type[Parameters]] = {
    "layout": LayoutSection,
    "operator": OperatorSection,
    "dexterity": DexteritySection,
    "voxels": VoxelsSection,
    "sampling": SamplingSection,
}
"""eiwa's own keys of a table; the others belong to the plugin that its ``kind`` names."""
DEFAULT_KINDS = {"voxels": "auto"}
"""``kind`` of a table that does not say."""


def design(tree: Tree, registry: Registry, needed: frozenset[str] = frozenset()) -> Design:
    """Validate the design tables of a study file.

    Parameters
    ----------
    tree
        The raw study file, overrides applied.
    registry
        Plugins that the tables may name.
    needed
        Metric numbers that something else in the study asks for.

    Raises
    ------
    SpecError
        With every finding.
    """
    findings: list[str] = []
    tables: dict[str, Parameters] = {}
    plugins: dict[str, tuple[Plugin, Parameters]] = {}
    for section in SECTIONS[:-1]:
        try:
            _section(section, tree, registry, tables, plugins)
        except SpecError as error:
            findings.extend(error.findings)
    metrics: dict[str, tuple[Plugin, Parameters]] = {}
    try:
        metrics = _metrics(tree, registry, needed)
    except SpecError as error:
        findings.extend(error.findings)
    if findings:
        raise SpecError(*findings)
    return Design(tables, plugins, metrics)


def _section(
    section: str,
    tree: Tree,
    registry: Registry,
    tables: dict[str, Parameters],
    plugins: dict[str, tuple[Plugin, Parameters]],
) -> None:
    """Split a table into eiwa's own keys and the plugin's, and validate both."""
    table = tree.get(section, {})
    if not isinstance(table, dict):
        raise SpecError(finding(section, f"must be a table: write [{section}].", value=table))
    own = OWN.get(section)
    if section in DEFAULT_KINDS:
        table = {"kind": DEFAULT_KINDS[section], **table}
    if section not in PLUGGED:
        assert own is not None
        tables[section] = validated(own, table, section)
        return
    if not isinstance(table.get("kind"), str):
        listed = f"Known: {', '.join(registry.names(section))}."
        if "kind" in table:
            raise SpecError(finding(f"{section}.kind", "must be a plugin's name.", value=table["kind"], remedy=listed))
        raise SpecError(finding(f"{section}.kind", f"is required. {listed}"))
    plugin = registry.find(section, table["kind"], f"{section}.kind")
    mine = {k: v for k, v in table.items() if own is not None and k in own.model_fields}
    known = {"kind", *mine, *(own.model_fields if own else ()), *plugin.parameters.model_fields}
    problems = [finding(f"{section}.{k}", f"unknown key{did_you_mean(k, known)}") for k in table if k not in known]
    theirs = {k: v for k, v in table.items() if k in plugin.parameters.model_fields and k not in mine}
    for model, part in ((own, mine), (plugin.parameters, theirs)):
        if model is None:
            continue
        try:
            parameters = validated(model, part, section, registry.context)
        except SpecError as error:
            problems.extend(error.findings)
            continue
        if model is own:
            tables[section] = parameters
        else:
            plugins[section] = (plugin, parameters)
    if problems:
        raise SpecError(*problems)


def _metrics(tree: Tree, registry: Registry, needed: frozenset[str]) -> dict[str, tuple[Plugin, Parameters]]:
    """The metrics of the study: those with a table, those always computed, those that yield a needed number."""
    tables = tree.get("metrics", {})
    if not (isinstance(tables, dict) and all(isinstance(t, dict) for t in tables.values())):
        raise SpecError(finding("metrics", "must hold one table per metric: write [metrics.F].", value=tables))
    numbers = registry.numbers()
    names = dict.fromkeys([*ALWAYS, *tables, *sorted(numbers[n][0] for n in needed if n in numbers)])
    metrics = {}
    for name in names:
        plugin = registry.find("metrics", name, f"metrics.{name}")
        parameters = validated(plugin.parameters, tables.get(name, {}), f"metrics.{name}", registry.context)
        metrics[name] = (plugin, parameters)
    return metrics
