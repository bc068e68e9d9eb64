"""Roots of a polynomial whose roots are all real and not positive, on columns: few of them, the extreme ones, their mean.

With roots -d, numbers d >= 0 have p, the product of z + d. Extreme ones follow from ratios of power sums (Bernoulli), after
the coefficients have been made those of the 16th powers (Dandelin and Graeffe); numbers that coincide do not disturb that.
"""

from __future__ import annotations

from math import comb

import numpy as np

from eiwa.core.symbols import Column, Symbol, absolute, maximum, minimum, polynomial, sqrt, where

Coefficients = list[Column]
"""Of a polynomial, the constant one first. Read the other way round: elementary symmetric functions, e[0] = 1 first."""


def least_and_greatest(p: Coefficients) -> tuple[Column, Column]:
    """The least and the greatest of one to six numbers with the mean 1; the least is 0 where it is not told from 0."""
    if len(p) <= 4:
        numbers = few(p)
        return _cut(numbers[0]), numbers[-1]
    together, apart = _squarings(p[0])
    f, y, z = ends(p, together)
    return _cut(unsquared(f / unsquared(y, apart), together)), unsquared(z, together + apart)


def least_over_greatest(p: Coefficients) -> Column:
    """Their ratio, in [0, 1], with fewer roots taken."""
    if len(p) <= 4:
        numbers = few(p)
        return _cut(numbers[0] / floored(numbers[-1]))
    together, apart = _squarings(p[0])
    f, y, z = ends(p, together)
    return _cut(minimum(unsquared(f / unsquared(y * z, apart), together), 1.0))


def _cut(x: Column) -> Column:
    """x, 0 where rounding may have made it."""
    return where(x > (1e-10 if is_single(x) else 1e-16), x, 0.0)


def normalised(p: Coefficients) -> tuple[Column, Coefficients]:
    """The mean of n numbers d >= 0 and, for the product p of z + d, that with d over their mean."""
    n = len(p) - 1
    mean = p[-2] * (1.0 / n)
    unit = 1.0 / maximum(mean, 1e-6 if is_single(mean) else 1e-45)
    power, result = unit, [float(n) if n > 1 else mean * unit, 1.0]
    for c in p[-3::-1]:
        power = power * unit
        result.insert(0, c * power)
    return mean, result


def few(p: Coefficients) -> list[Column]:
    """One to three numbers d >= 0 with the mean 1, ascending, for the product p of z + d, in closed form.

    The largest of three by Viete's formula 1 + 2 h cos(phi), cos(3 phi) = c; the others from their sum and product.
    """
    if len(p) == 2:
        return [p[0]]
    if len(p) == 3:
        high = 1.0 + sqrt(maximum(1.0 - p[0], 0.0))
        return [p[0] / high, high]
    product, pairs = p[0], p[1]
    h = sqrt(maximum(1.0 - (1.0 / 3.0) * pairs, 0.0))
    c = (product - pairs + 2.0) / floored(2.0 * h * h * h)
    high = 1.0 + 2.0 * h * _cosine_of_third(maximum(minimum(c, 1.0), -1.0))
    rest = product / high
    half = 0.5 * (pairs - rest) / high
    middle = half + sqrt(maximum(half * half - rest, 0.0))
    return [minimum(rest / floored(middle), middle), middle, high]


def _cosine_of_third(c: Column) -> Column:
    """cos(arccos(c) / 3) for c in [-1, 1], within 2e-15."""
    return polynomial(2.0 * sqrt(0.5 + 0.5 * c) - 1.0, _THIRD)


def mean_root(p: Coefficients) -> Column:
    """Mean square root of n numbers d >= 0 with the mean 1, for the product p of z + d."""
    n = len(p) - 1
    if n <= 3:
        return sum((sqrt(d) for d in few(p)), 0.0) * (1.0 / n)
    total: Column = _SQRT_AT_ZERO
    for weight, pole in zip(_SQRT_WEIGHTS, _SQRT_POLES, strict=True):
        shares = [(1.0 - k / n) * c for k, c in enumerate(p[:-1])]
        total = total + weight * (polynomial(n * pole, shares) / floored(polynomial(n * pole, p)))
    return total * n**0.5


def _squarings(x: Column) -> tuple[int, int]:
    """How often all roots are squared together, and again those of each end: single precision has less range."""
    return (1, 3) if is_single(x) else (3, 1)


