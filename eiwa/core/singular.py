"""Singular values of small matrices of columns, straight-line, so that they vectorise over samples and never fail.

The longer side is folded away by Householder reflections; the triangle that is left is made orthogonal by a fixed
number of sweeps of one-sided Jacobi rotations (M. R. Hestenes, "Inversion of matrices by biorthogonalization and
related results", J. SIAM 6, 1958), the longer vector first. No Gram matrix is formed: it would square the condition
number.

Errors relative to the largest singular value, up to 6 by 12: 1e-14 (single: 2e-6); up to 2e-5 where three singular
values or more lie within a part in ten of each other and the rest far below, so that five sweeps are not quite enough.
Singular values below 1e-70 (single: 1e-9) are not told apart: fourth powers underflow. Where only the extremes or the mean
are asked for, in double precision, :mod:`eiwa.core.characteristic` is ten times as quick; it has errors of its own.
"""

from __future__ import annotations

import numpy as np

from eiwa.core.characteristic import extreme_squares, mean_singular_value
from eiwa.core.linear import Matrix, product, volume
from eiwa.core.symbols import Column, Symbol, absolute, dot, minimum, root, sqrt, where

SWEEPS = (0, 0, 1, 4, 4, 5, 5)
"""Sweeps by the length of the shorter side."""


def extremes(A: Matrix) -> tuple[Column, Column]:
    """The smallest and the largest of the min(m, n) singular values of A (m x n)."""
    if is_single(A):
        values = singular_values(A)
        return values[-1], values[0]
    smallest, largest = extreme_squares(A)
    return sqrt(smallest), sqrt(largest)


def isotropy(A: Matrix) -> Column:
    """Geometric over arithmetic mean of the singular values, in [0, 1]; 0 for zeros."""
    n = min(len(A), len(A[0]))
    if is_single(A):
        values = singular_values(A)
        mean: Column = dot(values, [1.0 / n] * n)
        return root(minimum(product([value * _inverse(mean) for value in values]), 1.0), n)
    return root(minimum(volume(A) * _inverse(product([mean_singular_value(A)] * n)), 1.0), n)


def is_single(A: Matrix) -> bool:
    """Whether the entries are in single precision."""
    entry = next((x for row in A for x in row if not isinstance(x, float | int)), 0.0)
    return entry.tape.single if isinstance(entry, Symbol) else np.asarray(entry).dtype == np.float32


def singular_values(A: Matrix) -> list[Column]:
    """The min(m, n) singular values of A (m x n), descending; zeros for a matrix of zeros."""
    vectors = triangle(A)
    n = len(vectors)
    squares = [dot(v, v) for v in vectors]
    for _ in range(SWEEPS[n]):
        for i in range(n):
            for j in range(i + 1, n):
                squares[i], squares[j] = _rotate(vectors[i], vectors[j], squares[i], squares[j])
        squares = [dot(v, v) for v in vectors]
    return [sqrt(square) for square in squares]


def triangle(A: Matrix) -> list[list[Column]]:
    """A triangle with the singular values of A: vector k of min(m, n) has entries up to the k-th, zeros behind."""
    vectors = [list(v) for v in (A if len(A) <= len(A[0]) else zip(*A, strict=True))]
    n = len(vectors)
    for k in range(n):
        if len(vectors[k]) > k + 1:
            _reflect(vectors, k)
    return [v[:n] for v in vectors]


def _reflect(vectors: list[list[Column]], k: int) -> None:
    """Reflect all vectors from k on so that vector k keeps no entry behind the k-th."""
    x = vectors[k][k:]
    square = dot(x, x)
    length = sqrt(square)
    image = where(x[0] < 0.0, length, -length)
    axis = [x[0] - image, *x[1:]]
    scale = _inverse(square + length * absolute(x[0]))
    for vector in vectors[k + 1 :]:
        share = dot(axis, vector[k:]) * scale
        vector[k:] = [entry - share * a for entry, a in zip(vector[k:], axis, strict=True)]
    vectors[k][k:] = [image, *[0.0] * (len(x) - 1)]


def _rotate(a: list[Column], b: list[Column], aa: Column, bb: Column) -> tuple[Column, Column]:
    """Rotate two vectors until they are orthogonal, the longer one first; their new squared lengths.

    With g = a.b and d = b.b - a.a the tangent of the smaller angle is t = 2 g / (d + sign(d) sqrt(d^2 + 4 g^2)).
    """
    g, d = dot(a, b), bb - aa
    t = 2.0 * g * _inverse(absolute(d) + sqrt(d * d + 4.0 * (g * g)))
    swap = d > 0.0
    t = where(swap, t, -t)
    c = 1.0 / sqrt(1.0 + t * t)
    s, gain = c * t, t * g
    c, s = where(swap, s, c), where(swap, -c, s)
    for k, (x, y) in enumerate(zip(a, b, strict=True)):
        a[k], b[k] = c * x - s * y, s * x + c * y
    shorter, longer = aa - gain, bb + gain
    return where(swap, longer, shorter), where(swap, shorter, longer)


def _inverse(x: Column) -> Column:
    """1 / x, 0 where x is too small to be told from 0."""
    some = x > (1e-30 if is_single([[x]]) else 1e-280)
    return where(some, 1.0 / where(some, x, 1.0), 0.0)
