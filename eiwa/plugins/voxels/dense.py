"""Voxels in one array: the fastest store while the grid fits into memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.compiled import compiled
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, VoxelBackend

FIXED_POINT = 2.0**31
"""Values are summed in units of 2^-31, so that 2^31 samples of value 1 in one cell do not overflow."""


class DenseParameters(Parameters):
    """Every cell of the grid in one array."""

    aggregate: Literal["max", "mean"] = quantity(
        "max", description="What a cell keeps of the samples above the threshold: the largest, or their mean."
    )


@compiled
def deposit_max(store: Any, cells: Any, values: Any, count: Any) -> None:
    """Column 0: the largest value; column 1: hits."""
    for s in range(count):
        cell = cells[s]
        store[cell, 1] += 1.0
        store[cell, 0] = max(values[s], store[cell, 0])


@compiled
def deposit_mean(store: Any, cells: Any, values: Any, count: Any) -> None:
    """Column 0: sum of values in units of 2^-31; column 1: hits; column 2: survivors. Integers: order is immaterial."""
    for s in range(count):
        cell = cells[s]
        store[cell, 1] += 1
        if values[s] >= 0.0:
            store[cell, 0] += np.int64(values[s] * 2147483648.0 + 0.5)
            store[cell, 2] += 1


@compiled
def merge_max(into: Any, other: Any) -> None:
    """Larger value, sum of hits."""
    for cell in range(into.shape[0]):
        into[cell, 0] = max(into[cell, 0], other[cell, 0])
        into[cell, 1] += other[cell, 1]


@dataclass(frozen=True)
class DenseMax(VoxelBackend):
    """The largest value per cell."""

    deposit = staticmethod(deposit_max)
    bytes_per_cell = 16

    def open(self, cells: int) -> NDArray[np.float64]:
        """Zeros, shape (cells, 2)."""
        return np.zeros((cells, 2))

    def merge(self, into: Any, other: Any) -> None:
        """Larger value, sum of hits."""
        merge_max(into, other)

    def values(self, store: Any) -> Array:
        """The maxima."""
        return np.array(store[:, 0])

    def hits(self, store: Any) -> NDArray[np.int64]:
        """Samples per cell."""
        return np.asarray(store[:, 1], np.int64)


@dataclass(frozen=True)
class DenseMean(VoxelBackend):
    """The mean of the surviving samples per cell."""

    deposit = staticmethod(deposit_mean)
    bytes_per_cell = 24

    def open(self, cells: int) -> NDArray[np.int64]:
        """Zeros, shape (cells, 3)."""
        return np.zeros((cells, 3), np.int64)

    def merge(self, into: Any, other: Any) -> None:
        """Integer sums."""
        into += other

    def values(self, store: Any) -> Array:
        """Sum over survivors."""
        return np.asarray(store[:, 0] / (FIXED_POINT * np.maximum(store[:, 2], 1)))

    def hits(self, store: Any) -> NDArray[np.int64]:
        """Samples per cell."""
        return np.array(store[:, 1])


@hookimpl
def eiwa_voxels() -> list[Plugin]:
    """The dense backend."""
    backends = {"max": DenseMax, "mean": DenseMean}
    return [Plugin("dense", DenseParameters, lambda parameters: backends[parameters.aggregate]())]
