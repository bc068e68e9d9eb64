"""Contracts of dexterity indices, on arms that eiwa brings along."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.errors import EiwaError
from eiwa.core.interfaces import ArmColumns, Array, DexterityIndex, Postures, TracedIndex
from eiwa.core.symbols import Column
from eiwa.core.transforms import Transform, roll_pitch_yaw
from eiwa.testing import purity, reference
from eiwa.testing.contract import Contract, NotApplicable, Violation
from eiwa.testing.purity import Arrays, Asked, difference
from eiwa.testing.samples import rate, variations
from eiwa.testing.subject import Subject
from eiwa.testing.tracing import Recording

SAMPLES = 256


def builds(subject: Subject) -> str:
    """build(parameters) returns a DexterityIndex."""
    if not isinstance(subject.part, DexterityIndex):
        cause = (
            "build is a function that does not return what it makes, or the class does not derive from DexterityIndex."
        )
        raise Violation("an eiwa.core.interfaces.DexterityIndex", f"{type(subject.part).__name__}", cause)
    return type(subject.part).__name__


def prepares_numbers(subject: Subject) -> str:
    """prepare(arm, pilot) returns finite numbers (k,), the same every time."""
    first, second = _prepared(subject.part), _prepared(subject.build())
    for prepared in (first, second):
        if not isinstance(prepared, np.ndarray) or prepared.ndim != 1 or prepared.dtype != float:
            raise Violation("a float64 array of shape (k,)", f"{prepared!r}")
    if not np.isfinite(first).all():
        raise Violation("finite numbers", f"{first.tolist()}", "a mean or a quotient over postures without dexterity.")
    if not np.array_equal(first, second):
        raise Violation(
            "the same numbers from the same pilot", f"{first.tolist()}, then {second.tolist()}", "random numbers."
        )
    return f"{len(first)} numbers"


def has_the_right_shape(subject: Subject) -> str:
    """values(postures, prepared) answers n postures with a float64 array (n,)."""
    for n in (SAMPLES, 1):
        values = _values(subject.part, _some(_pilot()[1], slice(0, n)))
        if not isinstance(values, np.ndarray) or values.shape != (n,) or values.dtype != float:
            seen = f"shape {np.shape(values)}, {getattr(values, 'dtype', type(values).__name__)}"
            raise Violation(f"a float64 array of shape ({n},)", seen, "a sum over the wrong axis, or keepdims.")
    return "(n,)"


def is_finite_and_not_negative(subject: Subject) -> str:
    """Every posture has a finite value, not below 0, and not all are 0."""
    arm, postures = _pilot()
    values = _values(subject.part, _some(postures, slice(None)))
    _refuse(values, postures, f"an arm of {arm.dof} joints")
    if values.max() <= 0:
        cause = "a penalty that underflows, or rows of the Jacobian that are not looked at."
        raise Violation("some dexterity on an arm of six joints", "0 at every posture", cause)
    return f"{values.min():.3g} to {values.max():.3g} on an arm of {arm.dof} joints"


def survives_singular_postures(subject: Subject) -> str:
    """At singular postures and at joint limits the value is finite, too."""
    arm, postures = _pilot()
    some = _some(postures, slice(0, 8))
    J = some.jacobians
    lowest = replace(some, u=np.zeros_like(some.u), q=np.full_like(some.q, -reference.TURN))
    highest = replace(some, u=np.ones_like(some.u), q=np.full_like(some.q, reference.TURN))
    cases = {
        "a Jacobian of zeros": replace(some, jacobians=0 * J),
        "a Jacobian of rank 1": replace(some, jacobians=J[:, :, :1] * np.ones(arm.dof)),
        "a nearly singular Jacobian": replace(some, jacobians=J * np.array([1.0] * (arm.dof - 1) + [1e-160])),
        "every joint at its lower limit": lowest,
        "every joint at its upper limit": highest,
    }
    for name, case in cases.items():
        _refuse(_values(subject.part, case), case, name)
    return ", ".join(cases)


def serves_other_arms(subject: Subject) -> str:
    """Arms of 3 and of 7 joints, and one with a joint that turns freely: finite values, or a clear refusal."""
    said = []
    for name, key in {
        "3 slides": (reference.sliding,),
        "7 joints": (reference.serial, 7),
        "a free joint": (reference.unlimited,),
    }.items():
        arm, postures = reference.pilot(*key)
        try:
            values = _asked_plainly(subject.part, _some(postures, slice(None)), subject.part.prepare(arm, postures))
        except EiwaError as error:
            said.append(f"{name}: refused ({error})")
            continue
        _refuse(np.asarray(values), postures, f"an arm of {name}")
        said.append(f"{name}: up to {values.max():.3g}")
    return "; ".join(said)


def tells_its_invariances(subject: Subject) -> str:
    """How the index changes with the base's pose and the tool; fine for one that prefers directions, else a mistake."""
    changes = invariances(subject)
    same = [name for name, change in changes.items() if change <= purity.ROUNDING]
    other = [f"{name} (by up to {change:.0%})" for name, change in changes.items() if change > purity.ROUNDING]
    parts = [f"unchanged by {', '.join(same)}"] * bool(same) + [f"changed by {', '.join(other)}"] * bool(other)
    return "; ".join(parts)


