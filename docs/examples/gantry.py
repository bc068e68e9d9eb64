"""A master on three slides, written in plain NumPy: the smallest arm that a study can name."""

from dataclasses import dataclass

import numpy as np

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Arm, Array, Postures


class GantryParameters(Parameters):
    """Three slides along x, y and z, centred on the base frame."""

    travel: list[float] = quantity(
        unit="m", min_length=3, max_length=3, description="Travel along x, y and z.", examples=[[0.3, 0.2, 0.2]]
    )


@dataclass(frozen=True)
class Gantry(Arm):
    """The handle goes where the slides go and does not turn."""

    parameters: GantryParameters
    dof = 3
    limited = (True, True, True)

    def postures(self, u: Array) -> Postures:
        """Points of the unit cube as positions of the slides."""
        n = len(u)
        q = (u - 0.5) * np.array(self.parameters.travel)
        rotations = np.broadcast_to(np.eye(3), (n, 3, 3))
        jacobians = np.broadcast_to(np.eye(6, 3), (n, 6, 3))  # x, y, z follow the slides; no joint turns the handle
        return Postures(u, q, q, rotations, jacobians, np.ones(n, bool), self.limited)


@hookimpl
def eiwa_arms() -> list[Plugin]:
    """The gantry."""
    return [Plugin("gantry", GantryParameters, Gantry)]
