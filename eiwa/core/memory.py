"""What a grid takes in memory, told before it is taken."""

from __future__ import annotations

import os

from eiwa.core.errors import SpecError, finding
from eiwa.core.interfaces import VoxelBackend
from eiwa.core.kernel import thread_count


def memory(cells: int, backend: VoxelBackend) -> int:
    """Bytes for filling so many cells: both arms' stores, every thread's and one to merge (empty, if they grow), read-outs, E."""
    stores = 2 * backend.suited(2 * cells).bytes_per_cell * (thread_count() + 1)
    return cells * (stores + 6 * 8 + 2 * 8)


def require_memory(cells: int, backend: VoxelBackend, r: float) -> None:
    """Refuse a grid that this machine cannot hold, before anything is allocated.

    Raises
    ------
    SpecError
        Naming the memory, and the voxel size that would fit.
    """
    needed, present = memory(cells, backend), os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    allowed = 0.7 * present
    if needed > allowed or 2 * cells > 2**31 - 1:
        scale = max(needed / allowed, 2 * cells / (2**31 - 1)) ** (1 / 3)
        problem = f"{cells:.3g} cells need {needed / 2**30:.3g} GiB, this machine has {present / 2**30:.3g} GiB."
        remedy = f"Use at least {r * scale * 1.05:.2g} m."
        raise SpecError(finding("voxels.size", problem, value=r, remedy=remedy))