def invariances(subject: Subject) -> dict[str, float]:
    """Largest change of the index, relative to its largest value, under changes of the base's pose and of the tool."""
    arm, postures = _pilot()
    index, n = subject.part, SAMPLES
    wanted = _asked_plainly(index, _some(postures, slice(0, n)), index.prepare(arm, postures))
    Q: Transform = roll_pitch_yaw(0.7, -0.4, 1.1)[:3, :3]
    moves: dict[str, Callable[[Postures], Postures]] = {
        "turning the base": lambda p: replace(
            p, tips=p.tips @ Q.T, rotations=Q @ p.rotations, jacobians=np.kron(np.eye(2), Q) @ p.jacobians
        ),
        "moving the base": lambda p: replace(p, tips=p.tips + [0.3, -0.2, 0.5]),
        "turning the tool": lambda p: replace(p, rotations=p.rotations @ Q),
        "moving the tool": lambda p: _at(p, p.rotations @ [0.02, -0.05, 0.1]),
    }
    changes = {}
    for name, move in moves.items():
        moved = move(postures)
        seen = _asked_plainly(index, _some(moved, slice(0, n)), index.prepare(arm, moved))
        changes[name] = float(np.abs(seen - wanted).max() / max(float(np.abs(wanted).max()), 1e-300))
    return changes


def is_deterministic(subject: Subject) -> str:
    """The same values every time, from this index and from another one built alike."""
    return purity.same_again(_asked(subject.part), _asked(subject.build()))


def keeps_nothing_between_calls(subject: Subject) -> str:
    """An answer does not depend on what was asked before, and is left alone afterwards."""
    return purity.no_memory(_asked(subject.part), _asked(subject.build()))


def does_not_depend_on_the_block(subject: Subject) -> str:
    """A posture's value is the same in any block, at any place, alone or not."""
    return purity.no_neighbours(_asked(subject.part))


def leaves_its_input_alone(subject: Subject) -> str:
    """The postures are not written to."""
    return purity.input_intact(_asked(subject.part))


def may_be_asked_from_threads(subject: Subject) -> str:
    """Several threads at a time get what one thread gets."""
    return purity.threads_agree(_asked(subject.part))


def traced_form_is_the_array_form(subject: Subject) -> str:
    """columns(arm, p), traced, gives what values(postures, prepared) gives."""
    index = subject.part
    if not isinstance(index, TracedIndex):
        return NotApplicable("plain NumPy: evaluated in blocks, not compiled")
    arm, postures = _pilot()
    some = _some(postures, slice(0, SAMPLES))
    prepared = _prepared(index)
    recording = _recording(index, arm.dof, arm.limited, len(prepared))
    seen = recording.play(_flat(some), prepared)[:, 0]
    if problem := difference({"values": index.values(some, prepared)}, {"values": seen}, purity.ROUNDING):
        cause = "values is overridden with another formula, or a number is taken while tracing (float(...), if)."
        raise Violation("one index in every form", f"columns, traced: {problem}", cause)
    operations = sum(kind not in ("input", "parameter", "constant") for kind, _ in recording.nodes)
    return f"{operations} operations, compiled"


def structure_tells_formulas_apart(subject: Subject) -> str:
    """Indices of equal structure have the same formula but for what prepare returns."""
    index = subject.part
    if not isinstance(index, TracedIndex):
        return NotApplicable("plain NumPy: evaluated in blocks, not compiled")
    if index.structure is None:
        return "None: traced anew for every design"
    arm, alike = _pilot()[0], 0
    count = len(_prepared(index))
    for path, other in variations(subject):
        if other.structure == index.structure and len(_prepared(other)) == count:
            alike += 1
            if _recording(other, arm.dof, arm.limited, count) != _recording(index, arm.dof, arm.limited, count):
                cause = (
                    f"{path} is written into the formula as a number. Return it from prepare, or put it into structure."
                )
                raise Violation("equal formulas for equal structure", f"another {path} changes the formula", cause)
    return f"{alike} other designs share the kernel"


