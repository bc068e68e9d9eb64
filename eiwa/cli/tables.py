"""Tables of results, at most 80 columns wide."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from statistics import stdev
from typing import TYPE_CHECKING, Any

from rich.cells import cell_len
from rich.table import Table
from rich.text import Text

from eiwa.core.named import parted
from eiwa.core.scenarios import REFERENCE
from eiwa.core.spec import StudySpec
from eiwa.core.tree import exists, lookup

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

    from eiwa.core.interfaces import Operator
    from eiwa.study.rows import Row

WIDTH = 80
MAX_VALUES = 4


def results(spec: StudySpec, rows: Sequence[Row]) -> Table:
    """Named designs and leaders: what varies, the objective with its error, what was published."""
    variables = len(spec.searched) > MAX_VALUES
    columns = list(spec.ranges) if variables else varied(spec)
    metrics = shown_metrics(spec)
    objectives = columned(spec)
    published = sorted({m for d in spec.designs.values() for m in d.published})
    heads = ["design", *(short(path).replace(" ", "\n") for path in columns[:MAX_VALUES])]
    heads += [f"{metric} ± se" if metric == "F" else lines(metric) for metric in metrics]
    heads += [*(lines(label) for _, label in objectives), *(f"published\n{metric}" for metric in published)]
    shown, winner, first = _ranking(spec, rows)
    cells = []
    for name, row in shown:
        tie = " ~" if _tied(winner, row) else ""
        values = [_value(spec, row, column, variables) for column in columns[:MAX_VALUES]]
        numbers = [number(row, metric) for metric in metrics]
        values_of = [_objective(row, i) for i, _ in objectives]
        design = spec.designs.get(name)
        known = [_plain(design.published.get(m)) if design else "" for m in published]
        cells.append([name + tie, *values, *numbers, *values_of, *known])
    bold = next((k for k, (_, row) in enumerate(shown) if row is winner), None)
    return plain(f"Study {spec.study.name}", heads, cells, bold=bold, after=first - 1)


def best(spec: StudySpec, rows: Sequence[Row]) -> str | None:
    """Name of the best design of the results."""
    shown, winner, _ = _ranking(spec, rows)
    return next((name for name, row in shown if row is winner), None)


def ties(spec: StudySpec, rows: Sequence[Row]) -> bool:
    """Whether the results mark a design as tied with the best one."""
    shown, winner, _ = _ranking(spec, rows)
    return any(_tied(winner, row) for _, row in shown)


def _ranking(spec: StudySpec, rows: Sequence[Row]) -> tuple[list[tuple[str, Row]], Row | None, int]:
    """What the results show, by name; the best of it; and where the trials begin."""
    from eiwa.study.run import leaders

    best = leaders(spec, rows)
    full = {r["number"]: r for r in rows if r["kind"] == "leader" and r["state"] == "COMPLETE"}
    shown = [(r["name"], r) for r in designs(spec, rows)]
    if ranked(spec):
        sign = -1.0 if spec.objectives[0].direction == "maximize" else 1.0
        shown.sort(key=lambda item: sign * item[1]["objectives.0"])
    first = len(shown) if best else 0
    shown += [(f"trial {r['number']}", full.get(r["number"], r)) for r in best]
    return shown, shown[first][1] if best or (ranked(spec) and shown) else None, first


def _tied(winner: Row | None, row: Row) -> bool:
    from eiwa.study.compare import tied

    return winner is not None and row is not winner and bool(tied(winner, row))


def _objective(row: Row, i: int) -> str:
    """An objective with the standard deviation over its replicates."""
    replicated = row.get(f"replicated.objectives.{i}")
    if not replicated:
        return _plain(row.get(f"objectives.{i}"))
    return with_error(row[f"objectives.{i}"], stdev(replicated))


def ranked(spec: StudySpec) -> bool:
    """Whether named designs are ranked by the first objective: a study without trials that has one."""
    return not spec.study.trials and bool(spec.objectives) and spec.objectives[0].over != "designs"


def scenarios(spec: StudySpec, rows: Sequence[Row]) -> Table | None:
    """The first metric of the same designs under every scenario."""
    from eiwa.study.rows import metric_column
    from eiwa.study.run import leaders

    if len(spec.scenarios) < 2:
        return None
    metric = next((o.metric for o in spec.objectives if o.metric), "F")
    full = {r["number"]: r for r in rows if r["kind"] == "leader" and r["state"] == "COMPLETE"}
    shown = [(r["name"], r) for r in designs(spec, rows)][:3]
    shown += [(f"trial {r['number']}", full.get(r["number"], r)) for r in leaders(spec, rows)[:1]]
    cells = []
    for scenario in spec.scenarios:
        columns = [metric_column(m, scenario.label) for m in (metric, f"{metric}_se")]
        values = [with_error(*(row.get(column) for column in columns)) for _, row in shown]
        cells.append([scenario_label(spec, scenario.label), *values])
    return plain(f"{metric} under every scenario (*: the reference)", ["scenario", *(name for name, _ in shown)], cells)


def designs(spec: StudySpec, rows: Sequence[Row]) -> list[Row]:
    """The newest row of every named design of the study file, in its order."""
    newest = {r["name"]: r for r in rows if r["kind"] == "design" and r["state"] == "COMPLETE"}
    return [newest[name] for name in spec.designs if name in newest]


def shown_metrics(spec: StudySpec) -> list[str]:
    """Metrics worth a column: the objectives' at the reference, then F, unless an objective aggregates it."""
    named = [o.metric for o in spec.objectives if o.metric and o.over == "reference"]
    aggregated = any("F" in o.numbers for o in spec.objectives)
    return list(dict.fromkeys([*named, *([] if aggregated and (named or columned(spec)) else ["F"])]))[:3]


