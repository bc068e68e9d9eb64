"""A plugin that another plugin's parameters name, as a table with ``kind`` and that plugin's own keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import PlainSerializer, PlainValidator, ValidationInfo, WithJsonSchema
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from eiwa.core.errors import SpecError, blaming

if TYPE_CHECKING:
    from eiwa.core.hookspecs import Parameters, Plugin

WITHIN = "findings_within"
"""Type of the pydantic error that carries a nested table's findings."""


@dataclass(frozen=True)
class Part:
    """The plugin that a nested table names, with its validated parameters."""

    plugin: Plugin
    parameters: Parameters

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> CoreSchema:
        return core_schema.is_instance_schema(cls)

    def build(self) -> Any:
        """The part itself."""
        with blaming(self.plugin.build):
            return self.plugin.build(self.parameters)

    def table(self) -> dict[str, Any]:
        """The table in the study file's shape, defaults written out; keys without a value, which TOML lacks, left out."""
        return {"kind": self.plugin.name, **self.parameters.model_dump(mode="json", exclude_none=True)}


def _index(value: Any, info: ValidationInfo) -> Part:
    """The index of a table, found by the validation context's ``part``."""
    if isinstance(value, Part):
        return value
    if not isinstance(value, dict):
        raise ValueError("must be a table with a kind and that index's parameters")
    if "part" not in (info.context or {}):
        raise ValueError("can be looked up as part of a study only")
    try:
        found: Part = (info.context or {})["part"]("dexterity", value)
    except SpecError as error:
        raise PydanticCustomError(WITHIN, "nested", {"findings": error.findings}) from None
    return found


IndexParameter = Annotated[
    Part,
    PlainValidator(_index),
    PlainSerializer(Part.table, return_type=dict),
    WithJsonSchema(
        {
            "type": "object",
            "description": "Another dexterity index: its kind and its own parameters.",
            "properties": {"kind": {"type": "string"}},
            "required": ["kind"],
        }
    ),
]
"""Type of a plugin's parameter that holds another dexterity index; its ``build()`` makes that index."""
