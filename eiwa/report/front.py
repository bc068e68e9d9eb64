"""A Pareto front drawn: the trials goal against goal, and the hypervolume against the number of trials."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from eiwa.report.figure import OTHERS, _figure, _save
from eiwa.study.pareto import Goal, Pareto

PAIRS = 3
"""Panels of goal against goal; further pairs are left out."""
LINES = (OTHERS[2], OTHERS[1], "#000000", "#999999")
"""Of runs; the front that they make together is in the first of the others."""


def draw(found: Pareto, path: Path, title: str = "") -> None:
    """Draw a front into a file whose ending chooses the format (png, pdf, svg).

    Raises
    ------
    EiwaError
        Matplotlib is missing, the ending is unknown, or the file cannot be written.
    """
    pairs = list(combinations(range(len(found.goals)), 2))[:PAIRS]
    several = len(pairs) > 1
    figure = _figure((7.2, 6.0) if several else (7.2, 3.3))
    panels = figure.subplots(2, 2).ravel() if several else figure.subplots(1, 2)
    for panel, (x, y) in zip(panels, pairs, strict=False):
        _goals(panel, found, x, y)
    _history(panels[-1], found)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=7, frameon=False)
    if title:
        figure.suptitle(title, fontsize=10)
    _save(figure, path)


def _goals(panel: Any, found: Pareto, x: int, y: int) -> None:
    """Two goals: feasible trials grey, others hollow, the front in colour with its errors, the knee as a diamond."""
    columns = [found.goals[k].column for k in (x, y)]
    values = [
        (tuple(row.get(c) for c in columns), point is not None)
        for t in found.runs
        for row, point in zip(t.rows, t.points, strict=True)
        if row["state"] == "COMPLETE" and all(row.get(c) is not None for c in columns)
    ]
    feasible = np.array([v for v, good in values if good])
    infeasible = np.array([v for v, good in values if not good]).reshape(-1, 2)
    grey = {"linestyle": "none", "marker": "o", "markersize": 3, "markeredgewidth": 0.5}
    if len(infeasible):
        panel.plot(*infeasible.T, **grey, color="0.6", markerfacecolor="none", label="constraint not met")
    panel.plot(*feasible.T, **grey, color="0.7", label="feasible trial")
    front = np.array([(m.values[x], m.values[y]) for m in found.members])
    errors = np.array([[m.errors[x] or 0.0, m.errors[y] or 0.0] for m in found.members])
    if len(found.goals) == 2:
        panel.step(*_stairs(front, found.goals[x]), color=OTHERS[0], linewidth=0.8, alpha=0.6, where="post")
    panel.errorbar(
        *front.T, xerr=errors[:, 0], yerr=errors[:, 1],
        color=OTHERS[0], linestyle="none", marker="o", markersize=3.5, elinewidth=0.8, capsize=1.5, label="front",
    )  # fmt: skip
    for member in (m for m in found.members if m.knee):
        at = member.values[x], member.values[y]
        panel.plot(*at, color=OTHERS[1], marker="D", markersize=6, linestyle="none", label="knee", zorder=5)
    panel.set_xlabel(_axis(found.goals[x]), fontsize=8)
    panel.set_ylabel(_axis(found.goals[y]), fontsize=8)
    panel.tick_params(labelsize=7)


def _stairs(front: Any, goal: Goal) -> tuple[Any, Any]:
    """Corners of what the front attains, from the best of the first goal to the best of the second."""
    order = np.lexsort((front[:, 1], goal.sign * front[:, 0]))
    return front[order, 0], front[order, 1]


def _history(panel: Any, found: Pareto) -> None:
    """Hypervolume of every run after so many of its trials."""
    several = len(found.histories) > 1
    for k, (run, volumes) in enumerate(found.histories.items()):
        trials = np.arange(len(volumes) + 1)
        colour = LINES[k % len(LINES)]
        panel.step(trials, [0.0, *volumes], where="post", color=colour, linewidth=1.2, label=run)
    if several:
        panel.axhline(found.hypervolume, color="0.4", linestyle="dashed", linewidth=0.8, label="together")
        panel.legend(fontsize=6, frameon=False, loc="lower right")
    panel.set_xlabel("trials", fontsize=8)
    panel.set_ylabel(f"hypervolume{_units(found.goals)}", fontsize=8)
    panel.set_ylim(bottom=0)
    panel.tick_params(labelsize=7)


def _axis(goal: Goal) -> str:
    unit = f" [{goal.unit}]" if goal.unit else ""
    return f"{goal.name}{unit}, {'larger' if goal.maximised else 'smaller'} is better"


def _units(goals: Sequence[Goal]) -> str:
    units = [goal.unit for goal in goals if goal.unit not in ("", "1")]
    return f" [{'·'.join(units)}]" if units else ""
