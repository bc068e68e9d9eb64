"""``eiwa study sensitivity``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eiwa.cli.console import (
    AsJson,
    Runs,
    Settings,
    StudyFile,
    err,
    listen_to_log,
    out,
    print_json,
    require_drawable,
    settings,
)

if TYPE_CHECKING:
    from rich.table import Table

    from eiwa.core.interval import Difference
    from eiwa.core.objectives import ObjectiveSection
    from eiwa.core.spec import StudySpec
    from eiwa.study.sensitivity import Effect, Index, Sobol

Around = Annotated[
    str | None,
    typer.Option("--design", metavar="NAME", help="A named design, or 'trial N'; the best trial if not given."),
]


def sensitivity(
    study: StudyFile,
    design: Around = None,
    share: Annotated[
        float | None,
        typer.Option(
            "--share", metavar="S", min=0.001, max=1,
            help="Move each variable by this share of its range to both sides of the design; over its whole range if not given.",
        ),
    ] = None,
    sobol: Annotated[
        int,
        typer.Option(
            "--sobol", metavar="N", min=0, max=1 << 20,
            help="Base sample of the Sobol indices, a power of two: N (variables + 2) evaluations; 0 leaves them out.",
        ),
    ] = 64,
    replicates: Annotated[
        int | None,
        typer.Option("--replicates", min=2, help="Shared random streams for the errors; the study's number if not given."),
    ] = None,
    figure: Annotated[
        str | None, typer.Option("--figure", metavar="FILE", help="Draw a tornado plot (png, pdf, svg).")
    ] = None,
    runs: Runs = "runs",
    set_: Settings = None,
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """Show which variables the objectives depend on: over the search, and around a design."""
    from eiwa.core.errors import SpecError
    from eiwa.core.spec import load
    from eiwa.study import probe
    from eiwa.study import sensitivity as analysis
    from eiwa.study.store import Store

    require_drawable(figure)
    listen_to_log()
    spec = load(Path(study), settings(set_))
    if not spec.ranges:
        raise SpecError("search: nothing varies, so nothing can be told apart. Add [search].")
    varied = analysis.cost_of_sobol(spec, sobol)
    rows = Store(Path(runs) / spec.study.name).rows()
    centre = probe.centre(spec, rows, design)
    variables, alone = probe.variables_at(spec, centre), probe.lean(spec)
    limits = analysis.box(spec, variables, share)
    count = replicates or max(2, alone.resolved["sampling"]["replicates"])
    moved = analysis.cost_of_one_at_a_time(alone)
    cost = f"{moved} designs with {count} replicates" + (f", {varied} with one for the Sobol indices" if sobol else "")
    with progress(
        "sensitivity", moved + varied, cost, (moved * count + varied) * probe.seconds_per_design(spec, rows)
    ) as told:
        effects = analysis.one_at_a_time(alone, centre.overrides, variables, limits, count, told)
        indices = analysis.sobol_of_objectives(alone, centre.overrides, limits, sobol, told) if sobol else []
    told_apart = [analysis.importances(spec, rows, k) for k in range(len(spec.objectives))]
    shares = [
        (told_apart[k] if k < len(told_apart) else None, indices[k] if indices else None)
        for k in range(len(alone.objectives))
    ]
    if figure:
        from eiwa.report.tornado import draw

        draw(alone, effects, Path(figure), centre.name)
        err().print(f"Drew {figure}.", markup=False)
    if as_json:
        print_json(
            {
                "study": spec.study.name, "design": centre.name, "variables": variables, "replicates": count, "sobol": sobol,
                "limits": limits,
                "objectives": [
                    _summary(o, effects, k, *shares[k]) for k, o in enumerate(alone.objectives)
                ],
            }
        )  # fmt: skip
        return
    console = out()
    for k, objective in enumerate(alone.objectives):
        console.print(_effects(objective, effects, k, centre.name))
        console.print(_shares(spec, objective, *shares[k]))
    for line in _remarks(share, sobol, count, told_apart):
        console.print(line, markup=False)


@contextmanager
def progress(what: str, total: int, cost: str, seconds: float) -> Iterator[Callable[[], None]]:
    """Tell the cost, then a bar on stderr; gives what to call after every evaluation."""
    from rich.progress import Progress

    console = err()
    console.print(f"{cost}: about {duration(seconds)}.", markup=False, soft_wrap=True)
    with Progress(console=console) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)


def duration(seconds: float) -> str:
    """Seconds in the unit that a reader would choose."""
    if seconds < 90:
        return f"{max(1.0, seconds):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _summary(
    objective: ObjectiveSection, effects: Sequence[Effect], k: int, told: dict[str, float] | None, indices: Sobol | None
) -> dict[str, Any]:
    return {
        "objective": objective.label,
        "direction": objective.direction,
        "importance": told,
        "effects": [
            {
                "variable": e.variable,
                "levels": e.levels,
                "changes": [record(changes[k]) for changes in e.changes],
                "feasible": e.feasible,
                "slope": record(e.slopes[k]),
            }
            for e in effects
        ],
        "sobol": indices
        and {
            "variance": indices.variance,
            **{
                order: {e.variable: vars(index) for e, index in zip(effects, found, strict=True)}
                for order, found in (("first", indices.first), ("total", indices.total))
            },
        },
    }


def record(difference: Difference) -> dict[str, float | None]:
    """Plain values."""
    half = difference.half_width
    return {"mean": difference.mean, "half_width": half if math.isfinite(half) else None}


def _effects(objective: ObjectiveSection, effects: Sequence[Effect], k: int, name: str) -> Table:
    from eiwa.cli import tables

    columns = ["variable", "design", "moved to", "change", "or to", "change", "slope at the design"]
    rows = [
        [
            tables.short(e.variable), f"{e.value:.4g}",
            f"{e.levels[0]:.4g}", _change(e, 0, k), f"{e.levels[-1]:.4g}", _change(e, -1, k),
            _slope(e.slopes[k]),
        ]
        for e in effects
    ]  # fmt: skip
    return tables.plain(f"{objective.label}: one variable at a time, around {name}", columns, rows)


def _change(effect: Effect, end: int, k: int) -> str:
    difference = effect.changes[end][k]
    doubt = " ~" if math.isfinite(difference.half_width) and not difference.real else ""
    return f"{difference.mean:+.4f}{doubt}{'' if effect.feasible[end] else ' !'}"


def _slope(difference: Difference) -> str:
    if not math.isfinite(difference.half_width):
        return f"{difference.mean:.4g}"
    return f"{difference.mean:.3g} ± {difference.half_width:.1g}"


def _shares(
    spec: StudySpec, objective: ObjectiveSection, told: dict[str, float] | None, indices: Sobol | None
) -> Table:
    from eiwa.cli import tables

    rows = []
    for j, name in enumerate(spec.ranges):
        found = (_index(indices.first[j]), _index(indices.total[j])) if indices else ("-", "-")
        rows.append([tables.short(name), f"{told[name]:.1%}" if told else "-", *found])
    columns = ["variable", "tells the best\ntenth of trials", "alone\n(first order)", "in all\n(total order)"]
    return tables.plain(f"{objective.label}: shares", columns, rows)


def _index(index: Index) -> str:
    return f"{index.value:.2f} ({index.low:.2f} to {index.high:.2f})"


def _remarks(share: float | None, n: int, replicates: int, told: Sequence[dict[str, float] | None]) -> list[str]:
    from eiwa.study.sensitivity import LEAST_TRIALS

    where = "the whole search" if share is None else f"{share:.1%} of each range around the design"
    lines = [
        f"~ no change that can be told from its error (95 %, {replicates} paired replicates); slopes are per unit."
    ]
    if n:
        lines.append(
            f"First and total order: Sobol indices over {where}, N = {n}, with 95 % intervals; --sobol {4 * n} halves these."
        )
    if any(found is None for found in told):
        lines.append(f"PED-ANOVA needs {LEAST_TRIALS} feasible trials.")
    elif told:
        lines.append("Best tenth of trials: PED-ANOVA over the feasible trials of the search.")
    return lines
