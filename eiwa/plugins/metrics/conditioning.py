"""How well conditioned an arm is over all of its postures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eiwa.core.evaluation import Measurement
from eiwa.core.hookspecs import Number, Plugin, hookimpl
from eiwa.core.interfaces import Metric
from eiwa.core.optimum import pilot_points
from eiwa.core.singular import inverse_condition
from eiwa.core.taskspace import TaskSpace, characteristic_length, row_numbers, scaled


class GciParameters(TaskSpace):
    """Global conditioning index: mean of 1 / cond J over the joint space within its limits."""


@dataclass(frozen=True)
class GlobalConditioning(Metric):
    """Gosselin and Angeles' index (J. Mechanical Design 113, 1991), as a mean over joint space.

    The mean is over the valid ones of the pilot's 2^14 Sobol points: deterministic, the same for every seed, with a
    quasi-Monte Carlo error of some 1e-4.
    """

    parameters: GciParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The index."""
        arm, rows = measurement.setup.arm, row_numbers(self.parameters.rows)
        pilot = arm.postures(pilot_points(arm.dof)).solved
        inverse = 1.0 / characteristic_length(self.parameters.length, rows, pilot)
        jacobian = [list(row) for row in np.ascontiguousarray(pilot.jacobians.transpose(1, 2, 0))]
        return {"gci": float(np.mean(inverse_condition(scaled(jacobian, rows, inverse))))}


@hookimpl
def eiwa_metrics() -> list[Plugin]:
    """The global conditioning index."""
    number = Number("gci", "", "mean of 1 / cond J over joint space", 0.0, 1.0)
    return [Plugin("gci", GciParameters, GlobalConditioning, (number,))]
