"""Arithmetic in study files: numbers, names, + - * / **, parentheses; nothing else, so nothing can be run."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
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
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise SpecError(finding(self.path, "is not an expression.", value=self.text, remedy=ALLOWED)) from None
        for node in ast.walk(root):
            self._check(node)
        return root

    def _check(self, node: ast.AST) -> None:
        number = isinstance(node, ast.Constant) and type(node.value) in (int, float)
        passive = isinstance(node, ast.Name | ast.BinOp | ast.UnaryOp | ast.expr_context) or number
        known = type(node) in _BINARY or type(node) in _UNARY
        if not (passive or known):
            what = type(node).__name__.lower()
            problem = f"{'an' if what[0] in 'aeiou' else 'a'} {what} is not allowed here."
            raise SpecError(finding(self.path, problem, value=self.text, remedy=ALLOWED))

    @cached_property
    def names(self) -> frozenset[str]:
        """Variables that the expression reads."""
        return frozenset(node.id for node in ast.walk(self._root) if isinstance(node, ast.Name))

    def evaluate(self, values: Mapping[str, float]) -> float:
        """The expression's value; raises SpecError for a division by zero, an overflow or a complex power."""
        try:
            result = self._value(self._root, values)
        except OverflowError:
            raise SpecError(finding(self.path, f"is too large with {dict(values)}.", value=self.text)) from None
        except (ArithmeticError, RecursionError) as error:
            raise SpecError(finding(self.path, f"{error} with {dict(values)}.", value=self.text)) from None
        if not math.isfinite(result):
            raise SpecError(finding(self.path, f"is not a finite number with {dict(values)}.", value=self.text))
        return result

    def _value(self, node: ast.expr, values: Mapping[str, float]) -> float:
        if isinstance(node, ast.BinOp):
            left, right = self._value(node.left, values), self._value(node.right, values)
            value = _BINARY[type(node.op)](float(left), float(right))
            if isinstance(value, complex):
                raise ArithmeticError(f"{left:g} ** {right:g} is not a real number")
            return value
        if isinstance(node, ast.UnaryOp):
            return _UNARY[type(node.op)](self._value(node.operand, values))
        if isinstance(node, ast.Name):
            return values[node.id]
        assert isinstance(node, ast.Constant) and isinstance(node.value, int | float)
        return float(node.value)


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
