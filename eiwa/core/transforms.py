"""Homogeneous transforms as 4x4 arrays. ``T_a_b`` maps b-coordinates into a; lengths in m, angles in rad."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Transform = NDArray[np.float64]
"""A 4x4 homogeneous transform."""


def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, exact at multiples of 90 degrees so that structural zeros stay zeros."""
    quarter = angle / (np.pi / 2)
    if abs(quarter - round(quarter)) < 1e-14 * max(1.0, abs(quarter)):
        k = round(quarter) % 4
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[k]
    return float(np.cos(angle)), float(np.sin(angle))


def frozen(array: ArrayLike, dtype: type = np.float64) -> NDArray[np.float64]:
    """A read-only contiguous copy."""
    copy: NDArray[np.float64] = np.array(array, dtype=dtype, order="C")
    copy.setflags(write=False)
    return copy


def translation(x: float, y: float, z: float) -> Transform:
    """Translation by (x, y, z) [m]."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def rotation_x(angle: float) -> Transform:
    """Rotation about x [rad]."""
    c, s = _cos_sin(angle)
    return np.array([[1.0, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def rotation_y(angle: float) -> Transform:
    """Rotation about y [rad]."""
    c, s = _cos_sin(angle)
    return np.array([[c, 0.0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])


def rotation_z(angle: float) -> Transform:
    """Rotation about z [rad]."""
    c, s = _cos_sin(angle)
    return np.array([[c, -s, 0.0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Transform:
    """Rotation Rz(yaw) Ry(pitch) Rx(roll) [rad], the fixed-axis convention of URDF."""
    return rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll)


def inverse(T_a_b: Transform) -> Transform:
    """``T_b_a`` of a rigid ``T_a_b``."""
    T_b_a = np.eye(4)
    T_b_a[:3, :3] = T_a_b[:3, :3].T
    T_b_a[:3, 3] = -T_a_b[:3, :3].T @ T_a_b[:3, 3]
    return T_b_a


def align_z(axis: ArrayLike) -> Transform:
    """A rotation that takes z to a unit axis; exact for the coordinate axes."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(np.asarray(axis, float))
    return (
        rotation_z(np.arctan2(y, x)) @ rotation_y(np.arctan2(np.hypot(x, y), z))
        if x or y
        else rotation_x(0 if z > 0 else np.pi)
    )
