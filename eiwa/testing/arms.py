"""Contracts of arms."""

from __future__ import annotations

import math

import numpy as np

from eiwa.core.derivative import differentiate, on_arrays
from eiwa.core.interfaces import Arm, ArmColumns, Array, Postures, TracedArm
from eiwa.core.linear import volume
from eiwa.core.symbols import Column, as_columns
from eiwa.testing import purity
from eiwa.testing.contract import Contract, NotApplicable, Violation
from eiwa.testing.jacobian import diagnosis
from eiwa.testing.purity import Asked, difference
from eiwa.testing.samples import accuracy, points, rate, variations
from eiwa.testing.subject import Subject
from eiwa.testing.tracing import Recording

SAMPLES = 256
ACCURACY = 1e-6
"""Relative error of a Jacobian that differences cannot explain; they are good to about 1e-10."""
FAR = 50.0
"""No master device reaches so far [m]."""


def builds(subject: Subject) -> str:
    """build(parameters) returns an Arm."""
    if not isinstance(subject.part, Arm):
        cause = "build is a function that does not return what it makes, or the class does not derive from Arm."
        raise Violation("an eiwa.core.interfaces.Arm", f"{type(subject.part).__name__}", cause)
    return type(subject.part).__name__


def declares_its_joints(subject: Subject) -> str:
    """dof is the number of joints, limited has a bool for each; link_length is None or a length."""
    arm = subject.part
    if not isinstance(arm.dof, int) or isinstance(arm.dof, bool) or arm.dof < 1:
        raise Violation("dof: a whole number of joints", f"dof = {arm.dof!r}")
    if not isinstance(arm.limited, tuple) or [type(flag) for flag in arm.limited] != [bool] * arm.dof:
        raise Violation(f"limited: a tuple of {arm.dof} bools, one per joint", f"limited = {arm.limited!r}")
    if arm.link_length is not None and not (math.isfinite(arm.link_length) and arm.link_length >= 0):
        raise Violation("link_length: a length [m] or None", f"link_length = {arm.link_length!r}")
    if not isinstance(arm.when_singular(), str):
        raise Violation("when_singular(): a text", f"{arm.when_singular()!r}")
    return f"{arm.dof} joints, {sum(arm.limited)} limited"


def has_the_right_shapes(subject: Subject) -> str:
    """postures(u) answers n points with Postures of n: float64 arrays, valid bool, u as it was given."""
    arm = subject.part
    for n in (SAMPLES, 1):
        u = points(arm.dof, n)
        answer = arm.postures(u)
        if not isinstance(answer, Postures):
            raise Violation("Postures", f"{type(answer).__name__}")
        if np.shape(answer.u) != u.shape or not np.array_equal(answer.u, u):
            raise Violation("postures.u: the points that were asked for", f"an array of shape {np.shape(answer.u)}")
        for name, dtype in {
            **dict.fromkeys(("q", "tips", "rotations", "jacobians"), "float64"),
            "valid": "bool",
        }.items():
            seen = getattr(answer, name)
            if not isinstance(seen, np.ndarray) or seen.dtype != dtype:
                raise Violation(f"{name}: a NumPy array of {dtype}", f"{getattr(seen, 'dtype', type(seen).__name__)}")
        if tuple(answer.limited) != arm.limited:
            raise Violation(f"postures.limited = arm.limited = {arm.limited}", f"{answer.limited}")
    return f"u (n, {arm.dof}), jacobians (n, 6, {arm.dof})"


