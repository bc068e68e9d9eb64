"""What an F with its errors says about the true F on the grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

LEVEL = 0.95


@dataclass(frozen=True)
class Difference:
    """A paired difference: its mean over replicates, and the half-width of its confidence interval."""

    mean: float
    half_width: float

    @property
    def real(self) -> bool:
        """Whether it is larger than its error."""
        return abs(self.mean) > self.half_width


def interval(F: float, se: float, remaining: float, replicates: int, level: float = LEVEL) -> tuple[float, float]:
    """[F - t se, F + remaining + t se] with Student's t for a standard deviation from so many replicates.

    ``se`` is the standard deviation over full-size replicates; an attained maximum is a lower bound, so only the upper
    end carries what ``remaining`` says it may still gain.
    """
    t = float(student.ppf((1 + level) / 2, replicates - 1))
    return F - t * se, F + remaining + t * se


def paired(a: Sequence[float], b: Sequence[float], remaining: float = 0.0, level: float = LEVEL) -> Difference:
    """a - b over replicates that share their random streams; ``remaining`` is what either may still gain."""
    differences = np.subtract(a, b)
    t = float(student.ppf((1 + level) / 2, len(differences) - 1))
    error = t * float(np.std(differences, ddof=1)) / len(differences) ** 0.5
    return Difference(float(differences.mean()), error + remaining)
