"""Points of the unit cube, addressed by number.

Sample ``i`` of a stream depends on the stream's key and on ``i`` alone: any chunking, any number of threads
and any prefix give the same points. ``plain`` is SplitMix64 (Steele, Lea and Flood 2014), read in sample-major
order; ``sobol`` is Sobol's sequence with the direction numbers of Joe and Kuo (2008), shifted digitally by the key.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.compiled import compiled, float32_from_bits, float64_from_bits
from eiwa.core.errors import EiwaError
from eiwa.core.symbols import empty_rows

BLOCK = 256
"""Samples a compiled block holds."""
ARRAY_BLOCK = 1 << 13
"""Samples in the arrays that plugins in plain NumPy get."""
MAX_DIMENSIONS = 12
GAMMA = 0x9E3779B97F4A7C15

Sequence = Literal["plain", "sobol"]


@dataclass(frozen=True)
class Stream:
    """One random stream: a sequence's name and its key."""

    sequence: Sequence
    key: int

    @classmethod
    def of(cls, sequence: Sequence, *entropy: int) -> Stream:
        """The stream of a seed and a path of small integers (replicate, purpose)."""
        state = np.random.SeedSequence(list(entropy)).generate_state(1, np.uint64)
        return cls(sequence, int(state[0]))

    def table(self, dimensions: int) -> NDArray[np.uint64]:
        """What the fill function needs beside the key; empty for ``plain``."""
        if self.sequence == "plain":
            return np.zeros((0, 0), np.uint64)
        return _sobol_table(dimensions, self.key)

    def points(self, first: int, count: int, dimensions: int) -> NDArray[np.float64]:
        """Points ``first ... first + count - 1``, shape (count, dimensions), its columns contiguous."""
        start = first - first % BLOCK
        rows = empty_rows(-(-(first + count - start) // BLOCK) * BLOCK, dimensions)
        fill_points(rows, np.uint64(start), *self.drawing(dimensions))
        return rows[:, first - start : first - start + count].T

    def drawing(self, dimensions: int) -> tuple[bool, np.uint64, NDArray[np.uint64]]:
        """What :func:`fill_points` needs to know."""
        return self.sequence == "sobol", np.uint64(self.key), self.table(dimensions)


@compiled
def fill_plain(w: Any, stride: int, dimensions: int, start: Any, key: Any, table: Any) -> None:
    """Write a block of SplitMix64 points into the first rows of the scratch ``w``."""
    gamma = np.uint64(0x9E3779B97F4A7C15)
    for j in range(dimensions):
        row = w[j * stride :]  # the vectoriser does not see that j * stride + s is not negative
        state = key + gamma * (start * np.uint64(dimensions) + np.uint64(j + 1))
        for s in range(256):
            z = state + (gamma * np.uint64(dimensions)) * np.uint64(s)
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            z = z ^ (z >> np.uint64(31))
            if w.itemsize == 8:
                bits = (z >> np.uint64(12)) | np.uint64(0x3FF0000000000000)
                row[s] = float64_from_bits(bits) - (1.0 - 2.0**-53)
            else:
                bits = (z >> np.uint64(41)) | np.uint64(0x3F800000)
                row[s] = float32_from_bits(bits) - np.float32(1.0 - 2.0**-24)


@compiled
def fill_sobol(w: Any, stride: int, dimensions: int, start: Any, key: Any, table: Any) -> None:
    """Write a block of shifted Sobol points; ``start`` is a multiple of the block."""
    for j in range(dimensions):
        row, high = w[j * stride :], table[j, 32]
        for b in range(8, 32):
            if (start >> np.uint64(b)) & np.uint64(1):
                high ^= table[j, b]
        for s in range(256):
            x = high ^ table[j, 33 + s]
            if w.itemsize == 8:
                bits = (x << np.uint64(20)) | np.uint64(0x3FF0000000000000)
                row[s] = float64_from_bits(bits) - (1.0 - 2.0**-33)
            else:
                bits = (x >> np.uint64(9)) | np.uint64(0x3F800000)
                row[s] = float32_from_bits(bits) - np.float32(1.0 - 2.0**-24)


@compiled
def fill_points(rows: Any, start: Any, sobol: bool, key: Any, table: Any) -> None:
    """Fill the whole blocks of rows (d, n) with points from ``start`` on, a multiple of the block."""
    dimensions, stride = rows.shape
    w = rows.reshape(rows.size)
    for first in range(0, stride - stride % 256, 256):
        if sobol:
            fill_sobol(w[first:], stride, dimensions, start + np.uint64(first), key, table)
        else:
            fill_plain(w[first:], stride, dimensions, start + np.uint64(first), key, table)


FILLS: dict[str, Any] = {"plain": fill_plain, "sobol": fill_sobol}

# Joe and Kuo's primitive polynomials and initial direction numbers ("new-joe-kuo-6"), dimensions 2 to 12:
# degree, coefficients, m_1 ... m_degree.
_JOE_KUO = (
    (1, 0, (1,)),
    (2, 1, (1, 3)),
    (3, 1, (1, 3, 1)),
    (3, 2, (1, 1, 1)),
    (4, 1, (1, 1, 3, 3)),
    (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)),
    (5, 4, (1, 1, 5, 5, 5)),
    (5, 7, (1, 1, 7, 11, 19)),
    (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)),
)


def direction_numbers(dimension: int) -> list[int]:
    """The 32 direction numbers of one dimension (0-based), as 32-bit integers, for bits 0 ... 31 of the index."""
    if dimension == 0:
        return [1 << (31 - k) for k in range(32)]
    degree, coefficients, initial = _JOE_KUO[dimension - 1]
    v = [m << (31 - k) for k, m in enumerate(initial)]
    for k in range(degree, 32):
        value = v[k - degree] ^ (v[k - degree] >> degree)
        for i in range(1, degree):
            if (coefficients >> (degree - 1 - i)) & 1:
                value ^= v[k - i]
        v.append(value)
    return v


@lru_cache(maxsize=64)
def _sobol_table(dimensions: int, key: int) -> NDArray[np.uint64]:
    if dimensions > MAX_DIMENSIONS:
        raise EiwaError(f"sobol has at most {MAX_DIMENSIONS} dimensions, not {dimensions}: use estimator = 'plain'")
    table = np.zeros((dimensions, 33 + BLOCK), np.uint64)
    table[:, 32] = np.random.SeedSequence(key).generate_state(dimensions, np.uint32)
    for j in range(dimensions):
        table[j, :32] = direction_numbers(j)
        for b in range(8):
            table[j, 33 + (1 << b) : 33 + (2 << b)] = table[j, 33 : 33 + (1 << b)] ^ table[j, b]
    table.setflags(write=False)
    return table
