"""How values under several scenarios become one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

Aggregate = Literal["mean", "min", "max", "cvar", "share_above"]


def mean(values: Sequence[float]) -> float:
    """Arithmetic mean."""
    return math.fsum(values) / len(values)


def cvar(values: Sequence[float], tail: float, *, low_is_bad: bool) -> float:
    """Conditional value at risk: the mean of the worst share ``tail`` of equally likely values.

    Where the share ends within a value, that one counts in part (Rockafellar and Uryasev 2000).
    """
    worst_first = sorted(values, reverse=not low_is_bad)
    count = tail * len(values)
    weights = [min(1.0, max(0.0, count - k)) for k in range(len(values))]
    return math.fsum(w * v for w, v in zip(weights, worst_first, strict=True)) / count


def share_above(values: Sequence[float], level: float) -> float:
    """Share of the values that are at least ``level``."""
    return sum(value >= level for value in values) / len(values)
