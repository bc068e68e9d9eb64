"""A parameters' model in words: what a user may write at each key. Command line, docs and editors read it from here."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

Schema = Mapping[str, Any]


@dataclass(frozen=True)
class Key:
    """One parameter; ``type`` has its bounds, ``default`` is written as TOML ('none': may be left out)."""

    name: str
    type: str
    default: str
    required: bool
    unit: str
    source: str
    what: str


@dataclass(frozen=True)
class Table:
    """A model: its class's name, its docstring, its keys."""

    name: str
    text: str
    keys: tuple[Key, ...]


def tables(model: type[BaseModel]) -> list[Table]:
    """The model and the models that stand inside it, each once."""
    schema = model.model_json_schema()
    return [_table(schema), *(_table(part) for part in schema.get("$defs", {}).values() if "properties" in part)]


def _table(schema: Schema) -> Table:
    required = schema.get("required", [])
    keys = tuple(_key(name, key, name in required) for name, key in schema.get("properties", {}).items())
    return Table(schema["title"], schema.get("description", ""), keys)


def _key(name: str, key: Schema, required: bool) -> Key:
    default = "required" if required else toml(key.get("default"))
    return Key(
        name, allowed(key), default, required, key.get("unit", ""), key.get("source", ""), key.get("description", "")
    )


def allowed(key: Schema) -> str:
    """Type and bounds of one key's JSON schema."""
    if "anyOf" in key:
        texts = [allowed(part) for part in key["anyOf"] if part.get("type") != "null" and "$ref" not in part]
        models = [allowed(part) for part in key["anyOf"] if "$ref" in part]
        return " or ".join([*texts, *(models if len(models) == 1 else ["table"] if models else [])])
    if "enum" in key or "const" in key:
        return ", ".join(toml(v) for v in key.get("enum", [key.get("const")]))
    if "$ref" in key:
        return str(key["$ref"].split("/")[-1])
    if key.get("type") == "object" and "additionalProperties" not in key:
        return "table"
    if key.get("type") == "object" and isinstance(key.get("additionalProperties"), Mapping):
        return f"table of name = {allowed(key['additionalProperties'])}"
    if key.get("type") == "array":
        size = f"{key['minItems']} " if key.get("minItems") == key.get("maxItems", -1) else ""
        item = allowed(key["items"])
        return f"list of {size}{item + 's' if item.isalpha() else item}"
    if "pattern" in key:
        return f"string matching {key['pattern']}"
    signs = (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
    bounds = ", ".join(f"{sign} {key[bound]}" for bound, sign in signs if bound in key)
    return f"{key.get('type', 'any')} {bounds}".strip()


def toml(value: Any) -> str:
    """A plain value as TOML writes it; None, which TOML lacks, as 'none'."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {toml(v)}" for k, v in value.items() if v is not None) + " }" if value else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml(v) for v in value)}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool):
        return str(value).lower()
    return "none" if value is None else repr(value)
