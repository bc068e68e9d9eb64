"""Singular values in double precision by way of the characteristic polynomial: quick where many samples are asked for.

Reflections bring a matrix to bidiagonal form, all but its last three rows. The squares of its singular values are then the
roots of a polynomial whose coefficients are sums of products of squares, so that a tiny root keeps its leading digits. The
roots at either end follow from power sums of their 16th powers. Everything is a fixed number of operations without branches.

A polynomial cannot tell roots that nearly coincide: relative to the largest singular value, the extremes of most matrices
(nine in ten random ones) are within 1e-10, and all within 3e-3, which takes several singular values within a part in ten
of an extreme one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

from eiwa.core.linear import Matrix
from eiwa.core.symbols import Column, absolute, cross, dot, maximum, minimum, polynomial, sqrt, where

Vector = Sequence[Column]
Coefficients = list[Column]
"""Of a polynomial, the constant one first. Read the other way round: elementary symmetric functions, e[0] = 1 first."""
TINY = 1e-290
"""A number whose reciprocal is finite, below every square that is not zero but for rounding."""


def extreme_squares(A: Matrix) -> tuple[Column, Column]:
    """Squares of the smallest and the largest singular value of A, a matrix with min(m, n) <= 6."""
    mean, p = normalised(characteristic(A))
    if len(p) == 2:
        return mean, mean
    for _ in range(3):
        p = squared(p)
    f, inverses = harmonic(p)
    smallest, highest = largest(inverses), largest(p[::-1])
    return mean * _root(f / sqrt(smallest), 3), mean * _root(highest, 4)


def mean_singular_value(A: Matrix) -> Column:
    """Arithmetic mean of A's singular values, to 3e-7 of it."""
    scale, p = normalised(characteristic(A))
    n = len(p) - 1
    mean: Column = _SQRT_AT_ZERO
    for weight, pole in zip(_SQRT_WEIGHTS, _SQRT_POLES, strict=True):
        shares = [(1.0 - k / n) * c for k, c in enumerate(p[:-1])]
        mean = mean + weight * (polynomial(n * pole, shares) / _floored(polynomial(n * pole, p)))
    return sqrt(scale * float(n)) * mean


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
        q = _plus(p, _times([b], q))
        p = _plus(_times([a], p), [0.0, *q])
        x, rows = [row[0] for row in rows], [row[1:] for row in rows]
        if len(rows) > 3:
            b, columns = reflected(x, zip(*rows, strict=True))
            rows = [list(row) for row in zip(*columns, strict=True)]
    if len(rows[0]) > 4:
        rows = triangle(rows)
    block, coupling = minors([[*column, 0.0, 0.0][:3] for column in zip(*rows, strict=True)], x)
    return _plus(_times(p, block[3 - len(rows) :]), _times([0.0, *q], coupling))


def reflected(x: Vector, vectors: Iterable[Vector]) -> tuple[Column, list[list[Column]]]:
    """The square of |x|, and the vectors after Householder's reflection that maps x to (+-|x|, 0, 0, ...)."""
    square = dot(x, x)
    length = sqrt(square)
    length = where(x[0] < 0.0, -length, length)
    factor = 1.0 / _floored(square + length * x[0])
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


def normalised(p: Coefficients) -> tuple[Column, Coefficients]:
    """The mean of n numbers d >= 0 and, for the product p of z + d, that with d over their mean."""
    n = len(p) - 1
    mean = p[-2] * (1.0 / n)
    unit = 1.0 / maximum(mean, 1e-45)
    power, result = unit, [float(n), 1.0]
    for c in p[-3::-1]:
        power = power * unit
        result.insert(0, c * power)
    return mean, result


def harmonic(p: Coefficients) -> tuple[Column, Coefficients]:
    """The harmonic mean f of n numbers d >= 0, and the elementary symmetric functions of f/d, for the product p of z + d.

    Newton's inequality limits f, whatever rounding has made of p.
    """
    n = len(p) - 1
    first = _floored(p[1])
    inverse = float(n) / first
    f = minimum(p[0] * inverse, (0.5 * (n - 1)) * first / maximum(p[2], 1e-7 * first))
    factors = [inverse, inverse * f]
    while len(factors) < n:
        factors.append(factors[-2] * (f * f))
    return f, [1.0, float(n), *(c * factor for c, factor in zip(p[2:], factors[1:], strict=True))]


