"""From a stream of samples to filled voxels: sample, evaluate, locate, deposit.

When arm and indices are traced and the backend's ``deposit`` is compiled, the whole flow is one kernel; otherwise
the same steps run on arrays in larger blocks. Both give each sample to the same cell with the same value.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from eiwa.core import reuse, sampling, workspace
from eiwa.core.dexterity import Family
from eiwa.core.interfaces import Array, VoxelBackend
from eiwa.core.kernel import on_all_threads, scratch, thread_count
from eiwa.core.sampling import ARRAY_BLOCK, BLOCK, FILLS, Stream
from eiwa.core.symbols import stride
from eiwa.core.workspace import Target, packed

CHUNK = 1 << 15


@dataclass(frozen=True)
class Sampling:
    """How much is sampled: N per replicate (for elites the most), with which precision, to which tolerance."""

    samples: int
    dtype: Any = np.float64
    tolerance: float = 0.01

    @property
    def half(self) -> int:
        """N/2, rounded up to whole blocks."""
        return min(self.samples, -(-self.samples // (2 * BLOCK)) * BLOCK)


@dataclass(frozen=True, eq=False)
class Filled:
    """What the samples left in one target, on the target's grid.

    ``values``: the aggregate at N; ``half``: at N/2; ``hits``: samples per cell before any threshold. An estimator
    that does not sample evenly has neither of the last two.
    """

    values: Array
    half: Array | None
    hits: NDArray[np.int64] | None


class Flow(Protocol):
    """Samples ``first ... last - 1`` of a stream into a store that holds every member's cells one after another.

    Tips and raw indices are written into ``record`` (3 + m, N) where it has rows.
    """

    def __call__(self, first: int, last: int, record: NDArray[Any], store: Any) -> None:
        """Deposit them."""


def fill(
    family: Family, targets: Sequence[Target], backend: VoxelBackend, stream: Stream, amount: Sampling
) -> list[list[Filled]]:
    """Deposit the samples of one stream into every target, for every member of the family.

    Chunks of the stream are shared out among the threads, each with a store of its own; maxima and integer sums make
    the result the same for any number of threads. Samples asked for again are not computed again
    (:mod:`eiwa.core.reuse`).

    Returns
    -------
    For each member, what is left in each target.
    """
    key = None if family.identity is None else (family.identity, stream, amount.samples, np.dtype(amount.dtype))
    cells = sum(t.grid.cells for t in targets) * len(family.members)
    backend = backend.suited(cells)
    kept = reuse.samples.find(key) if key else None
    record = (
        reuse.samples.room(key, (3 + len(family.members), amount.samples), amount.dtype)
        if key and kept is None
        else None
    )
    if kept is not None:
        flow = replay_flow(kept, family, targets, backend, amount.dtype)
    elif family.traced and isinstance(backend.deposit, Dispatcher):
        flow = fused_flow(family, targets, backend, stream, amount.dtype)
    else:
        flow = array_flow(family, targets, backend, stream, amount.dtype)
    recorded = record if record is not None else np.empty((0, 0), amount.dtype)
    threads = min(thread_count(), max(1, amount.half // CHUNK))
    stores = [backend.open(cells) for _ in range(threads)]

    def deposit(first: int, last: int) -> None:
        starts = iter(range(first, last, CHUNK))

        def work(number: int) -> None:
            for start in starts:
                stop = min(start + CHUNK, last)
                stores[number] = backend.ready(stores[number], (stop - start) * len(targets) * len(family.members))
                flow(start, stop, recorded, stores[number])

        on_all_threads(work, range(threads))

    def read() -> Array:
        while len(stores) > 1:
            stores[0] = backend.merge(stores[0], stores.pop())
        return backend.values(stores[0])

    deposit(0, amount.half)
    half = read()
    stores.extend(backend.open(cells) for _ in range(threads - 1))
    deposit(amount.half, amount.samples)
    if record is not None:
        reuse.samples.keep(key, record)
    return _parted(targets, len(family.members), read(), half, backend.hits(stores[0]))


def _parted(
    targets: Sequence[Target], members: int, values: Array, half: Array, hits: NDArray[np.int64]
) -> list[list[Filled]]:
    filled: list[list[Filled]] = []
    start = 0
    for _ in range(members):
        filled.append([])
        for target in targets:
            part, shape = slice(start, start + target.grid.cells), target.grid.shape
            filled[-1].append(Filled(values[part].reshape(shape), half[part].reshape(shape), hits[part].reshape(shape)))
            start = part.stop
    return filled


def array_flow(family: Family, targets: Sequence[Target], backend: VoxelBackend, stream: Stream, dtype: Any) -> Flow:
    """The flow on blocks of arrays, for plugins in plain NumPy."""
    credit = _credit(family, targets, backend, dtype)

    def flow(first: int, last: int, record: NDArray[Any], store: Any) -> None:
        for start in range(first, last, ARRAY_BLOCK):
            stop = min(start + ARRAY_BLOCK, last)
            rows = family.rows(stream.points(start, stop - start, family.arm.dof), dtype)
            if record.size:
                record[:, start:stop] = rows
            credit(rows, store)

    return flow


def replay_flow(
    kept: NDArray[Any], family: Family, targets: Sequence[Target], backend: VoxelBackend, dtype: Any
) -> Flow:
    """The flow from kept samples."""
    credit = _credit(family, targets, backend, dtype)

    def flow(first: int, last: int, record: NDArray[Any], store: Any) -> None:
        for start in range(first, last, ARRAY_BLOCK):
            credit(kept[:, start : min(start + ARRAY_BLOCK, last)], store)

    return flow


def _credit(
    family: Family, targets: Sequence[Target], backend: VoxelBackend, dtype: Any
) -> Callable[[NDArray[Any], Any], None]:
    """A function that locates and deposits rows x, y, z, raw indices."""
    affines, layout = packed(targets, dtype)
    total = np.int32(sum(t.grid.cells for t in targets))
    scales, thresholds = family.scales(dtype), family.thresholds(dtype)

    def credit(rows: NDArray[Any], store: Any) -> None:
        n = rows.shape[1]
        cells, picks, values = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, dtype)
        x, y, z, *raws = rows
        for affine, shape in zip(affines, layout, strict=True):
            count = workspace.locate(x, y, z, raws[0], n, affine, shape, cells, picks)
            for raw, scale, threshold in zip(raws, scales, thresholds, strict=True):
                workspace.normalise(raw, picks, count, scale, threshold, values)
                backend.deposit(store, cells, values, count)
                cells += total

    return credit


def fused_flow(family: Family, targets: Sequence[Target], backend: VoxelBackend, stream: Stream, dtype: Any) -> Flow:
    """The flow as one compiled kernel."""
    dtype = np.dtype(dtype)
    dof, deposit, fill_function = family.arm.dof, backend.deposit.py_func, FILLS[stream.sequence].py_func
    source = _FLOW.format(
        backend=deposit.__module__,
        deposit=deposit.__name__,
        fill=fill_function.__name__,
        block=BLOCK,
        stride=stride(BLOCK, dtype),
        dof=dof,
        members=len(family.members),
    )
    kernel = family.kernel(dtype, source, (sampling, workspace, sys.modules[deposit.__module__]))
    affines, layout = packed(targets, dtype)
    arguments = (np.uint64(stream.key), stream.table(dof), family.constants)
    scales, thresholds = family.scales(dtype), family.thresholds(dtype)
    total = np.int32(sum(t.grid.cells for t in targets))

    def flow(first: int, last: int, record: NDArray[Any], store: Any) -> None:
        w, cells, picks = scratch(kernel.size, dtype), np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32)
        values = np.empty(BLOCK, dtype)
        kernel.module.flow(
            first, last, *arguments, w, scales, thresholds, affines, layout, total, cells, picks, values, record, store
        )

    return flow


_FLOW = """
from {backend} import {deposit} as deposit
from eiwa.core.sampling import {fill} as fill
from eiwa.core.workspace import locate, normalise


@compiled
def flow(first, last, key, table, p, w, scales, thresholds, affines, layout, total, cells, picks, values, record, store):
    x, y, z = {dof} * {stride}, ({dof} + 1) * {stride}, ({dof} + 2) * {stride}
    for start in range(first, last, {block}):
        n = min({block}, last - start)
        fill(w, {stride}, {dof}, np.uint64(start), key, table)
        block(w, p)
        for row in range(record.shape[0]):
            for s in range(n):
                record[row, start + s] = w[({dof} + row) * {stride} + s]
        for t in range(layout.shape[0]):
            raw = ({dof} + 3) * {stride}
            count = locate(w[x : x + {block}], w[y : y + {block}], w[z : z + {block}], w[raw : raw + {block}],
                           n, affines[t], layout[t], cells, picks)
            for member in range({members}):
                normalise(w[raw : raw + {block}], picks, count, scales[member], thresholds[member], values)
                deposit(store, cells, values, count)
                if member + 1 < {members}:
                    for s in range(count):
                        cells[s] += total
                raw += {stride}
"""
