"""eiwa side by side with the same algorithm by hand, with other libraries, and with parts in plain NumPy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.bench import native
from eiwa.bench.cases import CASES, PRECISIONS, VOXEL, Case, Missing
from eiwa.bench.comparators import COMPARATORS, Foreign, kinematics, penalty, stacked
from eiwa.bench.measure import Contender, Record, Tell, keys, visit
from eiwa.core.dexterity import Family
from eiwa.core.filling import CHUNK, Filled, Sampling, fill
from eiwa.core.interfaces import Arm, DexterityIndex, Postures
from eiwa.core.sampling import ARRAY_BLOCK, Stream
from eiwa.core.workspace import Target

SAMPLES = 1 << 20
CHECKED = 1 << 12
"""Postures at which a comparator must agree with eiwa before it is timed."""
TIP_TOLERANCE = {"f64": 1e-9, "f32": 1e-5}
DEXTERITY_TOLERANCE = {"f64": 1e-9, "f32": 1e-3}
"""Allowed differences of tips [m] and of Dex (its largest value is 1); sqrt det(J Jt) in f32 halves the digits."""


@dataclass(frozen=True, eq=False)
class NumpyArm(Arm):
    """An arm as an outsider writes it without tracing: postures in plain NumPy."""

    case: Case

    @property
    def dof(self) -> int:  # type: ignore[override]
        """Number of joints."""
        return self.case.joints

    @property
    def limited(self) -> tuple[bool, ...]:  # type: ignore[override]
        """All are."""
        return (True,) * self.case.joints

    def postures(self, u: NDArray[Any]) -> Postures:
        """One array per component, then stacked."""
        q = self.case.lower + u * self.case.span
        tip, axes, J = kinematics(np, self.case, np.ascontiguousarray(q.T))
        R = np.stack([np.stack(axis, axis=-1) for axis in axes], axis=-1)
        valid = np.ones(len(u), bool)
        return Postures(u, q, np.stack(tip, axis=-1), R, stacked(np, J, q[:, 0]), valid, self.limited)


@dataclass(frozen=True, eq=False)
class NumpyIndex(DexterityIndex):
    """Eq. (1) in plain NumPy."""

    case: Case

    def values(self, postures: Postures, prepared: NDArray[np.float64]) -> NDArray[Any]:
        """By ``linalg.det`` of J Jt."""
        J = postures.jacobians
        w = np.sqrt(np.maximum(np.linalg.det(J @ J.transpose(0, 2, 1)), 0))
        return np.asarray(w * penalty(np, self.case, postures.u.T))


STORED = ("q", "tips", "rotations", "jacobians", "valid")


@dataclass(frozen=True, eq=False)
class StoredArm(NumpyArm):
    """The same postures for every block, which cost nothing: C-ordered arrays, as NumPy makes them."""

    stored: Postures

    def postures(self, u: NDArray[Any]) -> Postures:
        """As many as are asked for."""
        return replace(self.stored, u=u, **{name: getattr(self.stored, name)[: len(u)] for name in STORED})


@dataclass(frozen=True, eq=False)
class StoredIndex(DexterityIndex):
    """The same values for every block."""

    stored: NDArray[Any]

    def values(self, postures: Postures, prepared: NDArray[np.float64]) -> NDArray[Any]:
        """As many as are asked for."""
        return self.stored[: len(postures.u)]


def filled(
    family: Family, case: Case, precision: str, samples: int, key: int, targets: Sequence[Target] | None = None
) -> list[Filled]:
    """What eiwa's flow leaves in both targets."""
    amount = Sampling(samples, PRECISIONS[precision])
    return fill(family, targets or case.targets(), case.setup.backend, Stream("plain", key), amount)[0]


def difference(family: Family, other: Family) -> tuple[float, float]:
    """Largest distance of two families' tips [m] and of their Dex, at fixed points of the unit cube."""
    u = Stream("plain", 1).points(0, CHECKED, family.arm.dof)
    (tips, raw), (others, theirs) = family.evaluate(u), other.evaluate(u)
    scale = family.scales(np.float64)
    return float(np.abs(tips - others).max()), float(np.abs((raw - theirs) * scale).max())


def checked(record: Record, error: tuple[float, float]) -> Record:
    """The record with the differences (none where one is not finite), and whether they are allowed."""
    allowed = error[0] <= TIP_TOLERANCE[record.precision] and error[1] <= DEXTERITY_TOLERANCE[record.precision]
    tip, dexterity = (value if np.isfinite(value) else None for value in error)
    return replace(record, tip_error=tip, dexterity_error=dexterity, agrees=allowed)


