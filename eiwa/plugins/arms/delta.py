"""Delta-type masters (Clavel 1988): three actuated cranks carry a platform that moves in translation only.

Crank i turns in a vertical plane through the axis of the base, at 0, 120 and 240 degrees. Its end, moved inwards by the
platform's radius, is the centre C_i of a sphere with the lower arm's length as radius; the platform's centre P lies on
all three. With c the circumcentre of the triangle C_1 C_2 C_3, rho its circumradius and n its unit normal,

    P = c + h n,  h = sqrt(l^2 - rho^2).

The lower arms v_i = P - C_i then satisfy v_i . dP = b_i dtheta_i with b_i = v_i . dC_i / dtheta_i, so that the columns of
the Jacobian are b_i (v_j x v_k) / (v_1 . (v_2 x v_3)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator, model_validator

from eiwa.core.chain_parameters import Angles, Range, Vector, increasing
from eiwa.core.errors import finding
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import ArmColumns, TracedArm
from eiwa.core.symbols import Column, cross, dot, maximum, sincos, sqrt, where
from eiwa.core.transforms import frozen

DIRECTIONS = ((1.0, 0.0), (-0.5, np.sqrt(0.75)), (-0.5, -np.sqrt(0.75)))
"""Cosine and sine of the planes of the cranks."""


class DeltaParameters(Parameters):
    """A delta: three cranks about axes tangent to the base, lower arms, a platform that does not turn.

    The base frame has its origin in the middle of the base and z as its axis, towards the platform; crank 1 is in the plane
    of x. A crank at 0 points outwards, at 90 degrees along z.
    """

    base_radius: float = quantity(
        gt=0, unit="m", description="From the base's axis to the axes of the cranks.", examples=[0.040]
    )
    platform_radius: float = quantity(
        gt=0, unit="m", description="From the platform's centre to its joints.", examples=[0.015]
    )
    upper: float = quantity(gt=0, unit="m", description="Length of the cranks.", examples=[0.060])
    lower: float = quantity(gt=0, unit="m", description="Length of the lower arms.", examples=[0.125])
    angles: Angles = quantity("deg", description="Unit of the limits.")
    limits: Range = quantity(unit="angles", description="Range [low, high] of every crank.", examples=[[-40, 90]])
    slope: Range = quantity(
        unit="angles",
        description="Range of the angle between the lower arms and the plane of their upper ends, one for all three; "
        "at 0 the platform gives way, and the index grows without bound.",
        examples=[[20, 85]],
    )
    tool: Vector = quantity([0.0, 0.0, 0.0], unit="m", description="The tip from the platform's centre.")

    _limits_increase = field_validator("limits", "slope")(increasing)

    @property
    def unit(self) -> float:
        """Radians per unit of angle."""
        return np.pi / 180 if self.angles == "deg" else 1.0

    @model_validator(mode="after")
    def _slope_is_that_of_an_arm(self) -> Self:
        if not (self.slope[0] * self.unit > 0 and self.slope[1] * self.unit <= np.pi / 2 + 1e-12):
            raise ValueError(f"slope must lie above 0 and not above a right angle, not {self.slope}")
        return self


@dataclass(frozen=True, eq=False)
class Delta(TracedArm):
    """The delta on columns: forward map and Jacobian in closed form.

    A posture is valid where the spheres meet with the slope in its range, with the platform on the far side of the
    cranks' ends (the other solution would have passed through their plane), and with every crank short of the dead point
    where it lines up with its lower arm.
    """

    parameters: DeltaParameters
    dof: int = 3
    limited: tuple[bool, ...] = (True, True, True)
    structure: str = "delta"

    @cached_property
    def constants(self) -> NDArray[np.float64]:  # type: ignore[override]
        """Range of the cranks [rad], R - r, L, l [m], bounds of h^2 [m2], tool [m]."""
        p = self.parameters
        low, high = (limit * p.unit for limit in p.limits)
        h = [p.lower * np.sin(min(end * p.unit, np.pi / 2)) for end in p.slope]
        lengths = [p.base_radius - p.platform_radius, p.upper, p.lower]
        return frozen([low, high - low, *lengths, h[0] ** 2, h[1] ** 2, *p.tool])

    @property
    def link_length(self) -> float:
        """Three cranks and three lower arms [m]."""
        return 3 * (self.parameters.upper + self.parameters.lower)

    def when_singular(self) -> str:
        """A delta does not turn."""
        return finding("dexterity.rows", "a delta moves in translation only.", remedy='Write rows = "translation".')

    def columns(self, u: Sequence[Column], p: Sequence[Column]) -> ArmColumns:
        """Forward map and Jacobian of three cranks."""
        low, span, radius, upper, lower, h_low, h_high, *tool = p
        q = [low + span * entry for entry in u]
        centres, motions = [], []
        for angle, (x, y) in zip(q, DIRECTIONS, strict=True):
            s, c = sincos(angle)
            out, turn = radius + upper * c, -(upper * s)
            centres.append([out * x, out * y, upper * s])
            motions.append([turn * x, turn * y, upper * c])
        a, b = ([e - f for e, f in zip(centre, centres[0], strict=True)] for centre in centres[1:])
        n = cross(a, b)
        area = dot(n, n)
        upright = (n[2] > 0.0) & (area > 1e-12 * (lower * lower * lower * lower))
        inverse = 1.0 / where(upright, area, 1.0)
        aa, bb = dot(a, a), dot(b, b)
        middle = [(e * bb + f * aa) * (0.5 * inverse) for e, f in zip(cross(n, a), cross(b, n), strict=True)]
        h = lower * lower - dot(middle, middle)
        rise = sqrt(maximum(h, h_low) * inverse)
        P = [o + m + rise * e for o, m, e in zip(centres[0], middle, n, strict=True)]
        arms = [[e - f for e, f in zip(P, centre, strict=True)] for centre in centres]
        drive = [dot(v, motion) for v, motion in zip(arms, motions, strict=True)]
        valid = upright & (h >= h_low) & (h <= h_high) & (drive[0] > 0.0) & (drive[1] > 0.0) & (drive[2] > 0.0)
        normals = [cross(arms[1], arms[2]), cross(arms[2], arms[0]), cross(arms[0], arms[1])]
        volume = dot(arms[0], normals[0])
        inverse_volume = 1.0 / where(valid, volume, 1.0)
        linear = [[normals[j][i] * (drive[j] * inverse_volume) for j in range(3)] for i in range(3)]
        return ArmColumns(
            u=u,
            q=q,
            tip=[e + f for e, f in zip(P, tool, strict=True)],
            rotation=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            jacobian=[*linear, *([[0.0] * 3] * 3)],
            limited=self.limited,
            valid=valid,
        )


@hookimpl
def eiwa_arms() -> list[Plugin]:
    """The delta."""
    return [Plugin("delta", DeltaParameters, Delta)]
