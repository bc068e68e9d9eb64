"""The arm mydevice: a waist that turns, a lift and a boom. Put your own device's geometry in their place."""

from dataclasses import dataclass

import numpy as np

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Arm, ArmColumns, Array, Postures


class MydeviceParameters(Parameters):
    """A waist that turns about z, a lift along z, a boom along its own x."""

    turn: float = quantity(120.0, gt=0, unit="deg", description="Turn of the waist to either side.")
    lift: float = quantity(0.3, gt=0, unit="m", description="Travel of the lift.")
    boom: list[float] = quantity([0.1, 0.4], unit="m", min_length=2, max_length=2, description="Length, in and out.")


@dataclass(frozen=True)
class Mydevice(Arm):
    """Joints: the waist's angle [rad], the lift's height [m], the boom's length [m]."""

    parameters: MydeviceParameters
    dof, limited = 3, (True, True, True)

    def postures(self, u: Array) -> Postures:
        """Points u (n, 3) of the unit cube as joint values, tips, rotations and Jacobians, in the base frame."""
        turn, lift, (near, far) = np.deg2rad(self.parameters.turn), self.parameters.lift, self.parameters.boom
        angle, height, length = turn * (2 * u[:, 0] - 1), lift * u[:, 1], near + (far - near) * u[:, 2]
        c, s = np.cos(angle), np.sin(angle)
        tip, rotation = [length * c, length * s, height], [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        # rows: the tip's velocity x, y, z, then the handle's angular velocity; columns: waist, lift, boom
        jacobian = [[-length * s, 0, c], [length * c, 0, s], [0, 1, 0], [0, 0, 0], [0, 0, 0], [1, 0, 0]]
        return ArmColumns(list(u.T), [angle, height, length], tip, rotation, jacobian, self.limited).postures()


@hookimpl
def eiwa_arms() -> list[Plugin]:
    """The name that a study writes in kind, the table's model, and what builds the arm from it."""
    return [Plugin("mydevice", MydeviceParameters, Mydevice)]
