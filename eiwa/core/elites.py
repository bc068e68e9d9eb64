"""Elite refinement: the maximum per voxel by searching instead of waiting.

Every cell that matters keeps the point of the unit cube that gave its best value so far. Generations of candidates are
mutated from these elites, and each candidate is credited to whichever cell it falls into, for both arms and for every
dexterity at once. Every value is attained by a stored point, so the result is a lower bound of the true maximum that
rises with the evaluations; what it may still gain is estimated from what the last doubling gained.

Candidates of a generation depend on the frozen elites and on counter-based random numbers alone, and are merged in the
order of their numbers with a strict comparison: the same bits for any number of threads. (Method: MAP-Elites, Mouret and
Clune 2015, with synchronous generations.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core import sampling, workspace
from eiwa.core.compiled import compiled, float64_from_bits, select
from eiwa.core.dexterity import Family
from eiwa.core.filling import Filled, Sampling
from eiwa.core.interfaces import Array
from eiwa.core.kernel import STRIDE, on_all_threads, scratch
from eiwa.core.sampling import BLOCK, Stream
from eiwa.core.workspace import Target, packed

FIRST = 1 << 17
"""Evaluations of the plain first pass."""
GENERATION = 1 << 13
SHARE = 1 << 11
"""Candidates that one thread takes at a time."""
COARSEST, SCALES = 4, 8
"""Mutations have amplitudes 2^-4 ... 2^-11 of a joint's range."""
GROWTH = 2.0**0.25
"""Checkpoints stand where the evaluations have grown by this factor; four of them make a doubling."""
CAUTION = 2.0
"""What remains is estimated as this multiple of the last doubling's gain; benchmarks/refinement.py shows the evidence."""
LEAST = 1e-3
"""The tolerance is relative to F, but to no less than this."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """How far the elites of one member have come.

    ``history``: (evaluations, F) at the checkpoints; ``remaining``: how much F may still rise; ``elites``: per target
    and cell the point of the unit cube that attains the cell's value, NaN where there is none, shape
    (targets, cells with weight, dof); ``cells``: their numbers on the grid.
    """

    history: Sequence[tuple[int, float]]
    remaining: float
    elites: Array
    cells: NDArray[np.int64]

    def at_half(self) -> float:
        """F when half of the evaluations had been spent, or the nearest checkpoint before."""
        last = self.history[-1][0]
        return [F for n, F in self.history if n <= max(last / 2 * 1.001, self.history[0][0])][-1]


def refine(
    family: Family, targets: Sequence[Target], weights: Array, stream: Stream, amount: Sampling
) -> list[tuple[list[Filled], Refinement]]:
    """Search the largest value of every weighted cell, for every target and member.

    Parameters
    ----------
    family
        Dexterities that share one arm.
    targets
        The arms' poses on one and the same grid.
    weights
        E_left + E_right on that grid: only cells with weight > 0 keep an elite, and progress is measured in
        F = mean over targets of sum(weights * values) / sum(weights).
    stream
        Its key starts the random numbers.
    amount
        ``samples`` is the largest number of evaluations; the search ends before when for every member what remains
        is under ``tolerance`` relative to max(F, 1e-3).
    """
    archives = Archives.empty(family, targets, weights)
    explore = _explorer(family, targets, archives, stream, amount.dtype)
    spent, checkpoint = 0, 0.0
    histories: list[list[tuple[int, float]]] = [[] for _ in family.members]
    while spent < amount.samples:
        size = min(FIRST if spent == 0 else GENERATION, amount.samples - spent)
        explore(spent, size)
        spent += size
        if spent >= checkpoint or spent >= amount.samples:
            for history, F in zip(histories, archives.F(family), strict=True):
                history.append((spent, F))
            checkpoint = max(spent, checkpoint) * GROWTH
            if all(remaining(h) <= amount.tolerance * max(h[-1][1], LEAST) for h in histories):
                break
    return [
        (archives.filled(family, m), Refinement(h, remaining(h), archives.points(m), archives.cells))
        for m, h in enumerate(histories)
    ]


def remaining(history: Sequence[tuple[int, float]]) -> float:
    """What F may still gain: a multiple of the last doubling's gain, all of 1 - F before the first doubling."""
    last, F = history[-1]
    before = [value for n, value in history if n * 1.999 <= last]
    return CAUTION * (F - before[-1]) if before else 1.0 - F


