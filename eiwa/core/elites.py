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
from eiwa.core.kernel import on_all_threads, scratch, thread_count
from eiwa.core.sampling import BLOCK, Stream
from eiwa.core.symbols import stride
from eiwa.core.workspace import Target, packed

FIRST = 1 << 17
"""Evaluations of the plain first pass."""
GENERATION = slice(1 << 13, 1 << 16)
"""Sizes of a generation: a 64th of the evaluations so far, within these. Larger ones draw from older elites, smaller ones
make threads wait for each other more often than they work."""
GROWTH = 2.0**0.25
"""Checkpoints stand where the evaluations have grown by this factor; four of them make a doubling."""
CAUTION = 2.0
"""What remains is estimated as this multiple of the last doubling's gain; benchmarks/refinement.py shows the evidence."""
EARLY = 1 << 20
"""Until then, one candidate in 8 moves anywhere, later one in 32: branches of the inverse kinematics are found early, while
no cell's elite is at its best, or not at all."""
GAMMA = np.uint64(0x9E3779B97F4A7C15)
"""SplitMix64's increment."""
SORTED = 17 / 16
"""Parents are brought into the order of their cells when there are so many times more."""
LEAST = 1e-3
"""The tolerance is relative to F, but to no less than this."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """How far the elites of one member have come for one field of weights.

    ``history``: (evaluations, F) at the checkpoints; ``remaining``: how much F may still rise; ``elites``: per target
    and cell the point of the unit cube that attains the cell's value, NaN where there is none, shape
    (targets, cells with any weight, dof); ``cells``: their numbers on the grid.
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
    family: Family,
    targets: Sequence[Target],
    weights: Sequence[Array],
    stream: Stream,
    amount: Sampling,
    *,
    reached: bool = False,
) -> list[tuple[list[Filled], list[Refinement]]]:
    """Search the largest value of every weighted cell, for every target and member; a refinement for every field.

    Parameters
    ----------
    family
        Dexterities that share one arm.
    targets
        The arms' poses on one and the same grid.
    weights
        E_left + E_right on that grid of one or more operators: only cells with some weight > 0 keep an elite, and
        progress is measured in F = mean over targets of sum(weights * values) / sum(weights), of every field.
    stream
        Its key starts the random numbers.
    amount
        ``samples`` is the largest number of evaluations; the search ends before when for every member and field what
        remains is under ``tolerance`` relative to max(F, 1e-3).
    reached
        Measure the progress by which cells are reached above the threshold, not by their values.
    """
    archives = Archives.empty(family, targets, weights)
    explore = _explorer(family, targets, archives, stream, amount.dtype)
    spent, checkpoint = 0, float(FIRST)
    histories: list[list[list[tuple[int, float]]]] = [[[] for _ in weights] for _ in family.members]
    while spent < amount.samples:
        size = min(generation(spent), amount.samples - spent)
        explore(spent, size)
        spent += size
        if spent >= checkpoint or spent >= amount.samples:
            for member, values in zip(histories, archives.F(family, reached), strict=True):
                for history, F in zip(member, values, strict=True):
                    history.append((spent, F))
            checkpoint = max(spent, checkpoint) * GROWTH
            if all(remaining(h) <= amount.tolerance * max(h[-1][1], LEAST) for member in histories for h in member):
                break
    return [
        (archives.filled(family, m), [Refinement(h, remaining(h), archives.points(m), archives.cells) for h in member])
        for m, member in enumerate(histories)
    ]


