"""Extreme singular values and isotropy of small matrices of columns, straight-line, so that they vectorise over samples.

Reflections bring a matrix to bidiagonal form, all but its last three rows. The squares of its singular values are then the
roots of a polynomial whose coefficients are sums of products of squares, so that a tiny root keeps its leading digits
(a Gram matrix would lose half of them); :mod:`eiwa.core.roots` finds them.

Errors relative to the largest singular value, against LAPACK: 1e-13 for up to three singular values, 5e-6 where they nearly
coincide; 1e-13 for more, but up to 3e-3 where at either end three or more nearly, not quite, coincide. On random postures
of arms of six and seven joints that makes 1e-6 at 99 %, 4e-4 at worst. In single precision, for entries of the order of
1: 1e-5 at 99 %, 1e-3 at worst on those arms; 5e-3 where three, 0.2 where more of them nearly coincide. A smallest value of
less than 1e-8 of the largest (single: 1e-5) is 0; so may be several that are all below 1e-4.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

from eiwa.core.linear import Matrix
from eiwa.core.roots import (
    Coefficients,
    floored,
    is_single,
    least_and_greatest,
    least_over_greatest,
    mean_root,
    normalised,
    plus,
    times,
)
from eiwa.core.symbols import Column, cross, dot, maximum, minimum, root, sqrt, where

Vector = Sequence[Column]


def extremes(A: Matrix) -> tuple[Column, Column]:
    """The smallest and the largest singular value of A, a matrix with min(m, n) <= 6."""
    mean, p = normalised(characteristic(A))
    low, high = least_and_greatest(p)
    return sqrt(mean * low), sqrt(mean * high)


def inverse_condition(A: Matrix) -> Column:
    """The smallest singular value of A over the largest, in [0, 1]; 0 for a matrix of zeros; min(m, n) <= 6."""
    return sqrt(least_over_greatest(normalised(characteristic(A))[1]))


def isotropy(A: Matrix) -> Column:
    """Geometric over arithmetic mean of A's singular values, in [0, 1]; 0 where A is singular to working precision.

    Within 1e-6 of its value (single: 1e-4) but next to a singularity, where the mean falls like a root of the smallest.
    """
    p = normalised(characteristic(A))[1]
    regular = p[0] > (1e-13 if is_single(p[0]) else 1e-24)
    geometric = root(sqrt(where(regular, p[0], 1.0)), len(p) - 1)
    return where(regular, minimum(geometric / maximum(mean_root(p), 1e-9), 1.0), 0.0)


def characteristic(A: Matrix) -> Coefficients:
    """Coefficients in z of the product of z + s^2 over all singular values s.

    Golub and Kahan's bidiagonalisation by reflections from both sides, stopped at three rows, where minors cost less.
    """
    rows = [list(row) for row in (A if len(A) < len(A[0]) else zip(*A, strict=True))]
    p: Coefficients = [1.0]
    q: Coefficients = [0.0]
    b: Column = 0.0
    x: Vector = []
    while len(rows) > 3:
        a, rows = reflected(rows[0], rows[1:])
        q = plus(p, times([b], q))
        p = plus(times([a], p), [0.0, *q])
        x, rows = [row[0] for row in rows], [row[1:] for row in rows]
        if len(rows) > 3:
            b, columns = reflected(x, zip(*rows, strict=True))
            rows = [list(row) for row in zip(*columns, strict=True)]
    if len(rows[0]) > 4:
        rows = triangle(rows)
    block, coupling = minors([[*column, 0.0, 0.0][:3] for column in zip(*rows, strict=True)], x)
    return plus(times(p, block[3 - len(rows) :]), times([0.0, *q], coupling))


def reflected(x: Vector, vectors: Iterable[Vector]) -> tuple[Column, list[list[Column]]]:
    """The square of |x|, and the vectors after Householder's reflection that maps x to (+-|x|, 0, 0, ...)."""
    square = dot(x, x)
    length = sqrt(square)
    length = where(x[0] < 0.0, -length, length)
    factor = 1.0 / floored(square + length * x[0])
    first = x[0] + length
    results = []
    for w in vectors:
        share = factor * (dot(x[1:], w[1:]) + first * w[0])
        results.append([w[0] - share * first, *(a - share * b for a, b in zip(w[1:], x[1:], strict=True))])
    return square, results


def triangle(rows: Sequence[Vector]) -> list[list[Column]]:
    """The lower triangular matrix that the rows become when reflections turn them all together."""
    result: list[list[Column]] = []
    heads: list[list[Column]] = [[] for _ in rows]
    while rows:
        _, rows = reflected(rows[0], rows)
        heads = [[*head, row[0]] for head, row in zip(heads, rows, strict=True)]
        result.append([*heads.pop(0), *[0.0] * (len(rows) - 1)])
        rows = [row[1:] for row in rows[1:]]
    return result


def minors(columns: Sequence[Vector], x: Vector) -> tuple[Coefficients, Coefficients]:
    """Coefficients in z of det(z + C Ct) and xt adj(z + C Ct) x, from C's columns with three entries each.

    No x: the second polynomial is 0.
    """
    crosses = [cross(c, d) for c, d in combinations(columns, 2)]
    triples = [dot(cross(c, d), e) for c, d, e in combinations(columns, 3)]
    block = [dot(triples, triples), _squares(crosses), _squares(columns), 1.0]
    if not x:
        return block, [0.0]
    along = [dot(normal, x) for normal in crosses]
    return block, [dot(along, along), _squares(cross(x, c) for c in columns), dot(x, x)]


def _squares(vectors: Iterable[Vector]) -> Column:
    total: Column = 0.0
    for v in vectors:
        total = total + dot(v, v)
    return total
