"""Voxels that keep the worst posture instead of the best: what a hand can rely on wherever the joints are."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.compiled import compiled
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, VoxelBackend


class WorstParameters(Parameters):
    """Every cell of the grid in one array; a cell keeps the least value above the threshold."""

    aggregate: Literal["min"] = quantity("min", description="What a cell keeps.")


@compiled
def deposit_min(store: Any, cells: Any, values: Any, count: Any) -> None:
    """Column 0: the largest 1 - value; column 1: hits; column 2: survivors."""
    for s in range(count):
        cell = cells[s]
        store[cell, 1] += 1.0
        if values[s] >= 0.0:  # -1 stands for a sample below the threshold
            store[cell, 0] = max(store[cell, 0], 1.0 - values[s])
            store[cell, 2] += 1.0


@dataclass(frozen=True)
class Worst(VoxelBackend):
    """The least surviving value per cell."""

    deposit = staticmethod(deposit_min)
    bytes_per_cell = 24

    def open(self, cells: int) -> NDArray[np.float64]:
        """Zeros, shape (cells, 3)."""
        return np.zeros((cells, 3))

    def merge(self, into: Any, other: Any) -> NDArray[np.float64]:
        """The larger 1 - value, sums of counts."""
        return np.stack([np.maximum(into[:, 0], other[:, 0]), *(into + other).T[1:]], axis=1)

    def values(self, store: Any) -> Array:
        """The least value, 0 where nothing survived."""
        return np.where(store[:, 2] > 0, 1.0 - store[:, 0], 0.0)

    def hits(self, store: Any) -> NDArray[np.int64]:
        """Samples per cell."""
        return np.asarray(store[:, 1], np.int64)


@hookimpl
def eiwa_voxels() -> list[Plugin]:
    """The backend."""
    return [Plugin("worst", WorstParameters, lambda parameters: Worst())]
