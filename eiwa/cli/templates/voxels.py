"""The voxel backend mydevice: a cell keeps the share of its samples above the threshold. Put your own in its place."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.compiled import compiled
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, VoxelBackend


class MydeviceParameters(Parameters):
    """Every cell of the grid in one array of two counts."""

    aggregate: Literal["share"] = quantity("share", description="What a cell keeps: the share above the threshold.")


@compiled
def deposit_share(store: Any, cells: Any, values: Any, count: Any) -> None:
    """Column 0: samples above the threshold; column 1: all samples. Whole numbers, so order is immaterial."""
    for s in range(count):
        store[cells[s], 1] += 1
        if values[s] >= 0.0:  # -1 stands for a sample below the threshold
            store[cells[s], 0] += 1


@dataclass(frozen=True)
class Mydevice(VoxelBackend):
    """Survivors over hits."""

    deposit = staticmethod(deposit_share)
    bytes_per_cell = 16

    def open(self, cells: int) -> NDArray[np.int64]:
        """Zeros, shape (cells, 2)."""
        return np.zeros((cells, 2), np.int64)

    def merge(self, into: Any, other: Any) -> NDArray[np.int64]:
        """Sums of counts."""
        return np.asarray(into + other)

    def values(self, store: Any) -> Array:
        """The share per cell, 0 where nothing survived."""
        return np.asarray(store[:, 0] / np.maximum(store[:, 1], 1))

    def hits(self, store: Any) -> NDArray[np.int64]:
        """Samples per cell."""
        return np.array(store[:, 1])


@hookimpl
def eiwa_voxels() -> list[Plugin]:
    """The name that a study writes in kind, the table's model, and what builds the backend from it."""
    return [Plugin("mydevice", MydeviceParameters, lambda parameters: Mydevice())]
