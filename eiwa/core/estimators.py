"""From an arm and an index to filled voxels: sample, evaluate, locate, deposit.

When arm and index are traced and the backend's ``deposit`` is compiled, the whole flow is one kernel; otherwise
the same steps run on arrays in larger blocks. Both give each sample to the same cell with the same value.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from eiwa.core import sampling, workspace
from eiwa.core.errors import PluginError, SingularArm
from eiwa.core.interfaces import (
    NOTHING,
    Arm,
    Array,
    DexterityIndex,
    Postures,
    TracedArm,
    TracedIndex,
    VoxelBackend,
    where_valid,
)
from eiwa.core.kernel import STRIDE, Map, on_all_threads, scratch, thread_count
from eiwa.core.optimum import maximum, pilot_points
from eiwa.core.sampling import BLOCK, FILLS, Stream
from eiwa.core.symbols import Column
from eiwa.core.workspace import Target, packed

CHUNK = 1 << 15
ARRAY_BLOCK = 1 << 13


@dataclass(frozen=True)
class Sampling:
    """How much is sampled: N per replicate, and with which precision."""

    samples: int
    dtype: Any = np.float64

    @property
    def half(self) -> int:
        """N/2, rounded up to whole blocks."""
        return min(self.samples, -(-self.samples // (2 * BLOCK)) * BLOCK)


@dataclass(frozen=True)
class Filled:
    """What the samples left in one target: the aggregate at N and at N/2, and hits, on the target's grid."""

    values: Array
    half: Array
    hits: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Dexterity:
    """An index prepared for one arm: ``values / normaliser`` lies in [0, 1]."""

    arm: Arm
    index: DexterityIndex
    prepared: NDArray[np.float64]
    normaliser: float
    threshold: float

    def raw(self, u: Array) -> tuple[Array, Array]:
        """Tips (n, 3) and the index before normalisation (n,), -1 where there is no solution."""
        return evaluate(self.arm, self.index, self.prepared, u)

    @cached_property
    def reach(self) -> float:
        """Largest distance of the tip from the base origin [m]."""

        def distance(u: Array) -> Array:
            tips, value = self.raw(u)
            return np.where(value >= 0, np.linalg.norm(tips, axis=1), -1.0)

        return maximum(distance, pilot_points(self.arm.dof))


def prepare(arm: Arm, index: DexterityIndex, normaliser: float | None, threshold: float) -> Dexterity:
    """Learn from the pilot what the index needs, and its maximum where no normaliser is given.

    Raises
    ------
    SingularArm
        The index is (numerically) zero at every posture of the pilot.
    PluginError
        The arm or the index answers with values that are not finite.
    """
    u = pilot_points(arm.dof)
    needs_postures = type(index).prepare is not DexterityIndex.prepare
    prepared = index.prepare(arm, arm.postures(u)) if needs_postures else NOTHING
    tips, raw = evaluate(arm, index, prepared, u)
    if not (np.isfinite(tips).all() and np.isfinite(raw).all()):
        raise PluginError(f"{type(arm).__name__} with {type(index).__name__}: values that are not finite")
    reach = float(np.abs(tips).max())
    if raw.max() <= 1e-12 * max(reach, 1e-3) ** 3:
        raise SingularArm(arm.when_singular() or "the dexterity index is zero at every posture")
    if normaliser is None:
        normaliser = maximum(lambda v: evaluate(arm, index, prepared, v)[1], u, raw)
    return Dexterity(arm, index, prepared, normaliser, threshold)


def evaluate(arm: Arm, index: DexterityIndex, prepared: NDArray[np.float64], u: Array) -> tuple[Array, Array]:
    """Tips (n, 3) and raw index (n,) at points of the unit cube; -1 where there is no solution."""
    if isinstance(arm, TracedArm) and isinstance(index, TracedIndex):
        out = _fused_map(arm, index, len(prepared))(u, np.concatenate([arm.constants, prepared]))
        return out[:, :3], out[:, 3]
    postures = arm.postures(u)
    return postures.tips, _raw(index, postures, prepared)


def _raw(index: DexterityIndex, postures: Postures, prepared: NDArray[np.float64]) -> Array:
    return np.where(postures.valid, np.maximum(index.values(postures, prepared), 0.0), -1.0)


