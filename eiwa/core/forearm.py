"""A forearm on an armrest: the chain of the Equivalent Human Ergonomic Model (EHEM) and the cells that its grip reaches.

T_W_grip = Trans(x_e + q1, q2, z_f) Ry(q4) Rz(toe_in + q5) Rx(q3) Trans(0, L_fw, 0) Ry(q6) Rx(q7) Rz(q8) Trans(0, L_g, 0)

for the right hand: slides along the edge and forward (q1, q2), pitch, roll and yaw about the fulcrum (q3, q4, q5),
pronation, deviation and flexion of the wrist (q6, q7, q8). The left hand is the mirror image in x. Supination, radial
deviation and palmar flexion are positive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.chain import Joint, SerialChain
from eiwa.core.compiled import compiled
from eiwa.core.interfaces import Array, compiled_map
from eiwa.core.optimum import maximum, pilot_points
from eiwa.core.sampling import Stream
from eiwa.core.symbols import Column, sincospi
from eiwa.core.transforms import frozen, rotation_z, translation
from eiwa.core.workspace import Grid

ROTATIONS = (3, 4, 2, 5, 6, 7)
"""q4, q5, q3, q6, q7, q8: the rotations in the chain's order, as indices into q."""
CHUNK = 1 << 16
FIRST, GENERATION = 1 << 17, 1 << 14
"""Rotations that :meth:`Forearm.best` tries at random, and then in steps from the best ones at a time."""
FINE, PITCH = 0.005, np.radians(20.0)
"""Its bins: about so wide in x and y [m], as high as a voxel, and so far in pitch [rad]."""
FINEST = 7
"""Its steps have amplitudes 1 ... 2^-7 of a joint's range."""
NOTHING = -1e300
KEPT = 8
"""Sets of cells that a forearm remembers."""


def slides(
    upper_arm: float, abduction: tuple[float, float] = (-10, 20), flexion: tuple[float, float] = (0, 25)
) -> Array:
    """Ranges of q1 and q2 [m], shape (2, 2): how far the elbow goes while the shoulder turns through angles [deg].

    An elbow goes no further than the upper arm is long. The defaults are comfortable: LUBA's adduction (Kee and Karwowski
    2001), abduction and flexion of ISO 11064-4.
    """
    ranges: Array = upper_arm * np.sin(np.radians(np.clip([abduction, flexion], -90.0, 90.0)))
    return ranges


@dataclass(frozen=True, eq=False)
class Rotations:
    """n rotations with both slides at zero: ``q`` (n, 8) [rad], grips ``tips`` (n, 3) [m] in W, ``promise`` (n,)."""

    q: Array
    tips: Array
    promise: Array


