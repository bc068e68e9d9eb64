"""Traced and compiled columns compute what NumPy computes; the tape shares, folds and forgets."""

import math
from operator import add, gt, mul, neg, sub

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eiwa.core import symbols
from eiwa.core.kernel import PART, Map, trace_block
from eiwa.core.sampling import BLOCK, Stream
from eiwa.core.symbols import Symbol, Tape
from tests import arms

EPS, EPS_SINGLE = np.finfo(np.float64).eps, np.finfo(np.float32).eps


def in_unit_interval(x):
    return (x >= 0.0) & (x < 1.0)


OPERATIONS = {
    "add": lambda x, y: x + y,
    "add a number": lambda x, y: 2.5 + x,
    "subtract": lambda x, y: x - y,
    "subtract from a number": lambda x, y: 2.5 - x,
    "multiply": lambda x, y: x * y,
    "divide": lambda x, y: x / y,
    "divide a number": lambda x, y: 2.5 / y,
    "negate": lambda x, y: -x,
    "floor": lambda x, y: symbols.floor(x),
    "absolute": lambda x, y: symbols.absolute(x),
    "sqrt": lambda x, y: symbols.sqrt(symbols.absolute(x)),
    "maximum": lambda x, y: symbols.maximum(x, y),
    "maximum with a number": lambda x, y: symbols.maximum(0.5, x),
    "minimum": lambda x, y: symbols.minimum(x, y),
    "minimum with a number": lambda x, y: symbols.minimum(x, 0.5),
    "less": lambda x, y: symbols.where(x < y, x, y),
    "less or equal": lambda x, y: symbols.where(x <= 1.0, x, -y),
    "greater": lambda x, y: symbols.where(x > y, 1.0, y),
    "greater or equal": lambda x, y: symbols.where(x >= 1.0, 1.0, 0.0),
    "number greater than": lambda x, y: symbols.where(gt(1.0, x), 0.0, x),
    "and": lambda x, y: symbols.where(in_unit_interval(x), x, y),
    "dot": lambda x, y: symbols.dot([x, 2.0, y], [y, x, 3.0]),
    "cross": lambda x, y: symbols.cross([x, y, 0.0], [y, x, 1.0])[2],
    "polynomial": lambda x, y: symbols.polynomial(x, (1.0, -2.0, 0.5)),
}
TRANSCENDENTAL = {
    "sin": lambda x, y: symbols.sin(x),
    "cos": lambda x, y: symbols.cos(x),
    "sinpi": lambda x, y: symbols.sincospi(x)[0],
    "cospi": lambda x, y: symbols.sincospi(x)[1],
    "expm1": lambda x, y: symbols.expm1(-3.0 * symbols.absolute(x)),
}
PI = np.longdouble("3.14159265358979323846264338327950288")
ALL = {**OPERATIONS, **TRANSCENDENTAL}


def inputs():
    rng = np.random.default_rng(0)
    special = np.array([[0.0, 1.0], [1.0, 1.0], [-1.0, 2.0], [0.5, -0.5], [2.0, 1.0], [1.0, 0.0625]])
    near_quarter_turns = np.arange(-12, 13)[:, None] * [np.pi / 2, 1.0] + [0.0, 0.125]
    return np.concatenate([special, near_quarter_turns, rng.uniform(-20, 20, (20_000, 2))])


@pytest.fixture(scope="module")
def compiled():
    """Every operation in one kernel, at the inputs."""
    out = Map(lambda u, p: [f(*u) for f in ALL.values()], 2, 0)(inputs(), np.zeros(0))
    return dict(zip(ALL, out.T, strict=True))


@pytest.fixture(scope="module")
def compiled_single():
    out = Map(lambda u, p: [f(*u) for f in ALL.values()], 2, 0, np.float32)(inputs(), np.zeros(0))
    return dict(zip(ALL, out.T, strict=True))


@pytest.mark.parametrize("name", OPERATIONS)
def test_compiled_operation_equals_numpy(name, compiled):
    expected = OPERATIONS[name](*inputs().T)
    np.testing.assert_allclose(compiled[name], expected, rtol=4 * EPS, atol=4e2 * EPS)