def is_finite(subject: Subject) -> str:
    """Every valid posture has finite numbers, and some posture is valid."""
    postures = subject.part.postures(points(subject.part.dof, SAMPLES))
    if not postures.valid.any():
        cause = "a sign in the condition of valid, or lengths that cannot close: try other parameters."
        raise Violation("postures with a solution", f"none of {SAMPLES} is valid", cause)
    for name in ("q", "tips", "rotations", "jacobians"):
        values = getattr(postures, name)
        bad = postures.valid & ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
        if bad.any():
            row = int(bad.argmax())
            cause = "a root or an arccos of something just outside its range, or a division by zero; else set valid = False."
            seen = f"{name} of posture {row} (u = {_short(postures.u[row])}) is {values[row].tolist()}"
            raise Violation("finite numbers where valid", f"{seen}; {int(bad.sum())} of {SAMPLES} postures", cause)
    reach = float(np.linalg.norm(postures.tips[postures.valid], axis=1).max())
    if reach > FAR:
        raise Violation("tips in metres", f"a tip {reach:.4g} from the base", "lengths in millimetres.")
    return f"{postures.valid.mean():.0%} valid, tips up to {reach:.3g} m from the base"


def moves_each_joint_through_its_range(subject: Subject) -> str:
    """From u_j = 0 to 1 joint j goes steadily from one limit to the other; a joint that is limited does move."""
    arm, steps = subject.part, 17
    base = points(arm.dof, 8)
    lines = np.repeat(base[:, None, :], steps, axis=1)
    ranges = []
    for j in range(arm.dof):
        u = lines.copy()
        u[..., j] = np.linspace(0, 1, steps)
        q = arm.postures(u.reshape(-1, arm.dof)).q.reshape(len(base), steps, arm.dof)
        moves = np.diff(q[..., j], axis=1)
        moves = moves[np.isfinite(moves)]  # where there is no solution q may be anything
        if not ((moves >= 0).all() or (moves <= 0).all()):
            raise Violation(f"q of joint {j} to rise or fall with u_{j}", "it turns back", "q wrapped to (-pi, pi].")
        if arm.limited[j] and not (moves != 0).any():
            cause = f"the range is empty (set limited[{j}] = False), or u_{j} is not used for joint {j}."
            raise Violation(f"joint {j} to move, since it is limited", f"q stays {q[0, 0, j]:.4g}", cause)
        ranges.append((float(np.nanmin(q[..., j])), float(np.nanmax(q[..., j]))))
    return ", ".join(f"{low:.3g} to {high:.3g}" for low, high in ranges)


def turns_by_rotations(subject: Subject) -> str:
    """Rotation matrices are orthonormal and right-handed."""
    postures = subject.part.postures(points(subject.part.dof, SAMPLES))
    R = postures.rotations[postures.valid]
    error = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    row = int(error.argmax())
    if error[row] > purity.ROUNDING:
        cause = "a sign or an entry in the wrong place, or axes that are not of unit length."
        raise Violation("R Rt = 1", f"R of posture {row} is {R[row].round(4).tolist()}, off by {error[row]:.2g}", cause)
    if (np.linalg.det(R) < 0).any():
        raise Violation("det R = 1", "det R = -1", "a mirrored axis: one column has the wrong sign.")
    return f"orthonormal {accuracy(float(error.max()))}"


def jacobian_is_the_derivative(subject: Subject) -> str:
    """J times the joints' motion is the tip's motion, by central differences: linear rows above angular ones."""
    arm = subject.part
    derivative = differentiate(arm, points(arm.dof, 64))
    trusted, error = derivative.trusted, derivative.mismatch
    if not trusted.any():
        cause = "tips that jump, or postures that are valid only here and there."
        raise Violation("tips that move smoothly with u", "differences converge at none of 64 postures", cause)
    wrong = error > np.maximum(ACCURACY, derivative.doubt[trusted] / derivative.scales)
    if not wrong.any():
        return f"{accuracy(float(error.max()))}, at {int(trusted.sum())} postures"
    error = np.where(wrong, error, 0.0)
    sample, row, joint = (int(i) for i in np.unravel_index(int(error.argmax()), error.shape))
    wanted, claimed = derivative.twists[trusted][sample], derivative.claimed[trusted][sample]
    where = f"{('x', 'y', 'z', 'rx', 'ry', 'rz')[row]} row, joint {joint} (from 0)"
    at = f"u = {_short(derivative.postures.u[trusted][sample])}"
    rate = derivative.rates[trusted][sample, joint, joint]
    per = rate if abs(rate) > 1e-12 else 1.0
    raise Violation(
        f"{where}: {wanted[row, joint] / per:.6g}, from the arm's own tips",
        f"{claimed[row, joint] / per:.6g} at posture {sample} ({at}); "
        f"{wrong.any(axis=(1, 2)).mean():.0%} of the postures disagree",
        diagnosis(derivative),
    )


