"""Arms read from a URDF: the joints from one link to another, as a serial chain."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from eiwa.core.chain import Joint, Kind, SerialChain
from eiwa.core.chain_parameters import Angles, ChainParameters, Range, Vector, increasing
from eiwa.core.errors import finding
from eiwa.core.hookspecs import FileParameter, Parameters, Plugin, hookimpl, quantity
from eiwa.core.transforms import Transform, align_z, frozen, inverse, roll_pitch_yaw, rotation_z, translation
from eiwa.plugins.arms.urdf.file import KINDS, Drive, FileJoint, drives, model, refuse, way


class UrdfJoint(Parameters):
    """What a study changes about a joint of the file; the rest is written out from the file."""

    xyz: Vector | None = quantity(None, unit="m", description="Origin in the parent link, before it is scaled.")
    rpy: Vector | None = quantity(None, unit="angles", description="Roll, pitch, yaw of the origin.")
    limits: Range | None = quantity(
        None, unit="angles or m", description="Range [low, high]; limits a continuous joint too."
    )

    _limits_increase = field_validator("limits")(increasing)


class UrdfParameters(ChainParameters):
    """A serial arm from a URDF: the joints from the link ``base`` to the link ``tip``."""

    file: FileParameter = quantity(description="The URDF, relative to the study file. Run xacro on it first.")
    base: str | None = quantity(None, description="First link; none: the one link that is no joint's child.")
    tip: str | None = quantity(None, description="Last link; none: the one link below the base without a joint on it.")
    angles: Angles = quantity("rad", description="Unit of the angles in this table (the file's are in rad).")
    scale: dict[str, Annotated[float, Field(gt=0)]] = quantity(
        {}, description="Link -> factor on the origins of the joints that stand on it; 1 where none is given."
    )
    joints: dict[str, UrdfJoint] = quantity({}, description="Joint -> what is changed about it.")

    @model_validator(mode="after")
    def _written_out(self) -> Self:
        """Every link and joint of the chain with its numbers, so that each has a path."""
        joints = self.way
        names, parents = [joint.name for joint in joints], [joint.parent for joint in joints]
        for name in self.joints:
            if name not in names:
                refuse(f"joints.{name}", f"the chain has no such joint. Joints: {', '.join(names)}.")
        for link in self.scale:
            if link not in parents:
                refuse(f"scale.{link}", f"no joint of the chain stands on such a link. Links: {', '.join(parents)}.")
        filled = {joint.name: _filled(joint, self.joints.get(joint.name, UrdfJoint()), self.unit) for joint in joints}
        values = {
            "base": parents[0],
            "tip": joints[-1].child,
            "scale": {link: self.scale.get(link, 1.0) for link in parents},
            "joints": filled,
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)
        return self

    @property
    def way(self) -> tuple[FileJoint, ...]:
        """The file's joints from base to tip."""
        return way(model(self.file.path, self.file.digest), self.base, self.tip)


def _filled(joint: FileJoint, change: UrdfJoint, unit: float) -> UrdfJoint:
    """The joint's numbers in the study's units: the study's own, else the file's."""
    limits, path = change.limits, f"joints.{joint.name}.limits"
    scale = 1.0 if joint.type == "prismatic" else unit
    if joint.type == "fixed" and limits is not None:
        refuse(path, "a fixed joint has no limits: remove them.", limits)
    if limits is None and joint.limits is not None and joint.type in ("revolute", "prismatic"):
        limits = [limit / scale for limit in joint.limits]
        if joint.mimic is None and not limits[0] < limits[1]:
            refuse(path, "the file's limits leave no range.", limits, "Write limits = [low, high] here.")
    if limits is None and joint.mimic is None and joint.type in ("revolute", "prismatic"):
        refuse(path, f"the {joint.type} joint has no <limit> in the file.", remedy="Write limits = [low, high] here.")
    rpy = change.rpy or [angle / unit for angle in joint.rpy]
    return UrdfJoint.model_construct(xyz=change.xyz or list(joint.xyz), rpy=rpy, limits=limits)


def chain(parameters: UrdfParameters) -> SerialChain:
    """The serial chain of a file, fixed joints folded, mimics honoured."""
    file = parameters.file
    moved = drives(model(file.path, file.digest), parameters.way)
    joints = tuple(_joint(joint, parameters, moved[joint.name]) for joint in parameters.way)
    couplings = parameters.couplings(joints)
    tool, base = frozen(parameters.T_last_tool), frozen(np.eye(4))
    return SerialChain(joints, tool, base, lambda: _explain_singular(parameters), couplings)


def _joint(joint: FileJoint, parameters: UrdfParameters, drive: Drive) -> Joint:
    change, factor = parameters.joints[joint.name], parameters.scale[joint.parent]
    assert change.xyz is not None and change.rpy is not None
    x, y, z = (factor * value for value in change.xyz)
    roll, pitch, yaw = (angle * parameters.unit for angle in change.rpy)
    T, kind = translation(x, y, z) @ roll_pitch_yaw(roll, pitch, yaw), KINDS[joint.type]
    if drive.mimic is not None and drive.mimic.multiplier == 0.0:
        return Joint(joint.name, "fixed", frozen(T @ _motion(kind, joint.axis, drive.mimic.offset)))
    unit = parameters.unit if kind == "revolute" else 1.0
    limits = None if change.limits is None else (change.limits[0] * unit, change.limits[1] * unit)
    if limits is not None and drive.limits is not None:
        limits = (max(limits[0], drive.limits[0]), min(limits[1], drive.limits[1]))
    return Joint(joint.name, kind, frozen(T), limits or drive.limits, joint.axis, drive.mimic)


def _motion(kind: Kind, axis: tuple[float, float, float], value: float) -> Transform:
    T_joint_z = align_z(axis)
    return T_joint_z @ (rotation_z(value) if kind == "revolute" else translation(0, 0, value)) @ inverse(T_joint_z)


def _explain_singular(parameters: UrdfParameters) -> str:
    """Which directions are missing; nothing when none are."""
    rank = chain(parameters).rank
    if rank == 6:
        return ""
    reason = f"from {parameters.base!r} to here the Jacobian has rank {rank} at every posture."
    return finding("arm.tip", reason, value=parameters.tip, remedy="Choose dexterity.rows that the arm moves in.")


@hookimpl
def eiwa_arms() -> list[Plugin]:
    """Arms from URDF files."""
    return [Plugin("urdf", UrdfParameters, chain)]
