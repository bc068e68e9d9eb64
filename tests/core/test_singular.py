"""Singular values on columns against LAPACK."""

from itertools import pairwise

import numpy as np
import pytest

from eiwa.core.kernel import Map
from eiwa.core.singular import extremes, isotropy, singular_values
from eiwa.core.symbols import as_columns, root

N = 2000
EQUAL = {"one value": (1.0,) * 6, "pairs": (1.0, 1.0, 0.5, 0.5, 0.1, 0.1), "rank 2": (1.0, 0.3, 0.0, 0.0, 0.0, 0.0)}


def random(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=(N, *shape))


def rotations(n, seed):
    return np.linalg.qr(random(n, n, seed=seed))[0]


def with_values(values):
    values = np.asarray(values)
    n = values.shape[-1]
    return (rotations(n, 1) * values[..., None, :]) @ rotations(n, 2)


def error(A, dtype):
    """Largest error of any singular value, relative to the largest one, per sample."""
    columns = [[np.ascontiguousarray(A[:, i, j], dtype) for j in range(A.shape[2])] for i in range(A.shape[1])]
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        found = np.stack(singular_values(columns), axis=-1)
    assert found.dtype == dtype
    expected = np.linalg.svd(A, compute_uv=False)
    return np.abs(found - expected).max(axis=1) / np.maximum(expected[:, 0], 1e-300)


PRECISIONS = pytest.mark.parametrize(("dtype", "bound"), [(np.float64, 1e-14), (np.float32, 2e-6)], ids=["f64", "f32"])


@PRECISIONS
@pytest.mark.parametrize("shape", [(1, 6), (2, 6), (3, 3), (3, 12), (4, 3), (6, 4), (5, 12), (6, 6), (6, 7), (6, 12)])
def test_they_are_those_of_lapack(shape, dtype, bound):
    assert error(random(*shape), dtype).max() < bound


@PRECISIONS
@pytest.mark.parametrize("values", EQUAL.values(), ids=EQUAL)
def test_equal_ones_and_zeros_are_as_accurate(values, dtype, bound):
    assert error(with_values(values), dtype).max() < bound


@PRECISIONS
def test_near_singular_and_graded_matrices_are_as_accurate(dtype, bound):
    graded = 10.0 ** np.random.default_rng(3).uniform(-6, 0, (N, 6))
    graded[:, 0] = 1.0
    assert error(with_values(graded), dtype).max() < bound


def test_clusters_are_accurate_to_the_stated_bound():
    generator = np.random.default_rng(4)
    near = 1.0 + 10.0 ** generator.uniform(-10, -0.5, (N, 1)) * generator.uniform(0, 1, (N, 6))
    near[:, 4:] = 10.0 ** generator.uniform(-2, 0, (N, 2))
    assert error(with_values(near), np.float64).max() < 1e-5


@PRECISIONS
def test_they_descend(dtype, bound):
    values = singular_values([[random(6, 6)[:, i, j].astype(dtype) for j in range(6)] for i in range(6)])
    assert all((a >= b).all() for a, b in pairwise(values))


@pytest.mark.parametrize("shape", [(2, 2), (3, 6), (6, 6)])
def test_a_matrix_of_zeros_has_zeros(shape):
    zeros = [[np.zeros(3) for _ in range(shape[1])] for _ in range(shape[0])]
    with np.errstate(all="raise"):
        assert not np.any(singular_values(zeros))


def test_compiled_in_single_precision_they_are_never_nan():
    """Constants that are zero, columns that vanish, equal values."""

    def function(x, p):
        return [*extremes([[x[0], x[1], 0.0], [x[2], x[3], 0.0], [0.0, 0.0, x[4]]]), root(x[5], 3), root(x[5], 5)]

    x = np.abs(random(6, seed=5).astype(np.float32))
    x[:, 5] /= x[:, 5].max()
    for k in range(6):
        x[100 * k : 100 * k + 50, k] = 0.0
    x[:20] = 0.0
    x[20:40] = 0.5
    out = Map(function, 6, 0, np.float32)(x, np.zeros(0))
    A = np.zeros((N, 3, 3))
    A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], A[:, 1, 1], A[:, 2, 2] = x[:, :5].T
    expected = np.linalg.svd(A, compute_uv=False)[:, [2, 0]]
    np.testing.assert_allclose(out[:, :2], expected, rtol=0, atol=2e-6 * expected.max())
    np.testing.assert_allclose(out[:, 2], np.cbrt(x[:, 5]), rtol=5e-6)
    np.testing.assert_allclose(out[:, 3], x[:, 5] ** 0.2, rtol=5e-5)


