"""Figures of a study's results as plotly's JSON: dictionaries that a page's own plotly draws."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from itertools import accumulate, cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.evaluation import metrics
from eiwa.core.outcome import measurements
from eiwa.core.spec import StudySpec
from eiwa.report.figure import INTERACTION, LEFT, RIGHT
from eiwa.study.rows import Row, metric_column

Figure = dict[str, Any]
Shown = Sequence[tuple[str, Row]]
"""Names and rows of named designs and of best trials."""

# Okabe and Ito's colour-blind safe palette, as in eiwa.report.figure: one meaning a colour.
TRIAL, BROKEN, BEST, NAMED = "#56B4E9", "#BBBBBB", "#009E73", "#E69F00"
SIDE_BY_SIDE = BEST, NAMED, TRIAL, "#000000", "#999999"
DARK = "#5C1F47"
DASHES = ("dash", "dot", "dashdot", "longdash")
MOST_CELLS = 1500


def history(spec: StudySpec, rows: Sequence[Row], shown: Shown) -> Figure:
    """The first objective of every trial and the best so far; designs evaluated in full with their standard error."""
    objective = spec.objectives[0]
    trials = sorted(_complete(rows), key=lambda r: r["number"])
    met = [r for r in trials if r["feasible"]]
    better = max if objective.direction == "maximize" else min
    running = list(accumulate((r["objectives.0"] for r in met), better))
    traces = [
        *_constrained(spec, trials, "number", "objectives.0"),
        _trace("best so far", [r["number"] for r in met], running, mode="lines", line={"color": BEST, "shape": "hv"}),
    ]
    last = trials[-1]["number"] if trials else 1
    dashes = cycle(DASHES)
    for name, row in shown:
        value, error = row.get("objectives.0"), spread(row, 0)
        if value is None:
            continue
        if row["kind"] == "design":
            line = {"color": NAMED, "dash": next(dashes)}
            traces.append(_trace(name, [0, last], [value] * 2, mode="lines", line=line, error=[error] * 2))
        elif error is not None:
            marker = {"color": BEST, "size": 9, "symbol": "diamond"}
            traces.append(_trace(name, [row["number"]], [value], mode="markers", marker=marker, error=[error]))
    return _figure(f"{objective.label} of every trial", traces, "trial", objective.label)


def fronts(spec: StudySpec, rows: Sequence[Row], shown: Shown) -> dict[str, Figure]:
    """Every objective against the first: trials, and designs evaluated in full with their standard errors."""
    labels = [o.label for o in spec.objectives]
    found = {}
    for i in range(1, len(labels)):
        traces = _constrained(spec, _complete(rows), "objectives.0", f"objectives.{i}")
        whole = [(n, r) for n, r in shown if r.get("objectives.0") is not None and r.get(f"objectives.{i}") is not None]
        named = [(n, r) for n, r in whole if r["kind"] == "design"]
        best = [(n, r) for n, r in whole if r["kind"] != "design"]
        traces += [_crossed("named designs", named, i, NAMED), _crossed("best trials", best, i, BEST)]
        traces[-2]["mode"] = "markers+text"
        found[f"front-{i}"] = _figure(f"{labels[i]} against {labels[0]}", traces, labels[0], labels[i])
    return found


def _crossed(title: str, shown: Shown, objective: int, colour: str) -> Figure:
    """An objective against the first one, with both errors and names."""
    trace = _trace(
        title,
        [r["objectives.0"] for _, r in shown],
        [r[f"objectives.{objective}"] for _, r in shown],
        mode="markers",
        text=[name for name, _ in shown],
        textposition="top center",
        marker={"color": colour, "size": 9, "symbol": "diamond"},
        error=[spread(r, objective) for _, r in shown],
    )
    return trace | {"error_x": _bars([spread(r, 0) for _, r in shown])}


def scenarios(metric: str, labels: Mapping[str, str], shown: Shown) -> Figure:
    """A metric under every scenario, designs side by side; ``labels``: scenario -> what to call it."""
    traces = []
    for (name, row), colour in zip(shown, cycle(SIDE_BY_SIDE), strict=False):
        values = [row.get(metric_column(metric, s)) for s in labels]
        errors = [row.get(metric_column(f"{metric}_se", s)) for s in labels]
        traces.append(
            _trace(name, list(labels.values()), values, mode="markers", marker={"color": colour}, error=errors)
        )
    figure = _figure(f"{metric} under every scenario", traces, "", metric)
    figure["layout"]["xaxis"] |= {"type": "category"}
    figure["layout"]["scattermode"] = "group"  # side by side within a category
    return figure


def workspace(spec: StudySpec, overrides: Mapping[str, Any], title: str) -> Figure:
    """The interaction workspace of a design under the reference scenario, replicate 0: what each place adds to V_I.

    In W: x to the right, y forward, z up, seen over the operator's right shoulder.

    Evaluates the design once. Cells are merged, eight into one, until at most :data:`MOST_CELLS` are left.
    """
    ((_, measurement),) = measurements(spec, overrides)
    first = measurement.first
    values, edge = np.asarray(first.E_sum * first.V_dual), first.V.grid.r
    low = np.array([first.V.grid.faces(axis)[0] for axis in range(3)])
    while np.count_nonzero(values) > MOST_CELLS:
        values, edge = merged(values), 2 * edge
    cells = np.argwhere(values > 0)
    share = values[tuple(cells.T)] / max(values.sum(), 1e-300)
    x, y, z = (np.round(low + (cells + 0.5) * edge, 4)).T.tolist()
    traces = [
        {
            "type": "scatter3d", "name": "share of V_I", "x": x, "y": y, "z": z, "mode": "markers",
            "marker": {
                "symbol": "square", "size": 4, "opacity": 0.6, "color": np.round(100 * share, 4).tolist(),
                "colorscale": [[0, "#F6E9F0"], [0.5, INTERACTION], [1, DARK]], "cmin": 0,
                "colorbar": {"title": {"text": "% of V_I"}, "len": 0.8},
            },
            "hovertemplate": "x %{x} y %{y} z %{z} m<br>%{marker.color} % of V_I<extra></extra>", "showlegend": False,
        }
    ]  # fmt: skip
    layout = measurement.setup.layout
    for name, pose, colour in zip(("right", "left"), layout.Ts_world_base, (RIGHT, LEFT), strict=True):
        bx, by, bz = pose[:3, 3].tolist()
        traces.append(
            {
                "type": "scatter3d", "name": f"{name} base", "x": [bx], "y": [by], "z": [bz], "mode": "markers",
                "marker": {"symbol": "diamond", "size": 7, "color": colour},
            }
        )  # fmt: skip
    F = metrics(measurement)["F"]
    axes: Figure = {f"{axis}axis": {"title": {"text": f"{axis} [m]"}} for axis in "xyz"}
    figure = _figure(f"Interaction workspace of {title}: F = {F:.4f}", traces, "", "")
    figure["layout"] |= {"scene": {**axes, "aspectmode": "data", "camera": {"eye": {"x": 1.5, "y": -1.3, "z": 1.1}}}}
    return figure


def merged(values: NDArray[Any]) -> NDArray[Any]:
    """Sums over 2 x 2 x 2 neighbours, the far border filled up with nothing."""
    even = np.pad(values, [(0, n % 2) for n in values.shape])
    nx, ny, nz = (n // 2 for n in even.shape)
    return np.asarray(even.reshape(nx, 2, ny, 2, nz, 2).sum(axis=(1, 3, 5)))


def spread(row: Row, number: int) -> float | None:
    """Standard deviation of an objective over the replicates of a row; None where there is only one."""
    values = row.get(f"replicated.objectives.{number}") or []
    return statistics.stdev(values) if len(values) > 1 else None


def _complete(rows: Sequence[Row]) -> list[Row]:
    return [r for r in rows if r["kind"] == "trial" and r["state"] == "COMPLETE"]


def _constrained(spec: StudySpec, trials: Sequence[Row], x: str, y: str) -> list[Figure]:
    """Trials as points; those that break a constraint as crosses of their own, with what they break."""
    broken = [r for r in trials if not r["feasible"]]
    met = [r for r in trials if r["feasible"]]
    told = [f"trial {r['number']} breaks {', '.join(_broken(spec, r))}" for r in broken]
    crosses = {"color": BROKEN, "symbol": "x"}
    return [
        _points("breaks a constraint", broken, x, y, marker=crosses, text=told),
        _points("trial", met, x, y, marker={"color": TRIAL}, text=[f"trial {r['number']}" for r in met]),
    ]


def _broken(spec: StudySpec, row: Row) -> list[str]:
    return [c.label for i, c in enumerate(spec.constraints) if (row.get(f"constraints.{i}") or 0.0) > 0]


def _points(name: str, rows: Sequence[Row], x: str, y: str, **more: Any) -> Figure:
    return _trace(name, [r[x] for r in rows], [r[y] for r in rows], mode="markers", hoverinfo="x+y+text", **more)


def _trace(name: str, x: Sequence[Any], y: Sequence[Any], *, error: Sequence[float | None] = (), **more: Any) -> Figure:
    trace: Figure = {"type": "scatter", "name": name, "x": list(map(_rounded, x)), "y": list(map(_rounded, y)), **more}
    if any(error):
        trace["error_y"] = _bars(error)
    return trace


def _bars(errors: Sequence[float | None]) -> Figure:
    return {"type": "data", "array": [_rounded(e or 0.0) for e in errors], "visible": True}


def _rounded(value: Any) -> Any:
    """Six digits, so that a figure of thousands of trials stays small."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _figure(title: str, traces: Sequence[Figure], x: str, y: str) -> Figure:
    layout = {
        "title": {"text": title},
        "xaxis": {"title": {"text": x}, "automargin": True},
        "yaxis": {"title": {"text": y}, "automargin": True},
        "legend": {"orientation": "h", "y": -0.25},
        "margin": {"l": 60, "r": 20, "t": 50, "b": 40},
    }
    return {"data": list(traces), "layout": layout}
