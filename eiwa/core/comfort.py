"""How comfortable a forearm's postures are, c(q) in [0, 1], and the best posture in every voxel.

RULA (McAtamney and Corlett 1993), LUBA (Kee and Karwowski 2001), or the distance from mid-comfort. Postures are those of
:mod:`eiwa.core.forearm`; the shoulder's is implied by where the elbow rests: flexion asin(q2 / L_ua), abduction
asin(q1 / L_ua), and the elbow bends by 90 deg + pitch - flexion.

RULA's scores stand here less 1, as numbers that need not be whole: a band's edge is a sigmoid, and Table A is interpolated.
Scores take degrees, as both are published.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eiwa.core.compiled import compiled
from eiwa.core.forearm import Rotations
from eiwa.core.interfaces import Array
from eiwa.core.workspace import Grid

LUBA_WRIST = (
    ((np.array([20, 60]), np.array([1, 2, 5])), (np.array([20, 45]), np.array([1, 2, 7]))),
    ((np.array([10, 30]), np.array([1, 3, 7])), (np.array([10, 20]), np.array([1, 3, 6]))),
)
"""Edges of bands and the scores between them, of flexion and extension, and of radial and ulnar deviation."""

TABLE_A = np.array(
    [
        [1, 2, 2, 2, 2, 3, 3, 3], [2, 2, 2, 2, 3, 3, 3, 3], [2, 3, 3, 3, 3, 3, 4, 4],
        [2, 3, 3, 3, 3, 4, 4, 4], [3, 3, 3, 3, 3, 4, 4, 4], [3, 4, 4, 4, 4, 4, 5, 5],
        [3, 3, 4, 4, 4, 4, 5, 5], [3, 4, 4, 4, 4, 4, 5, 5], [4, 4, 4, 4, 4, 5, 5, 5],
        [4, 4, 4, 4, 4, 5, 5, 5], [4, 4, 4, 4, 4, 5, 5, 5], [4, 4, 4, 5, 5, 5, 6, 6],
        [5, 5, 5, 5, 5, 6, 6, 7], [5, 6, 6, 6, 6, 7, 7, 7], [6, 6, 6, 7, 7, 7, 7, 8],
        [7, 7, 7, 7, 7, 8, 8, 9], [8, 8, 8, 8, 8, 9, 9, 9], [9, 9, 9, 9, 9, 9, 9, 9],
    ],
    float,
).reshape(6, 3, 4, 2)  # fmt: skip
"""RULA's Table A: upper arm 1-6, lower arm 1-3, wrist 1-4, wrist twist 1-2."""


class Comfort(ABC):
    """c(q): what it promises for rotations alone, and its largest value in every cell."""

    @abstractmethod
    def promise(self, q: Array) -> Array:
        """How comfortable the rotations of q are, whatever the slides: any increasing measure."""

    @abstractmethod
    def spread(self, E: Array, rotations: Rotations, layers: Array, ends: Array, grid: Grid) -> None:
        """Raise E to the comfort of every rotation, in its layer, in all cells that the slides' ``ends`` (2, 2) reach."""


@dataclass(frozen=True, eq=False)
class Product(Comfort):
    """c = comfort of the rotations x 2^-(sum over the slides of weight (slide - rest)^2)."""

    turns: Callable[[Array], Array]
    rest: Array
    weights: Array

    def promise(self, q: Array) -> Array:
        """The rotations' factor."""
        return self.turns(q)

    def spread(self, E: Array, rotations: Rotations, layers: Array, ends: Array, grid: Grid) -> None:
        """The factor of a slide is the same for a whole row or column of the rectangle."""
        c = rotations.promise
        _spread_product(E, rotations.tips, layers, ends, grid.r, *grid.origin[:2], c, self.rest, self.weights)


def luba() -> Product:
    """LUBA scores the wrist alone here, so every place of the elbow is as good as another."""

    def wrist(q: Array) -> Array:
        return luba_wrist(np.degrees(q[:, 7]), np.degrees(q[:, 6]))

    return Product(wrist, np.zeros(2), np.zeros(2))


def quadratic(ranges: Array) -> Product:
    """c = 2^-(sum of z^2), z a joint's distance from the middle of its comfortable range (8, 2) in half ranges.

    So c is 1 in the middle, and 1/2 where one joint is at the end of its comfortable range. A locked joint does not count.
    """
    middle, half = ranges.mean(axis=1), np.ptp(ranges, axis=1) / 2
    weights = np.divide(1.0, half**2, out=np.zeros(8), where=half > 0)

    def turns(q: Array) -> Array:
        bell: Array = np.exp2(-(weights * (q - middle) ** 2)[:, 2:].sum(axis=1))
        return bell

    return Product(turns, middle[:2], weights[:2])