def columned(spec: StudySpec) -> list[tuple[int, str]]:
    """Objectives that are not a metric at the reference, with their labels."""
    return [(i, o.label) for i, o in enumerate(spec.objectives) if o.over != "reference" or o.expression]


def metrics(spec: StudySpec, scenarios: Mapping[str, Mapping[str, float | None]], title: str) -> Table:
    """Every number of one design, one column per scenario; what it means, where there is but one."""
    known = {name: number for name, (_, number) in spec.registry.numbers().items()}
    heads = ["metric", *(scenario_label(spec, label) for label in scenarios)]
    rows = {}
    for name in next(iter(scenarios.values())):
        if not name.endswith("_se") and any(numbers[name] is not None for numbers in scenarios.values()):
            unit = f" [{known[name].unit}]" if known[name].unit else ""
            values = [with_error(numbers[name], numbers.get(f"{name}_se")) for numbers in scenarios.values()]
            rows[name] = [name + unit, *values]
    if len(scenarios) > 1:
        return plain(title, heads, list(rows.values()))
    table = plain(title, heads, [])
    table.add_column("meaning", style="dim")
    for name, cells in rows.items():
        table.add_row(*map(Text, cells), known[name].description)
    return table


def operators(spec: StudySpec, chosen: Mapping[str, Operator]) -> Table:
    """How the operator sat under every scenario, adjusted to their own liking."""
    rows = [(scenario_label(spec, label), f"{o.armrest:g}", f"{o.seat:g}") for label, o in chosen.items()]
    return plain("What the operator chose", ["scenario", "armrest [m]", "seat [m]"], rows)


def number(row: Row, metric: str) -> str:
    """A metric of a row with its error."""
    return with_error(row.get(f"metrics.{metric}"), row.get(f"metrics.{metric}_se"))


def with_error(value: float | None, error: float | None) -> str:
    """A number with its standard error, to digits that mean something."""
    if value is None:
        return "-"
    if error is None:
        if value >= 1000:
            return f"{value:,.0f}"
        return f"{value:.4f}" if abs(value) >= 1e-3 or value == 0 else f"{value:.2e}"
    return f"{value:.4f} ± {error:.4f}"


def varied(spec: StudySpec) -> list[str]:
    """Paths that designs or the search change, searched ones first."""
    named = [p for d in spec.designs.values() for p in parted(d.overrides)[1]]
    return list(dict.fromkeys([*spec.searched, *named]))