def unsquared(x: Column, times: int) -> Column:
    """x ** (1 / 2**times)."""
    for _ in range(times):
        x = sqrt(x)
    return x


def ends(p: Coefficients, squarings: int) -> tuple[Column, Column, Column]:
    """Of the n numbers d in the product p of z + d, squared that often: f and powers of the largest f/d and the largest d."""
    for _ in range(squarings):
        p = squared(p)
    f, inverses = harmonic(p)
    return f, largest(inverses), largest(p[::-1])


def harmonic(p: Coefficients) -> tuple[Column, Coefficients]:
    """The harmonic mean f of n numbers d >= 0, and the elementary symmetric functions of f/d, for the product p of z + d.

    Where rounding has left a p that Newton's inequality forbids, several d are not told from 0: then f is 0.
    """
    n = len(p) - 1
    first = floored(p[1])
    inverse = float(n) / first
    f = p[0] * inverse
    f = where(f * p[2] <= (0.501 * (n - 1)) * first, f, 0.0)
    factors = [inverse, inverse * f]
    while len(factors) < n:
        factors.append(factors[-2] * (f * f))
    return f, [1.0, float(n), *(c * factor for c, factor in zip(p[2:], factors[1:], strict=True))]


def largest(e: Coefficients) -> Column:
    """The largest of n numbers >= 0 to the power 2^k, from their elementary symmetric functions; they have a mean >= 1.

    Two different numbers, each any number of times, have power sums S2 ... S5 like those that are found, and the larger
    of the two is taken.
    """
    n = len(e) - 1
    scale: Column = 1.0
    if is_single(e[-1]):
        first, *others = squared(squared(e))[1:]
        mean, p = normalised([*others[::-1], maximum(first, float(n)), 1.0])
        # Maclaurin's inequality, lest rounding errors of several numbers next to 0 grow out of range.
        e = [1.0, float(n), *(minimum(absolute(c), float(comb(n, k))) for k, c in enumerate(p[-3::-1], 2))]
        scale = mean * mean
    e = squared(e)
    s2, s3, s4, s5 = power_sums(e, 5)[2:]
    s3, s4 = maximum(s3, float(n)), maximum(s4, float(n))
    noise = 4e-6 if is_single(s2) else 1e-14
    C, A = absolute(s2 * s4 - s3 * s3), maximum(s3 * s5 - (1.0 + noise) * (s4 * s4), 0.0)
    excess = maximum(s4 * C - s2 * A, 0.0)
    weight = excess + sqrt(excess * excess + (4.0 * A * (C * C) + _tiny(C)))
    return scale * (s4 * weight + 2.0 * (C * A)) / (s3 * weight)


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


def plus(p: Coefficients, q: Coefficients) -> Coefficients:
    """Sum of two polynomials."""
    shorter, longer = sorted((p, q), key=len)
    return [a + b for a, b in zip(longer, shorter, strict=False)] + longer[len(shorter) :]


def times(p: Coefficients, q: Coefficients) -> Coefficients:
    """Product of two polynomials."""
    result: Coefficients = [0.0] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            result[i + j] = a * b + result[i + j]
    return result


def is_single(x: Column) -> bool:
    """Whether a column is in single precision."""
    return x.tape.single if isinstance(x, Symbol) else np.asarray(x).dtype == np.float32


def _tiny(x: Column) -> float:
    """A number whose reciprocal is finite, below every square that is not zero but for rounding."""
    return 1e-36 if is_single(x) else 1e-290


def floored(x: Column) -> Column:
    """x, but so far above 0 that its reciprocal is finite."""
    return x if isinstance(x, float) and x > 0 else maximum(x, _tiny(x))


# cos(2 arccos(s) / 3), s = cos(arccos(c) / 2) = (1 + y) / 2, as a polynomial in y, fitted with 50 digits.
_THIRD = (
    0.766044443118978, 0.24740906632284043, -0.015509188436481955, 0.002466352815691789, -0.0005041246913301313,
    0.00011642544451832467, -2.891993360699116e-05, 7.54113105182103e-06, -2.035886681257262e-06, 5.639788836689093e-07,
    -1.5948649112929443e-07, 4.617777441564896e-08, -1.3456397963049525e-08, 3.6028213343971334e-09,
    -1.0683273724516248e-09, 5.264174066673318e-10, -1.5966098420242849e-10,
)  # fmt: skip
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