@pytest.mark.parametrize("name", OPERATIONS)
def test_compiled_single_operation_equals_numpy_single(name, compiled_single):
    expected = OPERATIONS[name](*inputs().astype(np.float32).T)
    np.testing.assert_allclose(compiled_single[name], expected, rtol=4 * EPS_SINGLE, atol=4e2 * EPS_SINGLE)


@pytest.mark.parametrize(
    "name", ["floor", "absolute", "sqrt", "maximum", "minimum", "less", "greater or equal", "and", "negate"]
)
def test_compiled_operation_that_rounds_correctly_equals_numpy_exactly(name, compiled):
    np.testing.assert_array_equal(compiled[name], OPERATIONS[name](*inputs().T))


BOTH = pytest.mark.parametrize(("name", "reference"), [("sin", np.sin), ("cos", np.cos)])


@BOTH
def test_sine_and_cosine_to_the_rounding_of_the_angle(name, reference, compiled):
    x = inputs()[:, 0].astype(np.longdouble)
    assert (np.abs(compiled[name] - reference(x)) / (1 + np.abs(x))).max() < 2e-16


@BOTH
def test_sine_and_cosine_of_half_turns_within_3e_16(name, reference, compiled):
    turns = inputs()[:, 0].astype(np.longdouble)
    exact = reference(PI * (turns - 2 * np.round(turns / 2)))
    assert np.abs(compiled[f"{name}pi"] - exact).max() < 3e-16


@BOTH
def test_single_sine_and_cosine_to_the_rounding_of_the_angle(name, reference, compiled_single):
    x = inputs()[:, 0].astype(np.float32).astype(np.float64)
    assert (np.abs(compiled_single[name] - reference(x)) / (1 + np.abs(x))).max() < 1.2e-7


@BOTH
def test_single_sine_and_cosine_of_half_turns_within_1_6e_7(name, reference, compiled_single):
    turns = inputs()[:, 0].astype(np.float32).astype(np.float64)
    assert np.abs(compiled_single[f"{name}pi"] - reference(np.pi * turns)).max() < 1.6e-7


def test_expm1_from_minus_60_to_0_relative(compiled):
    expected = np.expm1(-3.0 * np.abs(inputs()[:, 0]))
    np.testing.assert_allclose(compiled["expm1"], expected, rtol=3e-15)


def test_single_expm1_from_minus_60_to_0_relative(compiled_single):
    x = inputs()[:, 0].astype(np.float32)
    expected = np.expm1(np.float32(-3.0) * np.abs(x))
    np.testing.assert_allclose(compiled_single["expm1"], expected, rtol=2e-6)


def test_expm1_of_tiny_arguments_keeps_all_digits():
    x = -np.logspace(-300, -1, 1000)[:, None]
    value = Map(lambda u, p: [symbols.expm1(u[0])], 1, 0)(x, np.zeros(0))
    np.testing.assert_allclose(value, np.expm1(x), rtol=2e-14)


def test_single_map_answers_in_single_precision():
    assert Map(lambda u, p: [u[0] + 1.0], 1, 0, np.float32)(np.zeros((3, 1)), np.zeros(0)).dtype == np.float32


def test_parameters_change_without_another_kernel():
    scaled = Map(lambda u, p: [p[0] * u[0]], 1, 1)
    x = np.ones((1, 1))
    assert [scaled(x, np.array([k]))[0, 0] for k in (2.0, 3.0)] == [2.0, 3.0]


def test_outputs_may_be_constants():
    assert Map(lambda u, p: [u[0], 3, 0.5], 1, 0)(np.ones((2, 1)), np.zeros(0)).tolist() == [[1.0, 3.0, 0.5]] * 2


@pytest.mark.parametrize("n", [0, 1, 255, 256, 257, 20_000])
def test_every_number_of_rows(n):
    x = np.arange(float(n))[:, None]
    np.testing.assert_array_equal(Map(lambda u, p: [u[0] + 1.0], 1, 0)(x, np.zeros(0)), x + 1)


# The tape.


@pytest.fixture
def tape():
    return Tape()


