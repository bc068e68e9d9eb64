"""An index prepared for an arm, and families of them that are evaluated together."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.errors import PluginError, SingularArm, SpecError, blaming, finding, name_of
from eiwa.core.finite import all_finite
from eiwa.core.interfaces import (
    NOTHING,
    Arm,
    ArmColumns,
    Array,
    DexterityIndex,
    Postures,
    TracedArm,
    TracedIndex,
    parted,
    where_valid,
)
from eiwa.core.kernel import Map
from eiwa.core.optimum import maximum, pilot_points
from eiwa.core.scrutiny import raw_values, refuse_changing_answers, refuse_millimetres, refuse_wrong_jacobian
from eiwa.core.symbols import Column, where
from eiwa.core.symbols import maximum as maximum_of


@dataclass(frozen=True, eq=False)
class Dexterity:
    """An index prepared for one arm: ``values / normaliser`` lies in [0, 1]."""

    arm: Arm
    index: DexterityIndex
    prepared: NDArray[np.float64]
    normaliser: float
    threshold: float
    valid_share: float = 1.0
    """Share of the pilot's postures that are valid."""

    @property
    def traced(self) -> bool:
        """Whether arm and index are compiled into one kernel."""
        return self.alone.traced

    @cached_property
    def alone(self) -> Family:
        """The family of this one."""
        return Family((self,))

    def raw(self, u: Array) -> tuple[Array, Array]:
        """Tips (n, 3) [m] and the index before normalisation (n,), -1 where there is no solution."""
        tips, raw = self.alone.evaluate(u)
        return tips, raw[:, 0]

    @cached_property
    def reach(self) -> float:
        """Largest distance of the tip from the base origin [m]."""

        def distance(u: Array) -> Array:
            tips, raw = self.raw(u)
            return np.where(raw >= 0, np.linalg.norm(tips, axis=1), -1.0)

        return maximum(distance, pilot_points(self.arm.dof))


def prepare(arm: Arm, index: DexterityIndex, normaliser: float | None, threshold: float) -> Dexterity:
    """Learn from the pilot what the index needs, and its maximum where no normaliser is given.

    Raises
    ------
    SingularArm
        The index is (numerically) zero at every posture of the pilot.
    SpecError
        No posture of the pilot is valid, or tips are too far away to be in metres.
    PluginError
        The arm or the index answers with values that are not finite, that have a wrong shape, that contradict its
        Jacobian, or that change when they are asked for again.
    """
    u = pilot_points(arm.dof)
    needs_postures = type(index).prepare is not DexterityIndex.prepare
    with blaming(arm):
        pilot = arm.postures(u).solved if needs_postures else None
    if pilot is not None:
        _refuse_invalid(pilot.valid, len(u))
    with blaming(index):
        prepared = index.prepare(arm, pilot) if pilot is not None else NOTHING
    unit = Dexterity(arm, index, prepared, 1.0, threshold)
    tips, raw = unit.raw(u)
    valid = raw != -1.0
    _refuse_invalid(valid, len(u))
    _refuse_not_finite(arm, "tips", tips, u, valid)
    _refuse_not_finite(index, "values", raw, u, valid)
    refuse_millimetres(tips[valid])
    refuse_wrong_jacobian(arm, u)
    if not unit.traced:
        refuse_changing_answers(arm, index, prepared, u, tips, raw)
    size = max(float(np.abs(tips[valid]).max()), 1e-3)
    if raw.max() <= 1e-12 * size**3:
        zero = f"dexterity: the index is zero at every posture (at most {raw.max():.1g}). Check its parameters."
        raise SingularArm(arm.when_singular() or zero)
    if normaliser is None:
        normaliser = maximum(lambda v: unit.raw(v)[1], u, raw)
    return Dexterity(arm, index, prepared, normaliser, threshold, float(valid.mean()))