@dataclass(frozen=True, eq=False)
class Archives:
    """Best values and their points: ``best`` (targets, members, slots), ``points`` (targets, members, slots, dof)."""

    shape: tuple[int, int, int]
    cells: NDArray[np.int64]
    slots: NDArray[np.int32]
    weights: Array
    best: Array
    elites: Array

    @classmethod
    def empty(cls, family: Family, targets: Sequence[Target], weights: Array) -> Archives:
        """No elites yet; one slot per cell with weight."""
        flat = weights.ravel()
        cells = np.flatnonzero(flat > 0)
        slots = np.full(flat.size, -1, np.int32)
        slots[cells] = np.arange(cells.size, dtype=np.int32)
        size = (len(targets), len(family.members), cells.size)
        return cls(
            targets[0].grid.shape,
            cells,
            slots,
            flat[cells],
            np.full(size, -1.0),
            np.full((*size, family.arm.dof), np.nan),
        )

    def values(self, family: Family, member: int) -> Array:
        """Values that count, (targets, slots): capped at 1, 0 below the threshold."""
        best = self.best[:, member]
        return np.where(best >= family.members[member].threshold, np.clip(best, 0.0, 1.0), 0.0)

    def F(self, family: Family) -> list[float]:
        """Weighted mean over cells, averaged over targets, of every member."""
        total = max(float(self.weights.sum()), 1e-300)
        members = range(len(family.members))
        return [float((self.values(family, m).mean(axis=0) * self.weights).sum() / total) for m in members]

    def filled(self, family: Family, member: int) -> list[Filled]:
        """The targets' grids."""
        result = []
        for values in self.values(family, member):
            grid = np.zeros(self.slots.size)
            grid[self.cells] = values
            result.append(Filled(grid.reshape(self.shape), None, None))
        return result

    def points(self, member: int) -> Array:
        """The elites of one member, (targets, slots, dof)."""
        return self.elites[:, member]


def _explorer(
    family: Family, targets: Sequence[Target], archives: Archives, stream: Stream, dtype: Any
) -> Callable[[int, int], None]:
    """A function that evaluates ``size`` candidates from number ``first`` on, and merges them."""
    dtype, dof, members = np.dtype(dtype), family.arm.dof, len(family.members)
    affines, layout = packed(targets, dtype)
    layout[:, 3] = 0
    scales = family.scales(dtype)
    evaluate = _fused(family, affines, layout, archives.slots, stream, dtype) if family.traced else None
    buffers = [
        np.empty((dof, FIRST), dtype),
        np.empty((len(targets), FIRST), np.int32),
        np.empty((members, FIRST), dtype),
    ]

    def explore(first: int, size: int) -> None:
        occupied = np.flatnonzero(archives.best.ravel() >= 0) if first else np.zeros(0, np.int64)
        parents = archives.elites.reshape(-1, dof)
        u, slots, raws = buffers

        def work(start: int) -> None:
            stop = min(start + SHARE, size)
            part = slice(start, stop)
            if evaluate is not None:
                evaluate(first + start, stop - start, occupied, parents, u[:, part], slots[:, part], raws[:, part])
                return
            rows = np.empty((dof, stop - start))
            propose(
                rows.ravel(), stop - start, dof, stop - start, first + start, np.uint64(stream.key), occupied, parents
            )
            u[:, part] = rows
            tips, raw = family.evaluate(np.ascontiguousarray(u[:, part].T))
            x, y, z = (np.ascontiguousarray(tips[:, i], dtype) for i in range(3))
            raws[:, part] = raw.T
            for t in range(len(targets)):
                to_slots(x, y, z, raws[0, part], affines[t], layout[t], archives.slots, slots[t, part])

        on_all_threads(work, range(0, size, SHARE))
        pairs = [(t, m) for t in range(len(targets)) for m in range(members)]

        def credit(pair: tuple[int, int]) -> None:
            t, m = pair
            merge(archives.best[t, m], archives.elites[t, m], slots[t, :size], raws[m, :size], scales[m], u)

        on_all_threads(credit, pairs)

    return explore


