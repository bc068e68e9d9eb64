"""Extended manipulability: how well an arm moves in its worst direction when joints near a limit count less.

N. Vahrenkamp, T. Asfour, G. Metta, G. Sandini, R. Dillmann, "Manipulability analysis", IEEE-RAS Int. Conf. on Humanoid
Robots 2012, without its obstacles; the penalty is that of T. F. Chan and R. V. Dubey, "A weighted least-norm solution
based scheme for avoiding joint limits for redundant joint manipulators", IEEE Trans. Robotics and Automation 11, 1995.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.hookspecs import Plugin, hookimpl
from eiwa.core.interfaces import Arm, ArmColumns, Postures, TracedIndex
from eiwa.core.linear import volume
from eiwa.core.symbols import Column, absolute, maximum, minimum, sqrt, where
from eiwa.core.taskspace import TaskSpace, characteristic_length, row_numbers, scaled


class ExtendedParameters(TaskSpace):
    """Manipulability in the worst orthant, joints near a limit weighed down on their way to it (Vahrenkamp)."""


@dataclass(frozen=True)
class Extended(TracedIndex):
    """min over s in {-1, 1}^rows of the product of the singular values of J(s).

    J(s)_ij = J_ij pen_j where s_i J_ij moves joint j towards its nearer limit, else J_ij: a motion of the tip into the
    orthant s. With the joint's range R_j, pen_j = 1 / sqrt(1 + |dH/dq_j|), where H = sum R^2 / (4 (high - q) (q - low)),
    so |dH/dq| = |2 u - 1| / (4 R u^2 (1 - u)^2): 1 at mid-range, 0 at a limit and outside.
    """

    rows: tuple[int, ...]
    length: float | Literal["auto"]

    @property
    def structure(self) -> tuple[int, ...]:  # type: ignore[override]
        """The chosen rows."""
        return self.rows

    def prepare(self, arm: Arm, pilot: Postures) -> NDArray[np.float64]:
        """1 / L, then every joint's range [rad or m], read off the pilot, in which q is linear in u."""
        spread = np.ptp(pilot.u, axis=0)
        ranges = np.where(spread > 0, np.ptp(pilot.q, axis=0) / np.where(spread > 0, spread, 1.0), 1.0)
        length = characteristic_length(self.length, self.rows, pilot)
        return np.array([1.0 / length, *ranges])

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """The smallest of the 2^rows volumes."""
        J = scaled(arm.jacobian, self.rows, p[0])
        joints = range(len(arm.u))
        sides = [_towards(arm.u[j], p[1 + j]) if arm.limited[j] else (1.0, 1.0) for j in joints]
        signed = [
            [[_weighed(entry, sign, *side) for entry, side in zip(row, sides, strict=True)] for sign in (1, -1)]
            for row in J
        ]
        smallest, *others = (volume(orthant) for orthant in product(*signed))
        for other in others:
            smallest = minimum(smallest, other)
        return smallest


def _towards(u: Column, R: Column) -> tuple[Column, Column]:
    """Penalties of a joint for moving down and up."""
    margin = maximum(u - u * u, 0.0)
    steepness = 4.0 * R * (margin * margin)
    pen = sqrt(steepness / (steepness + absolute(2.0 * u - 1.0)))
    low = u < 0.5
    return where(low, pen, 1.0), where(low, 1.0, pen)


def _weighed(entry: Column, sign: int, down: Column, up: Column) -> Column:
    if isinstance(entry, float | int) and entry == 0:
        return 0.0
    backwards = entry < 0.0
    return entry * (where(backwards, down, up) if sign > 0 else where(backwards, up, down))


def _build(parameters: ExtendedParameters) -> Extended:
    return Extended(row_numbers(parameters.rows), parameters.length)


@hookimpl
def eiwa_dexterities() -> list[Plugin]:
    """Extended manipulability."""
    return [Plugin("extended", ExtendedParameters, _build)]
