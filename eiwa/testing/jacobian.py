"""What is wrong with a Jacobian: the usual mistakes, recognised by comparing it with the one from differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from eiwa.core.derivative import Derivative
from eiwa.core.interfaces import Array

CLOSE = 1e-4
"""Relative error up to which a mistake explains what was seen."""


def diagnosis(derivative: Derivative) -> str:
    """What usually causes a wrong Jacobian like this one.

    The whole matrix is compared with the right one in another frame, order or unit first, then column by column.
    """
    kept = derivative.trusted
    claimed, rates = derivative.postures.jacobians[kept], derivative.rates[kept]
    right = derivative.twists[kept] @ np.linalg.pinv(rates)
    for meaning, mistaken in _whole(right, derivative.postures.tips[kept], derivative.postures.rotations[kept], rates):
        if _close(claimed, mistaken):
            return f"the Jacobian is {meaning}."
    for fitted in (_elsewhere(claimed, right, derivative.postures.rotations[kept]), _rotated(claimed, right)):
        if fitted:
            return f"the Jacobian is {fitted}."
    columns: dict[str, list[int]] = {}
    for j in range(claimed.shape[2]):
        if not _close(claimed[:, :, j], right[:, :, j]):
            columns.setdefault(_column(j, claimed, right), []).append(j)
    return " ".join(f"column{'s' * (len(js) > 1)} {', '.join(map(str, js))}: {said}." for said, js in columns.items())


def _close(seen: Array, wanted: Array) -> bool:
    scale = max(float(np.abs(wanted).max(initial=0.0)), 1e-12)
    return bool(np.abs(seen - wanted).max(initial=0.0) <= CLOSE * scale)


def _whole(right: Array, tips: Array, R: Array, rates: Array) -> Iterator[tuple[str, Array]]:
    """The right Jacobian (n, 6, dof), mistaken as a whole: what the mistake means, and what it gives."""
    frames: dict[str, Callable[[Array], Array]] = {
        "": lambda J: J,
        "taken at the base origin instead of the tip (the spatial Jacobian)": lambda J: _moved(J, -tips),
        "in the tip's axes instead of the base's (the body Jacobian)": lambda J: _turned(J, np.swapaxes(R, 1, 2)),
    }
    orders = {"": list(range(6)), "with the angular rows above the linear ones": [3, 4, 5, 0, 1, 2]}
    units = {"": 1.0, "with the opposite sign": -1.0, "per degree": np.pi / 180}
    for frame, mistaken in frames.items():
        for order, rows in orders.items():
            for unit, factor in units.items():
                if meaning := ", ".join(part for part in (frame, order, unit) if part):
                    yield meaning, factor * mistaken(right)[:, rows]
    yield "taken by u instead of q: divide column j by the range of joint j", right @ rates
    without = np.concatenate([right[:, :3], 0 * right[:, 3:]], axis=1)
    yield "without its angular rows: they are zero although the handle turns", without
    yield "made of rates of roll, pitch and yaw, where angular velocity belongs", _euler(right, R)


def _moved(J: Array, by: Array) -> Array:
    """The Jacobian of the point at tip + by, shape (n, 3): v + w x by."""
    w = np.swapaxes(J[:, 3:], 1, 2)
    v = J[:, :3] + np.swapaxes(np.cross(w, by[:, None, :]), 1, 2)
    return np.concatenate([v, J[:, 3:]], axis=1)


def _turned(J: Array, R: Array) -> Array:
    return np.concatenate([R @ J[:, :3], R @ J[:, 3:]], axis=1)


def _euler(J: Array, R: Array) -> Array:
    """Angular rows as rates of roll, pitch, yaw of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch, yaw = -np.arcsin(np.clip(R[:, 2, 0], -1, 1)), np.arctan2(R[:, 1, 0], R[:, 0, 0])
    c, s, cy, sy, zero, one = np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw), 0 * yaw, 1 + 0 * yaw
    to_w = np.stack(
        [np.stack([c * cy, c * sy, -s], 1), np.stack([-sy, cy, zero], 1), np.stack([zero, zero, one], 1)], 2
    )
    return np.concatenate([J[:, :3], np.linalg.pinv(to_w) @ J[:, 3:]], axis=1)


def _elsewhere(claimed: Array, right: Array, R: Array) -> str:
    """Whether the linear rows belong to another point that is fixed to the handle."""
    if not _close(claimed[:, 3:], right[:, 3:]):
        return ""
    w = np.swapaxes(right[:, 3:], 1, 2)
    levers = np.stack([np.cross(w, R[:, None, :, k]) for k in range(3)], axis=-1).reshape(-1, 3)
    gap = np.swapaxes(claimed[:, :3] - right[:, :3], 1, 2).reshape(-1)
    d = np.linalg.lstsq(levers, gap, rcond=1e-9)[0]
    if not _close(claimed, _moved(right, R @ d)):
        return ""
    shown = ", ".join(f"{x:.4g}" for x in np.round(d, 9) + 0.0)
    return f"that of the point ({shown}) m from the tip, in the tip's axes: is the tool left out, or counted twice?"


def _rotated(claimed: Array, right: Array) -> str:
    """Whether linear and angular rows are in other axes, the same at every posture."""
    a, b = (np.swapaxes(J.reshape(len(J), 2, 3, -1), 2, 3).reshape(-1, 3) for J in (right, claimed))
    U, _, Vt = np.linalg.svd(b.T @ a)
    if not _close(claimed, _turned(right, np.broadcast_to(U @ Vt, (len(right), 3, 3)))):
        return ""
    return "in axes that are not the base's, which the tips are in: rows exchanged, or a base rotation left out"


FACTORS = {-1.0: "has the opposite sign", np.pi / 180: "is per degree", 180 / np.pi: "is multiplied by 180 / pi"}


def _column(j: int, claimed: Array, right: Array) -> str:
    """What one column (n, 6) is instead of the right one."""
    c, r = claimed[:, :, j], right[:, :, j]
    linear, angular = _close(c[:, :3], r[:, :3]), _close(c[:, 3:], r[:, 3:])
    factor = float((c * r).sum() / max((r * r).sum(), 1e-300))
    if _close(c, factor * r):
        known = [said for value, said in FACTORS.items() if abs(factor / value - 1) < CLOSE]
        return known[0] if known else "is zero" if abs(factor) < CLOSE else f"is {factor:.4g} times the right one"
    for k in range(claimed.shape[2]):
        if k != j and _close(c, right[:, :, k]):
            return f"is that of joint {k}"
    if angular and _close(c[:, :3], -r[:, :3]):
        return "has linear rows of the opposite sign: v = axis x (tip - joint), in this order"
    if angular:
        return "has wrong linear rows: v = axis x (tip - joint) for a turning joint, the axis for a sliding one"
    if linear:
        return "has wrong angular rows: the axis, in the base frame, for a turning joint, zero for a sliding one"
    if _close(np.linalg.norm(c[:, :3], axis=1), np.linalg.norm(r[:, :3], axis=1)):
        return "has the right length but another direction: is it in the joint's own frame?"
    return "differs by more than a sign, a unit or a frame"
