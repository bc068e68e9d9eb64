"""Penalties near joint limits, from each joint's place u in [0, 1] between them."""

from __future__ import annotations

from eiwa.core.interfaces import ArmColumns
from eiwa.core.linear import product
from eiwa.core.symbols import Column, expm1, maximum


def margins(arm: ArmColumns) -> list[Column]:
    """u (1 - u) of every limited joint, clipped at 0 outside its limits; 1/4 at mid-range."""
    return [maximum(u - u * u, 0.0) for u, limited in zip(arm.u, arm.limited, strict=True) if limited]


def penalty(arm: ArmColumns, K: Column) -> Column:
    """The factor of Eq. (1), 1 - exp(-K prod_j u_j (1 - u_j))."""
    return -expm1(-K * product(margins(arm)))


def unscaled(K: float | None, K_scaled: float | None, limited: tuple[bool, ...]) -> float:
    """K, or K' 4^N over the N limited joints, whichever is given."""
    if K is None:
        assert K_scaled is not None
        return K_scaled * 4.0 ** sum(limited)
    return K