def contenders(
    threads: Sequence[int], tell: Tell, joints: Sequence[int] = (6, 7), precisions: Sequence[str] = ("f64", "f32")
) -> tuple[list[Contender], list[str]]:
    """Everybody who agrees with eiwa or did not get so far, and why others are left out."""
    found: list[Contender] = []
    left_out: dict[str, str] = {}
    for j in joints:
        for precision in precisions:
            tell(f"preparing {j} joints, {precision}")
            found += _at_one_setting(CASES[j], precision, threads, left_out)
    return found, [f"{who}: {reason}" for who, reason in left_out.items()]


def _at_one_setting(
    case: Case, precision: str, threads: Sequence[int], left_out: dict[str, str]
) -> Iterator[Contender]:
    """eiwa first, then those that are compared with it, on every number of threads."""
    family, dtype = case.family(), PRECISIONS[precision]
    record = Record("compare", "eiwa", "flow", "sample", case.joints, precision, 1, SAMPLES, VOXEL)
    filled(family, case, precision, 1, next(keys))
    bases = {t: Contender(replace(record, threads=t), visit(_flow(family, case, precision), SAMPLES)) for t in threads}
    yield from bases.values()
    yield from _roof(family, case, record, bases, left_out)
    for comparator in COMPARATORS:
        if precision in comparator.precisions:
            try:
                foreign = Foreign(family.members, comparator.evaluate(case, dtype))
                known = checked(replace(record, who=comparator.who), difference(family, foreign))
            except Missing as error:
                left_out[comparator.who] = str(error)
                continue
            # Another version of a library may fail anywhere; that must not end the measurement.
            except Exception as error:
                left_out[comparator.who] = f"{type(error).__name__}: {error}"
                continue
            for t in threads if comparator.parallel else threads[:1]:
                samples = comparator.samples if t == 1 else max(comparator.samples, 2 * t * CHUNK)
                call = visit(_flow(foreign, case, precision), samples)
                yield Contender(replace(known, threads=t, samples=samples), call, bases[t])
    if precision == "f64":  # the array form computes in double precision
        yield from _array_forms(family, case, record, bases)


def _flow(family: Family, case: Case, precision: str) -> Any:
    targets = case.targets()
    return lambda n: filled(family, case, precision, n, next(keys), targets)


def _roof(
    family: Family, case: Case, record: Record, bases: dict[int, Contender], left_out: dict[str, str]
) -> Iterator[Contender]:
    """The hand-written flow, which must leave the same maxima; and the time of its flops in a matrix product."""
    try:
        result = native.roof(1 << 18, 1, case.joints, record.precision)
    except Missing as missing:
        left_out["roof"] = str(missing)
        return
    ours = filled(family, case, record.precision, 1 << 18, 1)
    total, hits = sum(float(f.values.sum()) for f in ours), sum(int(f.hits.sum()) for f in ours if f.hits is not None)
    error = max(abs(total / result["checksum"] - 1), abs(hits / round(result["hits"] * (1 << 18)) - 1))
    agrees = error <= DEXTERITY_TOLERANCE[record.precision]
    flops, dtype = int(result["flops_per_sample"]), PRECISIONS[record.precision]
    known = replace(record, who="roof", agrees=agrees, dexterity_error=error, flops=flops)
    for t, base in bases.items():

        def by_hand(t: int = t) -> float:
            return 1e-9 * float(native.roof(SAMPLES, t, case.joints, record.precision)["ns_per_sample"])

        def product(t: int = t) -> float:
            return float(flops / native.gemm(dtype, t))

        yield Contender(replace(known, threads=t), by_hand, base)
        yield Contender(replace(record, who="matrix product", part="product", threads=t, flops=flops), product, base)


def _array_forms(family: Family, case: Case, record: Record, bases: dict[int, Contender]) -> Iterator[Contender]:
    """An arm and an index in plain NumPy within eiwa's flow, and with stored answers what eiwa adds to their own time."""
    postures = case.setup.arm.postures(Stream("plain", 1).points(0, ARRAY_BLOCK, case.joints))
    arrays: dict[str, Any] = {name: np.ascontiguousarray(getattr(postures, name)) for name in STORED}
    # Prepared already: a study refuses an index that answers the same to whatever it is asked.
    (member,) = family.members
    arm, index = StoredArm(case, replace(postures, **arrays)), StoredIndex(abs(arrays["tips"][:, 0]))
    forms = {
        "eiwa, NumPy arm": (case.family(arm=NumpyArm(case)), Family((replace(member, arm=arm),))),
        "eiwa, NumPy index": (case.family(index=NumpyIndex(case)), Family((replace(member, index=index),))),
    }
    for who, (other, stored) in forms.items():
        known = checked(replace(record, who=who, samples=1 << 18), difference(family, other))
        for t, base in bases.items():
            yield Contender(replace(known, threads=t), visit(_flow(other, case, record.precision), 1 << 18), base)
            added = replace(record, who=who, part="rest", threads=t)
            yield Contender(added, visit(_flow(stored, case, record.precision), SAMPLES), base)
