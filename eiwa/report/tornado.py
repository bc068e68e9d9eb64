"""How far each variable moves an objective, as bars around the design."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eiwa.core.spec import StudySpec
from eiwa.report.figure import OTHERS, _figure, _save
from eiwa.study.pareto import goal_of
from eiwa.study.sensitivity import Effect


def draw(spec: StudySpec, effects: Sequence[Effect], path: Path, title: str) -> None:
    """Draw one panel per objective, the variable with the largest change on top.

    Raises
    ------
    EiwaError
        Matplotlib is missing, the ending is unknown, or the file cannot be written.
    """
    count = len(spec.objectives)
    figure = _figure((3.6 * max(1.4, count), 1.2 + 0.42 * len(effects)))
    panels = figure.subplots(1, count, squeeze=False)[0]
    for k, panel in enumerate(panels):
        _panel(panel, effects, k)
        unit = goal_of(spec, k).unit
        panel.set_xlabel(f"change of {spec.objectives[k].label}" + (f" [{unit}]" if unit else ""), fontsize=8)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=7, frameon=False)
    figure.suptitle(f"One variable at a time, around {title}", fontsize=9)
    _save(figure, path)


def _panel(panel: Any, effects: Sequence[Effect], k: int) -> None:
    ordered = sorted(effects, key=lambda e: max(abs(c[k].mean) for c in e.changes))
    for end, colour, label, aside in (
        (0, OTHERS[1], "at its low end", 0.17),
        (-1, OTHERS[2], "at its high end", -0.17),
    ):
        at = [y + aside for y in range(len(ordered))]
        changes = [e.changes[end][k] for e in ordered]
        panel.barh(at, [c.mean for c in changes], color=colour, height=0.3, label=label)
        panel.errorbar(
            [c.mean for c in changes], at, xerr=[c.half_width for c in changes],
            color="0.2", linestyle="none", elinewidth=0.8, capsize=1.5,
        )  # fmt: skip
    panel.axvline(0, color="0.2", linewidth=0.8)
    names = [f"{e.variable}\n{e.levels[0]:.3g} to {e.levels[-1]:.3g}" for e in ordered]
    panel.set_yticks(range(len(ordered)), names, fontsize=7)
    panel.tick_params(axis="x", labelsize=7)
