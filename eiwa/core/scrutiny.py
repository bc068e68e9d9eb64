"""What every arm and index is asked once before its numbers are believed; :mod:`eiwa.testing` asks much more."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray

from eiwa.core.derivative import differentiate
from eiwa.core.errors import PluginError, SpecError, blaming, finding, name_of
from eiwa.core.interfaces import Arm, Array, DexterityIndex, Postures, TracedArm

EXAMINED = 32
"""Postures of the pilot whose Jacobian is compared with differences."""
AGAIN = slice(96, 160)
"""Postures of the pilot that are evaluated again, alone."""
WRONG = 1e-3
"""Relative error of a Jacobian that no rounding explains."""
CHANGED = 1e-9
"""Relative change of an answer that no rounding explains."""

FAR = 20.0
"""No master device reaches so far [m]: its lengths are in mm."""

_seen: set[Hashable] = set()


def refuse_millimetres(tips: Array) -> None:
    """Refuse an arm whose tips (n, 3) no operator could reach.

    Raises
    ------
    SpecError
        A tip is more than 20 m from the base.
    """
    reach = float(np.linalg.norm(tips, axis=1).max())
    if reach > FAR:
        problem = f"its tip is up to {reach:.4g} m from its base; at most {FAR:g} m are allowed."
        raise SpecError(finding("arm", problem, remedy="Write its lengths in metres, not in millimetres."))


def refuse_wrong_jacobian(arm: Arm, u: Array) -> None:
    """Compare the Jacobian with differences of the arm's own tips, once per traced structure.

    Raises
    ------
    PluginError
        They disagree at most postures.
    """
    structure = (type(arm), arm.structure) if isinstance(arm, TracedArm) and arm.structure is not None else None
    if structure in _seen:
        return
    with blaming(arm):
        derivative = differentiate(arm, u[:EXAMINED])
    errors = derivative.mismatch
    if len(errors) >= 4 and np.median(errors.max(axis=(1, 2))) > WRONG:
        joint = int(np.median(errors.max(axis=1), axis=0).argmax())
        raise PluginError(
            f"{name_of(arm)}: the Jacobian is not the derivative of the tip: column {joint} (from 0) is wrong by "
            f"{np.median(errors[:, :, joint].max(axis=1)):.0%} of the largest entry. eiwa plugins check tells more."
        )
    if structure is not None:
        _seen.add(structure)


def refuse_changing_answers(
    arm: Arm, index: DexterityIndex, prepared: NDArray[np.float64], u: Array, tips: Array, raw: Array
) -> None:
    """Evaluate some postures of the pilot again.

    Parameters
    ----------
    tips, raw
        What the whole pilot gave: tips (n, 3) and raw indices (n,), -1 where there is no solution.

    Raises
    ------
    PluginError
        They come out different.
    """
    with blaming(arm):
        first, second = arm.postures(u[AGAIN]), arm.postures(u[AGAIN])
    kept = first.valid
    pairs = [(first.tips[kept], tips[AGAIN][kept])]
    pairs += [(getattr(first, name)[kept], getattr(second, name)[kept]) for name in ("tips", "rotations", "jacobians")]
    for part, answers in ((arm, pairs), (index, [(_values(index, first, prepared)[kept], raw[AGAIN][kept])])):
        for one, other in answers:
            if one.size and np.abs(one - other).max() > CHANGED * max(float(np.abs(one).max()), 1e-3):
                raise PluginError(
                    f"{name_of(part)}: the same joint vectors, evaluated again, gave other values. An answer may depend "
                    "on its own sample alone, not on what was asked before or with it. eiwa plugins check tells more."
                )


def _values(index: DexterityIndex, postures: Postures, prepared: NDArray[np.float64]) -> Array:
    return np.maximum(raw_values(index, postures, prepared), 0.0)


def raw_values(index: DexterityIndex, postures: Postures, prepared: NDArray[np.float64]) -> Array:
    """The index's own values, shape (n,).

    Raises
    ------
    PluginError
        It raises, or answers in another shape.
    """
    with blaming(index):
        values = np.asarray(index.values(postures, prepared))
    if values.shape != postures.valid.shape:
        wanted = postures.valid.shape
        raise PluginError(f"{name_of(index)}: values must have shape {wanted}, one per posture, not {values.shape}")
    return values
