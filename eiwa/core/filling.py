"""From a stream of samples to filled voxels: sample, evaluate, locate, deposit.

When arm and indices are traced and the backend's ``deposit`` is compiled, the whole flow is one kernel; otherwise
the same steps run on arrays in larger blocks, in double precision with one kernel for all that comes after a plugin's
answers. All give each sample to the same cell with the same value.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from eiwa.core import reuse, sampling, workspace
from eiwa.core.dexterity import Family, all_finite
from eiwa.core.interfaces import Array, TracedArm, VoxelBackend
from eiwa.core.kernel import on_all_threads, scratch, thread_count
from eiwa.core.sampling import ARRAY_BLOCK, BLOCK, FILLS, Stream
from eiwa.core.symbols import empty_rows, stride
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
    elif isinstance(backend.deposit, Dispatcher) and np.dtype(amount.dtype) == np.float64:
        flow = reading_flow(family, targets, backend, stream)
    else:
        flow = array_flow(family, targets, backend, stream, amount.dtype)
    recorded = record if record is not None else np.empty((0, 0), amount.dtype)

    def deposit(store: Any, first: int) -> Any:
        last = min(first + CHUNK, amount.half if first < amount.half else amount.samples)
        most = (last - first) * len(targets) * len(family.members)
        store = backend.ready(backend.open(cells) if store is None else store, most)
        flow(first, last, recorded, store)
        return store

    early, late = range(0, max(1, amount.half), CHUNK), range(amount.half, amount.samples, CHUNK)
    earlier, later = iter(early), iter(late)
    halves, wholes = Shelf(backend, len(early)), Shelf(backend, len(late) + 1)
    left: dict[str, Any] = {}

    def work(_: int) -> None:
        store, taken = None, 0
        try:
            for first in earlier:
                store, taken = deposit(store, first), taken + 1
            store, taken = halves.add(store, taken), 0
            if store is not None:
                left["half"], taken = backend.values(store), 1
            for first in later:
                store, taken = deposit(store, first), taken + 1
            store = wholes.add(store, taken)
        except BaseException:
            for _rest in chain(earlier, later):  # nobody goes on
                pass
            raise
        if store is not None:
            left["whole"] = store

    on_all_threads(work, range(min(thread_count(), len(early))))
    if record is not None:
        reuse.samples.keep(key, record)
    values, hits = backend.values(left["whole"]), backend.hits(left["whole"])
    return _parted(targets, len(family.members), values, left["half"], hits)


class Shelf:
    """Where threads leave their stores, until one of them has merged all."""

    def __init__(self, backend: VoxelBackend, parts: int) -> None:
        self._backend, self._parts = backend, parts
        self._lock = threading.Lock()
        self._left: list[tuple[Any, int]] = []

    def add(self, store: Any, parts: int) -> Any:
        """Leave a store with so many of all parts; the store of all, for whom completes it, else None."""
        with self._lock:  # one at a time, so that only one store waits beside those that threads fill
            if parts and self._left:
                other, more = self._left.pop()
                store, parts = self._backend.merge(store, other), parts + more
            if parts == self._parts:
                return store
            if parts:
                self._left.append((store, parts))
        return None


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
    """The flow on blocks of arrays, step by step."""
    credit = _credit(family, targets, backend, dtype)

    def flow(first: int, last: int, record: NDArray[Any], store: Any) -> None:
        for start in range(first, last, ARRAY_BLOCK):
            stop = min(start + ARRAY_BLOCK, last)
            rows = family.rows(stream.points(start, stop - start, family.arm.dof), dtype)
            if record.size:
                record[:, start:stop] = rows
            credit(rows, store)

    return flow


def reading_flow(family: Family, targets: Sequence[Target], backend: VoxelBackend, stream: Stream) -> Flow:
    """The flow on blocks of arrays, one kernel from the plugins' answers on; double precision, nothing recorded.

    It also draws the next block's points: after every call of compiled code a thread may have to wait for another's Python.
    """
    dtype, dof = np.dtype(np.float64), family.arm.dof
    source, components = _source(_READ, family, backend, dtype, results=sum(family.widths))
    kernel, where, drawing = family.reader(source, components), _where(family, targets, dtype), stream.drawing(dof)
    # Of valid, tips, Jacobians ... the second and the third must be finite; one that the kernel does not read is looked at here.
    arrays_read = {k for k, _ in kernel.read}
    checked = sum(family.widths[: 3 if 2 in arrays_read else 2])
    unread = 2 not in arrays_read and not isinstance(family.arm, TracedArm)
    credit = _credit(family, targets, backend, dtype)

    def flow(first: int, last: int, record: NDArray[Any], store: Any) -> None:
        w, room = scratch(kernel.size, dtype), _room(dtype)
        reading = checked, w.view(np.int64), family.prepared, w
        u = stream.points(first, min(ARRAY_BLOCK, last - first), dof)
        for stop in range(first + ARRAY_BLOCK, last + ARRAY_BLOCK, ARRAY_BLOCK):
            n = max(0, min(ARRAY_BLOCK, last - stop))
            following = empty_rows(-(-n // BLOCK) * BLOCK, dof)
            answers = family.answers(u)
            kept, table = kernel.layouts(answers)
            fine = len(u) if not unread or all_finite(answers[2]) else 0
            done = kernel.module.flow(following, np.uint64(stop), *drawing, fine, table, *reading, *where, *room, store)
            del answers, kept  # before the next ones, which then come to lie in the same memory, warm in the caches
            if done < len(u):  # rows() says what is not finite there
                credit(family.rows(u)[:, done:], store)
            u = following[:, :n].T

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
    dtype, dof, fill_function = np.dtype(dtype), family.arm.dof, FILLS[stream.sequence].py_func
    source, components = _source(_FUSED, family, backend, dtype, results=dof, fill=fill_function.__name__)
    kernel = family.kernel(dtype, source, components)
    arguments = (np.uint64(stream.key), stream.table(dof), family.constants)
    where = _where(family, targets, dtype)

    def flow(first: int, last: int, record: NDArray[Any], store: Any) -> None:
        w, room = scratch(kernel.size, dtype), _room(dtype)
        kernel.module.flow(first, last, *arguments, w, *where, *room, store, record)

    return flow


def _where(family: Family, targets: Sequence[Target], dtype: Any) -> tuple[Any, ...]:
    """What a flow needs to know of members and targets."""
    total = np.int32(sum(t.grid.cells for t in targets))
    return family.scales(dtype), family.thresholds(dtype), *packed(targets, dtype), total


def _room(dtype: Any) -> tuple[NDArray[Any], ...]:
    """Cells, sample numbers and values of a block."""
    return np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32), np.empty(BLOCK, dtype)


def _source(
    flow: str, family: Family, backend: VoxelBackend, dtype: np.dtype[Any], results: int, **names: Any
) -> tuple[str, list[ModuleType]]:
    """The source of a flow whose block writes tips and raw indices from row ``results`` on, and what it depends on."""
    deposit = backend.deposit.py_func
    names |= {"backend": deposit.__module__, "deposit": deposit.__name__, "members": len(family.members)}
    names |= {"block": BLOCK, "stride": stride(BLOCK, dtype), "dof": family.arm.dof, "results": results}
    return (_IMPORTS + flow + _CREDIT).format(**names), [sampling, workspace, sys.modules[deposit.__module__]]


_IMPORTS = """
from {backend} import {deposit} as deposit
from eiwa.core.workspace import locate, normalise
"""

_FUSED = """
from eiwa.core.sampling import {fill} as fill


