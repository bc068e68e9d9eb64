"""How far the joints are from their limits, alone or as a factor of another index."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Arm, ArmColumns, Postures, TracedIndex
from eiwa.core.limits import margins, penalty, unscaled
from eiwa.core.symbols import Column


class JointLimitsParameters(Parameters):
    """Distance from the joint limits in [0, 1], whatever the Jacobian."""

    form: Literal["product", "mean"] = quantity(
        "product",
        description="'product': the factor of Eq. (1), 0 at any limit; 'mean': the mean of 4 u (1 - u) over the limited "
        "joints (REACH), 1 at mid-range whatever their number, 0 only with every joint at a limit.",
    )
    K: float | None = quantity(
        None, gt=0, examples=[12270.0], description="Scaling factor of Eq. (1), for the form 'product'."
    )
    K_scaled: float | None = quantity(
        None,
        gt=0,
        description="Scale-free form K' = K 4^-N for N limited joints: the factor at mid-range is 1 - exp(-K').",
    )

    @model_validator(mode="after")
    def _factor(self) -> Self:
        given = (self.K is not None) + (self.K_scaled is not None)
        if self.form == "product" and given != 1:
            raise ValueError("give exactly one of K and K_scaled")
        if self.form == "mean" and given:
            raise ValueError("K and K_scaled belong to the form 'product': leave them out")
        return self


@dataclass(frozen=True)
class ProductForm(TracedIndex):
    """1 - exp(-K prod_j u_j (1 - u_j)), Eq. (1); 1 - exp(-K) for an arm without limits."""

    K: float | None
    K_scaled: float | None
    structure = ()

    def prepare(self, arm: Arm, pilot: Postures) -> NDArray[np.float64]:
        """K."""
        return np.array([unscaled(self.K, self.K_scaled, arm.limited)])

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """The factor on columns."""
        return penalty(arm, p[0])


@dataclass(frozen=True)
class MeanForm(TracedIndex):
    """Mean of 4 u_j (1 - u_j) over the limited joints; 1 for an arm without limits."""

    structure = ()

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """The mean on columns."""
        each = margins(arm)
        total: Column = 0.0
        for margin in each:
            total = margin + total
        return total * (4.0 / len(each)) if each else 1.0


def _build(parameters: JointLimitsParameters) -> TracedIndex:
    return MeanForm() if parameters.form == "mean" else ProductForm(parameters.K, parameters.K_scaled)


@hookimpl
def eiwa_dexterities() -> list[Plugin]:
    """The penalties alone."""
    return [Plugin("joint_limits", JointLimitsParameters, _build)]