def largest(e: Coefficients) -> Column:
    """The square of the largest of n numbers >= 0 whose mean is >= 1, from their elementary symmetric functions.

    Two different numbers, each any number of times, have power sums S2 ... S5 like those that are found, and the larger
    of the two is taken.
    """
    n = float(len(e) - 1)
    s2, s3, s4, s5 = power_sums(squared(e), 5)[2:]
    s3, s4 = maximum(s3, n), maximum(s4, n)
    C, A = absolute(s2 * s4 - s3 * s3), maximum(s3 * s5 - (1.0 + 1e-14) * (s4 * s4), 0.0)
    excess = maximum(s4 * C - s2 * A, 0.0)
    weight = excess + sqrt(excess * excess + (4.0 * A * (C * C) + TINY))
    return (s4 * weight + 2.0 * (C * A)) / (s3 * weight)


def squared(e: Coefficients) -> Coefficients:
    """Elementary symmetric functions of the squares (Dandelin and Graeffe)."""
    n = len(e) - 1
    result: Coefficients = []
    for k in range(n + 1):
        total = e[k] * e[k]
        for j in range(1, min(k, n - k) + 1):
            term = 2.0 * e[k + j] * e[k - j]
            total = total - term if j % 2 else total + term
        result.append(total)
    return result


def power_sums(e: Coefficients, count: int) -> list[Column]:
    """Sums of the powers 0, 1, ..., count of n numbers with the elementary symmetric functions e (Newton)."""
    n = len(e) - 1
    sums: list[Column] = [float(n)]
    for k in range(1, count + 1):
        total: Column = 0.0
        for j in range(min(k, n), 0, -1):
            term = e[j] * (sums[k - j] if j < k else float(k))
            total = total + term if j % 2 else total - term
        sums.append(total)
    return sums


def _root(x: Column, halvings: int) -> Column:
    for _ in range(halvings):
        x = sqrt(x)
    return x


def _plus(p: Coefficients, q: Coefficients) -> Coefficients:
    shorter, longer = sorted((p, q), key=len)
    return [a + b for a, b in zip(longer, shorter, strict=False)] + longer[len(shorter) :]


def _times(p: Coefficients, q: Coefficients) -> Coefficients:
    result: Coefficients = [0.0] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            result[i + j] = a * b + result[i + j]
    return result


def _squares(vectors: Iterable[Vector]) -> Column:
    total: Column = 0.0
    for v in vectors:
        total = total + dot(v, v)
    return total


def _floored(x: Column) -> Column:
    return x if isinstance(x, float) and x > 0 else maximum(x, TINY)


# sqrt(x) = c + sum of w x / (x + s) within 1.3e-7 on [0, 1], the best such approximation, computed with 40 digits.
_SQRT_AT_ZERO = 1.2447708820895073e-07
_SQRT_WEIGHTS = (
    4.443066678379549, 0.5368278244214031, 0.20680411278909008, 0.10329053104336743, 0.054982273768007545,
    0.029339936730888222, 0.015359819690351306, 0.007812632699788642, 0.003834702554410376, 0.0018032219495193195,
    0.0008048271145024466, 0.0003365081891058698, 0.00012921977840827883, 4.410719686420215e-05,
    1.2579485951136533e-05, 2.5846776910843015e-06,
)  # fmt: skip
_SQRT_POLES = (
    11.496770952328363, 1.0147111724962006, 0.2343925571255499, 0.06364721112622602, 0.017465261501248865,
    0.004618801276536955, 0.0011533400272372633, 0.0002682124040364796, 5.728331748841947e-05, 1.1041737386414126e-05,
    1.875760619755149e-06, 2.712986468805089e-07, 3.165612745533757e-08, 2.7154929053004284e-09,
    1.4173582367057634e-10, 2.620004043356584e-12,
)  # fmt: skip
