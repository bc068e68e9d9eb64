"""Contracts of voxel backends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from eiwa.core.interfaces import Array, VoxelBackend
from eiwa.testing.contract import Contract, Violation
from eiwa.testing.samples import accuracy, rate
from eiwa.testing.subject import Subject

CELLS, BLOCK = 1000, 256
"""Cells of the store that is looked at; a study deposits blocks of 256."""
BELOW = -1.0
"""The value of a sample below the threshold: a hit that does not survive."""

Deposits = tuple[NDArray[np.int32], Array]
"""Cells and values, one a sample."""


def builds(subject: Subject) -> str:
    """build(parameters) returns a VoxelBackend, and the parameters have a field aggregate."""
    if not isinstance(subject.part, VoxelBackend):
        cause = (
            "build is a function that does not return what it makes, or the class does not derive from VoxelBackend."
        )
        raise Violation("an eiwa.core.interfaces.VoxelBackend", f"{type(subject.part).__name__}", cause)
    if "aggregate" not in type(subject.parameters).model_fields:
        raise Violation("a parameter aggregate, which studies write in [voxels]", "none")
    if not (isinstance(subject.part.bytes_per_cell, int) and subject.part.bytes_per_cell > 0):
        raise Violation("bytes_per_cell: whole bytes of a store per cell", f"{subject.part.bytes_per_cell!r}")
    return f"{type(subject.part).__name__}, {subject.part.bytes_per_cell} bytes a cell"


def suits_any_size(subject: Subject) -> str:
    """suited(cells) is a VoxelBackend: for few cells and for many."""
    found = [subject.part.suited(cells) for cells in (CELLS, 1 << 28)]
    for backend in found:
        if not isinstance(backend, VoxelBackend):
            raise Violation("a VoxelBackend from suited(cells)", f"{type(backend).__name__}")
    return ", ".join(dict.fromkeys(type(backend).__name__ for backend in found))


def opens_empty(subject: Subject) -> str:
    """An empty store has value 0 and no hits in every cell."""
    values, hits = _read(subject, subject.part.open(CELLS))
    if values.any() or hits.any():
        raise Violation("0 everywhere in a store just opened", f"{np.count_nonzero(values)} values, {hits.sum()} hits")
    return f"{CELLS} cells"


def counts_every_hit(subject: Subject) -> str:
    """hits counts every sample, those below the threshold too."""
    cells, values = _deposits()
    _, hits = _read(subject, _filled(subject, [(cells, values)]))
    wanted = np.bincount(cells, minlength=CELLS)
    if not np.array_equal(hits, wanted):
        cell = int(np.argmax(hits != wanted))
        cause = "samples with value -1 are skipped." if hits.sum() < len(cells) else "a sample counts twice."
        raise Violation(f"{wanted[cell]} hits in cell {cell}", f"{hits[cell]}", cause)
    return f"{len(cells):,} samples, {(values < 0).mean():.0%} below the threshold"


def keeps_survivors_only(subject: Subject) -> str:
    """A cell's value is 0 where nothing survived, and in [0, 1] everywhere."""
    cells, values = _deposits()
    kept, _ = _read(subject, _filled(subject, [(cells, values)]))
    alive = np.bincount(cells[values >= 0], minlength=CELLS) > 0
    bad = (kept < 0) | (kept > 1) | (~alive & (kept != 0))
    if bad.any():
        cell = int(bad.argmax())
        cause = "the value -1 of a sample below the threshold is taken for a value, or a sum is not divided."
        raise Violation(f"cell {cell} {'in [0, 1]' if alive[cell] else 'at 0'}", f"{kept[cell]:.6g}", cause)
    return f"{int(alive.sum())} cells with survivors"


def knows_max_and_mean(subject: Subject) -> str:
    """For aggregate = max and mean the values are those, to 1e-8."""
    cells, values = _deposits()
    kept, _ = _read(subject, _filled(subject, [(cells, values)]))
    alive = values >= 0
    aggregate = getattr(subject.parameters, "aggregate", "")
    wanted = np.zeros(CELLS)
    if aggregate == "max":
        np.maximum.at(wanted, cells[alive], values[alive])
    elif aggregate == "mean":
        np.add.at(wanted, cells[alive], values[alive])
        wanted /= np.maximum(np.bincount(cells[alive], minlength=CELLS), 1)
    else:
        return f"{aggregate}: its author knows"
    if np.abs(kept - wanted).max() > 1e-8:
        cell = int(np.abs(kept - wanted).argmax())
        raise Violation(f"cell {cell}: {aggregate} {wanted[cell]:.8g}", f"{kept[cell]:.8g}")
    return f"{aggregate}, {accuracy(float(np.abs(kept - wanted).max()))}"


def reads_count_samples(subject: Subject) -> str:
    """deposit reads the first count entries of its arrays; what follows is left over from other blocks."""
    cells, values = _deposits()
    store = subject.part.ready(subject.part.open(CELLS), len(cells))
    for start in range(0, len(cells), BLOCK):
        part = cells[start : start + BLOCK]
        subject.part.deposit(
            store, np.append(part, [7, 7]), np.append(values[start : start + BLOCK], [1.0, 1.0]), len(part)
        )
    return _same(subject, store, _filled(subject, [(cells, values)]), "entries behind count are deposited")


def does_not_depend_on_the_order_of_deposits(subject: Subject) -> str:
    """The same samples in any order leave the same bits."""
    cells, values = _deposits()
    order = np.random.default_rng(1).permutation(len(cells))
    one, other = _filled(subject, [(cells, values)]), _filled(subject, [(cells[order], values[order])])
    return _same(
        subject, one, other, "a sum of floating-point numbers (sum whole numbers instead), or the last value kept"
    )


