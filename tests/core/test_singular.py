"""Extreme singular values, condition and isotropy on columns against LAPACK."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eiwa.core.kernel import Map
from eiwa.core.singular import extremes, inverse_condition, isotropy
from eiwa.core.symbols import as_columns, root
from tests import arms

N = 2000
SHAPES = [
    (1, 6),
    (2, 2),
    (2, 6),
    (3, 3),
    (3, 4),
    (3, 12),
    (4, 3),
    (4, 4),
    (6, 4),
    (5, 12),
    (6, 6),
    (6, 7),
    (6, 12),
    (12, 6),
]
PRECISIONS = pytest.mark.parametrize("dtype", [np.float64, np.float32], ids=["f64", "f32"])
DOUBLE = np.finfo(float).eps


def random(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=(N, *shape))


def with_values(values, seed=1):
    values = np.asarray(values, float)
    n = values.shape[-1]
    U, V = (np.linalg.qr(random(n, n, seed=seed + k))[0] for k in range(2))
    return (U * values[..., None, :]) @ V


def on_columns(function, A, dtype=float):
    """Nothing overflows, nothing is divided by zero, nothing is NaN; underflow is what tiny squares do."""
    columns = [[np.ascontiguousarray(A[:, i, j], dtype) for j in range(A.shape[2])] for i in range(A.shape[1])]
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        return function(columns)


def errors(A, dtype=float):
    """Error of the smallest and of the largest value, relative to the largest, per sample."""
    expected = np.linalg.svd(A, compute_uv=False)
    found = on_columns(extremes, A, dtype)
    assert all(value.dtype == dtype for value in found)
    difference = np.abs(np.stack(found) - expected[:, [-1, 0]].T)
    return difference / np.maximum(expected[:, 0], 1e-300)


@pytest.mark.parametrize("shape", SHAPES)
def test_nearly_all_are_those_of_lapack(shape):
    """Beyond rounding only where three of the values that are random here happen to lie close together."""
    error = errors(random(*shape))
    assert np.quantile(error, 0.9) < 1e-12
    assert error.max() < (1e-12 if min(shape) <= 3 else 3e-3)


@pytest.mark.parametrize("shape", SHAPES)
def test_in_single_precision_nearly_all_are_those_of_lapack(shape):
    error = errors(random(*shape), np.float32)
    assert np.quantile(error, 0.9) < 2e-5
    assert error.max() < (2e-4 if min(shape) <= 3 else 3e-3)


ARMS = {"paper": arms.paper(limits=(-2, 2)), "panda": arms.panda(), "mtm": arms.mtm(), "touch": arms.touch()}


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_on_arms_they_are_as_accurate_as_stated(arm):
    """Their smallest values also relative to themselves."""
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper, (20 * N, arm.dof))
    J = arms.forward(arm, q)[2] * np.repeat([5.0, 1.0], 3)[:, None]
    error = errors(J)
    assert np.quantile(error, 0.99) < 1e-6
    assert error.max() < 4e-4
    assert errors(J, np.float32).max() < 1e-3
    smallest = np.linalg.svd(J, compute_uv=False)[:, -1]
    relative = np.abs(on_columns(extremes, J)[0] / smallest - 1)
    assert np.quantile(relative[smallest > 1e-3], 0.99) < 1e-5


@PRECISIONS
@pytest.mark.parametrize(
    "values",
    [(1.0,) * 6, (1.0,) * 3, (1.0, 0.5, 0.5, 0.5, 0.5, 0.1), (3.0, 3.0, 1.0), (3.0, 1.0, 1.0), (2.0, 2.0)],
    ids=str,
)
def test_equal_values(values, dtype):
    bound = 4e-6 if dtype is np.float64 else 5e-3
    assert errors(np.broadcast_to(np.diag(values), (N, len(values), len(values))), dtype).max() < bound
    if dtype is np.float64:
        assert errors(with_values(values)).max() < 1e-4


@pytest.mark.parametrize(("n", "bound", "single"), [(3, 1e-5, 5e-3), (4, 3e-3, 0.2), (6, 3e-3, 0.2)])
def test_values_that_nearly_coincide_are_as_accurate_as_stated(n, bound, single):
    generator = np.random.default_rng(3)
    width, count = 10.0 ** generator.uniform(-10, -0.5, (N, 1)), generator.integers(2, n + 1, (N, 1))
    near = np.where(
        np.arange(n) < count, 1.0 + width * generator.uniform(size=(N, n)), 10.0 ** generator.uniform(-2, 1, (N, n))
    )
    assert errors(with_values(near)).max() < bound
    assert errors(with_values(near), np.float32).max() < single


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_a_graded_matrix(n):
    graded = 10.0 ** np.random.default_rng(4).uniform(-7, 0, (N, n))
    graded[:, 0] = 1.0
    assert np.quantile(errors(with_values(graded))[0], 0.99) < 1e-5
    assert errors(with_values(graded)).max() < 2e-3


def test_a_small_smallest_value_keeps_its_leading_digits():
    """Which it would not through a Gram matrix."""
    for n in (3, 6):
        A = with_values([2.0, 1.5, 1.0, 0.7, 0.5, 0.3][: n - 1] + [1e-6])
        np.testing.assert_allclose(on_columns(extremes, A)[0], 1e-6, rtol=1e-7)


@PRECISIONS
@pytest.mark.parametrize("rank", range(1, 6))
def test_a_rank_deficient_matrix_has_a_zero(rank, dtype):
    A = random(6, rank) @ random(rank, 6, seed=1)
    zero = 1e-8 if dtype is np.float64 else 5e-6
    assert errors(A, dtype)[0].max() < zero
    assert on_columns(inverse_condition, A, dtype).max() < zero


@PRECISIONS
@pytest.mark.parametrize("shape", [(1, 4), (2, 2), (3, 3), (3, 6), (4, 4), (6, 6), (6, 9)])
def test_zeros(shape, dtype):
    zeros = np.zeros((3, *shape))
    assert not np.any(on_columns(extremes, zeros, dtype))
    assert not np.any(on_columns(inverse_condition, zeros, dtype))
    assert not np.any(on_columns(isotropy, zeros, dtype))


@pytest.mark.parametrize("shape", SHAPES)
def test_the_inverse_condition_is_their_ratio(shape):
    A = random(*shape)
    smallest, largest = on_columns(extremes, A)
    np.testing.assert_allclose(on_columns(inverse_condition, A), smallest / largest, rtol=1e-12)


@PRECISIONS
@pytest.mark.parametrize("shape", SHAPES)
def test_isotropy_is_geometric_over_arithmetic_mean(shape, dtype):
    A = random(*shape)
    s = np.linalg.svd(A, compute_uv=False)
    expected = np.exp(np.log(s).mean(axis=1)) / s.mean(axis=1)
    regular = s[:, -1] > (1e-3 if dtype is np.float32 else 0) * s[:, 0]
    found = on_columns(isotropy, A, dtype)[regular]
    np.testing.assert_allclose(found, expected[regular], rtol=1e-6 if dtype is np.float64 else 1e-4)


def test_isotropy_of_a_singular_matrix_is_zero():
    assert not np.any(on_columns(isotropy, random(6, 5) @ random(5, 6, seed=1)))


@given(st.floats(1e-6, 1e6), st.sampled_from([2, 3, 5, 6]))
def test_a_factor_passes_through(factor, n):
    A = with_values(np.geomspace(1.0, 0.01, n))[:5]
    for found, expected in zip(on_columns(extremes, factor * A), (0.01, 1.0), strict=True):
        np.testing.assert_allclose(found, factor * expected, rtol=1e-8)
    np.testing.assert_allclose(on_columns(inverse_condition, factor * A), 0.01, rtol=1e-8)


def test_numbers_will_do_for_columns():
    """As in an arm whose Jacobian is constant."""
    assert extremes([[3.0, 0.0], [0.0, -4.0]]) == pytest.approx((3.0, 4.0), rel=1e-14)
    assert inverse_condition(np.eye(3).tolist()) == 1.0
    assert isotropy(np.eye(6).tolist()) == pytest.approx(1.0, abs=1e-6)


def functions(x, p):
    """Six rows with constants among them, three rows, roots."""
    sixth = [[*x[5 * k : 5 * k + 5], 0.0] for k in range(5)] + [[0.0, x[25], 1.0, 0.0, x[26], x[27]]]
    third = [x[:3], x[3:6], [0.0, 1.0, x[6]]]
    return [*extremes(sixth), inverse_condition(third), isotropy(third), root(x[28], 3), root(x[28], 5), root(x[28], 6)]


@PRECISIONS
def test_compiled_they_are_the_same_and_never_nan(dtype):
    """Columns that vanish, equal values."""
    x = random(29, seed=5)
    x[:, 28] = np.minimum(np.abs(x[:, 28]) / 3, 1)
    for k in range(29):
        x[20 * k : 20 * k + 10, k] = 0.0
    x[:10, :28] = 0.0
    x[600:610] = 0.5
    x = x.astype(dtype).astype(float)
    out = Map(functions, 29, 0, dtype)(x, np.zeros(0))
    expected = np.stack(np.broadcast_arrays(*functions(as_columns(x), None)), axis=-1)
    tolerance = 2e-7 if dtype is np.float64 else 2e-2
    assert np.isfinite(out).all()
    np.testing.assert_allclose(out[:, :4], expected[:, :4], rtol=0, atol=tolerance)
    assert np.quantile(np.abs(out - expected), 0.95) < (1e-13 if dtype is np.float64 else 1e-5)
    np.testing.assert_allclose(out[:, 4:], expected[:, 4:], rtol=1e-13 if dtype is np.float64 else 2e-6)
