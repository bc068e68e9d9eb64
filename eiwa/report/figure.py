"""The interaction workspace of one design, drawn from above and from the side."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.errors import EiwaError
from eiwa.core.evaluation import Measurement, Pair, metrics
from eiwa.core.interfaces import Array
from eiwa.core.outcome import measurements
from eiwa.core.spec import StudySpec
from eiwa.core.workspace import Grid
from eiwa.study.converge import Point

# Okabe and Ito's colour-blind safe palette; these three mean the same in every figure of eiwa, and nothing else.
RIGHT, LEFT, INTERACTION = "#0072B2", "#D55E00", "#CC79A7"
OTHERS = "#009E73", "#E69F00", "#56B4E9"
"""For what is on neither side."""
ISOVALUE = 0.3
VIEWS = ((0, 1, 2, "from above"), (1, 2, 0, "from the right side"))
AXES = ("x, to the right [m]", "y, forward [m]", "z, up [m]")


def require(path: Path) -> None:
    """Refuse, before any work, a picture that could not be drawn.

    Raises
    ------
    EiwaError
        Matplotlib is missing, the ending is unknown, or the folder cannot be written to.
    """
    known = _figure((1, 1)).canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in known:
        raise EiwaError(f"{path}: cannot be drawn: write png, pdf or svg at its end.")
    if not os.access(path.parent, os.W_OK) or path.is_dir():
        reason = "is a folder" if path.is_dir() else f"{path.parent} is no folder that can be written to"
        raise EiwaError(f"{path}: cannot be drawn: {reason}.")


def draw(spec: StudySpec, overrides: Mapping[str, Any], path: Path, title: str = "") -> None:
    """Draw one design under the reference scenario into a file.

    Parameters
    ----------
    spec, overrides
        The study, and the design as values at paths.
    path
        The picture; its ending chooses the format (png, pdf, svg).

    Raises
    ------
    EiwaError
        Matplotlib is missing, the ending is unknown, or the file cannot be written.
    """
    ((_, measurement),) = measurements(spec, overrides)
    figure = _figure((7.2, 3.6))
    panels = figure.subplots(1, 2)
    images = [_panel(panel, measurement, *view) for panel, view in zip(panels, VIEWS, strict=True)]
    colours = figure.colorbar(images[0], ax=panels, shrink=0.8, pad=0.02)
    colours.set_label("largest $V_{dual}$ along the line of sight", fontsize=8)
    colours.ax.tick_params(labelsize=7)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=4, fontsize=7, frameon=False)
    F = metrics(measurement)["F"]
    figure.suptitle(f"{title}: F = {F:.3f}" if title else f"F = {F:.3f}", fontsize=10)
    _save(figure, path)


def draw_convergence(points: Sequence[Point], path: Path, title: str) -> None:
    """F against the number of samples, a line per voxel size, with the refined F of elites as a dashed line.

    Raises
    ------
    EiwaError
        As :func:`draw`.
    """
    figure = _figure((4.8, 3.4))
    axes = figure.subplots()
    sizes = dict.fromkeys(p.size for p in points)
    for size, colour, marker in zip(sizes, OTHERS, "osD", strict=False):
        sampled = [p for p in points if p.size == size and p.estimator != "elites"]
        axes.errorbar(
            [p.samples for p in sampled], [p.F for p in sampled], yerr=[p.se or 0.0 for p in sampled],
            color=colour, marker=marker, markersize=3, capsize=2, label=f"{sampled[0].estimator}, r = {1e3 * size:g} mm",
        )  # fmt: skip
        for refined in (p for p in points if p.size == size and p.estimator == "elites"):
            axes.axhline(refined.F, color=colour, linestyle="dashed", linewidth=1)
            axes.axhspan(refined.F, refined.F + (refined.remaining or 0.0), color=colour, alpha=0.2)
    axes.set_xscale("log")
    axes.set_xlabel("samples N", fontsize=8)
    axes.set_ylabel("F", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.set_title(f"{title} (dashed: elites, band: may still rise)".strip(), fontsize=8)
    axes.legend(fontsize=7, frameon=False)
    _save(figure, path)


def _figure(size: tuple[float, float]) -> Any:
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise EiwaError("figures need matplotlib: pip install 'eiwa[figures]'") from None
    figure = Figure(figsize=size, dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Any, path: Path) -> None:
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise EiwaError(f"{path}: cannot be drawn: {error}") from None


def _panel(panel: Any, measurement: Measurement, across: int, up: int, along: int, name: str) -> Any:
    """One view: V_dual of both arms in grey, outlines of hands and of the interaction workspace, the two bases."""
    whole, first = measurement.whole, measurement.first
    V_dual = first.alpha * (whole.right.values + whole.left.values)
    extent = _extent(whole.grid, across, up)
    image = panel.imshow(
        _seen(V_dual, across, up, along),
        extent=extent,
        origin="lower",
        cmap="Greys",
        vmin=0,
        vmax=1,
        aspect="equal",
    )
    grid = first.V.grid
    for E, colour, style in ((first.E.right, RIGHT, "solid"), (first.E.left, LEFT, "dashed")):
        _outline(panel, grid, _seen(E > 0, across, up, along), across, up, colour, style)
    interaction = (first.E_sum > 0) & (first.V_dual >= ISOVALUE)
    _fill(panel, grid, _seen(interaction, across, up, along), across, up)
    right, left = (T[:3, 3] for T in measurement.setup.layout.Ts_world_base)
    for base, colour in ((left, LEFT), (right, RIGHT)):  # seen from the right, the right one is in front
        panel.plot(base[across], base[up], marker="^", color=colour, markersize=6, linestyle="none")
    low, high = _limits(whole, first.V.grid, across, up)
    panel.set_xlim(low[0], high[0])
    panel.set_ylim(low[1], high[1])
    panel.set_xlabel(AXES[across], fontsize=8)
    panel.set_ylabel(AXES[up], fontsize=8)
    panel.set_title(name, fontsize=8)
    panel.tick_params(labelsize=7)
    return image


def _seen(values: Array | NDArray[np.bool_], across: int, up: int, along: int) -> NDArray[Any]:
    """Largest value along the line of sight, as an image with ``up`` in the rows."""
    seen: NDArray[Any] = values.max(axis=along)
    return seen.T if across < up else seen


def _extent(grid: Grid, across: int, up: int) -> tuple[float, float, float, float]:
    x, y = grid.faces(across), grid.faces(up)
    return float(x[0]), float(x[-1]), float(y[0]), float(y[-1])


def _limits(whole: Pair, grid: Grid, across: int, up: int) -> tuple[list[float], list[float]]:
    """A window that holds the dexterous workspace and the hands."""
    reached = (whole.right.values > 0) | (whole.left.values > 0)
    low, high = [], []
    for axis in (across, up):
        others = tuple(k for k in range(3) if k != axis)
        cells = np.flatnonzero(reached.any(axis=others))
        faces, hands = whole.grid.faces(axis), grid.faces(axis)
        ends = (faces[cells[0]], faces[cells[-1] + 1]) if cells.size else (hands[0], hands[-1])
        low.append(float(min(ends[0], hands[0]) - 0.02))
        high.append(float(max(ends[1], hands[-1]) + 0.02))
    return low, high


def _outline(panel: Any, grid: Grid, mask: NDArray[Any], across: int, up: int, colour: str, style: str) -> None:
    x, y, padded = _padded(grid, mask, across, up)
    panel.contour(x, y, padded, levels=[0.5], colors=[colour], linewidths=1.2, linestyles=style)


def _fill(panel: Any, grid: Grid, mask: NDArray[Any], across: int, up: int) -> None:
    if mask.any():
        x, y, padded = _padded(grid, mask, across, up)
        panel.contourf(x, y, padded, levels=[0.5, 1.5], colors=[INTERACTION], alpha=0.45)


def _padded(grid: Grid, mask: NDArray[Any], across: int, up: int) -> tuple[Array, Array, Array]:
    """Centres and mask with an empty rim, so that outlines close at the grid's border."""
    x, y = (np.concatenate([[c[0] - grid.r], c, [c[-1] + grid.r]]) for c in map(grid.centres, (across, up)))
    return x, y, np.pad(mask.astype(float), 1)


def _legend() -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Line2D([], [], color=RIGHT, label="right hand, E > 0"),
        Line2D([], [], color=LEFT, linestyle="dashed", label="left hand, E > 0"),
        Patch(color=INTERACTION, alpha=0.45, label=f"interaction, $V_{{dual}} \\geq$ {ISOVALUE}"),
        Line2D([], [], color="grey", marker="^", linestyle="none", label="bases"),
    ]
