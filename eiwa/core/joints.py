"""The joints of a serial chain: how each moves, what drives it, and which rows of limits couple several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eiwa.core.errors import SpecError, finding
from eiwa.core.transforms import Transform

Kind = Literal["revolute", "prismatic", "fixed"]


@dataclass(frozen=True)
class Mimic:
    """Drives a joint by another one: q = multiplier * q_joint + offset."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Joint:
    """One joint: ``T_parent_joint`` at zero, then a motion about (revolute, [rad]) or along (prismatic, [m]) ``axis``.

    ``limits`` may be None for a revolute joint, which then covers a full turn and is not penalised. A joint that mimics
    another is no degree of freedom; its limits narrow those of the joint that drives it.
    """

    name: str
    kind: Kind
    T_parent_joint: Transform
    limits: tuple[float, float] | None = None
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    mimic: Mimic | None = None


@dataclass(frozen=True)
class Coupling:
    """A row low <= sum_j coefficients[j] q_j <= high over joints by name: what a parallelogram linkage allows."""

    coefficients: Mapping[str, float]
    low: float
    high: float


def unit_of(joint: Joint) -> float:
    """rad per half turn for a revolute joint, which saves the reduction of angles; 1 m for a prismatic one."""
    return float(np.pi) if joint.kind == "revolute" else 1.0


def check(joint: Joint, free: Sequence[str]) -> None:
    """Refuse a movable joint that cannot be; ``free`` names the joints that move by themselves.

    Raises
    ------
    SpecError
        An axis, limits or a mimic that cannot be.
    """
    if not (np.isfinite(joint.T_parent_joint).all() and np.isfinite(joint.axis).all() and any(joint.axis)):
        problem = "a joint needs a finite transform and an axis that is not zero."
        raise SpecError(finding(f"arm.joints.{joint.name}", problem, value=joint.axis))
    if joint.mimic is not None and (joint.mimic.joint not in free or not joint.mimic.multiplier):
        problem = "must mimic a joint of the chain that moves by itself, with a multiplier that is not zero."
        remedy = f"Free joints: {', '.join(free)}."
        raise SpecError(finding(f"arm.joints.{joint.name}.mimic", problem, value=joint.mimic.joint, remedy=remedy))
    path = f"arm.joints.{joint.name}.limits"
    if joint.limits is None:
        if joint.kind == "prismatic" and joint.mimic is None:
            raise SpecError(finding(path, "a prismatic joint needs limits.", remedy="Write limits = [low, high] in m."))
        return
    low, high = joint.limits
    if not (np.isfinite(low) and np.isfinite(high) and low <= high):
        raise SpecError(finding(path, "limits must be finite and increase.", value=[low, high]))
