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
        self._depths: list[int] = []

    def node(self, operation: str, *operands: Any) -> Symbol:
        """The symbol of ``operation(*operands)``; the same one when it was asked for before."""
        key = (operation, operands)
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(key)
            self._depths.append(1 + max((self._depths[o] for o in self._read(key)), default=0))
        return Symbol(self, self._known[key])

    def needed(self, roots: Iterable[int]) -> list[int]:
        """Indices of the nodes that the roots depend on, in evaluation order: what can be evaluated first comes first.

        In the order of the formula the compiled code would wait more often for what it has just begun.
        """
        alive: set[int] = set()
        stack = list(roots)
        while stack:
            index = stack.pop()
            if index not in alive:
                alive.add(index)
                stack.extend(self._read(self.nodes[index]))
        return sorted(alive, key=lambda index: (self._depths[index], index))

    @staticmethod
    def _read(node: tuple[str, tuple[Any, ...]]) -> tuple[int, ...]:
        operation, operands = node
        return () if operation in LEAVES else operands


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
    if isinstance(a, Symbol) and isinstance(b, Symbol) and a.index == b.index:
        return 0.0
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
    if isinstance(condition, bool | np.bool_):
        return a if condition else b
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


# Near-minimax polynomials through Chebyshev nodes, fitted with 60 digits, for |f| <= 1/2 and t = f^2:
# sin(pi f) = f (pi + t S(t)), cos(pi f) = 1 + t C(t). Absolute errors: double 6e-17, single 3e-8.
_SIN = (math.pi, -5.16771278004997, 2.55016403987734, -0.599264529320343, 0.08214588659675226, -0.007370430719633729,
        0.0004663008741094753, -2.190620163783774e-05, 7.725742817962156e-07)  # fmt: skip
_COS = (1.0, -4.934802200544679, 4.058712126416736, -1.3352627688518803, 0.23533063027215728, -0.025806890025870218,
        0.0019295626524467701, -0.00010458286357897863, 4.166399334389581e-06)  # fmt: skip
_SIN_SINGLE = (math.pi, -5.167712562122931, 2.5501361313427724, -0.5987048572826335, 0.07853971163817813)
_COS_SINGLE = (1.0, -4.934802196986968, 4.0587114146807455, -1.3352399606363405, 0.2350743678407016,
               -0.024627110494749145)  # fmt: skip


def rounded(x: Symbol) -> tuple[Symbol, Symbol]:
    """The integer next to x, and the sum in whose lowest bits it stands: x plus 1.5 times 2 to the bits of a fraction."""
    shift = 1.5 * 2.0 ** (23 if x.tape.single else 52)
    shifted = x + shift
    return shifted - shift, shifted


def sincos(x: Column) -> tuple[Column, Column]:
    """Sine and cosine [x in rad], within 2e-16 (1 + |x|) (single: 1.2e-7).

    Symbols are expanded into polynomials because libm does not vectorise.
    """
    return sincospi(x * (1.0 / math.pi)) if isinstance(x, Symbol) else (np.sin(x), np.cos(x))


def sincospi(h: Column) -> tuple[Column, Column]:
    """Sine and cosine of h half turns, within 3e-16 for |h| < 2^50 (single: 1.6e-7 for |h| < 2^21)."""
    if not isinstance(h, Symbol):
        return np.sin(np.pi * h), np.cos(np.pi * h)
    tape, single = h.tape, h.tape.single
    n, shifted = rounded(h)
    f = h - n
    t = f * f
    sine = f * polynomial(t, _SIN_SINGLE if single else _SIN)
    cosine = polynomial(t, _COS_SINGLE if single else _COS)
    return tape.node("flip", sine.index, shifted.index), tape.node("flip", cosine.index, shifted.index)


def sin(x: Column) -> Column:
    """Sine [x in rad]."""
    return sincos(x)[0]


def cos(x: Column) -> Column:
    """Cosine [x in rad]."""
    return sincos(x)[1]


# expm1(r) = r + r^2 P(r) for |r| <= ln(2) / 2, fitted in the same way. Relative errors: double 4e-17, single 2e-8.
_EXPM1 = (0.5000000000000001, 0.16666666666666669, 0.041666666666624164, 0.008333333333330065, 0.0013888888917196881,
          0.0001984126986304067, 2.4801521322116825e-05, 2.7557268480116333e-06, 2.762007599981065e-07,
          2.5100375924709717e-08)  # fmt: skip
_EXPM1_SINGLE = (0.5, 0.16666577025255677, 0.04166655466162291, 0.00836317313152351, 0.0013926176191150312)


def expm1(x: Column) -> Column:
    """exp(x) - 1 for x <= 0, to 3e-15 of its value (single: 2e-6)."""
    if not isinstance(x, Symbol):
        return np.expm1(x)
    x = maximum(x, -40.0)
    n, shifted = rounded(x * (1.0 / math.log(2.0)))
    r = x - n * math.log(2.0)
    power = x.tape.node("power", shifted.index)
    return power * (r + (r * r) * polynomial(r, _EXPM1_SINGLE if x.tape.single else _EXPM1)) + (power - 1.0)


def root(x: Column, k: int) -> Column:
    """k-th root of x in [0, 1], k from 1 to 6, to 1e-14 of its value (single: 1e-6); 0 for an odd root of less than 1e-16.

    Symbols: from a power of x made of square roots by four of Halley's steps.
    """
    if not isinstance(x, Symbol):
        return np.power(x, 1.0 / k)
    if k % 2 == 0:
        return root(sqrt(x), k // 2)
    if k == 1:
        return x
    some = x > 1e-16
    x = where(some, x, 1.0)
    quarter = sqrt(sqrt(x))
    sixteenth = sqrt(sqrt(quarter))
    y = sixteenth * (quarter if k == 3 else sqrt(quarter))
    for _ in range(4):
        power = y * y * y if k == 3 else (y * y) * (y * y) * y
        y = y * ((k - 1.0) * power + (k + 1.0) * x) / ((k + 1.0) * power + (k - 1.0) * x)
    return where(some, y, 0.0)


def polynomial(x: Column, coefficients: Sequence[float]) -> Column:
    """Sum of coefficients[k] x^k by Horner's rule."""
    total: Column = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = total * x + c
    return total


def stride(samples: int, dtype: Any = np.float64) -> int:
    """Distance of two rows of so many samples, an odd number of cache lines, so that rows do not share cache sets."""
    line = 64 // int(np.dtype(dtype).itemsize)
    return (-(-samples // line) | 1) * line


def empty_rows(n: int, width: int, dtype: Any = np.float64) -> NDArray[Any]:
    """Rows for ``width`` columns of n entries, a :func:`stride` long."""
    return np.empty((width, stride(n, dtype)), dtype)


def as_columns(array: NDArray[np.floating[Any]]) -> list[Column]:
    """The columns of an (n, k) array."""
    return list(np.ascontiguousarray(array.T))