# By the characteristic polynomial: double precision.


def near(top):
    """Four values within a part in ten of the largest or of the smallest one."""
    generator = np.random.default_rng(6)
    cluster = 10.0 ** generator.uniform(-8, -1, (N, 4))
    if top:
        return np.concatenate([1.0 - cluster, generator.uniform(0.01, 0.9, (N, 2))], axis=1)
    return np.concatenate([0.3 * (1.0 + cluster), generator.uniform(0.4, 1.0, (N, 2))], axis=1)


def extreme_error(A):
    """Error of the smallest and of the largest singular value, relative to the largest one, per sample."""
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        found = np.stack(extremes([as_columns(row) for row in A.transpose(1, 0, 2)]), axis=-1)
    expected = np.linalg.svd(A, compute_uv=False)
    return np.abs(found - expected[:, [-1, 0]]).max(axis=1) / np.maximum(expected[:, 0], 1e-300)


SHAPES = pytest.mark.parametrize(
    "shape", [(1, 6), (2, 6), (3, 3), (3, 12), (4, 3), (6, 4), (5, 12), (6, 6), (6, 7), (6, 12)]
)


@SHAPES
def test_most_extremes_are_as_accurate(shape):
    assert np.quantile(extreme_error(random(*shape)), 0.9) < 1e-10


@SHAPES
def test_all_extremes_are_within_three_thousandths(shape):
    assert extreme_error(random(*shape)).max() < 3e-3


@pytest.mark.parametrize("top", [True, False])
def test_extremes_of_clusters_are_within_three_thousandths(top):
    assert extreme_error(with_values(near(top))).max() < 3e-3


@pytest.mark.parametrize("values", EQUAL.values(), ids=EQUAL)
def test_extremes_that_are_equal_or_zero_are_within_a_ten_thousandth(values):
    assert extreme_error(with_values(values)).max() < 1e-4


def test_a_smallest_value_near_zero_keeps_its_digits():
    values = np.concatenate([np.tile([1.0, 0.8, 0.6, 0.4, 0.2], (N, 1)), 10.0 ** random(1)[:, :1] * 1e-6], axis=1)
    A = with_values(values)
    smallest, _ = extremes([as_columns(row) for row in A.transpose(1, 0, 2)])
    np.testing.assert_allclose(smallest, np.linalg.svd(A, compute_uv=False)[:, -1], rtol=1e-6)


@pytest.mark.parametrize("shape", [(3, 3), (6, 6), (6, 7), (4, 9)])
def test_isotropy_is_the_ratio_of_the_means(shape):
    A = random(*shape)
    s = np.linalg.svd(A, compute_uv=False)
    expected = s.prod(axis=1) ** (1 / s.shape[1]) / s.mean(axis=1)
    found = isotropy([as_columns(row) for row in A.transpose(1, 0, 2)])
    np.testing.assert_allclose(found, expected, rtol=0, atol=4e-7)


@pytest.mark.parametrize("shape", [(2, 2), (3, 6), (6, 6)])
def test_zeros_have_neither_extremes_nor_isotropy(shape):
    zeros = [[np.zeros(3) for _ in range(shape[1])] for _ in range(shape[0])]
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        assert not np.any([*extremes(zeros), isotropy(zeros)])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_single_precision_takes_the_rotations(dtype):
    """Equal values: the polynomial would be off by several per cent."""
    A = with_values((1.0,) * 6)
    smallest, largest = extremes([as_columns(row.astype(dtype)) for row in A.transpose(1, 0, 2)])
    assert max(np.abs(smallest - 1.0).max(), np.abs(largest - 1.0).max()) < 1e-4
