"""What every serial arm may be told, however its joints are given: unit of angles, tool, coupled limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from eiwa.core.chain import Coupling, Joint
from eiwa.core.errors import SpecError, finding
from eiwa.core.hookspecs import Parameters, quantity
from eiwa.core.transforms import Transform, roll_pitch_yaw, translation

Angles = Literal["deg", "rad"]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]


def increasing(limits: list[float] | None) -> list[float] | None:
    """The limits, when there is something between them.

    Raises
    ------
    ValueError
        They do not increase.
    """
    if limits is not None and not limits[0] < limits[1]:
        raise ValueError("must increase: write [low, high] with low < high")
    return limits


class CoupledRow(Parameters):
    """A row low <= sum of coefficient times joint value <= high; postures outside are not valid."""

    joints: Annotated[dict[str, float], Field(min_length=1)] = quantity(
        description="Joint -> coefficient: { shoulder = 1, elbow = 1 }."
    )
    limits: Range = quantity(
        unit="angles or m", description="Range [low, high] of the sum: angles where a revolute joint is part of it."
    )

    _limits_increase = field_validator("limits")(increasing)


class ChainParameters(Parameters):
    """Base of the parameters of serial arms."""

    angles: Angles = quantity("deg", description="Unit of all angles of the arm.")
    tool: Vector = quantity([0.0, 0.0, 0.0], unit="m", description="The tip in the last link's frame.")
    tool_rpy: Vector = quantity([0.0, 0.0, 0.0], unit="angles", description="Roll, pitch, yaw of the tip.")
    coupled: list[CoupledRow] = quantity([], description="Limits of sums of joints, such as a parallelogram's.")

    @property
    def unit(self) -> float:
        """Radians per unit of angle."""
        return np.pi / 180 if self.angles == "deg" else 1.0

    @property
    def T_last_tool(self) -> Transform:
        """The tip in the last link's frame."""
        roll, pitch, yaw = (angle * self.unit for angle in self.tool_rpy)
        return translation(*self.tool) @ roll_pitch_yaw(roll, pitch, yaw)

    def couplings(self, joints: Sequence[Joint]) -> tuple[Coupling, ...]:
        """The coupled limits in rad and m.

        Where revolute and prismatic joints meet, the whole row is in angles: a prismatic joint's coefficient is in
        angles per m.

        Raises
        ------
        SpecError
            A row names a joint that the arm does not have or that is fixed.
        """
        kinds = {joint.name: joint.kind for joint in joints if joint.kind != "fixed"}
        rows = []
        for number, row in enumerate(self.coupled):
            for name in row.joints:
                if name not in kinds:
                    known = f"Movable joints: {', '.join(kinds)}."
                    path = f"arm.coupled.{number}.joints.{name}"
                    raise SpecError(finding(path, "the arm has no such movable joint.", remedy=known))
            angular = "revolute" in (kinds[name] for name in row.joints)
            unit = self.unit if angular else 1.0
            of = {n: c * (1.0 if kinds[n] == "revolute" else unit) for n, c in row.joints.items()}
            rows.append(Coupling(of, row.limits[0] * unit, row.limits[1] * unit))
        return tuple(rows)
