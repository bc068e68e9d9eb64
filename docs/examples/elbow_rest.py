"""Hands that reach from elbows on the armrest: a human model in plain NumPy."""

from dataclasses import dataclass
from math import cos, radians

import numpy as np
from numpy.typing import NDArray

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, ErgonomicField, HumanModel, Operator
from eiwa.core.sampling import Stream
from eiwa.core.workspace import Grid


class ElbowRestParameters(Parameters):
    """E = comfort where a hand is a forearm away from its elbow, within a cone straight ahead."""

    elbow: list[float] = quantity(
        [0.223, 0.0, 0.046],
        unit="m",
        min_length=3,
        max_length=3,
        description="The right elbow in W; the left mirrored.",
    )
    forearm: list[float] = quantity(
        [0.30, 0.40], unit="m", min_length=2, max_length=2, description="Elbow to grip, wrist bent and straight."
    )
    cone: float = quantity(30.0, gt=0, lt=90, unit="deg", description="Largest angle from straight ahead.")
    comfort: float = quantity(0.5, gt=0, le=1, description="E of each hand.")


@dataclass(frozen=True)
class ElbowRest(HumanModel):
    """A part of a spherical shell around each elbow, which moves with the armrest and the seat."""

    parameters: ElbowRestParameters

    def bounds(self, operator: Operator) -> NDArray[np.float64]:
        """The box of both shells [m]."""
        (x, y, z), far = self._elbow(operator), self.parameters.forearm[1]
        return np.array([[-x - far, y, z - far], [x + far, y + far, z + far]])

    def field(self, grid: Grid, operator: Operator, stream: Stream) -> ErgonomicField:
        """E at the cells' centres; nothing here is random, so the stream is not used."""
        x, y, z = self._elbow(operator)
        right, left = (self._shell(grid, np.array([side * x, y, z])) for side in (1, -1))
        return ErgonomicField(right, left)

    def _elbow(self, operator: Operator) -> tuple[float, float, float]:
        x, y, z = self.parameters.elbow
        return x, y - operator.seat, z + operator.armrest

    def _shell(self, grid: Grid, elbow: NDArray[np.float64]) -> Array:
        (near, far), ahead = self.parameters.forearm, cos(radians(self.parameters.cone))
        lever = np.stack(np.meshgrid(*(grid.centres(axis) for axis in range(3)), indexing="ij"), axis=-1) - elbow
        distance = np.linalg.norm(lever, axis=-1)
        inside = (distance >= near) & (distance <= far) & (lever[..., 1] >= ahead * distance)
        return np.where(inside, self.parameters.comfort, 0.0)


@hookimpl
def eiwa_humans() -> list[Plugin]:
    """The model."""
    return [Plugin("elbow_rest", ElbowRestParameters, ElbowRest)]