def generation(spent: int) -> int:
    """The size of the next generation."""
    return min(max(spent // 64 // BLOCK * BLOCK, GENERATION.start), GENERATION.stop)


def remaining(history: Sequence[tuple[int, float]]) -> float:
    """What F may still gain: a multiple of the last doubling's gain, all of 1 - F before the first doubling."""
    last, F = history[-1]
    before = [value for n, value in history if n * 1.999 <= last]
    return CAUTION * (F - before[-1]) if before else 1.0 - F


@dataclass(frozen=True, eq=False)
class Archives:
    """Best values and their points: ``best`` (targets, slots, members), ``elites`` (targets, slots, members, dof).

    ``weights`` (fields, slots).
    """

    shape: tuple[int, int, int]
    cells: NDArray[np.int64]
    slots: NDArray[np.int32]
    weights: Array
    best: Array
    elites: Array

    @classmethod
    def empty(cls, family: Family, targets: Sequence[Target], weights: Sequence[Array]) -> Archives:
        """No elites yet; one slot per cell with weight in any field."""
        cells = np.flatnonzero(np.any([field.ravel() > 0 for field in weights], axis=0))
        slots = np.full(targets[0].grid.cells, -1, np.int32)
        slots[cells] = np.arange(cells.size, dtype=np.int32)
        size = (len(targets), cells.size, len(family.members))
        return cls(
            targets[0].grid.shape,
            cells,
            slots,
            np.array([field.ravel()[cells] for field in weights]),
            np.full(size, -1.0),
            np.full((*size, family.arm.dof), np.nan),
        )

    def values(self, family: Family, member: int) -> Array:
        """Values that count, (targets, slots): capped at 1, 0 below the threshold."""
        best = self.best[..., member]
        return np.where(best >= family.members[member].threshold, np.clip(best, 0.0, 1.0), 0.0)

    def F(self, family: Family, reached: bool = False) -> list[list[float]]:
        """Weighted mean over cells (of 1 where ``reached``), averaged over targets, of every member and field."""
        members = (self.values(family, m) for m in range(len(family.members)))
        means = [((v > 0) if reached else v).mean(axis=0) for v in members]
        return [[float((mean * w).sum() / max(float(w.sum()), 1e-300)) for w in self.weights] for mean in means]

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
        return self.elites[:, :, member]


def _explorer(
    family: Family, targets: Sequence[Target], archives: Archives, stream: Stream, dtype: Any
) -> Callable[[int, int], None]:
    """A function that evaluates ``size`` candidates from number ``first`` on, and merges them."""
    dtype, dof, members = np.dtype(dtype), family.arm.dof, len(family.members)
    affines, layout = packed(targets, dtype)
    layout[:, 3] = 0
    best, elites = archives.best.reshape(-1, members), archives.elites.reshape(-1, dof)
    frozen = (affines, layout, archives.slots, best, family.scales(dtype))
    evaluate = (_fused if family.traced else _by_arrays)(family, frozen, stream, dtype)
    rows = np.empty(len(targets) * GENERATION.stop, np.int32)
    found = np.empty((rows.size, members + dof), dtype)
    occupied, count, in_order = np.empty(len(best), np.int32), 0, 0

    def explore(first: int, size: int) -> None:
        nonlocal count, in_order
        share = -(-size // (thread_count() * BLOCK)) * BLOCK
        parents = occupied[: count if first >= FIRST else 0]

        def work(start: int) -> slice:
            n, room = min(share, size - start), len(targets) * start
            return slice(room, room + evaluate(first + start, n, parents, elites, rows[room:], found[room:]))

        for better in on_all_threads(work, range(0, size, share)):
            count = merge(best, elites, rows[better], found[better], occupied, count)
        if count > in_order * SORTED:  # neighbours in memory are read together
            occupied[:count].sort()
            in_order = count

    return explore


@compiled
def propose(
    w: Any, stride: Any, dof: Any, n: Any, first: Any, key: Any, occupied: Any, elites: Any, members: Any
) -> None:
    """Candidates number ``first`` ... ``first + n - 1`` into the first rows of the scratch ``w``, which has one row more.

    Without elites: plain samples. Else candidate i takes a cell (in turn) and inherits each joint from one of two members'
    elites there: what one member has found, another may use. It moves a random half of its joints by up to
    2^-4 ... 2^-11 of their ranges, a few by up to the whole range (another branch of the inverse kinematics may be better
    there), reflected at the ends.
    """
    count, words = occupied.shape[0], np.uint64(dof + 1)
    start, step = key + GAMMA * (np.uint64(first) * words), GAMMA * words
    if count > 0:
        turn, z, drawn = first % count, start, np.empty(n, np.uint64)
        for i in range(n):  # words are counted by adding, so that the loops over them vectorise
            word = mixed(z)
            seldom = select(first + i < EARLY, np.uint64(7 << 3), np.uint64(31 << 3))
            far = word & seldom == np.uint64(0)
            halvings = select(far, np.uint64(0), np.uint64(4) + (word & np.uint64(7)))
            w[dof * stride + i] = float64_from_bits((np.uint64(1023) - halvings) << np.uint64(52))
            drawn[i] = word >> np.uint64(8)
            z += step
        for i in range(n):
            bits, first_of_cell = drawn[i], np.uintp(occupied[turn]) * np.uintp(members)
            mother = elites[first_of_cell + one_of(members, bits >> np.uint64(40))]
            father = elites[first_of_cell + one_of(members, bits >> np.uint64(24))]
            for j in range(dof):
                w[j * stride + i] = mother[j] if bits & np.uint64(1) else father[j]
                bits >>= np.uint64(1)
            turn = turn + 1 if turn + 1 < count else 0
    for j in range(dof):
        z = start + GAMMA * np.uint64(j + 1)
        if count > 0:
            for i in range(n):
                bits = mixed(z)
                moved = bits & np.uint64(1) > np.uint64(0)
                move = w[dof * stride + i] * (2.0 * unit(bits) - 1.0)
                v = abs(w[j * stride + i] + select(moved, move, 0.0))
                w[j * stride + i] = select(v > 1.0, 2.0 - v, v)
                z += step
        else:
            for i in range(n):
                w[j * stride + i] = unit(mixed(z))
                z += step


@compiled
def unit(bits: Any) -> Any:
    """A number in (0, 1) from the upper 52 bits."""
    return float64_from_bits((bits >> np.uint64(12)) | np.uint64(0x3FF0000000000000)) - (1.0 - 2.0**-53)


@compiled
def one_of(members: Any, bits: Any) -> Any:
    """The number of one of so many members, from the lower 16 bits."""
    return (bits & np.uint64(0xFFFF)) * np.uint64(members) >> np.uint64(16)


@compiled
def mixed(z: Any) -> Any:
    """SplitMix64's output function."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@compiled
def keep_better(u: Any, tip: Any, raws: Any, n: Any, frozen: Any, room: Any, rows: Any, found: Any, count: Any) -> Any:
    """Append those of n candidates that are better than an elite of the frozen archives where their tips fall.

    ``u``, ``tip``, ``raws``: their points, where these lead, and the members' indices there, as tuples of columns but for
    u. A ``rows`` entry is target times slots + slot, a ``found`` entry the values of all members and then the point.
    ``room`` is scratch, two rows of at least min(n, BLOCK). Returns the new ``count``.
    """
    # Signed indices are asked whether they are negative, which takes a third of the time.
    affines, layout, slots, best, scales = frozen
    (x, y, z), cells, picks = tip, room[0], room[1]
    members, size = len(raws), best.shape[0] // layout.shape[0]
    for start in range(0, n, BLOCK):  # the order of entries must not depend on n
        part = slice(start, min(start + BLOCK, n))
        length = part.stop - start
        for t in range(layout.shape[0]):
            target = affines[t], layout[t]
            inside = workspace.locate(x[part], y[part], z[part], raws[0][part], length, *target, cells, picks)
            kept, better = 0, 0
            for k in range(inside):
                slot = slots[np.uintp(cells[k])]
                cells[kept], picks[kept] = t * size + slot, start + picks[k]
                kept += slot >= 0
            for k in range(kept):
                row, i, any_better = np.uintp(cells[k]), np.uintp(picks[k]), False
                for m in range(members):
                    any_better |= raws[m][i] * scales[m] > best[row, m]
                cells[better], picks[better] = row, i
                better += any_better
            for k in range(better):
                rows[count] = cells[k]
                for m in range(members):
                    found[count, m] = raws[m][picks[k]] * scales[m]
                for j in range(u.shape[0]):
                    found[count, members + j] = u[j, picks[k]]
                count += 1
    return count


@compiled
def merge(best: Any, elites: Any, rows: Any, found: Any, occupied: Any, count: Any) -> Any:
    """Credit candidates in the order of their numbers; a tie keeps the earlier one.

    A candidate counts for all members, so that their elites appear together. Rows that were empty are appended to the
    first ``count`` of ``occupied``; returns the new count.
    """
    members, dof = best.shape[1], elites.shape[1]
    for k in range(rows.shape[0]):
        row = rows[k]
        if best[row, 0] < 0.0:
            occupied[count] = row
            count += 1
        for m in range(members):
            if found[k, m] > best[row, m]:
                best[row, m] = found[k, m]
                for j in range(dof):
                    elites[row * members + m, j] = found[k, members + j]
    return count


def _by_arrays(
    family: Family, frozen: tuple[NDArray[Any], ...], stream: Stream, dtype: np.dtype[Any]
) -> Callable[..., int]:
    """Proposal, kinematics, indices and comparison of n candidates, for plugins in plain NumPy."""
    dof, key = family.arm.dof, np.uint64(stream.key)

    def evaluate(first: int, n: int, occupied: Any, elites: Any, rows: Any, found: Any) -> int:
        u, room = np.empty((dof + 1, n)), np.empty((2, BLOCK), np.int32)
        propose(u.ravel(), n, dof, n, first, key, occupied, elites, len(family.members))
        u = u[:dof].astype(dtype, copy=False)
        x, y, z, *raws = family.rows(u.T, dtype)
        return int(keep_better(u, (x, y, z), tuple(raws), n, frozen, room, rows, found, 0))

    return evaluate


def _fused(
    family: Family, frozen: tuple[NDArray[Any], ...], stream: Stream, dtype: np.dtype[Any]
) -> Callable[..., int]:
    """The same as one kernel."""
    dof = family.arm.dof
    raws = ", ".join(f"columns[{dof + 3 + m}]" for m in range(len(family.members)))
    source = _EXPLORE.format(block=BLOCK, stride=stride(BLOCK, dtype), dof=dof, raws=raws, members=len(family.members))
    kernel = family.kernel(dtype, source, (sampling, workspace, _this_module()))
    constants, key = family.constants, np.uint64(stream.key)

    def evaluate(first: int, n: int, occupied: Any, elites: Any, rows: Any, found: Any) -> int:
        w, room = scratch(kernel.size, dtype), np.empty((2, BLOCK), np.int32)
        explore = kernel.module.explore
        return int(explore(first, n, key, occupied, elites, constants, w, frozen, room, rows, found))

    return evaluate


def _this_module() -> Any:
    import sys

    return sys.modules[__name__]


_EXPLORE = """
from eiwa.core.elites import keep_better, propose


@compiled
def explore(first, size, key, occupied, elites, p, w, frozen, room, rows, found):
    columns = w.reshape(-1, {stride})
    u, tip, raws = columns[:{dof}], (columns[{dof}], columns[{dof} + 1], columns[{dof} + 2]), ({raws},)
    count = 0
    for start in range(0, size, {block}):
        n = min({block}, size - start)
        propose(w, {stride}, {dof}, n, first + start, key, occupied, elites, {members})
        block(w, p)
        count = keep_better(u, tip, raws, n, frozen, room, rows, found, count)
    return count
"""
