"""Voxel stores: one array for all cells, or pages of cells that are opened when a sample falls into them.

Both keep the same numbers: maxima do not depend on the order of samples, and means are sums of integers in units of
2^-31, so that 2^31 samples of value 1 in one cell do not overflow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.compiled import compiled
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, VoxelBackend

FIXED_POINT = 2.0**31
PAGE = 256
"""Consecutive cells (along z) of a page."""
SMALL = 64 << 20
"""Bytes of a dense store up to which ``auto`` takes it."""

Aggregate = Literal["max", "mean"]
AGGREGATE: Any = quantity(
    "max", description="What a cell keeps of the samples above the threshold: the largest, or their mean."
)


class DenseParameters(Parameters):
    """Every cell of the grid in one array: the fastest while the grid fits into memory."""

    aggregate: Aggregate = AGGREGATE


class SparseParameters(Parameters):
    """Cells in pages of 256 that are opened on demand: memory grows with what is occupied."""

    aggregate: Aggregate = AGGREGATE


class AutoParameters(Parameters):
    """``dense`` while a store takes at most 64 MiB, else ``sparse``; the numbers are the same."""

    aggregate: Aggregate = AGGREGATE


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


@compiled
def merge_mean(into: Any, other: Any) -> None:
    """Integer sums."""
    for cell in range(into.shape[0]):
        for column in range(3):
            into[cell, column] += other[cell, column]


@compiled
def row_of(directory: Any, opened: Any, cell: Any) -> Any:
    """The row of a cell; its page is opened when it is new."""
    page = cell // 256
    if directory[page] < 0:
        directory[page] = opened[0]
        opened[0] += 1
    return np.int64(directory[page]) * 256 + cell % 256


@compiled
def deposit_max_paged(store: Any, cells: Any, values: Any, count: Any) -> None:
    """As :func:`deposit_max`, by way of the directory."""
    directory, opened, rows = store
    for s in range(count):
        row = row_of(directory, opened, cells[s])
        rows[row, 1] += 1.0
        rows[row, 0] = max(values[s], rows[row, 0])


@compiled
def deposit_mean_paged(store: Any, cells: Any, values: Any, count: Any) -> None:
    """As :func:`deposit_mean`, by way of the directory."""
    directory, opened, rows = store
    for s in range(count):
        row = row_of(directory, opened, cells[s])
        rows[row, 1] += 1
        if values[s] >= 0.0:
            rows[row, 0] += np.int64(values[s] * 2147483648.0 + 0.5)
            rows[row, 2] += 1


@dataclass(frozen=True)
class _Store(VoxelBackend):
    """What the stores share: rows of (largest value, hits), or of (sum, hits, survivors)."""

    aggregate: Aggregate

    def _rows(self, count: int) -> NDArray[Any]:
        return np.zeros((count, 2)) if self.aggregate == "max" else np.zeros((count, 3), np.int64)

    def _merge(self, into: NDArray[Any], other: NDArray[Any]) -> None:
        (merge_max if self.aggregate == "max" else merge_mean)(into, other)

    def _aggregate(self, rows: NDArray[Any]) -> Array:
        if self.aggregate == "max":
            return np.array(rows[:, 0])
        return np.asarray(rows[:, 0] / (FIXED_POINT * np.maximum(rows[:, 2], 1)))


@dataclass(frozen=True)
class Dense(_Store):
    """A row for every cell."""

    @property
    def deposit(self) -> Any:
        """One row a cell."""
        return deposit_max if self.aggregate == "max" else deposit_mean

    @property
    def bytes_per_cell(self) -> int:  # type: ignore[override]
        """Two or three numbers."""
        return 16 if self.aggregate == "max" else 24

    def open(self, cells: int) -> NDArray[Any]:
        """Zeros, shape (cells, 2 or 3)."""
        return self._rows(cells)

    def merge(self, into: Any, other: Any) -> Any:
        """Row by row."""
        self._merge(into, other)
        return into

    def values(self, store: Any) -> Array:
        """The aggregate of every row."""
        return self._aggregate(store)

    def hits(self, store: Any) -> NDArray[np.int64]:
        """Samples of every row."""
        return store[:, 1].astype(np.int64)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Sparse(_Store):
    """A directory (number of the page, or -1, for every 256 cells), the pages opened and all cells, the pages' rows."""

    bytes_per_cell = 1

    @property
    def deposit(self) -> Any:
        """By way of the directory."""
        return deposit_max_paged if self.aggregate == "max" else deposit_mean_paged

    def open(self, cells: int) -> Any:
        """No page is open."""
        return np.full(-(-cells // PAGE), -1, np.int32), np.array([0, cells]), self._rows(0)

    def ready(self, store: Any, deposits: int) -> Any:
        """Rows for every page that so many deposits may open; what is never touched takes no memory."""
        directory, opened, rows = store
        wanted = min(int(opened[0]) + deposits, len(directory))
        if len(rows) >= wanted * PAGE:
            return store
        used = int(opened[0]) * PAGE
        grown = self._rows(min(max(wanted, 2 * int(opened[0])), len(directory)) * PAGE)
        grown[:used] = rows[:used]
        return directory, opened, grown

    def merge(self, into: Any, other: Any) -> Any:
        """Page by page."""
        into = self.ready(into, int(other[1][0]))
        for number in np.flatnonzero(other[0] >= 0):
            row = row_of(into[0], into[1], number * PAGE)
            start = int(other[0][number]) * PAGE
            self._merge(into[2][row : row + PAGE], other[2][start : start + PAGE])
        return into

    def values(self, store: Any) -> Array:
        """The aggregate of every cell."""
        return self._spread(store, self._aggregate(store[2]))

    def hits(self, store: Any) -> NDArray[np.int64]:
        """Samples of every cell."""
        return self._spread(store, store[2][:, 1].astype(np.int64))

    def _spread(self, store: Any, kept: NDArray[Any]) -> NDArray[Any]:
        """What the pages keep, at their cells; zeros elsewhere."""
        directory, opened, _ = store
        spread = np.zeros((len(directory), PAGE), kept.dtype)
        known = directory >= 0
        spread[known] = kept.reshape(-1, PAGE)[directory[known]]
        return spread.ravel()[: opened[1]]


@dataclass(frozen=True)
class Auto(Dense):
    """Dense while it is small."""

    def suited(self, cells: int) -> VoxelBackend:
        """Dense or sparse for a grid of so many cells."""
        return (Dense if cells * self.bytes_per_cell <= SMALL else Sparse)(self.aggregate)


@hookimpl
def eiwa_voxels() -> list[Plugin]:
    """Dense, sparse, and the choice between them."""
    return [
        Plugin("auto", AutoParameters, lambda parameters: Auto(parameters.aggregate)),
        Plugin("dense", DenseParameters, lambda parameters: Dense(parameters.aggregate)),
        Plugin("sparse", SparseParameters, lambda parameters: Sparse(parameters.aggregate)),
    ]
