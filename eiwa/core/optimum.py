"""The maximum of a function on the unit cube, found without gradients, whatever the number of threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from eiwa.core.interfaces import Array
from eiwa.core.sampling import MAX_DIMENSIONS, Stream
from eiwa.core.transforms import frozen

PILOT = 1 << 14


@lru_cache(maxsize=16)
def pilot_points(dof: int) -> Array:
    """The fixed pilot: 2^14 points of one Sobol sequence, whatever the study's seed; shape (2^14, dof)."""
    return frozen(Stream("sobol" if dof <= MAX_DIMENSIONS else "plain", 0).points(0, PILOT, dof))


def maximum(
    f: Callable[[Array], Array],
    u: Array,
    values: Array | None = None,
    starts: int = 16,
    smallest_step: float = 2.0**-16,
) -> float:
    """Maximum of f over the unit cube, from the best of some points by compass search, all starts in one batch.

    A point moves to the best of its 2 dof neighbours at distance h when that is better, else h is divided by 4. At the end
    the gradient is of the order of h, so the value is within about h^2 of a local maximum.
    """
    values = f(u) if values is None else values
    best = np.argpartition(-values, min(starts, len(u) - 1))[:starts]
    best = best[np.lexsort((best, -values[best]))]
    points, heights = np.array(u[best], float), np.array(values[best], float)
    n, dof = points.shape
    steps = np.full(n, 2.0**-4)
    moves = np.concatenate([np.eye(dof), -np.eye(dof)])
    while steps.max() >= smallest_step:
        trials = np.clip(points[:, None, :] + steps[:, None, None] * moves, 0.0, 1.0)
        reached = np.asarray(f(trials.reshape(-1, dof)), float).reshape(n, 2 * dof)
        choice = reached.argmax(axis=1)
        top = reached[np.arange(n), choice]
        better = top > heights
        points[better] = trials[better, choice[better]]
        heights[better] = top[better]
        steps[~better] /= 4
    return float(heights.max())
