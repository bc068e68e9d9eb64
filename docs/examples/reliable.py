"""The dexterity that most of the comfortable region offers: a metric with a parameter."""

from dataclasses import dataclass

import numpy as np

from eiwa.core.evaluation import Measurement
from eiwa.core.hookspecs import Number, Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Metric


class ReliableParameters(Parameters):
    """V_dual that a share of the cells with E > 0 reaches or exceeds."""

    share: float = quantity(0.5, gt=0, lt=1, description="The share of the cells.")


@dataclass(frozen=True)
class Reliable(Metric):
    """The quantile of V_dual at 1 - share, every cell counted alike."""

    parameters: ReliableParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The value, replicate 0; None where no cell is comfortable."""
        inside = measurement.first.V_dual[measurement.first.E_sum > 0]
        return {"reliable": float(np.quantile(inside, 1 - self.parameters.share)) if inside.size else None}


@hookimpl
def eiwa_metrics() -> list[Plugin]:
    """The metric and its number."""
    number = Number("reliable", "", "V_dual that a share of the comfortable cells reaches", 0.0, 1.0)
    return [Plugin("reliable", ReliableParameters, Reliable, (number,))]
