"""Small dense linear algebra on columns, written so that it vectorises over samples and never fails."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from eiwa.core.symbols import Column, absolute, dot, sqrt, where

Matrix = Sequence[Sequence[Column]]


def volume(A: Matrix) -> Column:
    """Product of all singular values of A: sqrt det(A At) when wide, sqrt det(At A) when tall, |det A| when square.

    Up to one column or row more than square goes through the largest minors (their squares sum to the Gram determinant,
    by Cauchy and Binet), which keep full accuracy near a singularity and lose every term of a zero; anything longer
    through Gram-Schmidt on its shorter side, since a Gram matrix would square the condition number.
    """
    wide = A if len(A) <= len(A[0]) else list(zip(*A, strict=True))
    if len(wide) == len(wide[0]):
        return absolute(determinant(wide))
    if len(wide) + 1 == len(wide[0]):
        minors = [minor for minor in largest_minors(wide).values() if not _is_zero(minor)]
        return sqrt(dot(minors, minors)) if minors else 0.0
    squares = orthogonal_squares([list(row) for row in wide])
    lengths = [sqrt(product(squares[k : k + 3])) for k in range(0, len(squares), 3)]
    return product(lengths)


def determinant(A: Matrix) -> Column:
    """Determinant of a square matrix."""
    return largest_minors(A)[tuple(range(len(A)))]


def largest_minors(A: Matrix) -> dict[tuple[int, ...], Column]:
    """Determinants of A's rows over every choice of as many columns, by Laplace expansion, each minor computed once."""
    minors: dict[tuple[int, ...], Column] = {(): 1.0}
    for k, row in enumerate(A):
        minors = {
            chosen: _expand(row, chosen, minors, sign=1.0 if k % 2 == 0 else -1.0)
            for chosen in combinations(range(len(row)), k + 1)
        }
    return minors


def _expand(
    row: Sequence[Column], chosen: tuple[int, ...], minors: dict[tuple[int, ...], Column], sign: float
) -> Column:
    total: Column = 0.0
    for position, j in enumerate(chosen):
        rest = chosen[:position] + chosen[position + 1 :]
        term = row[j] * minors[rest] if not _is_zero(minors[rest]) else 0.0
        total = total + term if sign > 0 else total - term
        sign = -sign
    return total


def _is_zero(x: Column) -> bool:
    return isinstance(x, float | int) and x == 0


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
