"""Arithmetic in study files equals Python's, and nothing but arithmetic is possible."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eiwa.core.errors import SpecError
from eiwa.core.expressions import Expression, in_order

VALUES = {"reach": 0.37, "split": 0.61, "n": -2.5}

numbers = st.floats(0, 1e6).map(repr) | st.sampled_from(["0.0", "0.5", "1.0", "2.0"])
operands = numbers | st.sampled_from(sorted(VALUES))
arithmetic = st.recursive(
    operands,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "**"]), inner).map(" ".join),
        inner.map("({})".format),
        inner.map("-{}".format),
        inner.map("+{}".format),
    ),
    max_leaves=12,
)


def value(text, values=VALUES):
    return Expression("search.x", text).evaluate(values)


def refused(text, values=VALUES):
    with pytest.raises(SpecError) as error:
        value(text, values)
    (line,) = error.value.findings
    assert line.startswith("search.x = ")
    return line


@given(arithmetic)
def test_equals_pythons_own_arithmetic(text):
    try:
        expected = eval(text, {"__builtins__": {}}, dict(VALUES))
    except ArithmeticError:
        expected = None
    if expected is None or isinstance(expected, complex) or not math.isfinite(expected):
        refused(text)
    else:
        assert value(text) == expected


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_reads_its_variables(a, b):
    assert value("a * b - (a - b) / 2", {"a": a, "b": b}) == a * b - (a - b) / 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 + 2 * 3", 7.0),
        ("(1 + 2) * 3", 9.0),
        ("-2 ** 2", -4.0),
        ("2 ** 3 ** 2", 512.0),
        ("1 - 2 - 3", -4.0),
        ("1e-3", 1e-3),
    ],
)
def test_precedence(text, expected):
    assert value(text) == expected


def test_a_whole_number_is_a_float():
    assert type(value("2")) is float


@pytest.mark.parametrize(
    "text",
    [
        "max(reach, split)",
        "__import__('os').system('true')",
        "reach[split]",
        "reach['a']",
        "(reach + 1).real",
        "[1, 2]",
        "(1, 2)",
        "{1: 2}",
        "'text'",
        "f'{reach}'",
        "1j",
        "True",
        "None",
        "...",
        "reach % 2",
        "reach // 2",
        "reach @ split",
        "1 << 40",
        "reach & 1",
        "~1",
        "not reach",
        "reach < split",
        "reach and split",
        "reach if split else n",
        "lambda: 1",
        "(reach := 2)",
        "[x for x in (1, 2)]",
        "yield_ == 1",
    ],
)
def test_anything_else_is_refused(text):
    line = refused(text)
    assert "is not allowed here" in line or "is not an expression" in line
    assert "Allowed are numbers, names of variables" in line


@pytest.mark.parametrize(
    "text",
    [
        "",
        "reach *",
        "reach split",
        "1; 2",
        "import os",
        "x = 1",
        "1\0",
        "(" * 5000 + "1" + ")" * 5000,
        "-" * 50_000 + "1",
        "+".join(["1"] * 20_000),
        "9" * 5000,
    ],
    ids=lambda text: text[:12] or "empty",
)
def test_what_is_no_expression(text):
    assert "is not an expression" in refused(text)


@pytest.mark.parametrize(
    "text",
    [
        "1 / 0",
        "reach / (split - split)",
        "0 ** -1",
        "9 ** 9 ** 9",
        "10 ** 400",
        "10 ** 400 * reach",
        "9" * 400,
        "1e400",
        "1e308 * 10",
        "1e400 - 1e400",
    ],
    ids=lambda text: text[:12],
)
def test_what_has_no_finite_value(text):
    refused(text)


@pytest.mark.parametrize("text", ["n ** 0.5", "-(n ** 0.5)", "n ** 0.5 + 1", "2 * n ** 0.5", "(n ** 0.5) ** 2"])
def test_complex_powers_are_refused(text):
    refused(text)


def test_a_message_tells_the_values():
    assert "with reach = 0.37." in refused("reach / 0")


def test_names():
    assert Expression("p", "a * (b + 2) ** -a").names == {"a", "b"}


def expressions(**texts):
    return {name: Expression(f"variables.{name}", text) for name, text in texts.items()}


def test_each_comes_after_what_it_reads():
    order = in_order(expressions(a="b + c", b="c * 2", c="low", d="a - b"), frozenset({"low"}))
    assert sorted(order) == ["a", "b", "c", "d"]
    assert order.index("c") < order.index("b") < order.index("a") < order.index("d")


@pytest.mark.parametrize(
    ("texts", "ring"),
    [
        ({"a": "a + 1"}, {"a -> a"}),
        ({"a": "b", "b": "a"}, {"a -> b -> a", "b -> a -> b"}),
        ({"a": "b", "b": "c", "c": "a", "d": "1"}, {"a -> b -> c -> a", "b -> c -> a -> b", "c -> a -> b -> c"}),
    ],
)
def test_a_circle_is_told(texts, ring):
    with pytest.raises(SpecError) as error:
        in_order(expressions(**texts), frozenset())
    (line,) = error.value.findings
    path, _, told = line.partition(": the variables read each other in a circle: ")
    assert told.rstrip(".") in ring
    assert path.removeprefix("variables.") in texts


def test_an_unknown_name():
    with pytest.raises(SpecError) as error:
        in_order(expressions(a="raech * 2"), frozenset({"reach", "layout.spacing"}))
    (line,) = error.value.findings
    assert line == "variables.a = 'raech * 2': raech is not a variable. Known: a, reach."
