"""Grids of voxels, and the way from a tip in a base frame to a cell of a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.compiled import LANES, compiled, compress, floor
from eiwa.core.transforms import Transform


@dataclass(frozen=True)
class Grid:
    """Cubic cells of size r [m] whose faces lie at integer multiples of r.

    ``origin`` is the index of the first cell along x, y, z: cell (0, 0, 0) spans origin * r to (origin + 1) * r.
    """

    r: float
    origin: tuple[int, int, int]
    shape: tuple[int, int, int]

    @classmethod
    def covering(cls, box: NDArray[np.float64], r: float) -> Grid:
        """The smallest grid that holds a box [[low], [high]], shape (2, 3) [m]."""
        # A bound that is a face up to rounding does not open another layer of cells.
        low = np.floor(box[0] / r + 1e-9).astype(int)
        high = np.ceil(box[1] / r - 1e-9).astype(int)
        x, y, z = (int(v) for v in low)
        nx, ny, nz = (max(1, int(v)) for v in high - low)
        return cls(r, (x, y, z), (nx, ny, nz))

    @property
    def cells(self) -> int:
        """Number of cells."""
        nx, ny, nz = self.shape
        return nx * ny * nz

    def centres(self, axis: int) -> NDArray[np.float64]:
        """Cell centres along one axis [m]."""
        return np.asarray((self.origin[axis] + np.arange(self.shape[axis]) + 0.5) * self.r)

    def faces(self, axis: int) -> NDArray[np.float64]:
        """Cell faces along one axis, one more than cells [m]."""
        return np.asarray((self.origin[axis] + np.arange(self.shape[axis] + 1)) * self.r)

    @property
    def halved(self) -> Grid:
        """The same box in cells of half the edge."""
        (x, y, z), (nx, ny, nz) = self.origin, self.shape
        return Grid(self.r / 2, (2 * x, 2 * y, 2 * z), (2 * nx, 2 * ny, 2 * nz))

    @property
    def symmetric(self) -> bool:
        """Whether mirroring in x maps the grid onto itself."""
        return 2 * self.origin[0] + self.shape[0] == 0

    def mirrored(self, values: NDArray[Any]) -> NDArray[Any]:
        """The mirror image in x of values on this grid; cells whose image lies outside are empty."""
        image = np.zeros_like(values)
        source = -1 - (self.origin[0] + np.arange(self.shape[0])) - self.origin[0]
        inside = (source >= 0) & (source < self.shape[0])
        image[inside] = values[source[inside]]
        return image

    def taking(self, values: NDArray[Any], home: Grid) -> NDArray[Any]:
        """Values of another grid of the same r on this one; cells that lie outside that grid are empty."""
        result = np.zeros(self.shape, values.dtype)
        starts = [b - a for a, b in zip(self.origin, home.origin, strict=True)]
        mine = tuple(slice(max(0, s), max(0, s + n)) for s, n in zip(starts, values.shape, strict=True))
        theirs = tuple(slice(max(0, -s), max(0, n - s)) for s, n in zip(starts, self.shape, strict=True))
        result[mine] = values[theirs]
        return result


def pooled(occupied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """On a :attr:`Grid.halved`, which cells of the whole edge have an occupied one of their eight."""
    nx, ny, nz = (n // 2 for n in occupied.shape)
    return np.asarray(occupied.reshape(nx, 2, ny, 2, nz, 2).any(axis=(1, 3, 5)))


@dataclass(frozen=True)
class Target:
    """A grid in some frame, and the pose of the arm's base in that frame."""

    grid: Grid
    T_grid_base: Transform

    def to_cells(self) -> NDArray[np.float64]:
        """The affine map (3, 4) from a tip in the base frame to cell coordinates."""
        affine = self.T_grid_base[:3, :] / self.grid.r
        affine[:, 3] -= self.grid.origin
        return affine


def packed(targets: Sequence[Target], dtype: Any) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Affine maps (t, 12) and, per target, shape and number of the first cell in the common store (t, 4)."""
    affines = np.array([t.to_cells().ravel() for t in targets], dtype)
    cells = [t.grid.cells for t in targets]
    offsets = np.concatenate([[0], np.cumsum(cells)])[:-1]
    layout = np.array([[*t.grid.shape, o] for t, o in zip(targets, offsets, strict=True)], np.int64)
    return affines, layout


@compiled
def locate(x: Any, y: Any, z: Any, raw: Any, n: Any, affine: Any, layout: Any, cells: Any, picks: Any) -> Any:
    """Which of n tips fall into one target, and into which of its cells.

    Samples without a solution (``raw`` < 0) are dropped. Returns how many entries of ``cells`` (with the target's
    offset) and ``picks`` (sample numbers) were written; both have at least n.
    """
    nx, ny, nz, none = np.int32(layout[0]), np.int32(layout[1]), np.int32(layout[2]), np.int32(-1)
    a0, a1, a2, a3 = affine[0], affine[1], affine[2], affine[3]
    b0, b1, b2, b3 = affine[4], affine[5], affine[6], affine[7]
    c0, c1, c2, c3 = affine[8], affine[9], affine[10], affine[11]
    for s in range(n):
        i = np.int32(floor(a0 * x[s] + a1 * y[s] + a2 * z[s] + a3))
        j = np.int32(floor(b0 * x[s] + b1 * y[s] + b2 * z[s] + b3))
        k = np.int32(floor(c0 * x[s] + c1 * y[s] + c2 * z[s] + c3))
        # Unsigned, a negative number is larger than any shape.
        low = (np.uint32(i) < np.uint32(nx)) & (np.uint32(j) < np.uint32(ny)) & (np.uint32(k) < np.uint32(nz))
        cell = (i * ny + j) * nz + k
        cells[s] = cell if low & (raw[s] >= 0) else none
    count, whole = 0, n - n % LANES
    for s in range(0, whole, LANES):
        count = compress(cells, picks, s, count, layout[3])
    for s in range(whole, n):
        if cells[s] >= 0:
            cells[count] = cells[s] + layout[3]
            picks[count] = s
            count += 1
    return count


@compiled
def normalise(raw: Any, picks: Any, count: Any, scale: Any, threshold: Any, values: Any) -> None:
    """Normalised values of the picked samples, capped at 1; -1 below the threshold."""
    for s in range(count):
        v = min(raw[picks[s]] * scale, 1.0)
        values[s] = v if v >= threshold else -1.0