@dataclass(frozen=True, eq=False)
class Family:
    """Indices prepared for one arm: one forward map and one Jacobian serve all of them."""

    members: tuple[Dexterity, ...]

    @property
    def arm(self) -> Arm:
        """The arm of all members."""
        return self.members[0].arm

    @cached_property
    def alike(self) -> bool:
        """Whether one formula on columns is that of all indices."""
        first = self.members[0].index
        return all(
            type(d.index) is type(first) and isinstance(d.index, TracedIndex) and d.index.structure == _structure(first)
            for d in self.members
        )

    @property
    def traced(self) -> bool:
        """Whether arm and indices can be compiled into one kernel."""
        return self.alike and isinstance(self.arm, TracedArm)

    @cached_property
    def constants(self) -> NDArray[np.float64]:
        """Numbers that the kernel reads: the arm's, then every member's; shape (k,)."""
        assert isinstance(self.arm, TracedArm)
        return np.concatenate([self.arm.constants, self.prepared])

    @cached_property
    def identity(self) -> Hashable:
        """Equal for families that give every sample the same tip and raw indices; None when that cannot be known."""
        index = self.members[0].index
        if not (self.traced and isinstance(self.arm, TracedArm) and isinstance(index, TracedIndex)):
            return None
        structures = (type(self.arm), self.arm.structure, type(index), index.structure)
        return None if None in structures else (*structures, len(self.members), self.constants.tobytes())

    def scales(self, dtype: Any) -> NDArray[Any]:
        """1 / normaliser of every member, shape (m,)."""
        return np.array([1 / d.normaliser for d in self.members], dtype)

    def thresholds(self, dtype: Any) -> NDArray[Any]:
        """Threshold of every member, shape (m,)."""
        return np.array([d.threshold for d in self.members], dtype)

    def evaluate(self, u: Array) -> tuple[Array, Array]:
        """Tips (n, 3) [m] and raw indices (n, m) at points of the unit cube; -1 where there is no solution."""
        rows = self.rows(u)
        return rows[:3].T, rows[3:].T

    def rows(self, u: Array, dtype: Any = np.float64) -> Array:
        """The same as rows: x, y, z and m raw indices, shape (3 + m, n)."""
        if self.traced:
            return np.ascontiguousarray(self.kernel()(u, self.constants).T, dtype)
        postures = self._postures(u)
        valid = postures.valid
        rows = np.empty((3 + len(self.members), len(u)), dtype)
        rows[:3] = postures.tips.T
        _refuse_not_finite(self.arm, "tips", rows[:3].T, u, valid)
        if not isinstance(self.arm, TracedArm):
            _refuse_not_finite(self.arm, "Jacobians", postures.jacobians, u, valid)
        for member, raw in zip(self.members, rows[3:], strict=True):
            raw[:] = raw_values(member.index, postures, member.prepared)
            _refuse_not_finite(member.index, "values", raw, u, valid)
            np.maximum(raw, 0.0, out=raw)
        if not valid.all():
            rows[:3, ~valid], rows[3:, ~valid] = 0.0, -1.0
        return rows

    @cached_property
    def prepared(self) -> NDArray[np.float64]:
        """What indices that are traced have prepared, one after another; shape (k,)."""
        return np.concatenate([d.prepared for d in self.members]) if self.alike else NOTHING

    @property
    def widths(self) -> tuple[int, ...]:
        """Columns of the arrays that :meth:`answers` gives."""
        dof = self.arm.dof
        return (1, 3, 6 * dof, 9, dof, dof) if self.alike else (1, 3, 6 * dof, *[1] * len(self.members))

    def answers(self, u: Array) -> list[Array]:
        """What plugins in NumPy say of n points: which are valid, tips, Jacobians, and what indices read or else their values."""
        postures = self._postures(u)
        n, valid = len(u), postures.valid.astype(float)[:, None]
        first = [valid, postures.tips, postures.jacobians.reshape(n, 6 * self.arm.dof)]
        if self.alike:
            return [*first, postures.rotations.reshape(n, 9), postures.q, postures.u]
        # An index may answer in the same memory each time.
        own = np.array if len(self.members) > 1 else np.asarray
        return [*first, *(own(raw_values(d.index, postures, d.prepared))[:, None] for d in self.members)]

    def _postures(self, u: Array) -> Postures:
        with blaming(self.arm):
            postures = self.arm.postures(u)
        if len(postures.valid) != len(u):
            raise PluginError(f"{name_of(self.arm)}: {len(postures.valid)} postures for {len(u)} points.")
        return postures

    def reader(self, flow: str, components: Sequence[ModuleType]) -> Map:
        """:meth:`answers` -> tip, raw indices, the indices' own values; ``flow`` is more source around the same block."""
        arm, index = self.arm, self.members[0].index
        traced = index if isinstance(index, TracedIndex) and self.alike else None
        structures = () if traced is None else (type(index), traced.structure, tuple(arm.limited))
        lengths = [len(d.prepared) for d in self.members] if traced else []
        key = ("reader", *structures, self.widths, tuple(lengths), flow)
        if None not in structures and key in _kernels:
            return _kernels[key]

        def function(columns: Sequence[Column], p: Sequence[Column]) -> list[Column]:
            (valid,), tip, J, *rest = parted(columns, self.widths)
            if traced is None:
                values = [value for (value,) in rest]
            else:
                R, q, u = rest
                posture = ArmColumns(u, q, tip, parted(R, (3, 3, 3)), parted(J, [arm.dof] * 6), arm.limited)
                with blaming(index):
                    values = [traced.columns(posture, own) for own in parted(p, lengths)]
            solved = valid > 0.5
            raws = [where(solved, maximum_of(value, 0.0), -1.0) for value in values]
            return [*(where(solved, x, 0.0) for x in tip), *raws, *(where(solved, value, 0.0) for value in values)]

        _kernels[key] = Map(function, self.widths, len(self.prepared), np.float64, flow, components)
        return _kernels[key]

    def kernel(self, dtype: Any = np.float64, flow: str = "", components: Sequence[ModuleType] = ()) -> Map:
        """The compiled formulas: u (n, dof) -> tip, raw indices; with ``flow``, more source around the same block."""
        arm, index = self.arm, self.members[0].index
        assert isinstance(arm, TracedArm) and isinstance(index, TracedIndex)
        lengths = [len(d.prepared) for d in self.members]
        structures = (type(arm), arm.structure, type(index), index.structure)
        key = (*structures, arm.dof, len(arm.constants), tuple(lengths), np.dtype(dtype), flow)
        if None not in structures and key in _kernels:
            return _kernels[key]

        def function(u: Sequence[Column], p: Sequence[Column]) -> list[Column]:
            constants, *prepared = parted(p, [len(arm.constants), *lengths])
            with blaming(arm):
                columns = arm.columns(u, constants)
            with blaming(index):
                values = [maximum_of(index.columns(columns, own), 0.0) for own in prepared]
            return [*columns.tip, *(where_valid(columns.valid, value, -1.0) for value in values)]

        _kernels[key] = Map(function, arm.dof, len(self.constants), dtype, flow, components)
        return _kernels[key]


_kernels: dict[Any, Map] = {}


def _refuse_not_finite(part: object, what: str, values: Array, u: Array, valid: NDArray[np.bool_]) -> None:
    if all_finite(values):
        return
    wrong = valid & ~np.isfinite(values).reshape(len(u), -1).all(axis=1)
    if wrong.any():
        where = np.array2string(u[wrong][0], precision=4, separator=", ")
        many = f"{int(wrong.sum())} of {len(u)} postures, first at u = {where}"
        raise PluginError(f"{name_of(part)}: {what} that are not finite at {many}")


def _refuse_invalid(valid: NDArray[Any], tried: int) -> None:
    if not valid.any():
        remedy = "Check coupled limits, joint limits and lengths."
        raise SpecError(finding("arm", f"none of {tried} postures within the joint limits is valid.", remedy=remedy))


def _structure(index: DexterityIndex) -> Any:
    return index.structure if isinstance(index, TracedIndex) else None
