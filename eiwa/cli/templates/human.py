"""The human model mydevice: hands that are most comfortable at a point each. Put your own in its place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import ErgonomicField, HumanModel, Operator
from eiwa.core.sampling import Stream
from eiwa.core.workspace import Grid


class MydeviceParameters(Parameters):
    """Comfort falls linearly from 1 at the right hand's best point to 0 at a distance; the left hand is its mirror image."""

    best: list[float] = quantity(
        [0.2, 0.35, 0.1], unit="m", min_length=3, max_length=3, description="Where E = 1, in W."
    )
    radius: float = quantity(0.2, gt=0, unit="m", description="Where E = 0.")


@dataclass(frozen=True)
class Mydevice(HumanModel):
    """E(x) = max(0, 1 - |x - best| / radius), on the armrest."""

    parameters: MydeviceParameters

    def bounds(self, operator: Operator) -> NDArray[np.float64]:
        """A box that holds both balls [m]."""
        (x, y, z), r = self.parameters.best, self.parameters.radius
        return np.array([[-abs(x) - r, y - r, z - r], [abs(x) + r, y + r, z + r]]) + [0, 0, operator.armrest]

    def field(self, grid: Grid, operator: Operator, stream: Stream) -> ErgonomicField:
        """E at the cells' centres; nothing here is random, so the stream is not used."""
        x, y, z = np.meshgrid(*(grid.centres(axis) for axis in range(3)), indexing="ij")
        bx, by, bz = self.parameters.best
        right, left = (
            np.sqrt((x - side * bx) ** 2 + (y - by) ** 2 + (z - operator.armrest - bz) ** 2) for side in (1, -1)
        )
        return ErgonomicField(*(np.maximum(0.0, 1 - d / self.parameters.radius) for d in (right, left)))


@hookimpl
def eiwa_humans() -> list[Plugin]:
    """The name that a study writes in kind, the table's model, and what builds the model from it."""
    return [Plugin("mydevice", MydeviceParameters, Mydevice)]
