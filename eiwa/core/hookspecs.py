"""The hooks of eiwa, and the records that they yield.

A plugin is a module (or any object) with functions marked :data:`hookimpl` that return lists of :class:`Plugin`.
The host validates the records, refuses a name that is taken, and never hands Optuna, TOML or the screen to a plugin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import pluggy
from pydantic import BaseModel, ConfigDict, Field

from eiwa.core.datafile import DataFile, FileParameter
from eiwa.core.parts import IndexParameter, Part

PROJECT = "eiwa"
__all__ = [
    "DataFile",
    "FileParameter",
    "IndexParameter",
    "Number",
    "Parameters",
    "Part",
    "Plugin",
    "hookimpl",
    "quantity",
]

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


class Parameters(BaseModel):
    """Base of every plugin's parameters: frozen, unknown keys refused, infinities and NaN refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


def quantity(default: Any = ..., *, unit: str = "", source: str = "", **constraints: Any) -> Any:
    """A documented parameter: a pydantic field that also names its unit and the source of its default."""
    extra: dict[str, Any] = {k: v for k, v in (("unit", unit), ("source", source)) if v}
    return Field(default, json_schema_extra=extra, **constraints)


@dataclass(frozen=True)
class Number:
    """One number that a metric yields, with the bounds that it can never leave."""

    name: str
    unit: str
    description: str
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class Plugin:
    """One arm, dexterity index, human model, voxel backend or metric.

    Parameters
    ----------
    name
        The ``kind`` in the study file (for a metric, the table ``[metrics.NAME]``).
    parameters
        The model that validates and documents the table.
    build
        From validated parameters to the part; see the hook for which part.
    numbers
        For a metric: what it yields.
    """

    name: str
    parameters: type[Parameters]
    build: Callable[[Any], Any]
    numbers: tuple[Number, ...] = ()

    @property
    def summary(self) -> str:
        """First line of the parameters' docstring."""
        return (self.parameters.__doc__ or "").strip().split("\n")[0]


@hookspec
def eiwa_arms() -> Iterable[Plugin]:
    """Arm models; ``build`` returns an :class:`eiwa.core.interfaces.Arm`."""
    return ()


@hookspec
def eiwa_dexterities() -> Iterable[Plugin]:
    """Dexterity indices; ``build`` returns an :class:`eiwa.core.interfaces.DexterityIndex`."""
    return ()


@hookspec
def eiwa_humans() -> Iterable[Plugin]:
    """Human models; ``build`` returns an :class:`eiwa.core.interfaces.HumanModel`."""
    return ()


@hookspec
def eiwa_voxels() -> Iterable[Plugin]:
    """Voxel backends; ``build`` returns an :class:`eiwa.core.interfaces.VoxelBackend`.

    The parameters' model must have a field ``aggregate``.
    """
    return ()


@hookspec
def eiwa_metrics() -> Iterable[Plugin]:
    """Metrics; ``build`` returns an :class:`eiwa.core.interfaces.Metric`."""
    return ()
