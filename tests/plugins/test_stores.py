"""Stores keep what NumPy would keep, in any order; dense and sparse ones the same to the last bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from eiwa.plugins.voxels.stores import PAGE, SMALL, Auto, Dense, DenseParameters, Sparse, eiwa_voxels

CELLS = 5
CELL = np.array([3, 0, 3, 3, 1, 0, 3], np.int32)
VALUE = np.array([0.5, 0.25, 1.0, -1.0, -1.0, 0.0, 0.75])
BELOW = -1.0
"""What stands for a sample below the threshold."""


def deposited(backend, cells=CELL, values=VALUE, count=None):
    store = backend.ready(backend.open(CELLS), len(cells))
    backend.deposit(store, cells, values, len(cells) if count is None else count)
    return store


@pytest.mark.parametrize("store", [Dense, Sparse])
@pytest.mark.parametrize(
    ("aggregate", "kept"), [("max", [0.25, 0.0, 0.0, 1.0, 0.0]), ("mean", [0.125, 0.0, 0.0, 0.75, 0.0])]
)
def test_a_cell_keeps_the_aggregate_of_its_survivors(store, aggregate, kept):
    backend = store(aggregate)
    assert backend.values(deposited(backend)).tolist() == kept


BACKENDS = pytest.mark.parametrize(
    "backend", [store(aggregate) for store in (Dense, Sparse) for aggregate in ("max", "mean")], ids=repr
)


@BACKENDS
def test_hits_count_samples_below_the_threshold_too(backend):
    assert backend.hits(deposited(backend)).tolist() == [2, 1, 0, 4, 0]


@BACKENDS
def test_a_sample_below_the_threshold_leaves_no_value(backend):
    store = deposited(backend, np.zeros(3, np.int32), np.full(3, BELOW))
    assert backend.values(store)[0] == 0.0


@BACKENDS
def test_an_empty_store_holds_zeros(backend):
    assert backend.values(backend.open(CELLS)).tolist() == [0.0] * CELLS


@BACKENDS
def test_an_empty_store_has_no_hits(backend):
    assert backend.hits(backend.open(CELLS)).tolist() == [0] * CELLS


@BACKENDS
def test_only_the_counted_samples_are_deposited(backend):
    assert backend.hits(deposited(backend, count=2)).sum() == 2


@pytest.mark.parametrize("backend", [Dense("max"), Dense("mean")], ids=repr)
def test_bytes_per_cell_are_what_a_dense_store_takes(backend):
    assert backend.open(CELLS).nbytes == CELLS * backend.bytes_per_cell


@BACKENDS
def test_single_precision_values_are_kept(backend):
    single = deposited(backend, values=VALUE.astype(np.float32))
    np.testing.assert_array_equal(backend.values(single), backend.values(deposited(backend)))


@BACKENDS
def test_values_are_a_copy(backend):
    store = deposited(backend)
    backend.values(store)[:] = 7.0
    assert backend.values(store).max() <= 1.0


def many():
    rng = np.random.default_rng(0)
    values = np.where(rng.uniform(size=10_000) < 0.3, BELOW, rng.uniform(size=10_000))
    return rng.integers(0, CELLS, 10_000).astype(np.int32), values


@BACKENDS
def test_the_order_of_samples_is_immaterial(backend):
    cells, values = many()
    order = np.random.default_rng(1).permutation(len(cells))
    np.testing.assert_array_equal(
        backend.values(deposited(backend, cells[order], values[order])),
        backend.values(deposited(backend, cells, values)),
    )


@pytest.mark.parametrize("quantity", ["values", "hits"])
@BACKENDS
def test_merged_parts_give_the_whole(backend, quantity):
    cells, values = many()
    merged = backend.open(CELLS)
    for part in (slice(7000, None), slice(0, 100), slice(100, 7000)):
        merged = backend.merge(merged, deposited(backend, cells[part], values[part]))
    read = getattr(backend, quantity)
    np.testing.assert_array_equal(read(merged), read(deposited(backend, cells, values)))


def test_a_mean_is_rounded_by_less_than_2_to_the_minus_31():
    cells, values = many()
    survivors = values >= 0
    sums = np.bincount(cells[survivors], values[survivors])
    expected = sums / np.bincount(cells[survivors])
    backend = Dense("mean")
    np.testing.assert_allclose(backend.values(deposited(backend, cells, values)), expected, rtol=0, atol=2.0**-31)


def test_a_maximum_is_numpys():
    cells, values = many()
    expected = np.zeros(CELLS)
    np.maximum.at(expected, cells, values)
    backend = Dense("max")
    np.testing.assert_array_equal(backend.values(deposited(backend, cells, values)), expected)


@pytest.mark.parametrize("aggregate", ["max", "mean"])
@given(
    parts=st.lists(st.lists(st.tuples(st.integers(0, 9 * PAGE), st.floats(-1.0, 1.0)), max_size=40), max_size=6),
    threads=st.integers(1, 3),
)
def test_dense_and_sparse_agree_to_the_last_bit(aggregate, parts, threads):
    """Deposits in blocks, shared out among several stores that are merged in the end."""
    read = []
    for backend in (Dense(aggregate), Sparse(aggregate)):
        stores = [backend.open(9 * PAGE + 1) for _ in range(threads)]
        for number, part in enumerate(parts):
            cells = np.array([cell for cell, _ in part], np.int32)
            values = np.array([value if value >= 0 else BELOW for _, value in part])
            stores[number % threads] = backend.ready(stores[number % threads], len(part))
            backend.deposit(stores[number % threads], cells, values, len(part))
        merged = stores[0]
        for other in stores[1:]:
            merged = backend.merge(merged, other)
        read.append((backend.values(merged), backend.hits(merged)))
    np.testing.assert_array_equal(read[0][0], read[1][0])
    np.testing.assert_array_equal(read[0][1], read[1][1])


@pytest.mark.parametrize("aggregate", ["max", "mean"])
def test_a_sparse_store_opens_only_the_pages_that_are_hit(aggregate):
    backend = Sparse(aggregate)
    store = backend.ready(backend.open(10**9), 3)
    backend.deposit(store, np.array([5, 10**9 - 1, 7], np.int32), np.ones(3), 3)
    assert store[1][0] == 2


def test_a_growing_store_keeps_what_it_has():
    backend = Sparse("max")
    store = backend.open(100 * PAGE)
    for cell in range(0, 100 * PAGE, PAGE):
        store = backend.ready(store, 1)
        backend.deposit(store, np.array([cell], np.int32), np.array([0.5]), 1)
    assert np.flatnonzero(backend.values(store)).tolist() == list(range(0, 100 * PAGE, PAGE))


@pytest.mark.parametrize(("cells", "chosen"), [(SMALL // 16, Dense("max")), (SMALL // 16 + 1, Sparse("max"))])
def test_auto_chooses_by_size(cells, chosen):
    assert Auto("max").suited(cells) == chosen


@pytest.mark.parametrize("name", ["auto", "dense", "sparse"])
def test_the_aggregate_reaches_the_store(name):
    plugin = next(p for p in eiwa_voxels() if p.name == name)
    assert plugin.build(plugin.parameters(aggregate="mean")).aggregate == "mean"


def test_another_aggregate_is_refused():
    with pytest.raises(ValidationError, match="'max' or 'mean'"):
        DenseParameters(aggregate="median")