def does_not_depend_on_the_order_of_merging(subject: Subject) -> str:
    """Stores of several threads, merged in any order, leave the bits of one store."""
    parts = [(cells, values) for cells, values in zip(*(np.array_split(a, 3) for a in _deposits()), strict=True)]
    whole = _filled(subject, parts)
    for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        merged, *others = (_filled(subject, [parts[k]]) for k in order)
        for other in others:
            merged = subject.part.merge(merged, other)
        _same(subject, merged, whole, "merge forgets hits or survivors, or adds floating-point sums")
    return "bit by bit"


def goes_on_after_reading(subject: Subject) -> str:
    """values and hits change nothing, and stay what they were while deposits go on: a study reads at half of its samples."""
    cells, values = _deposits()
    half = len(cells) // 2
    store = _filled(subject, [(cells[:half], values[:half])])
    early = subject.part.values(store)
    kept = np.array(early)
    _read(subject, store)
    store = _deposit(subject, store, cells[half:], values[half:])
    _same(subject, store, _filled(subject, [(cells, values)]), "reading a store changes it")
    if not np.array_equal(early, kept):
        cause = "values returns a view of the store. Return a copy."
        raise Violation("values that stay what they were", "they changed with later deposits", cause)
    return "bit by bit"


def grows(subject: Subject) -> str:
    """A hundred times the cells, nearly all empty, and the cells at both ends."""
    cells, values = _deposits()
    many = 100 * CELLS
    spread = (cells.astype(np.int64) * 100).astype(np.int32)
    spread[:2] = 0, many - 1
    values = values.copy()
    values[:2] = 0.75
    store = _deposit(subject, subject.part.open(many), spread, values)
    kept, hits = np.asarray(subject.part.values(store)), np.asarray(subject.part.hits(store))
    if (
        kept.shape != (many,)
        or hits.shape != (many,)
        or hits.sum() != len(spread)
        or not (kept[0] > 0 and kept[-1] > 0)
    ):
        raise Violation(
            f"{len(spread)} hits in {many} cells, the first and last among them", f"{hits.sum()} hits, {kept.shape}"
        )
    return f"{many:,} cells"


def takes_single_precision(subject: Subject) -> str:
    """Values may be float32: precision = "f32"."""
    cells, values = _deposits()
    store = _deposit(subject, subject.part.open(CELLS), cells, values.astype(np.float32))
    kept, hits = _read(subject, store)
    wanted, _ = _read(subject, _filled(subject, [(cells, values)]))
    if hits.sum() != len(cells) or np.abs(kept - wanted).max() > 1e-6:
        raise Violation("the same values to 1e-6", f"off by {np.abs(kept - wanted).max():.2g}, {hits.sum()} hits")
    return accuracy(float(np.abs(kept - wanted).max()))


def tells_its_speed(subject: Subject) -> str:
    """How many samples a second one thread deposits."""
    cells, values = _deposits()
    store = _deposit(subject, subject.part.open(CELLS), cells, values)
    linked = "linked into the kernel" if isinstance(subject.part.deposit, Dispatcher) else "plain Python, not linked"
    return f"{rate(lambda: subject.part.deposit(store, cells, values, len(cells)), len(cells))} samples/s, {linked}"


def _deposits() -> Deposits:
    """20,000 samples in the lower half of the cells, a third of them below the threshold, some cells hit once."""
    rng = np.random.default_rng(0)
    cells = np.minimum(rng.integers(0, CELLS // 2, 20_000), rng.integers(0, CELLS, 20_000)).astype(np.int32)
    values = rng.random(20_000)
    values[values < 1 / 3] = BELOW
    values[cells % 10 == 3] = BELOW
    return cells, values


def _deposit(subject: Subject, store: Any, cells: NDArray[np.int32], values: Array) -> Any:
    """The store with samples deposited block by block, made ready for them before, as a study does."""
    store = subject.part.ready(store, len(cells))
    for start in range(0, len(cells), BLOCK):
        part = cells[start : start + BLOCK]
        subject.part.deposit(store, part, values[start : start + BLOCK], len(part))
    return store


def _filled(subject: Subject, parts: Sequence[Deposits]) -> Any:
    store = subject.part.open(CELLS)
    for cells, values in parts:
        store = _deposit(subject, store, cells, values)
    return store


def _read(subject: Subject, store: Any) -> tuple[Array, NDArray[np.int64]]:
    values, hits = np.asarray(subject.part.values(store)), np.asarray(subject.part.hits(store))
    for name, array in (("values", values), ("hits", hits)):
        if array.shape != (CELLS,):
            raise Violation(f"{name} of shape ({CELLS},)", f"{array.shape}")
    if not np.isfinite(values).all():
        raise Violation("finite values", f"{values[~np.isfinite(values)][0]}", "a mean over no survivors: 0 there.")
    return values, hits


def _same(subject: Subject, one: Any, other: Any, cause: str) -> str:
    for name, a, b in zip(("values", "hits"), _read(subject, one), _read(subject, other), strict=True):
        if not np.array_equal(a, b):
            cell = int(np.argmax(a != b))
            raise Violation(f"{name} of cell {cell} to be {b[cell]!r}", f"{a[cell]!r}", f"{cause}.")
    return "bit by bit"


BASIC: tuple[Contract, ...] = (builds, suits_any_size, opens_empty)
CONTRACTS: tuple[Contract, ...] = (
    *BASIC,
    counts_every_hit,
    keeps_survivors_only,
    knows_max_and_mean,
    reads_count_samples,
    does_not_depend_on_the_order_of_deposits,
    does_not_depend_on_the_order_of_merging,
    goes_on_after_reading,
    grows,
    takes_single_precision,
    tells_its_speed,
)
