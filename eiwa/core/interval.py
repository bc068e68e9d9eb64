"""What an F with its errors says about the true F on the grid."""

from __future__ import annotations

from scipy.stats import t as student

LEVEL = 0.95


def interval(F: float, se: float, remaining: float | None, replicates: int, level: float = LEVEL) -> tuple[float, float]:
    """[F - t se, F + remaining + t se] with Student's t for a standard deviation from so many replicates.

    ``se`` is the standard deviation over full-size replicates; an attained maximum is a lower bound, so only the upper
    end carries what ``remaining`` says it may still gain (0 where the estimator does not say).
    """
    t = float(student.ppf((1 + level) / 2, replicates - 1))
    return F - t * se, F + (remaining or 0.0) + t * se