@dataclass(frozen=True, eq=False)
class Rula(Comfort):
    """c = 1 - (A - 1) / 8, Table A of RULA for a supported arm.

    Abduction is the elbow's slide to the side, the mid-line x = 0, and "out to the side" a forearm whose yaw is outward.
    """

    upper_arm: float
    toe_in: float
    smoothing: float

    def promise(self, q: Array) -> Array:
        """Low scores of wrist and twist."""
        least: Array = -_hands(q, self.smoothing).sum(axis=1)
        return least

    def spread(self, E: Array, rotations: Rotations, layers: Array, ends: Array, grid: Grid) -> None:
        """Abduction belongs to a column of the rectangle, flexion and the elbow to a row."""
        q, toe_in = rotations.q, float(np.degrees(self.toe_in))
        hands, place = _hands(q, self.smoothing), (grid.r, *grid.origin[:2])
        _spread_rula(
            E, rotations.tips, layers, ends, *place, q[:, 2].copy(), hands, self.upper_arm, toe_in, self.smoothing
        )


def luba_wrist(flexion: Array, deviation: Array) -> Array:
    """1 - sum(score - 1) / sum(largest score - 1) of the wrist's two axes [deg], palmar and radial positive; shape (n,)."""
    total, most = np.zeros(len(flexion)), 0.0
    for angle, (positive, negative) in zip((flexion, deviation), LUBA_WRIST, strict=True):
        # A joint at its limit stands, after rounding, on either side of a band's edge.
        scores = [values[np.searchsorted(edges, np.abs(angle) - 1e-9)] for edges, values in (positive, negative)]
        total += np.where(angle >= 0, *scores) - 1
        most += max(positive[1].max(), negative[1].max()) - 1
    comfort: Array = 1 - total / most
    return comfort


@compiled
def past(angle: Any, edge: Any, s: Any) -> Any:
    """0 well before a band's edge, 1 well behind it: a sigmoid of scale s."""
    return 1.0 / (1.0 + np.exp(min((edge - angle) / s, 700.0)))


@compiled
def rula_upper_arm(flexion: Any, supported: bool, s: Any) -> Any:
    """Upper arm: -20 to 20 deg, then 45, 90, or backward; 1 less when supported. Add :func:`rula_abducted`."""
    bands = past(-flexion, 20.0, s) + past(flexion, 20.0, s) + past(flexion, 45.0, s) + past(flexion, 90.0, s)
    return bands - (1.0 if supported else 0.0)


@compiled
def rula_abducted(abduction: Any, s: Any) -> Any:
    """What abduction adds to the upper arm: 1 beyond 20 deg (assumed; RULA names no angle)."""
    return past(abduction, 20.0, s)


@compiled
def rula_lower_arm(elbow: Any, s: Any) -> Any:
    """Lower arm: elbow flexion of 60 to 100 deg, or not. Add :func:`rula_aside`."""
    return past(-elbow, -60.0, s) + past(elbow, 100.0, s)


@compiled
def rula_aside(out: Any, across: bool, s: Any) -> Any:
    """What is added to the lower arm: 1 across the mid-line, or turned out to the side by 20 deg (assumed)."""
    return 1.0 if across else past(out, 20.0, s)


@compiled
def rula_wrist(flexion: Any, deviation: Any, s: Any) -> Any:
    """Wrist: neutral within 5 deg (assumed), up to 15 deg, beyond; 1 more when deviated by 10 deg (LUBA's first class)."""
    return past(abs(flexion), 5.0, s) + past(abs(flexion), 15.0, s) + past(abs(deviation), 10.0, s)


@compiled
def rula_twist(supination: Any, s: Any) -> Any:
    """Wrist twist: beyond half of the largest range, 82 deg of supination and 76 of pronation (Boone and Azen 1979)."""
    return past(supination, 41.0, s) + past(-supination, 38.0, s)


