"""The dense backend keeps what NumPy would keep, in any order."""

import numpy as np
import pytest
from pydantic import ValidationError

from eiwa.plugins.voxels.dense import DenseMax, DenseMean, DenseParameters, eiwa_voxels

CELLS = 5
CELL = np.array([3, 0, 3, 3, 1, 0, 3], np.int32)
VALUE = np.array([0.5, 0.25, 1.0, -1.0, -1.0, 0.0, 0.75])
BELOW = -1.0
"""What stands for a sample below the threshold."""


def deposited(backend, cells=CELL, values=VALUE, count=None):
    store = backend.open(CELLS)
    backend.deposit(store, cells, values, len(cells) if count is None else count)
    return store


@pytest.mark.parametrize(
    ("backend", "kept"),
    [(DenseMax(), [0.25, 0.0, 0.0, 1.0, 0.0]), (DenseMean(), [0.125, 0.0, 0.0, 0.75, 0.0])],
    ids=["max", "mean"],
)
def test_a_cell_keeps_the_aggregate_of_its_survivors(backend, kept):
    assert backend.values(deposited(backend)).tolist() == kept


BACKENDS = pytest.mark.parametrize("backend", [DenseMax(), DenseMean()], ids=["max", "mean"])


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


@BACKENDS
def test_bytes_per_cell_are_what_a_store_takes(backend):
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
        backend.merge(merged, deposited(backend, cells[part], values[part]))
    read = getattr(backend, quantity)
    np.testing.assert_array_equal(read(merged), read(deposited(backend, cells, values)))


def test_a_mean_is_rounded_by_less_than_2_to_the_minus_31():
    cells, values = many()
    survivors = values >= 0
    sums = np.bincount(cells[survivors], values[survivors])
    expected = sums / np.bincount(cells[survivors])
    np.testing.assert_allclose(
        DenseMean().values(deposited(DenseMean(), cells, values)), expected, rtol=0, atol=2.0**-31
    )


def test_a_maximum_is_numpys():
    cells, values = many()
    expected = np.zeros(CELLS)
    np.maximum.at(expected, cells, values)
    np.testing.assert_array_equal(DenseMax().values(deposited(DenseMax(), cells, values)), expected)


@pytest.mark.parametrize(("aggregate", "backend"), [("max", DenseMax), ("mean", DenseMean)])
def test_the_aggregate_chooses_the_backend(aggregate, backend):
    (plugin,) = eiwa_voxels()
    assert isinstance(plugin.build(DenseParameters(aggregate=aggregate)), backend)


def test_another_aggregate_is_refused():
    with pytest.raises(ValidationError, match="'max' or 'mean'"):
        DenseParameters(aggregate="median")
