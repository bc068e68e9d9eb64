"""Ways from samples to deposits: sample, evaluate, locate, deposit.

When arm and indices are traced and the backend's ``deposit`` is compiled, the whole flow is one kernel; otherwise
the same steps run on arrays in larger blocks, in double precision with one kernel for all that comes after a plugin's
answers. All give each sample to the same cell with the same value.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from eiwa.core import finite, sampling, workspace
from eiwa.core.dexterity import Family
from eiwa.core.finite import all_finite
from eiwa.core.interfaces import TracedArm, VoxelBackend
from eiwa.core.kernel import scratch
from eiwa.core.sampling import ARRAY_BLOCK, BLOCK, FILLS, Stream
from eiwa.core.symbols import empty_rows, stride
from eiwa.core.workspace import Target, packed


class Flow(Protocol):
    """Samples ``first ... last - 1`` of a stream into a store that holds every member's cells one after another.

    Tips and raw indices are written into ``record`` (3 + m, N) where it has rows.
    """

    def __call__(self, first: int, last: int, record: NDArray[Any], store: Any) -> None:
        """Deposit them."""


def flow_of(family: Family, targets: Sequence[Target], backend: VoxelBackend, stream: Stream, dtype: Any) -> Flow:
    """The fastest flow that the parts allow."""
    compiled = isinstance(backend.deposit, Dispatcher)
    if compiled and family.traced:
        return fused_flow(family, targets, backend, stream, dtype)
    if compiled and np.dtype(dtype) == np.float64:
        return reading_flow(family, targets, backend, stream)
    return array_flow(family, targets, backend, stream, dtype)


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
    scales, thresholds, affines, layout, total = _where(family, targets, dtype)

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
    return (_IMPORTS + flow + _CREDIT).format(**names), [finite, sampling, workspace, sys.modules[deposit.__module__]]


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
from eiwa.core.finite import rows_finite
from eiwa.core.sampling import fill_points


@compiled
def flow(following, stop, sobol, key, table, last, inputs, checked, bits, p, w,
         scales, thresholds, affines, layout, total, cells, picks, values, store):
    fill_points(following, stop, sobol, key, table)
    for start in range(0, last, {block}):
        n = min({block}, last - start)
        fetch(inputs, start, n, w, 0, {stride})
        if not rows_finite(bits, {stride}, 1, checked, n):
            return start
        block(w, p)
        if not rows_finite(bits, {stride}, {results} + 3 + {members}, {results} + 3 + 2 * {members}, n):
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