def measures_angles_in_radians(subject: Subject) -> str:
    """A joint that turns the handle does so by one radian per unit of q, or by another transmission than degrees."""
    postures = subject.part.postures(points(subject.part.dof, SAMPLES))
    for j in range(subject.part.dof):
        if np.allclose(np.linalg.norm(postures.jacobians[postures.valid, 3:, j], axis=1), np.pi / 180, rtol=1e-6):
            low, high = postures.q[:, j].min(), postures.q[:, j].max()
            seen = f"q from {low:.4g} to {high:.4g}, and the handle turns by pi / 180 per unit"
            raise Violation(f"joint {j} in radians", seen, "degrees: use np.deg2rad, and a Jacobian per radian.")
    return "[rad]"


def reduced_jacobian_has_the_same_volume(subject: Subject) -> str:
    """Where columns(u, p) offers a reduced Jacobian, all its rows together have the Jacobian's volume."""
    arm = subject.part
    if not isinstance(arm, TracedArm):
        return NotApplicable("plain NumPy: evaluated in blocks, not compiled")
    columns = arm.columns(as_columns(points(arm.dof, SAMPLES)), list(arm.constants))
    if columns.reduced is None or arm.dof < 6:
        return NotApplicable("no reduced Jacobian" if columns.reduced is None else "fewer than six joints")
    right, seen = (np.broadcast_to(volume(J), SAMPLES) for J in (columns.jacobian, columns.reduced))
    if problem := difference({"volumes": right}, {"volumes": seen}, purity.ROUNDING):
        cause = "a point that does not move with the handle, or rows that are not those of the same axes."
        raise Violation("the volume of the Jacobian at the tip", problem, cause)
    return accuracy(float(np.abs(seen - right).max() / right.max()))


def tells_its_mobility(subject: Subject) -> str:
    """In how many directions the tip can move at once: what dexterity.rows may ask for."""
    postures = subject.part.postures(points(subject.part.dof, SAMPLES))
    J = postures.jacobians[postures.valid]
    parts = {"translation": J[:, :3], "rotation": J[:, 3:], "all": J}
    return ", ".join(f"rank {np.linalg.matrix_rank(part, tol=1e-9).max()} of {name}" for name, part in parts.items())


def is_deterministic(subject: Subject) -> str:
    """The same postures every time, from this arm and from another one built alike."""
    return purity.same_again(_asked(subject.part), _asked(subject.build()))


def keeps_nothing_between_calls(subject: Subject) -> str:
    """An answer does not depend on what was asked before, and is left alone afterwards."""
    return purity.no_memory(_asked(subject.part), _asked(subject.build()))


def does_not_depend_on_the_block(subject: Subject) -> str:
    """A posture is the same in any block, at any place, alone or not."""
    return purity.no_neighbours(_asked(subject.part))


def leaves_its_input_alone(subject: Subject) -> str:
    """u is not written to."""
    return purity.input_intact(_asked(subject.part))


def may_be_asked_from_threads(subject: Subject) -> str:
    """Several threads at a time get what one thread gets."""
    return purity.threads_agree(_asked(subject.part))


