"""volume() against singular values, determinant against LAPACK."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eiwa.core.kernel import Map
from eiwa.core.linear import determinant, volume

SHAPES = [(rows, columns) for rows in range(1, 7) for columns in range(1, 13)]


def on_columns(function, matrices):
    """A function of a matrix of columns, at a stack of matrices (n, rows, columns)."""
    value = function([[matrices[:, i, j] for j in range(matrices.shape[2])] for i in range(matrices.shape[1])])
    return np.broadcast_to(value, len(matrices))


def singular_product(matrices):
    return np.linalg.svd(matrices, compute_uv=False).prod(axis=-1)


def size(matrices):
    """Product of the lengths of the shorter side's vectors: the largest volume they could have (Hadamard)."""
    shorter = matrices if matrices.shape[1] <= matrices.shape[2] else matrices.transpose(0, 2, 1)
    return np.linalg.norm(shorter, axis=2).prod(axis=1)


@pytest.mark.parametrize("shape", SHAPES)
def test_volume_is_the_product_of_the_singular_values(shape):
    A = np.random.default_rng(0).normal(size=(200, *shape))
    error = np.abs(on_columns(volume, A) - singular_product(A))
    assert (error / size(A)).max() < 1e-14


@pytest.mark.parametrize("shape", [(3, 3), (3, 5), (5, 3), (6, 6), (6, 7), (6, 12), (6, 4)])
def test_volume_near_a_singularity_keeps_its_digits(shape):
    """A Gram determinant would square the condition number and lose four of the digits asked for."""
    U, s, Vt = np.linalg.svd(np.random.default_rng(1).normal(size=(200, *shape)), full_matrices=False)
    s[:, -1] = 1e-6
    A = (U * s[:, None, :]) @ Vt
    np.testing.assert_allclose(on_columns(volume, A), s.prod(axis=1), rtol=1e-8)


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (5, 3), (6, 6), (6, 7), (6, 12), (6, 4)])
def test_volume_of_a_rank_deficient_matrix_vanishes(shape):
    rng = np.random.default_rng(2)
    k = min(shape) - 1
    A = rng.normal(size=(200, shape[0], k)) @ rng.normal(size=(200, k, shape[1]))
    assert (on_columns(volume, A) / size(A)).max() < 1e-14


@pytest.mark.parametrize("shape", SHAPES)
def test_volume_of_zeros_is_zero(shape):
    assert on_columns(volume, np.zeros((1, *shape))) == [0.0]


@pytest.mark.parametrize("shape", [(2, 3), (3, 2), (6, 7)])
def test_volume_with_a_zero_row_or_column_is_zero(shape):
    A = np.random.default_rng(3).normal(size=(10, *shape))
    shorter = A if shape[0] < shape[1] else A.transpose(0, 2, 1)
    shorter[:, 0] = 0.0
    np.testing.assert_array_equal(on_columns(volume, A), 0.0)


@pytest.mark.parametrize("shape", [(2, 3), (3, 2), (3, 3)])
def test_volume_of_numbers(shape):
    A = np.random.default_rng(4).normal(size=shape)
    assert volume(A.tolist()) == pytest.approx(singular_product(A), rel=1e-13)


@given(st.floats(1e-3, 1e3), st.integers(0, 1000))
def test_volume_of_six_rows_scales_with_the_cube_of_the_length(scale, seed):
    """A Jacobian's linear rows carry the length."""
    J = np.random.default_rng(seed).normal(size=(1, 6, 7))
    scaled = J * np.array([scale] * 3 + [1.0] * 3)[:, None]
    assert on_columns(volume, scaled)[0] == pytest.approx(scale**3 * on_columns(volume, J)[0], rel=1e-9)


@pytest.mark.parametrize("shape", [(3, 5), (5, 3), (4, 4)])
def test_compiled_volume(shape):
    rows, columns = shape
    A = np.random.default_rng(5).normal(size=(300, *shape))
    A[0] = 0.0

    def traced(u, p):
        return [volume([u[i * columns : (i + 1) * columns] for i in range(rows)])]

    value = Map(traced, rows * columns, 0)(A.reshape(300, -1), np.zeros(0))[:, 0]
    assert np.abs(value - singular_product(A)).max() < 1e-12


@pytest.mark.parametrize("n", range(1, 7))
def test_determinant(n):
    A = np.random.default_rng(6).normal(size=(200, n, n))
    error = np.abs(on_columns(determinant, A) - np.linalg.det(A))
    assert (error / size(A)).max() < 1e-14


def test_determinant_of_a_permutation_has_its_sign():
    cycle = np.roll(np.eye(4), 1, axis=0)[None]
    assert on_columns(determinant, cycle)[0] == -1.0
