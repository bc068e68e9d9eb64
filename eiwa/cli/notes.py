"""A study's tables as Markdown, for pages that show notes."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.text import Text

from eiwa.cli import tables
from eiwa.core.spec import StudySpec
from eiwa.core.tree import leaves
from eiwa.study.rows import metric_column

if TYPE_CHECKING:
    from rich.table import Table

    from eiwa.core.sections import RangeSection
    from eiwa.study.rows import Row


def study_note(spec: StudySpec, rows: Sequence[Row], remarks: Sequence[str]) -> str:
    """What the study asks, what it found so far, what it assumes, and how the numbers were made."""
    asked = [f"{o.direction.capitalize()} **{literal(o.label)}**" for o in spec.objectives]
    bounds = [f"**{literal(c.label)}**" for c in spec.constraints]
    question = " and ".join(asked) or "Compare named designs"
    parts = [f"# {literal(spec.study.name)}", question + (f" so that {' and '.join(bounds)}." if bounds else ".")]
    parts.append(_searched(spec))
    found = (tables.results(spec, rows), tables.scenarios(spec, rows), tables.assumptions(spec))
    parts += [markdown(table) for table in found if table is not None]
    parts += [literal(line) for line in remarks]
    made = json.loads(rows[-1]["versions"]) if rows else {}
    versions = ", ".join(f"{name} {version}" for name, version in made.items() if not name.startswith("eiwa."))
    parts.append(f"Spec hash `{spec.hash}`, seed {spec.study.seed}; last row made with {literal(versions)}.")
    return "\n\n".join(part for part in parts if part)


def trial_note(spec: StudySpec, row: Row, rank: str) -> str:
    """One of the best trials: its design, its numbers under every scenario, and how it meets the constraints."""
    values = [[f"`{path}`", literal(_shown(value))] for path, value in leaves(json.loads(row["overrides"]))]
    prefix = "metrics."
    names = [k.removeprefix(prefix) for k in row if k.startswith(prefix) and "@" not in k]
    numbers = {s.label: {n: row.get(metric_column(n, s.label)) for n in names} for s in spec.scenarios}
    streams = f"{row['replicates']} replicates" if row["replicates"] > 1 else "one replicate, so without errors"
    parts = [
        f"# Trial {row['number']}",
        f"{literal(rank)}; {streams}.",
        _table("Design", ["path", "value"], values),
        markdown(tables.metrics(spec, numbers, "Metrics")),
    ]
    if spec.constraints:
        slack = [[literal(c.label), _shown(-row[f"constraints.{i}"])] for i, c in enumerate(spec.constraints)]
        parts.append(_table("Constraints", ["constraint", "met by"], slack))
    return "\n\n".join(parts)


def markdown(table: Table) -> str:
    """A table of the command line as Markdown, its title in bold above; lines in bold stay bold."""
    cells = [[literal(_text(cell)) for cell in column.cells] for column in table.columns]
    right = [column.justify == "right" for column in table.columns]
    rows = [list(row) for row in zip(*cells, strict=True)]
    for row, said in zip(rows, table.rows, strict=True):
        if said.style == "bold":
            row[:] = [f"**{cell}**" if cell else "" for cell in row]
    return _table(_text(table.title), [literal(_text(c.header)) for c in table.columns], rows, right)


def literal(text: str) -> str:
    """Text in which Markdown sees no markup."""
    return re.sub(r"([\\`*_{}\[\]<>|~#$])", r"\\\1", text.replace("\n", " "))


def _table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool] = ()) -> str:
    ruler = ["---:" if k < len(right) and right[k] else "---" for k in range(len(heads))]
    lines = [f"| {' &ensp;| '.join(cells)} &ensp;|" for cells in (heads, *rows)]
    lines.insert(1, f"| {' | '.join(ruler)} |")
    return "\n".join([f"**{literal(title)}**", "", *lines])


def _text(cell: Any) -> str:
    return cell.plain if isinstance(cell, Text) else Text.from_markup(str(cell or "")).plain


def _searched(spec: StudySpec) -> str:
    """What the search chooses, and what follows from it."""
    ranges = [[f"`{name}`", _between(r)] for name, r in spec.ranges.items()]
    formulas = [[f"`{name}`", f"`{e.text}`"] for name, e in spec.expressions.items()]
    return (
        _table("What the search chooses", ["path or variable", "between, or equal to"], ranges + formulas)
        if ranges
        else ""
    )


def _between(r: RangeSection) -> str:
    steps = f" in steps of {r.step:g}" if r.step is not None else ""
    return f"{r.low:g} and {r.high:g}{steps}{' (logarithmic)' if r.log else ''}"


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
