"""The metric mydevice: how evenly the two hands are served. Put your own number in its place."""

from dataclasses import dataclass

from eiwa.core.evaluation import Measurement
from eiwa.core.hookspecs import Number, Parameters, Plugin, hookimpl
from eiwa.core.interfaces import Metric


class MydeviceParameters(Parameters):
    """The right hand's share of what both hands can use."""


@dataclass(frozen=True)
class Mydevice(Metric):
    """sum E_right V_dual over sum (E_right + E_left) V_dual: 1/2 where both hands are served alike."""

    parameters: MydeviceParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The share, replicate 0; None where neither hand can use anything."""
        first = measurement.first
        right, left = (float((E * first.V_dual).sum()) for E in (first.E.right, first.E.left))
        return {"mydevice": right / (right + left) if right + left > 0 else None}


@hookimpl
def eiwa_metrics() -> list[Plugin]:
    """The table [metrics.mydevice], its model, what builds the metric, and the number that it yields."""
    number = Number("mydevice", "", "right hand's share of what both can use", 0.0, 1.0)
    return [Plugin("mydevice", MydeviceParameters, Mydevice, (number,))]
