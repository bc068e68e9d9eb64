"""Samples of an arm that are kept, because what changed since (spacing, offset, operator, threshold) does not move them.

A set of samples is kept when it is asked for the second time: a search over link lengths never asks twice and pays
nothing, a search over spacing finds them from its third trial on.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

CAPACITY = 512 << 20
"""Bytes of kept samples."""


@dataclass
class Kept:
    """Least recently used sets are dropped first.

    ``hits`` and ``misses`` count the requests; a set is an array (3 + m, N): tips x, y, z and m raw indices.
    """

    capacity: int = CAPACITY
    hits: int = 0
    misses: int = 0
    _sets: OrderedDict[Hashable, NDArray[Any]] = field(default_factory=OrderedDict)
    _seen: OrderedDict[Hashable, None] = field(default_factory=OrderedDict)

    def find(self, key: Hashable) -> NDArray[Any] | None:
        """The set of a key, if it is kept."""
        if key in self._sets:
            self._sets.move_to_end(key)
            self.hits += 1
            return self._sets[key]
        self.misses += 1
        return None

    def room(self, key: Hashable, shape: tuple[int, int], dtype: Any) -> NDArray[Any] | None:
        """An array to record a set into, when its key was asked for before and it fits; :meth:`keep` it when full."""
        size = shape[0] * shape[1] * np.dtype(dtype).itemsize
        again = key in self._seen
        self._seen[key] = None
        self._seen.move_to_end(key)
        while len(self._seen) > 256:
            self._seen.popitem(last=False)
        return np.empty(shape, dtype) if again and size <= self.capacity else None

    def keep(self, key: Hashable, samples: NDArray[Any]) -> None:
        """Keep a recorded set."""
        samples.setflags(write=False)
        self._sets[key] = samples
        while self.bytes() > self.capacity:
            self._sets.popitem(last=False)

    def bytes(self) -> int:
        """Memory in use."""
        return sum(samples.nbytes for samples in self._sets.values())


samples = Kept()
"""The sets of this process."""
