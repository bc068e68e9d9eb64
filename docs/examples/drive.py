"""How fast the tip can be driven along one direction: a dexterity index in plain NumPy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Arm, Array, DexterityIndex, Postures


class DriveParameters(Parameters):
    """Largest speed of the tip along a direction of the base frame, for joint speeds of norm 1."""

    direction: list[float] = quantity(
        [1.0, 0.0, 0.0], min_length=3, max_length=3, description="The direction; its length does not matter."
    )


@dataclass(frozen=True)
class Drive(DexterityIndex):
    """|Jvt d| with d the unit direction."""

    parameters: DriveParameters

    def prepare(self, arm: Arm, pilot: Postures) -> NDArray[np.float64]:
        """d."""
        d = np.array(self.parameters.direction)
        return np.asarray(d / np.linalg.norm(d))

    def values(self, postures: Postures, prepared: NDArray[np.float64]) -> Array:
        """One value a posture, not negative."""
        return np.asarray(np.linalg.norm(prepared @ postures.jacobians[:, :3], axis=1))


@hookimpl
def eiwa_dexterities() -> list[Plugin]:
    """The index."""
    return [Plugin("drive", DriveParameters, Drive)]
