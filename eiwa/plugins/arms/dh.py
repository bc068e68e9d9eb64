"""Arms given by a Denavit-Hartenberg table, standard or modified."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from eiwa.core.chain import Joint, SerialChain
from eiwa.core.chain_parameters import ChainParameters, Range
from eiwa.core.errors import SpecError, finding
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.transforms import frozen, rotation_x, rotation_z, translation

Convention = Literal["standard", "modified"]
MOST_TURNS = 5
"""Of a revolute joint with limits, to either side; 120 rad are 19."""


TWISTS = {"waist": 0, "shoulder": 90, "upper": -90, "fore": 0, "pitch": -90, "roll": 90}
LENGTHS = {"upper": 0.26, "fore": 0.18}
EXAMPLE = [{"name": n, "alpha": alpha, "a": LENGTHS.get(n, 0), "limits": [-120, 120]} for n, alpha in TWISTS.items()]
"""Table 1 of the paper with the lengths of its optimum."""


class DhJoint(Parameters):
    """One row of the table; a fixed row has no limits and keeps ``theta`` and ``d``."""

    name: str = quantity(min_length=1, pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$", description="Names the joint in paths.")
    kind: Literal["revolute", "prismatic", "fixed"] = quantity("revolute", description="What moves.")
    alpha: float = quantity(0.0, unit="angles", description="Twist (modified: of the row before, alpha_{j-1}).")
    a: float = quantity(0.0, unit="m", description="Link length (modified: a_{j-1}).")
    d: float = quantity(0.0, unit="m", description="Offset along the joint axis; a prismatic joint adds to it.")
    theta: float = quantity(0.0, unit="angles", description="Offset of the joint angle; a revolute joint adds to it.")
    limits: Range | None = quantity(
        None,
        unit="angles or m",
        description="Range [low, high]; none for a revolute joint that turns freely.",
    )

    @field_validator("limits")
    @classmethod
    def _limits_increase(cls, limits: list[float] | None) -> list[float] | None:
        if limits is not None and not limits[0] < limits[1]:
            raise ValueError("must increase: write [low, high] with low < high, or kind = 'fixed' without limits")
        return limits

    @model_validator(mode="after")
    def _limits_suit_the_kind(self) -> Self:
        if self.kind == "prismatic" and self.limits is None:
            raise ValueError("a prismatic joint needs limits = [low, high] in m")
        if self.kind == "fixed" and self.limits is not None:
            raise ValueError("a fixed joint has no limits: remove them")
        return self


class DhParameters(ChainParameters):
    """A serial arm from its Denavit-Hartenberg table.

    ``modified`` (Craig): T_{j-1,j} = Rx(alpha_{j-1}) Tx(a_{j-1}) Rz(theta_j) Tz(d_j).
    ``standard``: T_{j-1,j} = Rz(theta_j) Tz(d_j) Tx(a_j) Rx(alpha_j).
    """

    convention: Convention = quantity(
        description="How the rows are read: 'standard' or 'modified' (Craig).", examples=["modified"]
    )
    joints: Annotated[list[DhJoint], Field(min_length=1)] = quantity(
        description="The rows, from the base.", examples=[EXAMPLE]
    )

    @model_validator(mode="after")
    def _angles_are_in_their_unit(self) -> Self:
        for joint in self.joints:
            most = max(map(abs, joint.limits or [0.0])) if joint.kind == "revolute" else 0.0
            if most * self.unit > 2 * np.pi * MOST_TURNS:
                turns = f"{most * self.unit / (2 * np.pi):.4g} turns, at most {MOST_TURNS} are allowed"
                remedy = (
                    'angles = "deg" reads them as degrees' if self.angles == "rad" else "without limits it turns freely"
                )
                raise ValueError(f"joint {joint.name} has limits = {joint.limits} {self.angles}, {turns}: {remedy}")
        return self

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [joint.name for joint in self.joints]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"joints share the name {', '.join(twice)}: give each its own")
        return self


def chain(parameters: DhParameters) -> SerialChain:
    """The serial chain of a table."""
    unit = parameters.unit
    joints, T = [], np.eye(4)
    for row in parameters.joints:
        Rz_Tz = rotation_z(row.theta * unit) @ translation(0, 0, row.d)
        link = rotation_x(row.alpha * unit) @ translation(row.a, 0, 0)
        before, after = (link @ Rz_Tz, np.eye(4)) if parameters.convention == "modified" else (Rz_Tz, link)
        scale = unit if row.kind == "revolute" else 1.0
        limits = None if row.limits is None else (row.limits[0] * scale, row.limits[1] * scale)
        joints.append(Joint(row.name, row.kind, frozen(T @ before), limits))
        T = after
    return SerialChain(
        tuple(joints),
        frozen(T @ parameters.T_last_tool),
        frozen(np.eye(4)),
        lambda: _explain_singular(parameters),
        parameters.couplings(joints),
    )


def _explain_singular(parameters: DhParameters) -> str:
    """Why a table is singular everywhere, with the rank of the other reading; nothing when it is not."""
    this = parameters.convention
    other: Convention = "standard" if this == "modified" else "modified"
    rank, twin_rank = (chain(p).rank for p in (parameters, parameters.model_copy(update={"convention": other})))
    if rank == 6:
        return ""
    reason = f"the Jacobian has rank {rank} at every posture, so the arm is singular everywhere."
    if twin_rank > rank:
        remedy = (
            f"Read as convention = '{other}' the same table has rank {twin_rank}: is that the one it was written in?"
        )
    else:
        remedy = f"Read as '{other}' it has rank {twin_rank}: check the table, or choose dexterity.rows that the arm moves in."
    return finding("arm.convention", reason, value=this, remedy=remedy)


def _build(parameters: DhParameters) -> SerialChain:
    if all(joint.kind == "fixed" for joint in parameters.joints):
        raise SpecError(
            finding("arm.joints", "every joint is fixed.", remedy="Make at least one revolute or prismatic.")
        )
    return chain(parameters)


@hookimpl
def eiwa_arms() -> list[Plugin]:
    """Arms from DH tables."""
    return [Plugin("dh", DhParameters, _build)]
