"""``eiwa study pareto``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eiwa.cli.console import AsJson, Runs, Settings, StudyFile, err, out, print_json, require_drawable, settings
from eiwa.core.errors import EiwaError

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.table import Table

    from eiwa.core.spec import StudySpec
    from eiwa.study.pareto import Goal, Member, Pareto

SHOWN = 30
Chosen = Annotated[
    str | None,
    typer.Option(
        "--objectives",
        metavar="A,B",
        help="Numbers in the rows, separated by commas: a metric's NAME or NAME@SCENARIO, or an objective's label. "
        "+NAME: larger is better; -NAME: smaller is better; without a sign as the study's objective has it, "
        "and smaller is better where none names it. The study's objectives when not given.",
    ),
]
Others = Annotated[
    list[str] | None,
    typer.Option("--with", metavar="FOLDER", help="Folder of another run with the same objectives; repeatable."),
]
Figure = Annotated[str | None, typer.Option("--figure", metavar="FILE", help="Draw the front (png, pdf, svg).")]
Csv = Annotated[str | None, typer.Option("--csv", metavar="FILE", help="Write the front as CSV; - is stdout.")]
Parquet = Annotated[
    str | None, typer.Option("--parquet", metavar="FILE", help="Write the front as Parquet; - is stdout.")
]


def pareto(
    study: StudyFile,
    objectives: Chosen = None,
    others: Others = None,
    figure: Figure = None,
    csv: Csv = None,
    parquet: Parquet = None,
    runs: Runs = "runs",
    set_: Settings = None,
    as_json: AsJson = False,
) -> None:
    """Show the trials that no other beats in every objective: the front, its knee, its hypervolume."""
    from eiwa.cli.results import results
    from eiwa.study.pareto import pareto as pareto_of
    from eiwa.study.store import Store

    require_drawable(figure)
    spec, store = results(study, runs, settings(set_))
    found = pareto_of(spec, [store, *(Store(Path(other)) for other in others or [])], objectives)
    if figure:
        from eiwa.report.front import draw

        draw(found, Path(figure), spec.study.name)
        err().print(f"Drew {figure}.", markup=False)
    for path, write in ((csv, _write_csv), (parquet, _write_parquet)):
        if path:
            _into(path, write, table_of(found))
    if as_json:
        print_json(summary(spec, found))
    elif "-" not in (csv, parquet):
        console = out()
        console.print(shown(spec, found))
        for line in remarks(found):
            console.print(line, markup=False)


def table_of(found: Pareto) -> pa.Table:
    """One row per member: where it comes from, what was searched, its goals with their errors, what it adds."""
    import pyarrow as pa

    rows = [_record(found.goals, member) for member in found.members]
    columns = list(dict.fromkeys(column for row in rows for column in row))
    return pa.Table.from_pylist([{column: row.get(column) for column in columns} for row in rows])


def _record(goals: Sequence[Goal], member: Member) -> dict[str, Any]:
    searched = {k: v for k, v in member.row.items() if k.startswith(("parameters.", "values.")) and v is not None}
    values = {goal.name: value for goal, value in zip(goals, member.values, strict=True)}
    errors = {f"{goal.name}_se": error for goal, error in zip(goals, member.errors, strict=True)}
    marks = {"contribution": member.contribution, "knee": member.knee, "doubtful": member.doubtful}
    return {"run": member.run, "trial": member.row["number"], **searched, **values, **errors, **marks}


def summary(spec: StudySpec, found: Pareto) -> dict[str, Any]:
    """Everything about a front as plain values."""
    goals = [{"name": g.name, "column": g.column, "maximised": g.maximised, "unit": g.unit} for g in found.goals]
    return {
        "study": spec.study.name,
        "objectives": goals,
        "front": [{**_record(found.goals, m), "best": list(m.best)} for m in found.members],
        "reference": dict(zip((g.name for g in found.goals), found.reference, strict=True)),
        "hypervolume": found.hypervolume,
        "share": found.hypervolume / found.box,
        "last_quarter": found.last_quarter,
        "histories": found.histories,
    }


def shown(spec: StudySpec, found: Pareto) -> Table:
    """The members with what was searched, as many columns of that as fit."""
    from eiwa.cli import tables

    members = _selected(found.members)
    several = len(found.runs) > 1
    heads = [*(["run"] if several else []), "trial"]
    before = [[*([m.run] if several else []), _name(m)] for m in members]
    tails = [*map(_head, found.goals), "adds"]
    after = [[*(_goal(m, k, g.name) for k, g in enumerate(found.goals)), f"{m.contribution:.1%}"] for m in members]
    searched = _searched(spec)
    while True:
        columns = [*heads, *(tables.short(c.split(".", 1)[1]).replace(" ", "\n") for c in searched), *tails]
        values = [[_cell(m.row.get(c)) for c in searched] for m in members]
        rows = [[*a, *b, *c] for a, b, c in zip(before, values, after, strict=True)]
        if not searched or tables.width(columns, rows) <= tables.WIDTH:
            return tables.plain(f"Front of {spec.study.name}", columns, rows)
        searched.pop()


def remarks(found: Pareto) -> list[str]:
    """What the reader of the table must know."""
    members, names = found.members, [g.name for g in found.goals]
    hidden = len(members) - len(_selected(members))
    feasible = sum(p is not None for t in found.runs for p in t.points)
    trials = sum(len(t.rows) for t in found.runs)
    at = ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, found.reference, strict=True))
    lines = [f"{hidden} more members: --csv FILE has them all."] if hidden else []
    lines.append(f"{len(members)} of {feasible} feasible trials ({trials} in all) are on the front.")
    share = found.hypervolume / found.box
    lines.append(f"Hypervolume {found.hypervolume:.4g}: {share:.1%} of the box from the ideal to the reference point.")
    lines.append(f"Reference point {at}: the front's worst, and a tenth of its range more.")
    if found.last_quarter is not None:
        of = f" of {found.runs[0].run}" if len(found.runs) > 1 else ""
        lines.append(f"The last quarter of the trials{of} added {found.last_quarter:.1%} of the hypervolume.")
    lines.append("* the best value of an objective; adds: the share of the hypervolume that no other member dominates.")
    if any(m.doubtful for m in members):
        lines.append("~ within the errors another member is at least as good in everything (95 %, paired replicates).")
    alone = sum(m.doubtful is None for m in members)
    if alone:
        lines.append(
            f"{alone} of {len(members)} members have no paired replicates: whether another beats them is not known."
        )
    if not any(m.knee for m in members):
        lines.append("No knee: no member lies nearer to the ideal point than the line between the extremes.")
    return lines


def _selected(members: Sequence[Member]) -> list[Member]:
    """At most so many as a screen shows: knee, extremes, those whose errors are known, and those that add most."""
    ranked = sorted(members, key=lambda m: (not (m.knee or m.best), m.errors[0] is None, -m.contribution))
    kept = {id(m) for m in ranked[:SHOWN]}
    return [m for m in members if id(m) in kept]


def _searched(spec: StudySpec) -> list[str]:
    """Columns of searched values; of variables where these are fewer."""
    paths, variables = [f"values.{p}" for p in spec.searched], [f"parameters.{v}" for v in spec.ranges]
    return paths if len(paths) <= len(variables) else variables


def _head(goal: Goal) -> str:
    from eiwa.cli.tables import lines

    return f"{lines(goal.name)}\n{'max' if goal.maximised else 'min'}{f' [{goal.unit}]' if goal.unit else ''}"


def _goal(member: Member, k: int, name: str) -> str:
    from eiwa.cli.tables import with_error

    return with_error(member.values[k], member.errors[k] or None) + (" *" if name in member.best else "")


def _name(member: Member) -> str:
    return f"{member.row['number']}{' ~' if member.doubtful else ''}{' knee' if member.knee else ''}"


def _cell(value: Any) -> str:
    if not isinstance(value, float):
        return "" if value is None else str(value)
    return f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"


def _into(path: str, write: Callable[[pa.Table, Any], None], table: pa.Table) -> None:
    """Write to a file, or to stdout for ``-``."""
    if path == "-":
        sys.stdout.flush()
        write(table, sys.stdout.buffer)
        return
    try:
        write(table, path)
    except OSError as error:
        raise EiwaError(f"{path}: cannot be written: {error.strerror or error}") from None
    err().print(f"Wrote {path}.", markup=False)


def _write_csv(table: pa.Table, sink: Any) -> None:
    from pyarrow import csv

    csv.write_csv(table, sink)


def _write_parquet(table: pa.Table, sink: Any) -> None:
    from pyarrow import parquet

    parquet.write_table(table, sink, compression="zstd")