@compiled
def rula_comfort(upper_arm: Any, lower_arm: Any, wrist: Any, twist: Any) -> Any:
    """1 - (A - 1) / 8, of the four scores less 1."""
    u, v = min(max(upper_arm, 0.0), 5.0), min(lower_arm, 2.0)
    w, t = min(wrist, 3.0), min(twist, 1.0)
    i, j, k = min(int(u), 4), min(int(v), 1), min(int(w), 2)
    a, b, c = u - i, v - j, w - k
    score = 0.0
    for di in range(2):
        for dj in range(2):
            for dk in range(2):
                share = (a if di else 1.0 - a) * (b if dj else 1.0 - b) * (c if dk else 1.0 - c)
                entry = TABLE_A[i + di, j + dj, k + dk]
                score += share * ((1.0 - t) * entry[0] + t * entry[1])
    return max(1.0 - (score - 1.0) / 8.0, 0.0)


@compiled
def _hands(q: Any, s: Any) -> Any:
    """Scores of wrist and twist, less 1, shape (n, 2)."""
    scores = np.empty((len(q), 2))
    for n in range(len(q)):
        scores[n, 0] = rula_wrist(np.degrees(q[n, 7]), np.degrees(q[n, 6]), s)
        scores[n, 1] = rula_twist(np.degrees(q[n, 5]), s)
    return scores


@compiled
def _shoulder(slide: Any, upper_arm: Any) -> Any:
    """The angle [deg] that an elbow's slide implies."""
    return np.degrees(np.arcsin(min(max(slide / upper_arm, -1.0), 1.0)))


@compiled
def _slide(cell: Any, r: Any, tip: Any, low: Any, high: Any, rest: Any) -> Any:
    """The slide in [low, high] nearest to ``rest`` that takes a tip's coordinate into a cell."""
    return min(max(rest, cell * r - tip, low), (cell + 1) * r - tip, high)


@compiled
def _cells(tip: Any, low: Any, high: Any, r: Any, origin: Any, count: Any) -> Any:
    """The cells of one axis of a grid that a tip's coordinate reaches by a slide: first, and one behind the last."""
    return max(int(np.floor((tip + low) / r)) - origin, 0), min(int(np.floor((tip + high) / r)) - origin + 1, count)


@compiled
def _spread_product(
    E: Any, tips: Any, layers: Any, ends: Any, r: Any, ox: Any, oy: Any, promise: Any, rest: Any, weights: Any
) -> None:
    nx, ny, _ = E.shape
    columns = np.empty(nx)
    for n in range(len(tips)):
        x, y, k = tips[n, 0], tips[n, 1], layers[n]
        first, last = _cells(x, ends[0, 0], ends[0, 1], r, ox, nx)
        for i in range(first, last):
            z = _slide(i + ox, r, x, ends[0, 0], ends[0, 1], rest[0]) - rest[0]
            columns[i] = 2.0 ** -(weights[0] * z * z)
        for j in range(*_cells(y, ends[1, 0], ends[1, 1], r, oy, ny)):
            z = _slide(j + oy, r, y, ends[1, 0], ends[1, 1], rest[1]) - rest[1]
            row = promise[n] * 2.0 ** -(weights[1] * z * z)
            for i in range(first, last):
                E[i, j, k] = max(E[i, j, k], row * columns[i])


@compiled
def _spread_rula(
    E: Any, tips: Any, layers: Any, ends: Any, r: Any, ox: Any, oy: Any, pitch: Any, hands: Any, length: Any,
    toe_in: Any, s: Any,
) -> None:  # fmt: skip
    nx, ny, _ = E.shape
    abducted, aside = np.empty(nx), np.empty(nx)
    for i in range(nx):
        aside[i] = rula_aside(-toe_in, i + ox < 0, s)
    for n in range(len(tips)):
        x, y, k = tips[n, 0], tips[n, 1], layers[n]
        wrist, twist = hands[n]
        first, last = _cells(x, ends[0, 0], ends[0, 1], r, ox, nx)
        for i in range(first, last):
            abducted[i] = rula_abducted(_shoulder(_slide(i + ox, r, x, ends[0, 0], ends[0, 1], 0.0), length), s)
        for j in range(*_cells(y, ends[1, 0], ends[1, 1], r, oy, ny)):
            for rest in (0.0, ends[1, 1]):  # the upper arm likes the near end of a row, the elbow at times the far one
                flexion = _shoulder(_slide(j + oy, r, y, ends[1, 0], ends[1, 1], rest), length)
                upper_arm = rula_upper_arm(flexion, True, s)
                lower_arm = rula_lower_arm(90.0 + np.degrees(pitch[n]) - flexion, s)
                most = rula_comfort(upper_arm, lower_arm, wrist, twist)
                for i in range(first, last):
                    if most > E[i, j, k]:
                        c = rula_comfort(upper_arm + abducted[i], lower_arm + aside[i], wrist, twist)
                        E[i, j, k] = max(E[i, j, k], c)