@compiled
def flow(first, last, key, table, p, w, scales, thresholds, affines, layout, total, cells, picks, values, store, record):
    for start in range(first, last, {block}):
        n = min({block}, last - start)
        fill(w, {stride}, {dof}, np.uint64(start), key, table)
        block(w, p)
        for row in range(record.shape[0]):
            for s in range(n):
                record[row, start + s] = w[({results} + row) * {stride} + s]
"""

_READ = """
from eiwa.core.sampling import fill_points


@compiled
def finite(bits, first, last, n):
    exponent, most = np.int64(0x7FF0000000000000), np.int64(0)
    for row in range(first, last):
        line = bits[row * {stride} :]
        for s in range(n):
            most = max(most, line[s] & exponent)
    if most < exponent:
        return True
    for row in range(first, last):
        line = bits[row * {stride} :]
        for s in range(n):
            if bits[s] > 0 and line[s] & exponent == exponent:  # the first row says which postures are valid
                return False
    return True


@compiled
def flow(following, stop, sobol, key, table, last, inputs, checked, bits, p, w,
         scales, thresholds, affines, layout, total, cells, picks, values, store):
    fill_points(following, stop, sobol, key, table)
    for start in range(0, last, {block}):
        n = min({block}, last - start)
        fetch(inputs, start, n, w, 0, {stride})
        if not finite(bits, 1, checked, n):
            return start
        block(w, p)
        if not finite(bits, {results} + 3 + {members}, {results} + 3 + 2 * {members}, n):
            return start
"""

_CREDIT = """
        x, y, z, raw = {results} * {stride}, ({results} + 1) * {stride}, ({results} + 2) * {stride}, ({results} + 3) * {stride}
        for t in range(layout.shape[0]):
            count = locate(w[x : x + {block}], w[y : y + {block}], w[z : z + {block}], w[raw : raw + {block}],
                           n, affines[t], layout[t], cells, picks)
            for member in range({members}):
                normalise(w[raw + member * {stride} :], picks, count, scales[member], thresholds[member], values)
                deposit(store, cells, values, count)
                if member + 1 < {members}:
                    for s in range(count):
                        cells[s] += total
    return last
"""