@compiled
def propose(w: Any, stride: Any, dof: Any, n: Any, first: Any, key: Any, occupied: Any, parents: Any) -> None:
    """Candidates number ``first`` ... ``first + n - 1`` into the first rows of the scratch ``w``.

    Without elites: plain samples. Else candidate i takes elite i (in turn), and moves a random half of its joints by
    up to a random power of two of their ranges, reflected at the ends.
    """
    gamma, words = np.uint64(0x9E3779B97F4A7C15), np.uint64(dof + 1)
    count = occupied.shape[0]
    chosen = np.empty(n, np.uint64)
    parent = np.zeros(n, np.int64)
    turn = first % max(count, 1)
    for i in range(n):
        chosen[i] = mixed(key + gamma * (np.uint64(first + i) * words))
        if count > 0:
            parent[i] = occupied[turn]
            turn = turn + 1 if turn + 1 < count else 0
    for j in range(dof):
        for i in range(n):
            bits = mixed(key + gamma * (np.uint64(first + i) * words + np.uint64(j + 1)))
            unit = float64_from_bits((bits >> np.uint64(12)) | np.uint64(0x3FF0000000000000)) - (1.0 - 2.0**-53)
            if count == 0:
                w[j * stride + i] = unit
            else:
                word = chosen[i]
                amplitude = float64_from_bits((np.uint64(1023 - 4) - (word & np.uint64(7))) << np.uint64(52))
                moved = (word >> np.uint64(8 + j % 32)) & np.uint64(1) > np.uint64(0)
                v = abs(parents[parent[i], j] + select(moved, amplitude * (2.0 * unit - 1.0), 0.0))
                w[j * stride + i] = select(v > 1.0, 2.0 - v, v)


@compiled
def mixed(z: Any) -> Any:
    """SplitMix64's output function."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@compiled
def to_slots(x: Any, y: Any, z: Any, raw: Any, affine: Any, layout: Any, slots: Any, out: Any) -> None:
    """The archive slot that each tip falls into, -1 for none."""
    n = x.shape[0]
    cells, picks = np.empty(n, np.int32), np.empty(n, np.int32)
    count = workspace.locate(x, y, z, raw, n, affine, layout, cells, picks)
    out[:] = -1
    for s in range(count):
        out[picks[s]] = slots[cells[s]]


@compiled
def merge(best: Any, elites: Any, slots: Any, raw: Any, scale: Any, u: Any) -> None:
    """Credit candidates in the order of their numbers; a tie keeps the earlier one."""
    for i in range(slots.shape[0]):
        slot = slots[i]
        if slot >= 0 and raw[i] * scale > best[slot]:
            best[slot] = raw[i] * scale
            for j in range(u.shape[0]):
                elites[slot, j] = u[j, i]


def _fused(
    family: Family,
    affines: Array,
    layout: NDArray[np.int64],
    slots: NDArray[np.int32],
    stream: Stream,
    dtype: np.dtype[Any],
) -> Callable[..., None]:
    """Proposal, kinematics, indices and location as one kernel."""
    source = _EXPLORE.format(block=BLOCK, stride=STRIDE[dtype], dof=family.arm.dof, members=len(family.members))
    kernel = family.kernel(dtype, source, (sampling, workspace, _this_module()))
    constants, key = family.constants, np.uint64(stream.key)

    def evaluate(first: int, size: int, occupied: Any, parents: Any, u: Any, out: Any, raws: Any) -> None:
        w = scratch(kernel.rows, dtype)
        kernel.module.explore(first, size, key, occupied, parents, constants, w, affines, layout, slots, u, out, raws)

    return evaluate


def _this_module() -> Any:
    import sys

    return sys.modules[__name__]


_EXPLORE = """
from eiwa.core.elites import propose, to_slots


@compiled
def explore(first, size, key, occupied, parents, p, w, affines, layout, slots, u, out, raws):
    x, y, z, raw = {dof} * {stride}, ({dof} + 1) * {stride}, ({dof} + 2) * {stride}, ({dof} + 3) * {stride}
    for start in range(0, size, {block}):
        n = min({block}, size - start)
        propose(w, {stride}, {dof}, n, first + start, key, occupied, parents)
        for j in range({dof}):
            for s in range(n):
                u[j, start + s] = w[j * {stride} + s]
        block(w, p)
        for t in range(layout.shape[0]):
            to_slots(w[x : x + n], w[y : y + n], w[z : z + n], w[raw : raw + n],
                     affines[t], layout[t], slots, out[t, start : start + n])
        for m in range({members}):
            for s in range(n):
                raws[m, start + s] = w[raw + m * {stride} + s]
"""
