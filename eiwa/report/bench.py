"""Figures of what ``eiwa bench`` measured: who is how fast, where a trial's time goes, how a sample's time scales."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from eiwa.bench.measure import Record
from eiwa.report.figure import OTHERS, _figure, _save

LOOKS = {
    (6, "f64"): (OTHERS[0], "o"),
    (7, "f64"): (OTHERS[0], "s"),
    (6, "f32"): (OTHERS[1], "o"),
    (7, "f32"): (OTHERS[1], "s"),
}
AXES = {"samples": "samples N", "joints": "joints", "voxel": "voxel size r [mm]", "threads": "threads"}


def draw(records: Sequence[Record], folder: Path) -> list[Path]:
    """One picture for each of compare, share and scaling that was measured.

    Raises
    ------
    EiwaError
        Matplotlib is missing or a file cannot be written.
    """
    drawn = []
    pictures: dict[str, Callable[[Sequence[Record]], Any]] = {"compare": _compare, "share": _share, "scaling": _scaling}
    for what, picture in pictures.items():
        part = [r for r in records if r.what == what and r.seconds is not None]
        if part:
            drawn.append(folder / f"{what}.png")
            _save(picture(part), drawn[-1])
    return drawn


def _compare(records: Sequence[Record]) -> Any:
    """Median and quartiles of everybody's time per sample, a panel for each number of threads."""
    flows = [r for r in records if r.part in ("flow", "product")]
    threads = sorted({r.threads for r in flows})
    slowest: dict[str, float] = {}
    for r in flows:
        slowest[r.who] = max(slowest.get(r.who, 0.0), r.seconds or 0.0)
    names = sorted(slowest, key=lambda who: -slowest[who])
    figure = _figure((7.2, 0.8 + 0.27 * len(names)))
    panels = figure.subplots(1, len(threads), sharey=True, sharex=True, squeeze=False)[0]
    for panel, t in zip(panels, threads, strict=True):
        for offset, ((joints, precision), (colour, marker)) in enumerate(LOOKS.items()):
            shown = [r for r in flows if (r.threads, r.joints, r.precision) == (t, joints, precision)]
            panel.errorbar(
                [1e9 * (r.seconds or 0) for r in shown],
                [names.index(r.who) + 0.15 * (1.5 - offset) for r in shown],
                xerr=_spread(shown, 1e9), color=colour, marker=marker, markersize=3.5, linestyle="none",
                elinewidth=1, markerfacecolor=colour if joints == 6 else "white", label=f"{joints} joints, {precision}",
            )  # fmt: skip
        panel.set_title(f"{t} thread{'s' * (t > 1)}", fontsize=8)
        panel.set_xscale("log")
        panel.set_xlabel("time per sample [ns]", fontsize=8)
        panel.set_yticks(range(len(names)), names)
        panel.tick_params(labelsize=7)
        panel.grid(axis="both", linewidth=0.3)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7, frameon=False)
    return figure


def _share(records: Sequence[Record]) -> Any:
    """Milliseconds of every stage of a trial, with its share."""
    stages = list(dict.fromkeys(r.part for r in records if r.part != "trial"))
    threads = sorted({r.threads for r in records})
    figure = _figure((4.8, 0.8 + 0.26 * len(stages)))
    axes = figure.subplots()
    height = 0.8 / len(threads)
    for number, (t, colour) in enumerate(zip(threads, (OTHERS[0], OTHERS[1]), strict=False)):
        shown = {r.part: r for r in records if r.threads == t}
        rows = [len(stages) - 1 - k + height * ((len(threads) - 1) / 2 - number) for k in range(len(stages))]
        found = [shown[stage] for stage in stages]
        label = f"{t} thread{'s' * (t > 1)}, {1e3 * (shown['trial'].seconds or 0):.0f} ms in all"
        bars = axes.barh(rows, [1e3 * (r.seconds or 0) for r in found], height, color=colour, label=label)
        axes.bar_label(bars, [f"{r.ratio or 0:.1%}" for r in found], padding=2, fontsize=6)
    axes.set_yticks(range(len(stages) - 1, -1, -1), stages)
    axes.margins(x=0.12)
    axes.set_xlabel("time per trial [ms]", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=7, frameon=False, loc="lower right")
    return figure


def _scaling(records: Sequence[Record]) -> Any:
    """Time per sample along every axis."""
    figure = _figure((7.2, 4.8))
    panels = figure.subplots(2, 2).ravel()
    most = max(r.threads for r in records)
    for panel, (axis, label) in zip(panels, AXES.items(), strict=True):
        part = [r for r in records if r.part == axis]
        lines = [(None, OTHERS[2])] if axis == "threads" else [(1, OTHERS[0]), (most, OTHERS[1])][: 1 + (most > 1)]
        for t, colour in lines:
            shown = [r for r in part if t is None or r.threads == t]
            name = None if t is None else f"{t} thread{'s' * (t > 1)}"
            x = [getattr(r, axis) * (1e3 if axis == "voxel" else 1) for r in shown]
            y = [1e9 * (r.seconds or 0) for r in shown]
            panel.errorbar(
                x, y, yerr=_spread(shown, 1e9), color=colour, marker="o", markersize=3, capsize=2, label=name
            )
        if axis == "threads" and part:
            first = 1e9 * (part[0].seconds or 0)
            panel.plot([r.threads for r in part], [first / r.threads for r in part], color="grey", linestyle="dotted",
                       linewidth=1, label="first / threads")  # fmt: skip
        if axis != "joints":
            panel.set_xscale("log", base=2)
        if axis == "voxel":
            panel.set_yscale("log")
            panel.yaxis.set_major_formatter("{x:g}")
            panel.yaxis.set_minor_formatter("")
        else:
            panel.set_ylim(bottom=0)
        if axis != "samples":
            values = sorted({getattr(r, axis) * (1e3 if axis == "voxel" else 1) for r in part})
            panel.set_xticks(values, [f"{value:g}" for value in values])
        panel.set_xlabel(label, fontsize=8)
        panel.set_ylabel("time per sample [ns]", fontsize=8)
        panel.tick_params(labelsize=7)
        panel.legend(fontsize=7, frameon=False)
    return figure


def _spread(records: Sequence[Record], scale: float) -> list[list[float]]:
    """Distances from the median to the quartiles."""
    middles = [r.seconds or 0.0 for r in records]
    lower = [scale * (m - (r.lower or m)) for r, m in zip(records, middles, strict=True)]
    upper = [scale * ((r.upper or m) - m) for r, m in zip(records, middles, strict=True)]
    return [lower, upper]
