"""The study file as JSON Schema (draft 2020-12), with every plugin's parameters: editors complete and check it.

What one key may hold is exact; what only several keys together decide (a path that must exist, exactly one of two
keys) is left to ``eiwa study check``. Where a table's ``kind`` names a plugin, ``if``/``then`` choose its keys, which
tells an editor what is wrong at the key itself; for completion the table lists the keys of all plugins.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel

from eiwa.core import manufacture, objectives, sections
from eiwa.core.design import DEFAULT_KINDS, OWN, SECTIONS
from eiwa.core.hookspecs import Plugin
from eiwa.core.registry import KINDS, Registry

Schema = dict[str, Any]

PATH = f"^({'|'.join(SECTIONS)})\\..+$"
"""A quoted path to a value of a design."""


def schema(registry: Registry, part: bool = False) -> Schema:
    """The schema of studies that may name the registry's plugins, or of files of tables that a design takes ``from``."""
    definitions: Schema = {}
    tables = {section: _table(section, registry, definitions) for section in SECTIONS[:-1]}
    properties: Schema = {
        "study": _own(sections.StudySection, definitions),
        "plugins": _list({"type": "string", "pattern": "\\.py$"}, "Local plugin files, beside the study file."),
        **tables,
        "metrics": _metrics(registry, definitions),
        **_search(definitions),
        "scenarios": _scenarios(registry, definitions),
        **_goals(registry, definitions),
        "designs": {
            "type": "object",
            "description": "Named designs: paths with values, and what was published.",
            "additionalProperties": _design(registry, definitions),
        },
        "execution": _own(sections.ExecutionSection, definitions),
        "tolerance": _paths(_own(manufacture.ToleranceSection, definitions), "Paths, and their errors of manufacture."),
        "catalogue": _paths(_list({"type": "number"}, least=1), "Paths, and the values that can be bought."),
        "assumptions": {
            "type": "object",
            "description": "Paths, and why they have the value that they have.",
            "additionalProperties": {"type": "string"},
        },
    }
    required = ["study", *(name for name, table in tables.items() if table.get("required"))]
    required = [] if part else required
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "eiwa study"}
    return {**head, **_object(properties, required), "$defs": definitions}


def _table(section: str, registry: Registry, definitions: Schema) -> Schema:
    """A table of eiwa's own keys, or of a plugin's, or of both."""
    own = _own(OWN[section], definitions) if section in OWN else _object({}, [])
    if section not in KINDS:
        return own
    names, default = registry.names(section), DEFAULT_KINDS.get(section)
    kind: Schema = {"enum": names, "description": "The plugin whose keys stand in this table."}
    union: dict[str, list[str]] = {}
    choices = []
    for name in names:
        theirs = _parameters(registry.entries[section, name].plugin, section, definitions)
        whole = _object({"kind": {}, **theirs["properties"], **own["properties"]}, theirs["required"])
        definitions[f"{section}-{name}"] = {**whole, "description": theirs.get("description", "")}
        chosen: Schema = {"properties": {"kind": {"enum": [name]}}}
        chosen |= {} if name == default else {"required": ["kind"]}
        choices.append({"if": chosen, "then": {"$ref": f"#/$defs/{section}-{name}"}})
        for key, value in theirs["properties"].items():
            union.setdefault(key, []).append(f"{name}: {value.get('description', '')}".strip())
    described = {key: {"description": "\n\n".join(texts)} for key, texts in union.items()}
    required = own["required"] if default else ["kind", *own["required"]]
    properties = {"kind": kind | ({"default": default} if default else {}), **described, **own["properties"]}
    return {"type": "object", "properties": properties, "required": required, "allOf": choices}


def _metrics(registry: Registry, definitions: Schema) -> Schema:
    """One table per metric."""
    plugins = [entry.plugin for entry in registry.of_kind("metrics")]
    properties = {plugin.name: _parameters(plugin, "metrics", definitions) for plugin in plugins}
    return _object(properties, []) | {"description": "Metrics to compute, each a table."}


def _search(definitions: Schema) -> Schema:
    """[variables] and [search]: ranges and expressions, by name and by path."""
    either: Schema = {"anyOf": [_own(sections.RangeSection, definitions), {"type": "string"}]}
    either["description"] = "A range { low = ..., high = ... } or an expression of variables."
    variables = {
        "type": "object",
        "patternProperties": {"^[A-Za-z_][A-Za-z0-9_]*$": either},
        "additionalProperties": False,
    }
    described = {"description": "Numbers that the sampler chooses, and expressions of them."}
    return {"variables": variables | described, "search": _paths(either, "Paths, and what the search puts there.")}


