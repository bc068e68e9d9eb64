"""``eiwa evaluate``: one design."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

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


def evaluate(
    study: StudyFile,
    design: Annotated[
        str | None, typer.Option("--design", metavar="NAME", help="A named design, or 'trial N'.")
    ] = None,
    set_: Settings = None,
    replicates: Annotated[
        int | None,
        typer.Option("--replicates", min=1, help="Independent streams; the study's number when not given."),
    ] = None,
    figure: Annotated[
        str | None,
        typer.Option("--figure", metavar="FILE", help="Draw the interaction workspace (png, pdf, svg)."),
    ] = None,
    runs: Runs = "runs",
    as_json: AsJson = False,
) -> None:
    """Evaluate one design: the study file's own values, a named design's or a trial's, with --set on top."""
    from eiwa.cli import tables, trust
    from eiwa.cli.results import tell_changes
    from eiwa.core.design import SECTIONS
    from eiwa.core.outcome import evaluate as outcome_of
    from eiwa.core.spec import load
    from eiwa.study.compare import overrides_of
    from eiwa.study.estimate import apart
    from eiwa.study.rows import adjustable
    from eiwa.study.store import Store

    require_drawable(figure)
    listen_to_log()
    put = settings(set_)
    spec = load(Path(study), put)
    store = Store(Path(runs) / spec.study.name)
    rows = []
    if design not in {None, *spec.designs} and store.exists():
        tell_changes(spec, store)
        rows = store.rows()
    overrides = {} if design is None else dict(overrides_of(spec, design, rows))
    overrides |= {path: value for path, value in put.items() if "." in path and path.split(".")[0] in SECTIONS}
    tables_of = spec.design(overrides).tables["sampling"]
    count = replicates or tables_of.replicates  # type: ignore[attr-defined]
    outcome = outcome_of(spec, overrides, count, named=design is not None)
    if figure:
        from eiwa.report.figure import draw

        draw(spec, overrides, Path(figure), title=(design or spec.study.name) + (", changed by --set" if put else ""))
        err().print(f"Drew {figure}.", markup=False)
    if as_json:
        objectives = {o.label: v for o, v in zip(spec.objectives, outcome.objectives, strict=True)}
        constraints = {c.label: v for c, v in zip(spec.constraints, outcome.violations, strict=True)}
        print_json(
            {
                "study": spec.study.name,
                "design": design,
                "settings": put,
                "overrides": overrides,
                "replicates": count,
                "metrics": outcome.scenarios[""],
                "scenarios": {k: v for k, v in outcome.scenarios.items() if k},
                "operators": {k: asdict(v) for k, v in outcome.operators.items()},
                "objectives": objectives,
                "violations": constraints,
                "feasible": outcome.feasible,
            }
        )
        return
    title = f"Design {design or 'as written in ' + study}" + (", changed by --set" if put else "")
    console = out()
    console.print(tables.metrics(spec, outcome.scenarios, title))
    if adjustable(spec):
        console.print(tables.operators(spec, outcome.operators))
    if not outcome.scenarios[""]["F"]:
        console.print(trust.apart(apart(spec, overrides)), markup=False)
    for constraint, violation in zip(spec.constraints, outcome.violations, strict=True):
        if violation is None:
            state = "reads variables, which this design does not have"
        else:
            state = "met" if violation <= 0 else f"not met (by {violation:.4g})"
        console.print(f"constraint {constraint.label}: {state}", markup=False)
