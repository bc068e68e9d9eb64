"""A product of other indices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eiwa.core.hookspecs import IndexParameter, Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Arm, ArmColumns, Array, DexterityIndex, Postures, TracedIndex
from eiwa.core.linear import product
from eiwa.core.symbols import Column


class ProductParameters(Parameters):
    """The product of other indices, each with its own parameters."""

    factors: list[IndexParameter] = quantity(
        min_length=1,
        examples=[[{"kind": "condition", "rows": "translation"}, {"kind": "joint_limits", "form": "mean"}]],
        description="Tables [[dexterity.factors]], each with the kind and the parameters of an index.",
    )


def _prepared(factors: Sequence[DexterityIndex], arm: Arm, pilot: Postures) -> NDArray[np.float64]:
    """What every factor learned, behind one another, filled up with zeros to one width."""
    parts = [factor.prepare(arm, pilot) for factor in factors]
    width = max(len(part) for part in parts)
    return np.concatenate([np.pad(part, (0, width - len(part))) for part in parts])


@dataclass(frozen=True)
class TracedProduct(TracedIndex):
    """The product of indices that are all traced: one kernel, in which the Jacobian is computed once."""

    factors: tuple[TracedIndex, ...]

    @property
    def structure(self) -> tuple[object, ...] | None:  # type: ignore[override]
        """The factors' types and structures; None where one of them has none."""
        each = tuple((type(factor), factor.structure) for factor in self.factors)
        return None if any(structure is None for _, structure in each) else each

    def prepare(self, arm: Arm, pilot: Postures) -> NDArray[np.float64]:
        """What the factors learned."""
        return _prepared(self.factors, arm, pilot)

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """The product on columns."""
        width = len(p) // len(self.factors)
        return product([f.columns(arm, p[k * width : (k + 1) * width]) for k, f in enumerate(self.factors)])


@dataclass(frozen=True)
class ArrayProduct(DexterityIndex):
    """The product where some index is written for arrays alone."""

    factors: tuple[DexterityIndex, ...]

    def prepare(self, arm: Arm, pilot: Postures) -> NDArray[np.float64]:
        """What the factors learned."""
        return _prepared(self.factors, arm, pilot)

    def values(self, postures: Postures, prepared: NDArray[np.float64]) -> Array:
        """The product of the factors' values."""
        parts = np.split(prepared, len(self.factors))
        values = [factor.values(postures, part) for factor, part in zip(self.factors, parts, strict=True)]
        result: Array = np.prod(values, axis=0)
        return result


def _build(parameters: ProductParameters) -> DexterityIndex:
    factors = tuple(factor.build() for factor in parameters.factors)
    return TracedProduct(factors) if all(isinstance(f, TracedIndex) for f in factors) else ArrayProduct(factors)


@hookimpl
def eiwa_dexterities() -> list[Plugin]:
    """The product of indices."""
    return [Plugin("product", ProductParameters, _build)]
