"""Small dense linear algebra on columns, written so that it vectorises over samples and never fails."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from eiwa.core.symbols import Column, absolute, dot, sqrt, where

Matrix = Sequence[Sequence[Column]]


def volume(A: Matrix) -> Column:
    """Product of all singular values of A: sqrt det(A At) when wide, sqrt det(At A) when tall, |det A| when square.

    A square matrix goes through its minors, which keep full accuracy near a singularity; any other through
    Gram-Schmidt on its shorter side, since a Gram matrix would square the condition number.
    """
    rows, columns = len(A), len(A[0])
    if rows == columns:
        return absolute(determinant(A))
    vectors = [list(row) for row in A] if rows < columns else [list(column) for column in zip(*A, strict=True)]
    squares = orthogonal_squares(vectors)
    lengths = [sqrt(product(squares[k : k + 3])) for k in range(0, len(squares), 3)]
    return product(lengths)


def determinant(A: Matrix) -> Column:
    """Determinant by Laplace expansion along the rows, every minor computed once."""
    n = len(A)
    minors: dict[tuple[int, ...], Column] = {(): 1.0}
    for k in range(n):
        minors = {
            chosen: _expand(A[k], chosen, minors, sign=1.0 if k % 2 == 0 else -1.0)
            for chosen in combinations(range(n), k + 1)
        }
    return minors[tuple(range(n))]


def _expand(
    row: Sequence[Column], chosen: tuple[int, ...], minors: dict[tuple[int, ...], Column], sign: float
) -> Column:
    total: Column = 0.0
    for position, j in enumerate(chosen):
        rest = chosen[:position] + chosen[position + 1 :]
        term = row[j] * minors[rest]
        total = total + term if sign > 0 else total - term
        sign = -sign
    return total


def orthogonal_squares(vectors: list[list[Column]]) -> list[Column]:
    """Squared lengths that the vectors keep after modified Gram-Schmidt; their product is the Gram determinant."""
    vectors = [list(v) for v in vectors]
    squares = []
    for k, pivot in enumerate(vectors):
        square = dot(pivot, pivot)
        squares.append(square)
        if k + 1 == len(vectors):
            break
        inverse = where_positive(square)
        for other in vectors[k + 1 :]:
            share = dot(pivot, other) * inverse
            other[:] = [a - share * b for a, b in zip(other, pivot, strict=True)]
    return squares


def where_positive(x: Column) -> Column:
    """1/x where x > 0, else 0."""
    if isinstance(x, float | int):
        return 1.0 / x if x > 0 else 0.0
    positive = x > 0.0
    return where(positive, 1.0 / where(positive, x, 1.0), 0.0)


def product(factors: Sequence[Column]) -> Column:
    """Product of the factors, in order."""
    total: Column = 1.0
    for factor in factors:
        total = factor * total
    return total
