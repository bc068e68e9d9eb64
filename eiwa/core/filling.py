"""Voxels filled from a stream of samples, shared out among threads."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core import reuse
from eiwa.core.dexterity import Family
from eiwa.core.flows import flow_of, replay_flow
from eiwa.core.interfaces import Array, VoxelBackend
from eiwa.core.kernel import on_all_threads, thread_count
from eiwa.core.sampling import BLOCK, Stream
from eiwa.core.workspace import Target

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
    else:
        flow = flow_of(family, targets, backend, stream, amount.dtype)
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
