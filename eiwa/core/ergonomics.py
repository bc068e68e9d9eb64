"""Published scores of postures, as comfort in [0, 1]: RULA (McAtamney and Corlett 1993), LUBA (Kee and Karwowski 2001).

RULA's scores stand here less 1, as numbers that need not be whole: a band's edge is a sigmoid, and Table A is interpolated.
Angles in degrees, as both are published.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from eiwa.core.compiled import compiled
from eiwa.core.interfaces import Array

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