@dataclass(frozen=True, eq=False)
class Forearm:
    """The right forearm of a person on an armrest.

    Parameters
    ----------
    half_width, fulcrum_height
        x_e and z_f: where the fulcrum stands on the edge while both slides are 0 [m].
    toe_in
        Constant inward yaw [rad].
    length, grip
        L_fw, fulcrum to wrist, and L_g, wrist to grip [m].
    ranges
        [low, high] of q1 ... q8 [m, m, rad, ...], shape (8, 2).
    """

    half_width: float
    fulcrum_height: float
    toe_in: float
    length: float
    grip: float
    ranges: Array

    @cached_property
    def chain(self) -> SerialChain:
        """The six rotations, with both slides at zero."""
        steps = [
            ("roll", (0.0, 1.0, 0.0), translation(self.half_width, 0, self.fulcrum_height)),
            ("yaw", (0.0, 0.0, 1.0), rotation_z(self.toe_in)),
            ("pitch", (1.0, 0.0, 0.0), np.eye(4)),
            ("pronation", (0.0, 1.0, 0.0), translation(0, self.length, 0)),
            ("deviation", (1.0, 0.0, 0.0), np.eye(4)),
            ("flexion", (0.0, 0.0, 1.0), np.eye(4)),
        ]
        joints = tuple(
            Joint(name, "revolute", frozen(T), (float(low), float(high)), axis)
            for (name, axis, T), (low, high) in zip(steps, self.ranges[list(ROTATIONS)], strict=True)
        )
        return SerialChain(joints, frozen(translation(0, self.grip, 0)), frozen(np.eye(4)))

    def tips(self, u: Array) -> Array:
        """Grips (n, 3) [m] in W with both slides at zero, at shares u (n, 6) of the rotations' ranges."""
        return self.chain.tips(u)

    def angles(self, u: Array) -> Array:
        """q (n, 8) of the same postures [rad], the slides at zero."""
        q = np.zeros((len(u), 8))
        q[:, ROTATIONS] = self.chain.lower + u * (self.chain.upper - self.chain.lower)
        return q

    @cached_property
    def tip_box(self) -> NDArray[np.float64]:
        """Bounds [[low], [high]] of :meth:`tips`, shape (2, 3) [m]."""
        u = pilot_points(self.chain.dof)
        high = [maximum(lambda v, k=axis: self.tips(to_ends(v))[:, k], u) for axis in range(3)]  # type: ignore[misc]
        low = [-maximum(lambda v, k=axis: -self.tips(to_ends(v))[:, k], u) for axis in range(3)]  # type: ignore[misc]
        box: NDArray[np.float64] = np.array([low, high]) + np.array([[-1e-6], [1e-6]])
        return box

    def bounds(self, armrest: float) -> NDArray[np.float64]:
        """Box of both hands in W, shape (2, 3) [m], the armrest raised by so much [m]."""
        (low_x, high_x), (low_y, high_y) = self.ranges[:2]
        low, high = self.tip_box + [[low_x, low_y, armrest], [high_x, high_y, armrest]]
        wide = max(-low[0], high[0])
        return np.array([[-wide, low[1], low[2]], [wide, high[1], high[2]]])

    def reached(self, grid: Grid, armrest: float, stream: Stream, samples: int) -> NDArray[np.bool_]:
        """The cells that the grip comes to.

        An armrest that rises by whole cells takes them along, so they are found once and moved.
        """
        layers = round(armrest / grid.r)
        rest = armrest - layers * grid.r
        rest = 0.0 if abs(rest) < 1e-9 * grid.r else rest
        home = Grid.covering(self.bounds(rest), grid.r)
        key = (home, rest, stream, samples)
        if key not in self._found:
            if len(self._found) >= KEPT:
                del self._found[next(iter(self._found))]
            self._found[key] = self._sampled(home, rest, stream, samples)
        x, y, z = home.origin
        return grid.taking(self._found[key], replace(home, origin=(x, y, z + layers)))

    @cached_property
    def _found(self) -> dict[Any, NDArray[np.bool_]]:
        return {}

    def _sampled(self, grid: Grid, armrest: float, stream: Stream, samples: int) -> NDArray[np.bool_]:
        """The cells of a grid that covers :meth:`bounds`.

        The rotations are sampled, denser towards the ends of their ranges, because the ends make the border; the two
        slides are translations, so the whole rectangle of cells that one rotation reaches is marked at once.
        """
        ends = self.ranges[:2].ravel() / grid.r
        widths = np.floor([ends[1] - ends[0], ends[3] - ends[2]]).astype(np.int64)
        marks = np.zeros((2, 2, *grid.shape), np.bool_)
        for first in range(0, samples, CHUNK):
            u = stream.points(first, min(CHUNK, samples - first), self.chain.dof)
            cells = (self.tips(to_ends(u)) + [0, 0, armrest]) / grid.r - np.array(grid.origin)
            _mark(marks, cells, ends, widths)
        return _spread(marks, widths)

    def best(
        self, r: float, armrest: float, stream: Stream, samples: int, promise: Callable[[Array], Array]
    ) -> Rotations:
        """The rotations of largest promise, one for each small bin of grips and pitch, the most promising first.

        What a comfort that depends on the whole posture needs: the slides can be chosen for each rotation and voxel, so
        only rotations have to be searched. The first are random as in :meth:`reached`, the others steps from the best
        of each bin (Mouret and Clune 2015).

        Parameters
        ----------
        r
            Edge of a voxel [m]: no bin is shared by two layers of voxels.
        samples
            Rotations to try.
        promise
            From q (n, 8) to (n,): how comfortable these rotations are, slides aside; any increasing measure.
        """
        fine = r / max(1, round(r / FINE))
        size, lift = np.array([fine, fine, r]), np.array([0.0, 0.0, armrest])
        first, last = np.floor((self.tip_box + lift) / size).astype(np.int64)
        pitches = max(1, int(np.ceil(np.ptp(self.ranges[2]) / PITCH)))
        shape = (*(last - first + 1), pitches)
        best = np.full(np.prod(shape), NOTHING)
        shares = np.zeros((len(best), self.chain.dof))

        def credit(u: Array) -> None:
            cells = np.floor((self.tips(u) + lift) / size).astype(np.int64) - first
            pitch = (u[:, 2] * pitches).astype(np.int64)
            bins = np.ravel_multi_index((*cells.T, pitch), shape, mode="clip")
            better = _improve(bins, promise(self.angles(u)), best)
            shares[bins[better]] = u[better]  # of several for one bin the last stays, which is the best

        random = min(samples, FIRST)
        for number in range(0, random, CHUNK):
            credit(to_ends(stream.points(number, min(CHUNK, random - number), self.chain.dof)))
        steps, spent = Stream("plain", stream.key), random
        while spent < samples:
            elites = np.flatnonzero(best > NOTHING)
            x = steps.points(spent, min(GENERATION, samples - spent), 13)
            start = shares[elites[(spent + np.arange(len(x))) % len(elites)]]
            credit(np.clip(start + 2.0 ** (-FINEST * x[:, 12:]) * (x[:, :6] - x[:, 6:12]), 0.0, 1.0))
            spent += len(x)
        found = np.flatnonzero(best > NOTHING)
        found = found[np.argsort(-best[found], kind="stable")]
        return Rotations(self.angles(shares[found]), self.tips(shares[found]) + lift, best[found])