@pytest.fixture
def x(tape):
    return tape.node("input", 0)


@pytest.fixture
def y(tape):
    return tape.node("input", 1)


FOLDED = {
    "plus zero": lambda x: x + 0.0,
    "zero plus": lambda x: 0.0 + x,
    "minus zero": lambda x: x - 0.0,
    "times one": lambda x: x * 1.0,
    "one times": lambda x: np.float64(1.0) * x,
    "negated twice": lambda x: neg(neg(x)),
    "times minus one, negated": lambda x: -(x * -1.0),
    "zero minus, negated": lambda x: -(0.0 - x),
}


@pytest.mark.parametrize("fold", FOLDED.values(), ids=FOLDED)
def test_identities_are_folded(fold, x):
    assert fold(x).index == x.index


@pytest.mark.parametrize("zero", [0, 0.0, np.float64(0.0)])
def test_a_product_with_zero_is_the_number_zero(zero, x):
    assert (x * zero, zero * x) == (0.0, 0.0)


def test_a_parameter_is_never_folded(tape, x):
    assert isinstance(tape.node("parameter", 0) * x, Symbol)


@pytest.mark.parametrize("operation", [lambda a, b: a + b, lambda a, b: a * b])
def test_commuted_operations_are_shared(operation, x, y):
    assert operation(x, y).index == operation(y, x).index


def test_differences_are_not_commuted(x, y):
    assert (x - y).index != (y - x).index


def test_equal_subexpressions_are_shared(x, y):
    assert (x * y + 1.0).index == (y * x + 1.0).index


def test_adding_a_negated_column_is_a_difference(x, y):
    assert (x + -y).index == (x - y).index


def test_subtracting_a_negated_column_is_a_sum(x, y):
    assert (x - -y).index == (x + y).index


def test_shared_subexpression_is_computed_once():
    source, _ = trace_block(lambda u, p: [(u[0] * u[1]) + (u[1] * u[0])], 2, 0, np.dtype(float))
    assert source.count(" * ") == 1


def test_operations_that_no_output_needs_are_left_out():
    def wasteful(u, p):
        symbols.sqrt(u[0])
        return [u[0] + 1.0]

    source, _ = trace_block(wasteful, 1, 0, np.dtype(float))
    assert "sqrt" not in source


def test_single_precision_source_has_no_double_literals():
    source, _ = trace_block(lambda u, p: [u[0] + 0.1], 1, 0, np.dtype(np.float32))
    assert "np.float32(0.1)" in source


@pytest.mark.parametrize("use", [bool, lambda s: 1.0 if s < 0.5 else 0.0, lambda s: 0.0 < s < 1.0])
def test_the_truth_value_of_a_symbol_raises(use, x):
    with pytest.raises(TypeError, match="where"):
        use(x)


def test_symbols_join_true_in_an_and(x):
    condition = x < 1.0
    assert (True & condition).index == (condition & True).index == condition.index


def test_symbols_join_false_in_an_and(x):
    assert (x < 1.0) & False is False


def value_of(symbol, inputs):
    """A slow interpreter of the tape; numbers are their own value."""
    if not isinstance(symbol, Symbol):
        return symbol
    operation, operands = symbol.tape.nodes[symbol.index]
    if operation == "input":
        return inputs[operands[0]]
    if operation == "constant":
        return operands[0]
    values = [value_of(Symbol(symbol.tape, o), inputs) for o in operands]
    return {"add": add, "sub": sub, "mul": mul, "neg": neg}[operation](*values)


NUMBERS = st.sampled_from([-1.0, 0.0, 1.0, 0.5])
EXPRESSIONS = st.recursive(
    st.sampled_from(["x", "y"]) | NUMBERS,
    lambda inner: st.tuples(st.sampled_from([add, sub, mul]), inner, inner) | st.tuples(st.just(neg), inner),
    max_leaves=12,
)


def built(expression, names):
    if not isinstance(expression, tuple):
        return names.get(expression, expression)
    operation, *operands = expression
    return operation(*(built(o, names) for o in operands))


