"""Arithmetic on columns, where a column is a NumPy array of samples or a symbol.

An arm or an index writes its formulas once, with ``+ - * /`` and the functions of this module. Fed with
arrays it computes; fed with symbols it is *traced*: every operation becomes a node of a :class:`Tape`
(equal nodes are shared, constants folded), and :mod:`eiwa.core.kernel` writes the nodes that matter as one
straight-line loop body. Data-dependent Python branches are not traceable: use :func:`where`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Column: TypeAlias = Any
"""A float, a NumPy array with one entry a sample, or a :class:`Symbol`."""


class Tape:
    """The operations of one traced function, in an order in which they can be evaluated."""

    def __init__(self, single: bool = False) -> None:
        self.single = single
        self.nodes: list[tuple[str, tuple[Any, ...]]] = []
        self._known: dict[tuple[str, tuple[Any, ...]], int] = {}

    def node(self, operation: str, *operands: Any) -> Symbol:
        """The symbol of ``operation(*operands)``; the same one when it was asked for before."""
        key = (operation, operands)
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(key)
        return Symbol(self, self._known[key])

    def needed(self, roots: Iterable[int]) -> list[int]:
        """Indices of the nodes that the roots depend on, in evaluation order."""
        alive: set[int] = set()
        stack = list(roots)
        while stack:
            index = stack.pop()
            if index not in alive:
                alive.add(index)
                operation, operands = self.nodes[index]
                stack.extend(o for o in operands if isinstance(o, int) and operation not in LEAVES)
        return sorted(alive)


LEAVES = ("input", "parameter", "constant")


class Symbol:
    """One node of a tape; arithmetic on it adds nodes."""

    __slots__ = ("index", "tape")
    __array_ufunc__ = None

    def __init__(self, tape: Tape, index: int) -> None:
        self.tape = tape
        self.index = index

    def __bool__(self) -> bool:
        raise TypeError("a traced column has no truth value: use eiwa.core.symbols.where")

    def __hash__(self) -> int:
        return self.index

    def __neg__(self) -> Column:
        operation, operands = self.tape.nodes[self.index]
        return Symbol(self.tape, operands[0]) if operation == "neg" else self.tape.node("neg", self.index)

    def __add__(self, other: Column) -> Column:
        return _add(self, other)

    def __radd__(self, other: Column) -> Column:
        return _add(self, other)

    def __sub__(self, other: Column) -> Column:
        return _subtract(self, other)

    def __rsub__(self, other: Column) -> Column:
        return _subtract(other, self)

    def __mul__(self, other: Column) -> Column:
        return _multiply(self, other)

    def __rmul__(self, other: Column) -> Column:
        return _multiply(self, other)

    def __truediv__(self, other: Column) -> Column:
        return _binary("div", self, other) if other is not self else 1.0

    def __rtruediv__(self, other: Column) -> Column:
        return _binary("div", other, self)

    def __lt__(self, other: Column) -> Column:
        return _binary("lt", self, other)

    def __le__(self, other: Column) -> Column:
        return _binary("le", self, other)

    def __gt__(self, other: Column) -> Column:
        return _binary("lt", other, self)

    def __ge__(self, other: Column) -> Column:
        return _binary("le", other, self)

    def __and__(self, other: Column) -> Column:
        if isinstance(other, bool | np.bool_):
            return self if other else False
        return _binary("and", self, other)

    __rand__ = __and__


def _is(value: Column, number: float) -> bool:
    return not isinstance(value, Symbol | np.ndarray) and value == number


def _binary(operation: str, a: Column, b: Column) -> Symbol:
    tape = a.tape if isinstance(a, Symbol) else b.tape
    return tape.node(operation, _lift(tape, a).index, _lift(tape, b).index)


def _lift(tape: Tape, value: Column) -> Symbol:
    if isinstance(value, Symbol):
        return value
    if not math.isfinite(value):
        raise ValueError(f"a traced formula has the constant {value}: use a finite number")
    return tape.node("constant", float(value))


def _commuted(operation: str, a: Symbol, b: Column) -> Symbol:
    b = _lift(a.tape, b)
    first, second = sorted((a.index, b.index))
    return a.tape.node(operation, first, second)


def _add(a: Symbol, b: Column) -> Column:
    if _is(b, 0.0):
        return a
    if isinstance(b, Symbol) and b.tape.nodes[b.index][0] == "neg":
        return _subtract(a, -b)
    return _commuted("add", a, b)


def _subtract(a: Column, b: Column) -> Column:
    if _is(b, 0.0):
        return a
    if _is(a, 0.0):
        return -b
    if isinstance(b, Symbol) and b.tape.nodes[b.index][0] == "neg":
        return a + (-b)
    return _binary("sub", a, b)


def _multiply(a: Symbol, b: Column) -> Column:
    if _is(b, 0.0):
        return 0.0
    if _is(b, 1.0):
        return a
    if _is(b, -1.0):
        return -a
    return _commuted("mul", a, b)


def where(condition: Column, a: Column, b: Column) -> Column:
    """``a`` where the condition holds, else ``b``."""
    if isinstance(condition, Symbol):
        tape = condition.tape
        return tape.node("select", condition.index, _lift(tape, a).index, _lift(tape, b).index)
    return np.where(condition, a, b)


def sqrt(x: Column) -> Column:
    """Square root."""
    return x.tape.node("sqrt", x.index) if isinstance(x, Symbol) else np.sqrt(x)


def floor(x: Column) -> Column:
    """Largest integer not above x, as a float."""
    return x.tape.node("floor", x.index) if isinstance(x, Symbol) else np.floor(x)


def absolute(x: Column) -> Column:
    """Absolute value."""
    return x.tape.node("abs", x.index) if isinstance(x, Symbol) else np.abs(x)


def maximum(a: Column, b: Column) -> Column:
    """The larger of two columns."""
    traced = isinstance(a, Symbol) or isinstance(b, Symbol)
    return where(a < b, b, a) if traced else np.maximum(a, b)


def minimum(a: Column, b: Column) -> Column:
    """The smaller of two columns."""
    traced = isinstance(a, Symbol) or isinstance(b, Symbol)
    return where(b < a, b, a) if traced else np.minimum(a, b)


def dot(a: Sequence[Column], b: Sequence[Column]) -> Column:
    """Inner product of two short vectors of columns."""
    total: Column = 0.0
    for x, y in zip(a, b, strict=True):
        total = x * y + total
    return total


def cross(a: Sequence[Column], b: Sequence[Column]) -> list[Column]:
    """Cross product of two 3-vectors of columns."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