def to_ends(u: Array) -> Array:
    """Points (n, dof) of the unit cube moved towards its faces: sin^2(pi u / 2), arcsine-distributed for uniform u."""
    return compiled_map(("to ends",), _to_ends, u.shape[1], 0)(u, NO_PARAMETERS)


def _to_ends(u: Sequence[Column], _: Sequence[Column]) -> list[Column]:
    sines = [sincospi(0.5 * column)[0] for column in u]
    return [s * s for s in sines]


NO_PARAMETERS = np.zeros(0)


@compiled
def _mark(marks: Any, cells: Any, ends: Any, widths: Any) -> None:
    """Mark the first cell of every rectangle, by how many cells it spans beyond ``widths`` (0 or 1) in x and y."""
    _, _, nx, ny, nz = marks.shape
    for s in range(cells.shape[0]):
        i, j = int(np.floor(cells[s, 0] + ends[0])), int(np.floor(cells[s, 1] + ends[2]))
        more_x = int(np.floor(cells[s, 0] + ends[1])) - i - widths[0]
        more_y = int(np.floor(cells[s, 1] + ends[3])) - j - widths[1]
        k = int(np.floor(cells[s, 2]))
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
            marks[more_x, more_y, i, j, k] = True


def _spread(marks: NDArray[np.bool_], widths: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Extend every mark to its rectangle."""
    reached = np.zeros(marks.shape[2:], np.bool_)
    for more_x in range(2):
        for more_y in range(2):
            columns = np.array(marks[more_x, more_y])
            for step in range(1, widths[0] + more_x + 1):
                columns[step:] |= marks[more_x, more_y, :-step]
            reached |= columns
            for step in range(1, widths[1] + more_y + 1):
                reached[:, step:] |= columns[:, :-step]
    return reached


@compiled
def _improve(bins: Any, values: Any, best: Any) -> Any:
    """Raise ``best`` to the values that fall into its bins; which of them did, in their order."""
    better = np.zeros(len(bins), np.bool_)
    for n in range(len(bins)):
        if values[n] > best[bins[n]]:
            best[bins[n]] = values[n]
            better[n] = True
    return better
