"""A serial chain of revolute, prismatic and fixed joints, its forward map and geometric Jacobian.

Inside, every joint is turned to move about or along z. The formulas are written on columns once; constants that are exactly
0 or +-1 in a rotation, and exactly 0 in a translation, are folded at tracing, all others stay parameters of the kernel.
A joint may mimic another, and rows lo <= c.q <= hi may couple the limits of several.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.errors import SpecError, finding
from eiwa.core.interfaces import ArmColumns, Array, TracedArm, compiled_map
from eiwa.core.joints import Coupling, Joint, Kind, Mimic, check, unit_of
from eiwa.core.symbols import Column, Symbol, as_columns, cross, dot, sincospi
from eiwa.core.transforms import Transform, align_z, frozen, inverse

__all__ = ["Coupling", "Joint", "Kind", "Mimic", "SerialChain"]
MAX_JOINTS = 12

Vector = Sequence[Column]


@dataclass(frozen=True, eq=False)
class SerialChain(TracedArm):
    """A frozen serial chain from its base frame to its tip.

    Parameters
    ----------
    joints
        In order from the base; 1-12 of them free to move.
    T_last_tip
        The tool in the last joint's frame.
    T_base_first
        The first joint's parent frame in the arm's base frame.
    singular_hint
        What :meth:`when_singular` answers, computed when asked.
    couplings
        Joint vectors outside any of these rows are not valid; an index does not see how near they are.

    Raises
    ------
    SpecError
        No free joint, too many, limits that are not finite or not increasing, an unlimited prismatic joint, a joint
        that mimics none of the free ones or leaves the one that drives it no range.
    """

    joints: tuple[Joint, ...]
    T_last_tip: Transform
    T_base_first: Transform
    singular_hint: Any = None
    couplings: tuple[Coupling, ...] = ()

    def __post_init__(self) -> None:
        free = len(self.free)
        if not 1 <= free <= MAX_JOINTS:
            raise SpecError(finding("arm.joints", f"{free} movable joints; a chain has 1 to {MAX_JOINTS}."))
        for joint in self.movable:
            check(joint, [j.name for j in self.free])
        for joint, span in zip(self.free, self._ranges, strict=True):
            if span is not None and span[0] > span[1]:
                problem = "no value of the joint keeps those that mimic it within their limits."
                raise SpecError(finding(f"arm.joints.{joint.name}.limits", problem, value=joint.limits))

    @cached_property
    def movable(self) -> tuple[Joint, ...]:
        """The joints that are not fixed."""
        return tuple(j for j in self.joints if j.kind != "fixed")

    @cached_property
    def free(self) -> tuple[Joint, ...]:
        """The joints that move by themselves, one per degree of freedom."""
        return tuple(j for j in self.movable if j.mimic is None)

    @property
    def dof(self) -> int:  # type: ignore[override]
        """Number of free joints."""
        return len(self.free)

    @cached_property
    def drives(self) -> tuple[tuple[int, float, float], ...]:
        """Of each movable joint: which free joint drives it, multiplier and offset."""
        number = {joint.name: k for k, joint in enumerate(self.free)}
        return tuple(
            (number[j.name], 1.0, 0.0)
            if j.mimic is None
            else (number[j.mimic.joint], j.mimic.multiplier, j.mimic.offset)
            for j in self.movable
        )

    @cached_property
    def _ranges(self) -> tuple[tuple[float, float] | None, ...]:
        """Of each free joint: the values that keep it and all that mimic it within their limits, if any has some."""
        ranges: list[tuple[float, float] | None] = [None] * self.dof
        for joint, (k, multiplier, offset) in zip(self.movable, self.drives, strict=True):
            if joint.limits is not None:
                low, high = sorted((limit - offset) / multiplier for limit in joint.limits)
                known = ranges[k]
                ranges[k] = (low, high) if known is None else (max(known[0], low), min(known[1], high))
        return tuple(ranges)

    @cached_property
    def limited(self) -> tuple[bool, ...]:  # type: ignore[override]
        """Whether each free joint has limits a penalty can use."""
        return tuple(span is not None and span[0] < span[1] for span in self._ranges)

    @cached_property
    def lower(self) -> NDArray[np.float64]:
        """Lower ends of the sampled ranges, shape (dof,) [rad or m]."""
        return frozen([span[0] if span else -np.pi for span in self._ranges])

    @cached_property
    def upper(self) -> NDArray[np.float64]:
        """Upper ends of the sampled ranges, shape (dof,) [rad or m]."""
        return frozen([span[1] if span else np.pi for span in self._ranges])

    @cached_property
    def rows(self) -> NDArray[np.float64]:
        """The couplings as low <= C q <= high: C, low and high side by side, shape (rows, dof + 2)."""
        drives = dict(zip([j.name for j in self.movable], self.drives, strict=True))
        rows = np.zeros((len(self.couplings), self.dof + 2))
        for row, coupling in zip(rows, self.couplings, strict=True):
            row[-2:] = coupling.low, coupling.high
            for name, coefficient in coupling.coefficients.items():
                k, multiplier, offset = drives[name]
                row[k] += coefficient * multiplier
                row[-2:] -= coefficient * offset
        return frozen(rows)

    @cached_property
    def Ts_fixed(self) -> NDArray[np.float64]:
        """What stands before each movable joint, and behind the last: shape (dof + 1, 4, 4)."""
        Ts, T = [], np.array(self.T_base_first)
        for joint in self.joints:
            T = T @ joint.T_parent_joint
            if joint.kind != "fixed":
                T_joint_z = align_z(joint.axis)
                Ts.append(T @ T_joint_z)
                T = inverse(T_joint_z)
        Ts.append(T @ self.T_last_tip)
        Ts_fixed = np.array(Ts)
        Ts_fixed[np.abs(Ts_fixed) < 1e-15] = 0.0
        return frozen(Ts_fixed)

    @cached_property
    def _free(self) -> NDArray[np.bool_]:
        """Which entries of the fixed transforms are parameters of the kernel."""
        free: NDArray[np.bool_] = self.Ts_fixed[:, :3, :] != 0.0
        free[:, :, :3] &= np.abs(self.Ts_fixed[:, :3, :3]) != 1.0
        return free

    @cached_property
    def constants(self) -> NDArray[np.float64]:  # type: ignore[override]
        """Ranges of the joints (half turns or m), the free entries of the fixed transforms, the rows of the couplings."""
        ranges = np.stack([self.lower, self.upper - self.lower], axis=1) / self._units[:, None]
        return frozen(np.concatenate([ranges.ravel(), self.Ts_fixed[:, :3, :][self._free], self.rows.ravel()]))

    @cached_property
    def _units(self) -> NDArray[np.float64]:
        """:func:`unit_of` each free joint."""
        return frozen([unit_of(joint) for joint in self.free])

    @cached_property
    def structure(self) -> Hashable:  # type: ignore[override]
        """Kinds of joints, what drives them, the pattern of folded entries, and which joints are coupled."""
        folded = np.where(self._free, 2.0, self.Ts_fixed[:, :3, :])
        coupled = (self.rows[:, : self.dof] != 0.0).tobytes()
        return tuple(j.kind for j in self.movable), self.drives, self.limited, folded.tobytes(), coupled

    @cached_property
    def link_length(self) -> float:
        """Sum of the distances between consecutive frames, tool included [m]."""
        Ts = [joint.T_parent_joint for joint in self.joints] + [self.T_last_tip]
        return float(sum(np.linalg.norm(T[:3, 3]) for T in Ts))

    @cached_property
    def rank(self) -> int:
        """Largest rank of the Jacobian at some random postures."""
        u = as_columns(np.random.default_rng(0).uniform(size=(64, self.dof)))
        rows = self.columns(u, list(self.constants)).jacobian
        jacobians = np.stack([np.stack([np.broadcast_to(entry, 64) for entry in row], axis=-1) for row in rows], axis=1)
        return int(np.linalg.matrix_rank(jacobians, tol=1e-9).max())

    def when_singular(self) -> str:
        """The hint of whoever built the chain."""
        return str(self.singular_hint()) if self.singular_hint else ""

    def to_u(self, q: Array) -> Array:
        """Joint vectors as points of the unit cube (outside [0, 1] when beyond a limit)."""
        span = self.upper - self.lower
        return (np.asarray(q, float) - self.lower) / np.where(span > 0, span, 1.0)

    def columns(self, u: Sequence[Column], p: Sequence[Column]) -> ArmColumns:
        """Joint values from the unit cube, then :meth:`at`; valid where every coupling holds."""
        at = self.at(u, [p[2 * j] + u[j] * p[2 * j + 1] for j in range(self.dof)], p[2 * self.dof :])
        return replace(at, valid=self._within(at.q, p[len(p) - self.rows.size :]))

    def _within(self, q: Sequence[Column], p: Sequence[Column]) -> Column:
        """Whether joint values lie within every coupling, whose rows are ``p``."""
        valid: Column = True
        for k, row in enumerate(self.rows):
            *coefficients, low, high = p[k * len(row) : (k + 1) * len(row)]
            chosen = [j for j in range(self.dof) if row[j] != 0.0]
            total = dot([coefficients[j] for j in chosen], [q[j] for j in chosen])
            valid = (total >= low) & (total <= high) & valid
        return valid

    def at(self, u: Sequence[Column], h: Sequence[Column], p: Sequence[Column]) -> ArmColumns:
        """Forward map and geometric Jacobian on columns, at joint values ``h`` in half turns or m."""
        fixed = self._fixed_columns(list(p))
        R: list[list[Column]] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        o: list[Column] = [0.0, 0.0, 0.0]
        axes: list[Vector] = []
        points: list[list[Vector]] = []
        for j, joint in enumerate(self.movable):
            before = o
            R, o = _compose(R, o, *fixed[j])
            axes.append([row[2] for row in R])
            points.append([o, before] if _along_z(*fixed[j]) else [o])
            if j > 0 and _on_z(fixed[j][1]):
                points[j - 1].append(o)
            value = self._value(j, h)
            if joint.kind == "revolute":
                s, c = sincospi(value)
                R = [[c * r[0] + s * r[1], c * r[1] - s * r[0], r[2]] for r in R]
            else:
                o = [a + value * z for a, z in zip(o, axes[j], strict=True)]
        R, tip = _compose(R, o, *fixed[-1])
        if _on_z(fixed[-1][1]):
            points[-1].append(tip)
        return ArmColumns(
            u=u,
            q=[unit * value if unit != 1.0 else value for unit, value in zip(self._units.tolist(), h, strict=True)],
            tip=tip,
            rotation=R,
            jacobian=self._jacobian(tip, axes, points),
            limited=self.limited,
            reduced=self._jacobian(self._meeting_point(tip, points), axes, points) if self.dof >= 6 else None,
        )

    def _value(self, j: int, h: Sequence[Column]) -> Column:
        """Value of a movable joint, in half turns or m, from those of the free joints."""
        k, multiplier, offset = self.drives[j]
        unit = unit_of(self.movable[j])
        return h[k] * (multiplier * float(self._units[k]) / unit) + offset / unit

    def _jacobian(self, reference: Vector, axes: list[Vector], points: list[list[Vector]]) -> list[list[Column]]:
        """The geometric Jacobian at a point: each free joint's column sums what it drives.

        The linear part vanishes where the axis is known to pass through the point.
        """
        jacobian: list[list[Column]] = [[0.0] * self.dof for _ in range(6)]
        for joint, drive, axis, on_axis in zip(self.movable, self.drives, axes, points, strict=True):
            if joint.kind == "prismatic":
                twist = [*axis, 0.0, 0.0, 0.0]
            elif any(_same(point, reference) for point in on_axis):
                twist = [0.0, 0.0, 0.0, *axis]
            else:
                lever = [a - b for a, b in zip(reference, on_axis[0], strict=True)]
                twist = [*cross(axis, lever), *axis]
            k, multiplier, _ = drive
            for row, entry in zip(jacobian, twist, strict=True):
                row[k] = entry * multiplier + row[k]
        return jacobian

    def _meeting_point(self, tip: Vector, points: list[list[Vector]]) -> Vector:
        """The point through which most revolute axes pass; the tip, if none is better."""

        def axes_through(point: Vector) -> int:
            turning = (p for joint, p in zip(self.movable, points, strict=True) if joint.kind == "revolute")
            return sum(any(_same(point, other) for other in on_axis) for on_axis in turning)

        return max([tip, *(point for on_axis in points for point in on_axis)], key=axes_through)

    def _fixed_columns(self, p: list[Column]) -> list[tuple[list[list[Column]], list[Column]]]:
        """Rotation and translation of every fixed transform, folded entries as floats, the others from ``p``."""
        entries = iter(p)
        result = []
        for T, free in zip(self.Ts_fixed, self._free, strict=True):
            rows = [[next(entries) if free[i, k] else float(T[i, k]) for k in range(4)] for i in range(3)]
            result.append(([row[:3] for row in rows], [row[3] for row in rows]))
        return result

    def tips(self, u: Array) -> Array:
        """Tip positions (n, 3) [m] alone, at points of the unit cube."""
        key = (type(self), self.structure, "tips")
        function = compiled_map(key, lambda u, p: self.columns(u, p).tip, self.dof, len(self.constants))
        return function(u, self.constants)

    def forward(self, q: Array, precision: Any = np.float64) -> tuple[Array, Array, Array]:
        """Tips, orientations and geometric Jacobians at joint vectors, limits not regarded.

        Parameters
        ----------
        q
            Joint vectors, shape (n, dof) [rad or m].
        precision
            ``numpy.float64`` or ``numpy.float32``.

        Returns
        -------
        tips (n, 3) [m], orientations (n, 3, 3), Jacobians (n, 6, dof) at the tip in the base frame, linear rows first.
        """
        n, dof = np.shape(q)
        if dof != self.dof:
            raise ValueError(f"q has {dof} columns, the chain has {self.dof} joints")
        p = self.constants[2 * dof :]
        key = (type(self), self.structure, "forward")
        out = compiled_map(key, self._forward_columns, dof, len(p), precision)(q, p)
        return out[:, :3], out[:, 3:12].reshape(n, 3, 3), out[:, 12:].reshape(n, 6, dof)

    def _forward_columns(self, q: Sequence[Column], p: Sequence[Column]) -> list[Column]:
        arm = self.at(q, [value * (1.0 / unit) for value, unit in zip(q, self._units.tolist(), strict=True)], p)
        return [
            *arm.tip,
            *(e for row in arm.rotation for e in row),
            *(e for row in arm.jacobian for e in row),
        ]


def _compose(R: list[list[Column]], o: list[Column], Rf: list[list[Column]], tf: list[Column]) -> Any:
    """Orientation and origin after a fixed transform."""
    origin = [o[i] + _row_times(R[i], tf) for i in range(3)]
    rotation = [[_row_times(R[i], [Rf[k][j] for k in range(3)]) for j in range(3)] for i in range(3)]
    return rotation, origin


def _along_z(Rf: list[list[Column]], tf: list[Column]) -> bool:
    """Whether a fixed transform is known to move along its own z axis, which then passes through its parent's origin."""
    z = [row[2] for row in Rf]
    return all(_is(t, 0.0) or _is(a, 1.0) or _is(a, -1.0) for t, a in zip(tf, z, strict=True))


def _on_z(tf: list[Column]) -> bool:
    """Whether a translation is known to be along its parent's z axis."""
    return _is(tf[0], 0.0) and _is(tf[1], 0.0)


def _is(x: Column, number: float) -> bool:
    return isinstance(x, float) and x == number


def _same(a: Vector, b: Vector) -> bool:
    """Whether two points are known to be the same."""
    return all(
        x is y
        or (isinstance(x, Symbol) and isinstance(y, Symbol) and x.index == y.index)
        or (isinstance(x, float) and isinstance(y, float) and x == y)
        for x, y in zip(a, b, strict=True)
    )


def _row_times(row: Sequence[Column], vector: Sequence[Column]) -> Column:
    total: Column = 0.0
    for a, b in zip(row, vector, strict=True):
        total = total + a * b
    return total