@given(EXPRESSIONS)
def test_folding_does_not_change_the_value(expression):
    tape, inputs = Tape(), (0.75, -2.25)
    traced = built(expression, {"x": tape.node("input", 0), "y": tape.node("input", 1)})
    expected = built(expression, dict(zip("xy", inputs, strict=True)))
    assert math.isclose(value_of(traced, inputs), expected, rel_tol=1e-12, abs_tol=1e-12)


def test_what_can_be_evaluated_first_comes_first(tape, x, y):
    """A chain of three, a pair beside it, their sum, and something that nobody needs."""
    chain = x * 3.0 * 5.0 * 7.0
    pair = y * 11.0
    x - y
    total = chain + pair
    order = [tape.nodes[index] for index in tape.needed([total.index])]
    assert {kind for kind, _ in order[:6]} == {"input", "constant"}
    assert [kind for kind, _ in order[6:]] == ["mul", "mul", "mul", "mul", "add"]
    assert order.index(tape.nodes[pair.index]) < order.index(tape.nodes[chain.index]) - 1


LAYOUTS = {
    "rows": np.ascontiguousarray,
    "columns": np.asfortranarray,
    "part of a longer array": lambda x: np.vstack([x, x])[: len(x)],
    "every second": lambda x: np.repeat(x, 2, axis=0)[::2],
    "reversed": lambda x: x[::-1].copy()[::-1],
    "part of wider rows": lambda x: np.hstack([x, x])[:, : x.shape[1]],
    "columns reversed": lambda x: np.asfortranarray(x[:, ::-1])[:, ::-1],
    "the same sample": lambda x: np.broadcast_to(np.arange(3.0), x.shape),
    "single precision": lambda x: x.astype(np.float32),
    "not aligned": lambda x: np.ndarray(x.shape, float, b"\0" + x.tobytes(), offset=1),
}


@pytest.fixture(scope="module")
def reading():
    """A map of two inputs, of which one column and one whole array are not read."""
    return Map(lambda u, p: [u[0] - u[2], u[0]], (3, 2), 0, outputs=(1, 1))


@pytest.mark.parametrize("laid_out", LAYOUTS.values(), ids=LAYOUTS)
@pytest.mark.parametrize("n", [0, 1, 3, 4, BLOCK, BLOCK + 1, PART + 1, 20_001])
def test_inputs_may_be_laid_out_as_they_like(reading, n, laid_out):
    x = laid_out(np.random.default_rng(0).normal(size=(n, 3)))
    difference, first = reading.parts(x, np.zeros((n, 2)), np.zeros(0))
    x = x.astype(float)
    np.testing.assert_array_equal(np.hstack([difference, first]), np.stack([x[:, 0] - x[:, 2], x[:, 0]], axis=1))


@pytest.mark.parametrize("shapes", [[(4, 2), (4, 2)], [(4, 3), (3, 2)], [(4, 3), (4, 3)], [(4, 3), (4,)], [(4, 3)]])
def test_inputs_of_other_shapes_are_refused(reading, shapes):
    """They are read by their addresses."""
    with pytest.raises(ValueError, match=r"arrays of 4 rows must have \[3, 2\] columns, not the shapes"):
        reading.parts(*map(np.zeros, shapes), np.zeros(0))


def test_one_column_of_many():
    """Nothing before it is read, and nothing before its row is written."""
    double = Map(lambda u, p: [2 * u[1], u[0]], (1, 1), 0)
    x = np.random.default_rng(0).normal(size=(9, 2, 2))
    found = double(x[:, 0, :1], x[:, 1, :1], np.zeros(0))
    np.testing.assert_array_equal(found, np.stack([2 * x[:, 1, 0], x[:, 0, 0]], axis=1))


def test_the_columns_of_postures_are_contiguous():
    """So that NumPy reads an entry of all Jacobians as quickly as it can; powers of two apart, they would share cache sets."""
    postures = arms.paper().postures(Stream("plain", 1).points(0, 4096, 6))
    for name in ("u", "q", "tips", "rotations", "jacobians"):
        strides = getattr(postures, name).strides
        assert strides[0] == 8
        assert strides[-1] // 64 % 2 == 1