def _scenarios(registry: Registry, definitions: Schema) -> Schema:
    """Paths with lists or grids of values, and named tables of settings."""
    axis = {"anyOf": [_list({}, least=1), _own(sections.GridSection, definitions)]}
    named = _design(registry, definitions)
    del named["properties"]["published"]
    taken = dict.fromkeys(SECTIONS, False)
    text = "Settings under which every design is evaluated: paths with values, or [scenarios.NAME]."
    return {
        "type": "object",
        "description": text,
        "properties": taken,
        "patternProperties": {PATH: axis},
        "additionalProperties": named,
    }


def _goals(registry: Registry, definitions: Schema) -> Schema:
    """[[objectives]] and [[constraints]], whose metric must be a number that some metric yields."""
    goals: Schema = {}
    for name, model in (("objectives", objectives.ObjectiveSection), ("constraints", objectives.ConstraintSection)):
        item = _own(model, definitions)
        item["properties"]["metric"] = {**item["properties"]["metric"], "enum": sorted(registry.numbers())}
        item["properties"]["metric"].pop("type", None)
        goals[name] = _list(item, (model.__doc__ or "").split("\n")[0])
    return goals


def _design(registry: Registry, definitions: Schema) -> Schema:
    """A named design: paths with values, whole tables of plugins, a file to take tables from, what was published."""
    own = _own(sections.DesignSection, definitions)["properties"]
    value = own["overrides"]["additionalProperties"]
    value = {"anyOf": [choice for choice in value["anyOf"] if choice.get("type") != "object"]}
    published = _object({name: {"type": "number"} for name in sorted(registry.numbers())}, [])
    properties = {
        "from": {"type": "string", "description": "A TOML file, beside the study file, to take whole tables from."},
        **{
            section: {"$ref": f"#/properties/{section}"}
            for section in SECTIONS
            if section in KINDS and section != "metrics"
        },
        "published": published | {"description": own["published"]["description"]},
    }
    return _paths(value, "") | {"properties": properties}


def _parameters(plugin: Plugin, section: str, definitions: Schema) -> Schema:
    return _own(plugin.parameters, definitions, f"{section}-{plugin.name}-")


def _own(model: type[BaseModel], definitions: Schema, prefix: str = "") -> Schema:
    """A model's schema; its nested models become definitions under names that begin with the prefix."""
    raw = model.model_json_schema(ref_template=f"#/$defs/{prefix}{{model}}")
    for name, part in raw.pop("$defs", {}).items():
        definitions[f"{prefix}{name}"] = _plain(part)
    found: Schema = _plain(raw)
    return {**found, "properties": found.get("properties", {}), "required": found.get("required", [])}


def _plain(node: Any) -> Any:
    """Without pydantic's titles and what TOML lacks (null); units and sources in the description, where editors show it."""
    if isinstance(node, list):
        return [_plain(item) for item in node]
    if not isinstance(node, Mapping):
        return node
    dropped = ("title", "unit", "source", *(["default"] if node.get("default", 0) is None else []))
    kept = {key: value for key, value in node.items() if key not in dropped or key in node.get("properties", ())}
    if "properties" in node:  # keys of a table may be called title or unit
        kept["properties"] = {key: _plain(value) for key, value in node["properties"].items()}
    result = {
        key: value if key in ("properties", "default", "examples") else _plain(value) for key, value in kept.items()
    }
    if "const" in result:
        result["enum"] = [result.pop("const")]
    if "anyOf" in result:
        choices = [choice for choice in result.pop("anyOf") if choice != {"type": "null"}]
        result |= choices[0] if len(choices) == 1 else {"anyOf": choices}
    text = _described(node)
    return {**result, "description": text} if text else result


def _described(node: Mapping[str, Any]) -> str:
    parts = [re.sub(r"``", "`", node["description"])] if isinstance(node.get("description"), str) else []
    parts += [f"[{node['unit']}]"] if isinstance(node.get("unit"), str) else []
    parts += [f"Source: {node['source']}."] if isinstance(node.get("source"), str) else []
    return " ".join(parts)


def _object(properties: Schema, required: Iterable[str]) -> Schema:
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


def _list(item: Schema, description: str = "", least: int = 0) -> Schema:
    found: Schema = {"type": "array", "items": item}
    return found | ({"description": description} if description else {}) | ({"minItems": least} if least else {})


def _paths(value: Schema, description: str) -> Schema:
    """A table of quoted paths; one without quotes is a table in TOML, which is refused."""
    table = {"type": "object", "patternProperties": {PATH: value}, "additionalProperties": False}
    return table | ({"description": description} if description else {})