# Near-minimax polynomials through Chebyshev nodes on [-pi/2, pi/2], fitted with 60 digits:
# sin(r) = r + r^3 S(r^2), cos(r) = 1 - r^2/2 + r^4 C(r^2). Absolute errors: double 7e-17, single 3e-8.
_SIN = (-0.16666666666666666, 0.008333333333333316, -0.00019841269841254974, 2.755731921916321e-06,
        -2.5052107616993267e-08, 1.6058977312275076e-10, -7.643970290763911e-13, 2.73144469174093e-15)  # fmt: skip
_COS = (0.04166666666666666, -0.0013888888888884767, 2.4801587298913537e-05, -2.755731857336371e-07,
        2.0876681558653064e-09, -1.1466252251226389e-11, 4.646435833977799e-14)  # fmt: skip
_SIN_SINGLE = (-0.16666665963818528, 0.008333242134838725, -0.000198227394537892, 2.63475627893445e-06)
_COS_SINGLE = (0.041666666078304146, -0.001388881255103052, 2.4786082410736204e-05, -2.6546064858882037e-07)
# pi in parts short enough that n * part is exact for |n| < 2^20 (single: 2^14).
_PI_PARTS = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)
_PI_PARTS_SINGLE = (3.140625, 0.0009670257568359375, 6.278329573009626e-07)


def sincos(x: Column) -> tuple[Column, Column]:
    """Sine and cosine [x in rad]; symbols are expanded into polynomials because libm does not vectorise."""
    if not isinstance(x, Symbol):
        return np.sin(x), np.cos(x)
    single = x.tape.single
    n = floor(x * (1.0 / math.pi) + 0.5)
    r = x
    for part in _PI_PARTS_SINGLE if single else _PI_PARTS:
        r = r - n * part
    sign = 1.0 - 2.0 * (n - 2.0 * floor(n * 0.5))
    t = r * r
    sine = r + (r * t) * polynomial(t, _SIN_SINGLE if single else _SIN)
    cosine = (1.0 - 0.5 * t) + (t * t) * polynomial(t, _COS_SINGLE if single else _COS)
    return sign * sine, sign * cosine


def sin(x: Column) -> Column:
    """Sine [x in rad]."""
    return sincos(x)[0]


def cos(x: Column) -> Column:
    """Cosine [x in rad]."""
    return sincos(x)[1]


_EXPM1_HALVINGS = 8
_EXPM1_TERMS = (12, 7)


def expm1(x: Column) -> Column:
    """exp(x) - 1 for x <= 0, to about 1e-14 of its value (single: 1e-6).

    From expm1(2 y) = expm1(y) (expm1(y) + 2): halve, sum the series, double again.
    """
    if not isinstance(x, Symbol):
        return np.expm1(x)
    y = maximum(x, -40.0) * (0.5**_EXPM1_HALVINGS)
    terms = _EXPM1_TERMS[x.tape.single]
    e = y * polynomial(y, [1.0 / math.factorial(k) for k in range(1, terms)])
    for _ in range(_EXPM1_HALVINGS):
        e = e * (e + 2.0)
    return e


def polynomial(x: Column, coefficients: Sequence[float]) -> Column:
    """Sum of coefficients[k] x^k by Horner's rule."""
    total: Column = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = total * x + c
    return total


def as_columns(array: NDArray[np.floating[Any]]) -> list[Column]:
    """The columns of an (n, k) array."""
    return list(np.ascontiguousarray(array.T))
