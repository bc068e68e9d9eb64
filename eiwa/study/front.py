"""Geometry of a Pareto front: points (n, m) whose every coordinate is the better the smaller it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.errors import EiwaError
from eiwa.core.interfaces import Array

MARGIN = 0.1
"""How far behind the front's worst values the reference point lies, as a share of the front's range."""


def nondominated(points: Array) -> NDArray[np.bool_]:
    """Which points no other point dominates; of equal ones the first."""
    left, k = np.arange(len(points)), 0
    while k < len(left):
        stays = (points[left] < points[left[k]]).any(axis=1)
        stays[k] = True
        left, k = left[stays], int(stays[:k].sum()) + 1
    kept = np.zeros(len(points), np.bool_)
    kept[left] = True
    return kept


def reference(front: Array) -> Array:
    """The front's worst value of every objective, moved away from the front by a tenth of its range there.

    Where all members are equal in an objective, by a tenth of their value (of 1 where that is 0). So the ends of the
    front count, and points that the front dominates do not move it.
    """
    worst, extent = front.max(axis=0), np.ptp(front, axis=0)
    scale = np.where(extent > 0, extent, np.where(worst != 0, np.abs(worst), 1.0))
    moved: Array = worst + MARGIN * scale
    return moved


def hypervolume(front: Array, reference: Array) -> float:
    """Volume that the front dominates within the reference point."""
    return float(_moocore().hypervolume(front, ref=reference)) if len(front) else 0.0


def contributions(front: Array, reference: Array) -> Array:
    """Hypervolume that each member alone dominates, (n,)."""
    shares: Array = _moocore().hv_contributions(front, ref=reference)
    return shares


def history(points: Sequence[Array | None], reference: Array) -> list[float]:
    """Hypervolume after each point, with the reference point of the whole front; None is a design that does not count."""
    front = np.empty((0, len(reference)))
    volumes, volume = [], 0.0
    for point in points:
        if point is not None and not (front <= point).all(axis=1).any():
            front = np.vstack([front[~(point <= front).all(axis=1)], point])
            volume = hypervolume(front, reference)
        volumes.append(volume)
    return volumes


def bulge(front: Array) -> Array:
    """Distance of every member from the hyperplane through the extremes, positive towards the ideal point, (n,).

    The front is scaled to [0, 1] in every objective first. Its extremes E (m, m) are the best members of each objective;
    the plane {x : n x = 1} through them has E n = 1. For two objectives it is the chord. Where the extremes span no plane
    that faces the ideal point (n > 0), it is sum x = 1.

    References
    ----------
    I. Das, "On characterizing the 'knee' of the Pareto curve based on normal-boundary intersection", Structural
    Optimization 18 (1999).
    """
    low, extent = front.min(axis=0), np.ptp(front, axis=0)
    scaled = (front - low) / np.where(extent > 0, extent, 1.0)
    m = front.shape[1]
    E = scaled[[_best(scaled, k) for k in range(m)]]
    normal = np.linalg.solve(E, np.ones(m)) if np.linalg.matrix_rank(E) == m else np.zeros(m)
    normal = normal if (normal > 0).all() else np.ones(m)
    distances: Array = (1.0 - scaled @ normal) / np.linalg.norm(normal)
    return distances


def knee(front: Array) -> int | None:
    """The member that bulges most; None where none lies clearly nearer to the ideal point than the extremes' plane."""
    distances = bulge(front)
    most = int(np.argmax(distances))
    return most if distances[most] > 1e-9 else None


def _best(front: Array, k: int) -> int:
    """The best member of objective k; of equal ones the best in the others."""
    order = [*(front[:, j] for j in reversed(range(front.shape[1])) if j != k), front[:, k]]
    return int(np.lexsort(order)[0])


def _moocore() -> Any:
    try:
        import moocore
    except ImportError:
        raise EiwaError('Pareto sets need moocore: pip install "eiwa[analysis]"') from None
    return moocore
