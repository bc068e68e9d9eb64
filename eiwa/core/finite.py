"""Whether numbers are finite, at the speed of memory: from their bits, as compiled code may take all for finite."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.compiled import compiled

INFINITE = 0x7FF0000000000000
"""The exponent's bits of a double: all are set in NaN and the infinities alone."""


def all_finite(values: NDArray[Any]) -> bool:
    """Whether no entry is NaN or infinite; contiguous doubles at the speed of memory."""
    line = values if values.flags.c_contiguous else values.T
    if line.flags.c_contiguous and line.dtype == np.float64:
        return bool(largest_exponent(line.reshape(-1).view(np.int64)) < INFINITE)
    return bool(np.isfinite(values).all())


@compiled
def largest_exponent(bits: Any) -> Any:
    """The largest exponent, in place, of doubles that are given as integers."""
    most = np.int64(0)
    for k in range(bits.size):
        most = max(most, bits[k] & np.int64(0x7FF0000000000000))
    return most


@compiled
def rows_finite(bits: Any, stride: Any, first: Any, last: Any, n: Any) -> bool:
    """Whether n entries of the rows ``first ... last - 1`` are finite where the first row of all is not 0."""
    most, infinite = np.int64(0), np.int64(0x7FF0000000000000)
    for row in range(first, last):
        most = max(most, largest_exponent(bits[row * stride : row * stride + n]))
    if most < infinite:
        return True
    for row in range(first, last):
        line = bits[row * stride :]
        for s in range(n):
            if bits[s] != 0 and line[s] & infinite == infinite:
                return False
    return True