def fill(
    dexterity: Dexterity, targets: Sequence[Target], backend: VoxelBackend, stream: Stream, amount: Sampling
) -> list[Filled]:
    """Deposit the samples of one stream into every target.

    Chunks of the stream are shared out among the threads, each with a store of its own; maxima and integer sums make
    the result the same for any number of threads.
    """
    flow = _Flow.choose(dexterity, backend, stream, amount)
    affines, layout = packed(targets, amount.dtype)
    cells = sum(t.grid.cells for t in targets)
    threads = min(thread_count(), max(1, amount.half // CHUNK))
    stores = [backend.open(cells) for _ in range(threads)]

    def deposit(first: int, last: int) -> None:
        starts = list(range(first, last, CHUNK))
        shares = [starts[t::threads] for t in range(threads)]

        def work(share: list[int], store: Any) -> None:
            for start in share:
                flow.run(start, min(start + CHUNK, last), affines, layout, store)

        on_all_threads(work, shares, stores)

    def read() -> Array:
        merged = stores[0]
        for other in stores[1:]:
            backend.merge(merged, other)
        stores[1:] = [backend.open(cells) for _ in stores[1:]]
        return backend.values(merged)

    deposit(0, amount.half)
    half = read()
    deposit(amount.half, amount.samples)
    values, hits = read(), backend.hits(stores[0])
    filled = []
    for target, offset in zip(targets, layout[:, 3], strict=True):
        part, shape = slice(offset, offset + target.grid.cells), target.grid.shape
        filled.append(Filled(values[part].reshape(shape), half[part].reshape(shape), hits[part].reshape(shape)))
    return filled


@dataclass(frozen=True, eq=False)
class _Flow:
    """Sampling to depositing, for one dexterity, backend and stream."""

    dexterity: Dexterity
    backend: VoxelBackend
    stream: Stream
    amount: Sampling

    @staticmethod
    def choose(dexterity: Dexterity, backend: VoxelBackend, stream: Stream, amount: Sampling) -> _Flow:
        traced = isinstance(dexterity.arm, TracedArm) and isinstance(dexterity.index, TracedIndex)
        fused = traced and isinstance(backend.deposit, Dispatcher)
        return (_FusedFlow if fused else _ArrayFlow)(dexterity, backend, stream, amount)

    @cached_property
    def table(self) -> NDArray[np.uint64]:
        return self.stream.table(self.dexterity.arm.dof)

    def run(self, first: int, last: int, affines: Any, layout: Any, store: Any) -> None:
        raise AssertionError("abstract")


class _ArrayFlow(_Flow):
    """Blocks of arrays, for plugins in plain NumPy."""

    def run(self, first: int, last: int, affines: Any, layout: Any, store: Any) -> None:
        d = self.dexterity
        for start in range(first, last, ARRAY_BLOCK):
            n = min(ARRAY_BLOCK, last - start)
            tips, raw = d.raw(self.stream.points(start, n, d.arm.dof))
            x, y, z = (np.ascontiguousarray(tips[:, i], self.amount.dtype) for i in range(3))
            raw = np.ascontiguousarray(raw, self.amount.dtype)
            cells, values = np.empty(n, np.int32), np.empty(n, self.amount.dtype)
            for affine, grid in zip(affines, layout, strict=True):
                count = workspace.locate(x, y, z, raw, n, 1 / d.normaliser, d.threshold, affine, grid, cells, values)
                self.backend.deposit(store, cells, values, count)


class _FusedFlow(_Flow):
    """One compiled kernel."""

    @cached_property
    def map(self) -> Map:
        d = self.dexterity
        assert isinstance(d.arm, TracedArm) and isinstance(d.index, TracedIndex)
        return _fused_map(
            d.arm, d.index, len(d.prepared), self.amount.dtype, self.stream.sequence, self.backend.deposit
        )

    @cached_property
    def constants(self) -> NDArray[np.float64]:
        assert isinstance(self.dexterity.arm, TracedArm)
        return np.concatenate([self.dexterity.arm.constants, self.dexterity.prepared])

    def run(self, first: int, last: int, affines: Any, layout: Any, store: Any) -> None:
        dtype = np.dtype(self.amount.dtype)
        kernel = self.map
        number = dtype.type
        kernel.module.flow(
            first,
            last,
            np.uint64(self.stream.key),
            self.table,
            self.constants,
            scratch(kernel.rows, dtype),
            number(1 / self.dexterity.normaliser),
            number(self.dexterity.threshold),
            affines,
            layout,
            np.empty(BLOCK, np.int32),
            np.empty(BLOCK, dtype),
            store,
        )


_FLOW = """
from {backend_module} import {deposit} as deposit
from eiwa.core.sampling import {fill} as fill
from eiwa.core.workspace import locate


@compiled
def flow(first, last, key, table, p, w, scale, threshold, affines, layout, cells, values, store):
    for start in range(first, last, {block}):
        n = min({block}, last - start)
        fill(w, {stride}, {dof}, np.uint64(start), key, table)
        block(w, p)
        for t in range(layout.shape[0]):
            count = locate(
                w[{x} : {x} + {block}], w[{y} : {y} + {block}], w[{z} : {z} + {block}], w[{raw} : {raw} + {block}],
                n, scale, threshold, affines[t], layout[t], cells, values)
            deposit(store, cells, values, count)
"""

_fused: dict[Any, Map] = {}


def _fused_map(
    arm: TracedArm,
    index: TracedIndex,
    prepared: int,
    dtype: Any = np.float64,
    sequence: sampling.Sequence | None = None,
    deposit: Any = None,
) -> Map:
    """The kernel of an arm and an index: an array map, or with a sequence and a ``deposit`` the whole flow."""
    dtype = np.dtype(dtype)
    structures = (type(arm), arm.structure, type(index), index.structure)
    key = (*structures, arm.dof, len(arm.constants), prepared, dtype, sequence, deposit)
    if None not in structures and key in _fused:
        return _fused[key]

    def function(u: Sequence[Column], p: Sequence[Column]) -> list[Column]:
        columns = arm.columns(u, p[: len(arm.constants)])
        value = index.columns(columns, p[len(arm.constants) :])
        return [*columns.tip, where_valid(columns.valid, value, -1.0)]

    text, components = _flow_source(arm.dof, dtype, sequence, deposit) if sequence else ("", ())
    kernel = Map(function, arm.dof, len(arm.constants) + prepared, dtype, text, components)
    _fused[key] = kernel
    return kernel


def _flow_source(
    dof: int, dtype: np.dtype[Any], sequence: sampling.Sequence, deposit: Any
) -> tuple[str, tuple[ModuleType, ...]]:
    stride = STRIDE[dtype]
    rows = {name: (dof + k) * stride for k, name in enumerate(("x", "y", "z", "raw"))}
    text = _FLOW.format(
        backend_module=deposit.py_func.__module__,
        deposit=deposit.py_func.__name__,
        fill=FILLS[sequence].py_func.__name__,
        block=BLOCK,
        stride=stride,
        dof=dof,
        **rows,
    )
    return text, (sampling, workspace, sys.modules[deposit.py_func.__module__])
