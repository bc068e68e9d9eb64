"""A searched range and the unit interval: linear, logarithmic or stepped."""

from __future__ import annotations

import math

from optuna.distributions import FloatDistribution

from eiwa.core.samplers import steps
from eiwa.core.sections import RangeSection


def distribution(r: RangeSection) -> FloatDistribution:
    """Optuna's distribution of a range."""
    return FloatDistribution(r.low, _last(r), log=r.log, step=r.step)


def scaled(r: RangeSection, unit: float) -> float:
    """The value at a place in [0, 1]; every step has an equal share."""
    if r.log:
        return math.exp(math.log(r.low) + unit * (math.log(r.high) - math.log(r.low)))
    if r.step is None:
        return r.low + unit * (r.high - r.low)
    return min(_last(r), r.low + int(unit * (steps(r) + 1)) * r.step)


def place(r: RangeSection, value: float) -> float:
    """Where in [0, 1] a value lies, the inverse of :func:`scaled`; a step's value lies in the middle of its share."""
    if r.log:
        return (math.log(value) - math.log(r.low)) / (math.log(r.high) - math.log(r.low))
    if r.step is None:
        return (value - r.low) / (r.high - r.low)
    return (round((value - r.low) / r.step) + 0.5) / (steps(r) + 1)


def _last(r: RangeSection) -> float:
    """The largest value that the steps reach."""
    return r.high if r.step is None else min(r.high, r.low + steps(r) * r.step)
