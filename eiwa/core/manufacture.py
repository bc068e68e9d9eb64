"""What manufacture does to a design: errors of its values, and the values that a catalogue offers."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, sqrt
from typing import Any, Self

import numpy as np
from pydantic import model_validator

from eiwa.core.errors import SpecError, finding
from eiwa.core.findings import validated
from eiwa.core.hookspecs import Parameters, quantity
from eiwa.core.interfaces import Array
from eiwa.core.named import refuse_unquoted
from eiwa.core.tree import leaves


class ToleranceSection(Parameters):
    """The error of a manufactured value, around the designed one."""

    normal: float | None = quantity(None, gt=0, description="Standard deviation of a normal error, in the path's unit.")
    uniform: float | None = quantity(None, gt=0, description="Half-width of a uniform error, in the path's unit.")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.normal is None) == (self.uniform is None):
            raise ValueError("give normal (a standard deviation) or uniform (a half-width)")
        return self

    @property
    def deviation(self) -> float:
        """Standard deviation of the error."""
        return self.normal if self.normal is not None else (self.uniform or 0.0) / sqrt(3)

    def errors(self, rng: np.random.Generator, count: int) -> Array:
        """Independent errors, (count,)."""
        if self.normal is not None:
            return rng.normal(0.0, self.normal, count)
        assert self.uniform is not None
        return rng.uniform(-self.uniform, self.uniform, count)


def tolerances(table: Mapping[str, Any]) -> dict[str, ToleranceSection]:
    """The table ``[tolerance]``: paths with their errors."""
    found = {}
    for path, value in table.items():
        if not isinstance(value, dict):
            remedy = "Write { normal = 0.0005 } or { uniform = 0.001 }."
            raise SpecError(finding(f'tolerance."{path}"', "must be a table.", value=value, remedy=remedy))
        if any(isinstance(inner, dict) for inner in value.values()):
            whole = next(iter(leaves(value, path)))[0].rpartition(".")[0]
            remedy = f'Quote the whole path: "{whole}" = {{ normal = 0.0005 }}.'
            raise SpecError(finding(f"tolerance.{path}", "errors stand at quoted paths here.", remedy=remedy))
        found[path] = validated(ToleranceSection, value, f'tolerance."{path}"')
    return found


def catalogue(table: Mapping[str, Any]) -> dict[str, list[float]]:
    """The table ``[catalogue]``: paths with the values that can be bought, in increasing order."""
    found = {}
    for path, values in table.items():
        refuse_unquoted("catalogue", path, values)
        numbers = isinstance(values, list) and all(isinstance(v, int | float) and type(v) is not bool for v in values)
        if not (numbers and values and all(map(isfinite, values))) or len(set(values)) < len(values):
            problem = "must be a list of different, finite numbers."
            remedy = f'Write "{path}" = [0.15, 0.18, 0.20].'
            raise SpecError(finding(f'catalogue."{path}"', problem, value=values, remedy=remedy))
        found[path] = sorted(map(float, values))
    return found
