"""Arithmetic in study files: numbers, names, + - * / **, parentheses; nothing else, so nothing can be run.

A name is a variable's (``reach``) or a path (``arm.joints.upper.a``, ``layout.offset[1]``).
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter

from eiwa.core.errors import SpecError, finding

_BINARY: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_UNARY: dict[type[ast.unaryop], Callable[[float], float]] = {ast.UAdd: operator.pos, ast.USub: operator.neg}
ALLOWED = "Allowed are numbers, names of variables, + - * / ** and parentheses."


@dataclass(frozen=True)
class Expression:
    """An arithmetic expression, and the TOML path it was written at."""

    path: str
    text: str

    @cached_property
    def _root(self) -> ast.expr:
        try:
            root = ast.parse(self.text, mode="eval").body
            self._check(root)
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise SpecError(finding(self.path, "is not an expression.", value=self.text, remedy=ALLOWED)) from None
        return root

    def _check(self, node: ast.AST) -> None:
        number = isinstance(node, ast.Constant) and type(node.value) in (int, float)
        if number or _name(node):
            return
        known = isinstance(node, ast.BinOp | ast.UnaryOp) or type(node) in _BINARY or type(node) in _UNARY
        if not known:
            what = type(node).__name__.lower()
            problem = f"{'an' if what[0] in 'aeiou' else 'a'} {what} is not allowed here."
            raise SpecError(finding(self.path, problem, value=self.text, remedy=ALLOWED))
        for part in ast.iter_child_nodes(node):
            self._check(part)

    @cached_property
    def names(self) -> frozenset[str]:
        """Variables and paths that the expression reads."""
        return frozenset(_names(self._root))

    def evaluate(self, values: Mapping[str, float]) -> float:
        """The expression's value; raises SpecError for a division by zero, an overflow or a complex power."""
        try:
            result = self._value(self._root, values)
        except OverflowError:
            raise self._without_value("is too large", values) from None
        except (ArithmeticError, RecursionError) as error:
            raise self._without_value(str(error), values) from None
        if not math.isfinite(result):
            raise self._without_value("is not a finite number", values)
        return result

    def _without_value(self, problem: str, values: Mapping[str, float]) -> SpecError:
        read = ", ".join(f"{name} = {values[name]:.6g}" for name in sorted(self.names) if name in values)
        return SpecError(finding(self.path, problem + (f" with {read}." if read else "."), value=self.text))

    def _value(self, node: ast.expr, values: Mapping[str, float]) -> float:
        if isinstance(node, ast.BinOp):
            left, right = self._value(node.left, values), self._value(node.right, values)
            value = _BINARY[type(node.op)](float(left), float(right))
            if isinstance(value, complex):
                raise ArithmeticError(f"{left:g} ** {right:g} is not a real number")
            return value
        if isinstance(node, ast.UnaryOp):
            return _UNARY[type(node.op)](self._value(node.operand, values))
        if name := _name(node):
            if name not in values:
                raise SpecError(finding(self.path, f"{name} has no value here.", value=self.text, remedy=ALLOWED))
            return values[name]
        assert isinstance(node, ast.Constant) and isinstance(node.value, int | float)
        return float(node.value)


ROUNDING = 1e-9
"""What is forgiven to either side of an inequality."""


@dataclass(frozen=True)
class Inequality:
    """``a <= b``, ``a >= b`` or a chain ``a <= b <= c`` of expressions, and the TOML path it was written at."""

    path: str
    text: str

    @cached_property
    def _pairs(self) -> list[tuple[Expression, Expression]]:
        """(smaller, larger) sides."""
        try:
            root = ast.parse(self.text, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            root = None
        if not isinstance(root, ast.Compare) or not all(isinstance(op, ast.LtE | ast.GtE) for op in root.ops):
            remedy = "Write it with <= or >=, as in 'upper + lower <= 0.44'."
            raise SpecError(finding(self.path, "is not an inequality.", value=self.text, remedy=remedy))
        sides = [Expression(self.path, ast.unparse(side)) for side in (root.left, *root.comparators)]
        pairs = zip(root.ops, sides[:-1], sides[1:], strict=True)
        return [(a, b) if isinstance(op, ast.LtE) else (b, a) for op, a, b in pairs]

    @cached_property
    def names(self) -> frozenset[str]:
        """Variables and paths that it reads."""
        return frozenset(name for pair in self._pairs for side in pair for name in side.names)

    def violation(self, values: Mapping[str, float]) -> float:
        """By how much it is not met, <= 0 where it is; rounding of 1e-9 is forgiven."""
        return max(a.evaluate(values) - b.evaluate(values) for a, b in self._pairs) - ROUNDING


def _name(node: ast.AST) -> str:
    """``reach``, ``arm.joints.upper.a``; ``layout.offset[1]`` as ``layout.offset.1``; empty for anything else."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (inner := _name(node.value)):
        return f"{inner}.{node.attr}"
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant) and type(node.slice.value) is int:
        inner = _name(node.value)
        return f"{inner}.{node.slice.value}" if inner else ""
    return ""


def _names(node: ast.AST) -> Iterator[str]:
    if name := _name(node):
        yield name
        return
    for part in ast.iter_child_nodes(node):
        yield from _names(part)


def in_order(expressions: Mapping[str, Expression], known: frozenset[str]) -> list[str]:
    """Names of the expressions so that each comes after those it reads.

    Raises
    ------
    SpecError
        An unknown name, or a cycle.
    """
    for expression in expressions.values():
        unknown = sorted(expression.names - known - set(expressions))
        if unknown:
            names = ", ".join(sorted(n for n in known | set(expressions) if n.isidentifier())) or "none"
            problem = f"{', '.join(unknown)} is not a variable."
            raise SpecError(finding(expression.path, problem, value=expression.text, remedy=f"Known: {names}."))
    graph = {name: expression.names & set(expressions) for name, expression in expressions.items()}
    try:
        return list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        ring = " -> ".join(reversed(error.args[1]))
        path = expressions[error.args[1][0]].path
        raise SpecError(finding(path, f"the variables read each other in a circle: {ring}.")) from None
