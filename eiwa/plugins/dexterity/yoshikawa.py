"""Yoshikawa's manipulability with the joint-limit penalty of Eq. (1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Arm, ArmColumns, Postures, TracedIndex
from eiwa.core.limits import penalty, unscaled
from eiwa.core.linear import volume
from eiwa.core.symbols import Column
from eiwa.core.taskspace import ROWS, ROWS_FIELD, RowsParameter, row_numbers


class YoshikawaParameters(Parameters):
    """Manipulability sqrt det(J Jt), penalised near joint limits: Eq. (1).

    Exactly one of ``K`` and ``K_scaled`` is given.
    """

    K: float | None = quantity(
        None,
        gt=0,
        description="Scaling factor of Eq. (1). 12270 gives a factor of 0.95 at mid-range of six joints.",
        examples=[12270],
    )
    K_scaled: float | None = quantity(
        None,
        gt=0,
        description="Scale-free form K' = K 4^-N for N limited joints: the factor at mid-range is 1 - exp(-K').",
    )
    rows: RowsParameter = ROWS_FIELD

    @model_validator(mode="after")
    def _one_factor(self) -> Self:
        if (self.K is None) == (self.K_scaled is None):
            raise ValueError("give exactly one of K and K_scaled")
        return self


@dataclass(frozen=True)
class Yoshikawa(TracedIndex):
    """w (1 - exp(-K prod_j u_j (1 - u_j))) with w the product of J's singular values in the chosen rows.

    With fewer joints than rows, w = sqrt det(Jt J). Joints without a range leave the product, which is clipped at 0
    outside the limits.
    """

    K: float | None
    K_scaled: float | None
    rows: tuple[int, ...]

    @property
    def structure(self) -> tuple[int, ...]:  # type: ignore[override]
        """The chosen rows; everything else is a parameter of the kernel."""
        return self.rows

    def prepare(self, arm: Arm, pilot: Postures) -> NDArray[np.float64]:
        """K = K' 4^N over the N limited joints."""
        return np.array([unscaled(self.K, self.K_scaled, arm.limited)])

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """Eq. (1) on columns."""
        jacobian = arm.reduced if arm.reduced is not None and len(self.rows) == len(ROWS) else arm.jacobian
        return volume([jacobian[row] for row in self.rows]) * penalty(arm, p[0])


def _build(parameters: YoshikawaParameters) -> Yoshikawa:
    return Yoshikawa(parameters.K, parameters.K_scaled, row_numbers(parameters.rows))


@hookimpl
def eiwa_dexterities() -> list[Plugin]:
    """The index of the paper."""
    return [Plugin("yoshikawa", YoshikawaParameters, _build)]
