"""What an arm's tip does when its joints move a little: the independent witness of its Jacobian."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from eiwa.core.interfaces import Arm, Array, Postures, TracedArm
from eiwa.core.symbols import as_columns

STEP = 2.0**-12
"""Smaller of the two steps of the central differences, in the unit cube."""


@dataclass(frozen=True, eq=False)
class Derivative:
    """Central differences of an arm at n postures, by the coordinates of the unit cube.

    ``rates`` (n, dof, dof): dq_i / du_j; ``twists`` (n, 6, dof): velocity of the tip above angular velocity, per u_j;
    ``doubt`` (n, 6, dof): how much ``twists`` changes with the step, infinite where a neighbour has no solution.
    """

    postures: Postures
    rates: Array
    twists: Array
    doubt: Array

    @cached_property
    def claimed(self) -> Array:
        """The twists that the arm's Jacobian says, J dq/du, shape (n, 6, dof)."""
        return np.asarray(self.postures.jacobians @ self.rates)

    @cached_property
    def scales(self) -> Array:
        """Largest linear and angular entry of the twists, repeated per row: shape (6, 1)."""
        known = np.isfinite(self.doubt).all(axis=(1, 2))
        entries = np.maximum(np.abs(self.twists), np.abs(self.claimed))[known]
        largest = [float(entries[:, rows].max(initial=0.0)) for rows in (slice(0, 3), slice(3, 6))]
        return np.repeat(np.maximum(largest, 1e-12), 3)[:, None]

    @cached_property
    def trusted(self) -> NDArray[np.bool_]:
        """Postures where the differences have converged, shape (n,)."""
        return np.asarray((self.doubt <= 1e-3 * self.scales).all(axis=(1, 2)))

    @cached_property
    def mismatch(self) -> Array:
        """|J dq/du - twists| of trusted postures relative to :attr:`scales`, shape (trusted, 6, dof)."""
        return np.asarray(np.abs(self.claimed - self.twists)[self.trusted] / self.scales)


def on_arrays(arm: Arm, u: Array) -> Postures:
    """An arm's postures without compiling anything: formulas on columns are evaluated by NumPy."""
    if not isinstance(arm, TracedArm):
        return arm.postures(u)
    return arm.columns(as_columns(u), list(arm.constants)).postures()


def differentiate(arm: Arm, u: Array) -> Derivative:
    """Differences at u (n, dof) by steps h and 2 h, extrapolated to fourth order (Richardson)."""
    u = np.clip(u, 2 * STEP, 1 - 2 * STEP)
    n, dof = u.shape
    offsets = np.array([-2.0, -1.0, 1.0, 2.0])[:, None, None] * STEP * np.eye(dof)
    at = on_arrays(arm, u)
    around = on_arrays(arm, (u[:, None, None, :] + offsets).reshape(-1, dof))
    shape = (n, 4, dof)
    q, valid = around.q.reshape(*shape, dof), around.valid.reshape(shape)
    tips, R = around.tips.reshape(*shape, 3), around.rotations.reshape(*shape, 3, 3)

    def slope(low: int, high: int) -> tuple[Array, Array]:
        turn = R[:, high] @ np.swapaxes(R[:, low], -1, -2)
        skew = (turn - np.swapaxes(turn, -1, -2)) / 2
        angle = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
        moved = np.concatenate([tips[:, high] - tips[:, low], angle], axis=-1)
        step = offsets[high, 0, 0] - offsets[low, 0, 0]
        return np.swapaxes(q[:, high] - q[:, low], 1, 2) / step, np.swapaxes(moved, 1, 2) / step

    (rates, near), (wider, far) = slope(1, 2), slope(0, 3)
    solved = (at.valid & valid.all(axis=(1, 2)))[:, None, None]
    doubt = np.where(solved, np.abs(near - far) / 3, np.inf)
    return Derivative(at, (4 * rates - wider) / 3, (4 * near - far) / 3, doubt)