def traced_form_is_the_array_form(subject: Subject) -> str:
    """columns(u, p), traced and on NumPy columns, gives what postures(u) gives."""
    arm = subject.part
    if not isinstance(arm, TracedArm):
        return NotApplicable("plain NumPy: evaluated in blocks, not compiled")
    u = points(arm.dof, SAMPLES)
    wanted = _fields(arm.postures(u))
    played = recording(arm).play(u, arm.constants)
    for form, seen in (("on NumPy columns", on_arrays(arm, u)), ("traced", _unflattened(arm, u, played))):
        if problem := difference(wanted, _fields(seen), purity.ROUNDING):
            cause = "postures is overridden with other formulas, or a number is taken while tracing (float(...), if)."
            raise Violation("one arm in every form", f"columns {form}: {problem}", cause)
    operations = sum(kind not in ("input", "parameter", "constant") for kind, _ in recording(arm).nodes)
    return f"{operations} operations, compiled"


def structure_tells_formulas_apart(subject: Subject) -> str:
    """Arms of equal structure have the same formulas but for their constants."""
    arm = subject.part
    if not isinstance(arm, TracedArm):
        return NotApplicable("plain NumPy: evaluated in blocks, not compiled")
    if arm.structure is None:
        return "None: traced anew for every design"
    alike = 0
    for path, other in variations(subject):
        if other.structure == arm.structure and other.dof == arm.dof:
            alike += 1
            if recording(other) != recording(arm):
                cause = f"{path} is written into the formulas as a number. Put it into constants, or into structure."
                raise Violation("equal formulas for equal structure", f"another {path} changes the formulas", cause)
    return f"{alike} other designs share the kernel"


def tells_its_speed(subject: Subject) -> str:
    """How many postures a second one thread evaluates."""
    u = points(subject.part.dof, 1 << 13)
    flow = "compiled" if isinstance(subject.part, TracedArm) else "plain NumPy"
    return f"{rate(lambda: subject.part.postures(u), len(u))} postures/s, {flow}"


def recording(arm: TracedArm) -> Recording:
    """The arm's formulas, traced: q, tip, rotation, Jacobian, valid."""

    def flat(u: list[Column], p: list[Column]) -> list[Column]:
        c = arm.columns(u, p)
        return [*c.q, *c.tip, *(e for r in c.rotation for e in r), *(e for r in c.jacobian for e in r), c.valid]

    return Recording.of(flat, arm.dof, len(arm.constants))


def _unflattened(arm: TracedArm, u: Array, flat: Array) -> Postures:
    q, tip, rotation, jacobian, valid = np.split(flat.T, np.cumsum([arm.dof, 3, 9, 6 * arm.dof]))
    rows = (jacobian.reshape(6, arm.dof, -1), rotation.reshape(3, 3, -1))
    return ArmColumns(as_columns(u), q, tip, rows[1], rows[0], arm.limited, valid[0] > 0.5).postures()  # type: ignore[arg-type]


def _fields(postures: Postures) -> dict[str, Array]:
    return {name: getattr(postures, name) for name in ("q", "tips", "rotations", "jacobians", "valid")}


def _asked(arm: Arm) -> Asked:
    return Asked("arm", lambda inputs: _fields(arm.postures(inputs["u"])), {"u": points(arm.dof, SAMPLES)})


def _short(values: Array) -> str:
    return "[" + ", ".join(f"{v:.3g}" for v in values) + "]"


BASIC: tuple[Contract, ...] = (builds, declares_its_joints, has_the_right_shapes, is_finite)
CONTRACTS: tuple[Contract, ...] = (
    *BASIC,
    is_deterministic,
    keeps_nothing_between_calls,
    does_not_depend_on_the_block,
    leaves_its_input_alone,
    may_be_asked_from_threads,
    moves_each_joint_through_its_range,
    turns_by_rotations,
    jacobian_is_the_derivative,
    measures_angles_in_radians,
    traced_form_is_the_array_form,
    structure_tells_formulas_apart,
    reduced_jacobian_has_the_same_volume,
    tells_its_mobility,
    tells_its_speed,
)
