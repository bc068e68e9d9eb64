"""The best trials of a study, which are evaluated again with all replicates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eiwa.core.spec import StudySpec
from eiwa.study.front import nondominated
from eiwa.study.rows import Row

LEADERS = 3
"""Leaders of a study with one objective."""
SPREAD = 9
"""The most leaders of a study with several."""


def leaders(spec: StudySpec, rows: Sequence[Row], count: int = LEADERS) -> list[Row]:
    """The best feasible trials, ties by number.

    One objective: the ``count`` best, best first. Several: members of the Pareto front (at most :data:`SPREAD`) spread
    evenly along the first objective, best first.
    """
    trials = [r for r in rows if r["kind"] == "trial" and r["state"] == "COMPLETE" and r["feasible"]]
    if not spec.objectives or not trials:
        return []
    signs = np.array([-1.0 if o.direction == "maximize" else 1.0 for o in spec.objectives])
    values = signs * np.array([[r[f"objectives.{i}"] for i in range(len(signs))] for r in trials])
    numbers = np.array([r["number"] for r in trials])
    order = np.lexsort((numbers, *values.T[::-1]))
    chosen = order[:count] if len(signs) == 1 else order[_spread(values[order])]
    return [trials[k] for k in chosen]


def _spread(values: NDArray[np.float64]) -> list[int]:
    """Members of the front nearest to evenly spaced values of the first objective; rows are sorted, smaller is better."""
    members = np.flatnonzero(nondominated(values))
    first = values[members, 0]
    wanted = np.linspace(first[0], first[-1], SPREAD)
    return sorted({int(members[np.abs(first - value).argmin()]) for value in wanted})


def parameters(result: Row) -> dict[str, float]:
    """A row's sampled variables."""
    prefix = "parameters."
    return {k.removeprefix(prefix): v for k, v in result.items() if k.startswith(prefix) and v is not None}
