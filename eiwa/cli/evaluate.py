"""``eiwa evaluate``: one design."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from eiwa.cli.console import AsJson, Settings, StudyFile, err, listen_to_log, out, print_json, settings


def evaluate(
    study: StudyFile,
    design: Annotated[str | None, typer.Option("--design", metavar="NAME", help="A named design of the study.")] = None,
    set_: Settings = None,
    replicates: Annotated[
        int | None,
        typer.Option("--replicates", min=1, help="Independent streams; the study's number when not given."),
    ] = None,
    figure: Annotated[
        str | None,
        typer.Option("--figure", metavar="FILE", help="Draw the interaction workspace (png, pdf, svg)."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Evaluate one design: the study file's own values, or a named design's, with --set on top."""
    from eiwa.cli import tables
    from eiwa.core.design import SECTIONS
    from eiwa.core.errors import SpecError
    from eiwa.core.outcome import evaluate as outcome_of
    from eiwa.core.spec import load
    from eiwa.core.tree import did_you_mean
    from eiwa.study.rows import adjustable

    listen_to_log()
    put = settings(set_)
    spec = load(Path(study), put)
    if design is not None and design not in spec.designs:
        raise SpecError(f"--design {design}: the study has no such design{did_you_mean(design, spec.designs)}")
    overrides = dict(spec.designs[design].overrides) if design else {}
    overrides |= {path: value for path, value in put.items() if "." in path and path.split(".")[0] in SECTIONS}
    tables_of = spec.design(overrides).tables["sampling"]
    count = replicates or tables_of.replicates  # type: ignore[attr-defined]
    outcome = outcome_of(spec, overrides, count, named=design is not None)
    if figure:
        from eiwa.report.figure import draw

        draw(spec, overrides, Path(figure), title=design or "")
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
    for constraint, violation in zip(spec.constraints, outcome.violations, strict=True):
        if violation is None:
            state = "reads variables, which this design does not have"
        else:
            state = "met" if violation <= 0 else f"not met (by {violation:.4g})"
        console.print(f"constraint {constraint.label}: {state}", markup=False)