def tells_its_speed(subject: Subject) -> str:
    """How many postures a second are evaluated."""
    some = _some(_pilot()[1], slice(0, 1 << 13))
    prepared = _prepared(subject.part)
    flow = "compiled" if isinstance(subject.part, TracedIndex) else "plain NumPy"
    return f"{rate(lambda: subject.part.values(some, prepared), 1 << 13)} postures/s, {flow}"


def _pilot() -> Any:
    return reference.pilot(reference.serial, 6)


def _prepared(index: DexterityIndex) -> Any:
    return index.prepare(*_pilot())


def _values(index: DexterityIndex, postures: Postures) -> Array:
    return _asked_plainly(index, postures, _prepared(index))


def _asked_plainly(index: DexterityIndex, postures: Postures, prepared: NDArray[np.float64]) -> Array:
    """The index's values; a formula is traced and played back, which needs no compiler."""
    if not isinstance(index, TracedIndex) or type(index).values is not TracedIndex.values:
        return index.values(postures, prepared)
    recording = _recording(index, postures.u.shape[1], postures.limited, len(prepared))
    return recording.play(_flat(postures), prepared)[:, 0]


def _flat(postures: Postures) -> Array:
    """u, q, tip, rotation and Jacobian as the inputs of :func:`_recording`."""
    p, n = postures, len(postures.u)
    return np.concatenate([p.u, p.q, p.tips, p.rotations.reshape(n, 9), p.jacobians.reshape(n, -1)], axis=1)


def _some(postures: Postures, rows: slice) -> Postures:
    """Copies of some postures, which may be written to."""
    names = [f.name for f in fields(Postures) if f.name != "limited"]
    copies: dict[str, Any] = {name: np.array(getattr(postures, name)[rows]) for name in names}
    return replace(postures, **copies)


def _at(postures: Postures, offsets: Array) -> Postures:
    """The same handle, with the tip moved by offsets (n, 3) in the base frame."""
    w = np.swapaxes(postures.jacobians[:, 3:], 1, 2)
    jacobians = np.array(postures.jacobians)
    jacobians[:, :3] += np.swapaxes(np.cross(w, offsets[:, None, :]), 1, 2)
    return replace(postures, tips=postures.tips + offsets, jacobians=jacobians)


def _refuse(values: Array, postures: Postures, where: str) -> None:
    good = np.isfinite(values) & (values >= -1e-12)
    if not good.all():
        row = int((~good).argmax())
        cause = "a root of a small negative number, a division by a singular value that is zero, or a logarithm."
        seen = f"{values[row]} at posture {row}; {int((~good).sum())} of {len(values)} postures"
        raise Violation(f"finite values, not below 0, for {where}", seen, cause)


def _asked(index: DexterityIndex) -> Asked:
    arm, postures = _pilot()
    prepared = index.prepare(arm, postures)
    some = _some(postures, slice(0, SAMPLES))

    def answer(given: Arrays) -> Arrays:
        postures = replace(some, **given)  # type: ignore[arg-type]
        return {"values": _asked_plainly(index, postures, prepared)}

    return Asked("index", answer, {f.name: getattr(some, f.name) for f in fields(Postures) if f.name != "limited"})


def _recording(index: TracedIndex, dof: int, limited: tuple[bool, ...], prepared: int) -> Recording:
    """The formula, traced on columns u, q, tip, rotation, Jacobian."""

    def formula(inputs: list[Column], p: list[Column]) -> list[Column]:
        entries = iter(inputs)

        def take(count: int) -> list[Column]:
            return [next(entries) for _ in range(count)]

        u, q, tip = take(dof), take(dof), take(3)
        arm = ArmColumns(u, q, tip, [take(3) for _ in range(3)], [take(dof) for _ in range(6)], limited)
        return [index.columns(arm, p)]

    return Recording.of(formula, 2 * dof + 12 + 6 * dof, prepared)


BASIC: tuple[Contract, ...] = (builds, prepares_numbers, has_the_right_shape, is_finite_and_not_negative)
CONTRACTS: tuple[Contract, ...] = (
    *BASIC,
    survives_singular_postures,
    serves_other_arms,
    is_deterministic,
    keeps_nothing_between_calls,
    does_not_depend_on_the_block,
    leaves_its_input_alone,
    may_be_asked_from_threads,
    traced_form_is_the_array_form,
    structure_tells_formulas_apart,
    tells_its_invariances,
    tells_its_speed,
)
