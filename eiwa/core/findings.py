"""Turns what pydantic finds into messages that name the TOML path, the value, what is allowed and the remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from eiwa.core.errors import SpecError, finding
from eiwa.core.hookspecs import Parameters
from eiwa.core.parts import WITHIN
from eiwa.core.tree import did_you_mean

M = TypeVar("M", bound=Parameters)


def validated(model: type[M], table: Any, path: str, context: Mapping[str, Any] | None = None) -> M:
    """The table as its model; ``context`` finds the files and plugins that it names (``Registry.context``).

    Raises
    ------
    SpecError
        With one finding per path that is wrong.
    """
    if not isinstance(table, dict):
        raise SpecError(finding(path, f"must be a table: write [{path.split('.')[0]}].", value=table))
    try:
        return model.model_validate(table, context=context)
    except ValidationError as error:
        lines: dict[str, list[Any]] = {}
        within: list[str] = []
        for item in error.errors(include_url=False):
            steps, missing = _steps(table, item["loc"])
            missing = missing and item["type"] == "missing"
            where = ".".join([path, *steps] if path else steps)
            if item["type"] == WITHIN:
                within += [f"{where}.{line}" for line in item["ctx"]["findings"]]
            else:
                lines.setdefault(where, []).append((item, missing))
        raise SpecError(*(_line(where, items, model) for where, items in lines.items()), *within) from None


def _steps(table: Any, location: Sequence[Any]) -> tuple[list[str], bool]:
    """Path steps of a pydantic location; list items by name; steps that only pydantic knows are dropped."""
    node, steps = table, []
    for key in location:
        if isinstance(node, dict) and key in node:
            node = node[key]
            steps.append(str(key))
        elif isinstance(node, list) and isinstance(key, int) and key < len(node):
            node = node[key]
            steps.append(str(node.get("name", key)) if isinstance(node, dict) else str(key))
        elif isinstance(node, dict) and key == location[-1]:
            return [*steps, str(key)], True
    return steps, False


def _line(where: str, items: list[Any], model: type[BaseModel]) -> str:
    item, missing = items[0]
    if missing:
        return finding(where, "is required.", remedy=_described(model, item["loc"]))
    if item["type"] == "extra_forbidden":
        known = _model_at(model, item["loc"][:-1]).model_fields
        return finding(where, f"unknown key{did_you_mean(str(item['loc'][-1]), known)}")
    problem = " or ".join(dict.fromkeys(_problem(i) for i, _ in items)).replace(" or must be ", " or ") + "."
    if isinstance(item["input"], dict):
        return finding(where, problem)
    return finding(where, problem, value=item["input"], remedy=_described(model, item["loc"]))


def _described(model: type[BaseModel], location: Sequence[Any]) -> str:
    """What the field at a place means and in which unit; an item of a list is described by its list."""
    *above, last = (key for key in location if not isinstance(key, int)) if location else ("",)
    field = _model_at(model, above).model_fields.get(str(last))
    if field is None:
        return ""
    extra = field.json_schema_extra
    unit = extra.get("unit") if isinstance(extra, dict) else None
    return (field.description or "") + (f" Unit: {unit}." if unit else "")


def _problem(item: Any) -> str:
    if item["type"] == "value_error":
        return str(item["ctx"]["error"])
    if item["type"] in ("too_short", "too_long"):
        bound = item["ctx"].get("min_length", item["ctx"].get("max_length"))
        return f"must have {'at least' if item['type'] == 'too_short' else 'at most'} {bound} items"
    if item["type"] == "string_pattern_mismatch":
        if not item["ctx"]["pattern"].startswith("^[A-Za-z0-9]"):
            return "is not of the form that is needed"
        return "may hold letters, digits, '_' and '-' ('.' too in a study's name), and begins with a letter or digit"
    if item["type"] == "model_type":
        return "must be a table"
    text: str = item["msg"]
    for old, new in (
        ("Input should be", "must be"),
        ("List should have", "must have"),
        ("String should", "must"),
    ):
        text = text.replace(old, new)
    return text[0].lower() + text[1:]


def _model_at(model: type[BaseModel], location: Sequence[Any]) -> type[BaseModel]:
    """The model of a nested table."""
    for key in location:
        field = model.model_fields.get(str(key))
        if field is not None:
            model = next((m for m in _models(field.annotation)), model)
    return model


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models(argument)]