def assumptions(spec: StudySpec) -> Table | None:
    """Every assumption: its path, the value in force, why."""
    if not spec.assumptions:
        return None
    table = blank("Assumptions (what the study's source does not state)")
    table.add_column("what", style="cyan")
    table.add_column("value", justify="left", max_width=22)
    table.add_column("why", ratio=1)
    for path, reason in spec.assumptions.items():
        table.add_row(Text(path), Text(_shown(lookup(spec.resolved, path))), Text(reason))
    return table


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ""
    if isinstance(value, list):
        return ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def scenario_label(spec: StudySpec, label: str) -> str:
    """A scenario's label with path steps cut; the reference by the value it has."""
    if label != REFERENCE.label:
        return " ".join(_cut(part) for part in label.split(" "))
    if spec.scenarios[0].title:
        return f"{spec.scenarios[0].title} *"
    paths = list(dict.fromkeys(p for p in spec.tree.get("scenarios", {}) if "." in p))
    shown = " ".join(_cut(f"{p}={_shown(lookup(spec.defaults, p))}") for p in paths)
    return f"{shown} *" if shown else "value" if len(spec.scenarios) == 1 else "as written *"


def _cut(setting: str) -> str:
    """'layout.offset.1=0.8' -> 'offset 1=0.8'."""
    path, equals, value = setting.partition("=")
    return f"{short(path)}{equals}{value}"


def short(path: str) -> str:
    """'arm.joints.upper.a' -> 'upper a', 'layout.spacing' -> 'spacing'."""
    steps = path.split(".")
    return (
        " ".join(steps[2:])
        if steps[:2] == ["arm", "joints"]
        else steps[-1]
        if len(steps) == 2
        else " ".join(steps[-2:])
    )


def _value(spec: StudySpec, row: Row, column: str, variable: bool) -> str:
    """What a row has in a column: its own value at a path, the study's, or its variable's."""
    if variable:
        return _plain(row.get(f"parameters.{column}"))
    overrides = json.loads(row["overrides"])
    if column in overrides:
        return _plain(overrides[column])
    resolved = spec.defaults_with(parted(overrides)[0])
    return _plain(lookup(resolved, column)) if exists(resolved, column) else ""


def lines(label: str, width: int = 16) -> str:
    """A label on as many lines as it takes, broken behind spaces and underscores."""
    lines = [""]
    for word in re.findall(r"[^ _]*[ _]?", label):
        lines = [*lines[:-1], lines[-1] + word] if len(lines[-1] + word) <= width else [*lines, word]
    return "\n".join(line.strip() for line in lines)


def _plain(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return _shown(value)
    return (f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}") if isinstance(value, float) else str(value)


class Folding(Table):
    """A table whose columns that find no room follow below, beside the first one again."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widths = [max(_length(text) for text in (c.header, *c.cells)) if c.no_wrap else 2 for c in self.columns]
        parts = [[0]]
        for k in range(1, len(self.columns)):
            if len(parts[-1]) > 1 and sum(2 + widths[j] for j in (*parts[-1], k)) > options.max_width:
                parts.append([0])
            parts[-1].append(k)
        if len(parts) == 1:
            yield from super().__rich_console__(console, options)
            return
        for n, part in enumerate(parts):
            table = self._of(part)
            table.title = None if n else self.title
            yield table

    def _of(self, part: Sequence[int]) -> Table:
        """Some of the columns."""
        table = blank("")
        for k in part:
            c = self.columns[k]
            table.add_column(c.header, justify=c.justify, style=c.style, no_wrap=c.no_wrap)
        for row, *cells in zip(self.rows, *(self.columns[k].cells for k in part), strict=True):
            table.add_row(*cells, style=row.style, end_section=row.end_section)
        return table


def _length(cell: Any) -> int:
    text = cell if isinstance(cell, Text) else Text.from_markup(str(cell))
    return max(map(cell_len, text.plain.split("\n")))


def blank(title: str) -> Table:
    """A table without columns yet."""
    from rich import box

    return Folding(
        title=title.replace("[", "\\[") or None,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )


def plain(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    bold: int | None = None,
    after: int | None = None,
) -> Table:
    """Texts as they are, the first column to the left.

    ``bold`` is the number of a row to stress, ``after`` of one to draw a line under.
    """
    table = blank(title)
    for number, column in enumerate(columns):
        table.add_column(Text(column), justify="right" if number else "left", no_wrap=True)
    for number, row in enumerate(rows):
        table.add_row(*map(Text, row), style="bold" if number == bold else None, end_section=number == after)
    return table


def width(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Characters of a table: its widest cells, and two between columns."""
    cells = [[*head.split("\n"), *(row[k] for row in rows)] for k, head in enumerate(columns)]
    return sum(2 + max(map(len, column)) for column in cells)
