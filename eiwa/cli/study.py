"""``eiwa study``: run, check, show."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eiwa.cli import dashboard, pareto, sensitivity, stored, tolerance
from eiwa.cli.console import (
    AsJson,
    Runs,
    Settings,
    StudyFile,
    called,
    err,
    listen_to_log,
    out,
    pip,
    print_json,
    resumable,
    settings,
)

if TYPE_CHECKING:
    from eiwa.core.spec import StudySpec
    from eiwa.study.rows import Row
    from eiwa.study.store import Store

FAR = 0.2
"""``run`` speaks of too few samples only where the last doubling still moved F by more than this share."""
app = typer.Typer(help="Run, check and look at studies.", no_args_is_help=True)


@app.command("run")
def run(
    study: StudyFile,
    fresh: bool = typer.Option(False, "--fresh", help="Begin anew; old results are kept aside."),
    workers: Annotated[
        int | None,
        typer.Option("--workers", metavar="N", min=0, help="Worker processes, as execution.workers says otherwise."),
    ] = None,
    runs: Runs = "runs",
    set_: Settings = None,
    as_json: AsJson = False,
) -> None:
    """Evaluate the named designs, search, and show the best; an interrupted study is continued."""
    from eiwa.cli import trust
    from eiwa.cli.progress import StudyProgress
    from eiwa.core.errors import EiwaError
    from eiwa.core.spec import load
    from eiwa.study.estimate import apart, own_numbers, shortfall
    from eiwa.study.run import Run
    from eiwa.study.store import Store

    listen_to_log()
    chosen = {} if workers is None else {"execution.workers": workers}
    spec = load(Path(study), settings(set_) | chosen)
    store = Store(Path(runs) / spec.study.name)
    console = err()
    if fresh and (aside := store.set_aside()):
        console.print(f"Old results are kept in {aside}.", markup=False)
    if not store.exists():
        with suppress(EiwaError):  # the run itself tells what is wrong with a design
            found = own_numbers(spec)
            if not found["F"]:
                console.print(trust.apart(apart(spec, {})), style="yellow", markup=False)
            elif short := shortfall(spec, FAR, found):
                console.print(trust.shortfall(short, spec), style="yellow", markup=False)
    with resumable(), StudyProgress(spec, console) as progress:
        finished = Run(spec, store, progress).execute()
    if not finished:
        console.print(f"Study {spec.study.name} is complete ({store.folder}); nothing was left to do.", markup=False)
    _report(spec, store, study, set_, as_json)


@app.command("show")
def show(study: StudyFile, runs: Runs = "runs", set_: Settings = None, as_json: AsJson = False) -> None:
    """Show the results that a study has so far."""
    from eiwa.cli.results import results

    spec, store = results(study, runs, settings(set_))
    _report(spec, store, study, set_, as_json)


@app.command("compare")
def compare(
    study: StudyFile,
    a: Annotated[str, typer.Argument(metavar="A", help="A named design, or 'trial N'.")],
    b: Annotated[str, typer.Argument(metavar="B", help="The design to compare it with.")],
    replicates: Annotated[int, typer.Option("--replicates", min=2, help="Shared random streams.")] = 8,
    runs: Runs = "runs",
    set_: Settings = None,
    as_json: AsJson = False,
) -> None:
    """Say whether two designs' F differ by more than the error of their difference."""
    from eiwa.cli import tables
    from eiwa.core.spec import load
    from eiwa.study.compare import compare as compared
    from eiwa.study.compare import overrides_of
    from eiwa.study.store import Store

    listen_to_log()
    spec = load(Path(study), settings(set_))
    rows = Store(Path(runs) / spec.study.name).rows()
    first, second = (overrides_of(spec, name, rows) for name in (a, b))
    outcomes, difference = compared(spec, first, second, replicates)
    if as_json:
        values = {name: o.scenarios[""] for name, o in zip((a, b), outcomes, strict=True)}
        print_json({"designs": values, **asdict(difference), "real": difference.real, "replicates": replicates})
        return
    console = out()
    for name, outcome in zip((a, b), outcomes, strict=True):
        numbers = outcome.scenarios[""]
        console.print(f"{name}: F = {tables.with_error(numbers['F'], numbers['F_se'])}", markup=False)
    verdict = "a real difference" if difference.real else "no difference that can be told from its error"
    sign = f"{difference.mean:+.4f} ± {difference.half_width:.4f}"
    console.print(f"F({a}) - F({b}) = {sign} (95 %, {replicates} paired replicates): {verdict}.", markup=False)


@app.command("check")
def check(study: StudyFile, set_: Settings = None, as_json: AsJson = False) -> None:
    """Validate a study file; tell cells, memory and seconds per trial."""
    from eiwa.cli import trust
    from eiwa.core.spec import load
    from eiwa.study.estimate import apart, estimate, own_numbers, shortfall
    from eiwa.study.sampler import announced, require

    listen_to_log()
    spec = load(Path(study), settings(set_))
    require(spec)
    cost, found = estimate(spec), own_numbers(spec)
    short = shortfall(spec, found=found)
    if as_json:
        short_of = asdict(short) if short else None
        print_json(
            {
                "study": spec.study.name,
                "hash": spec.hash,
                "sampler": spec.sampler.kind,
                **cost.as_dict(),
                "F": found["F"],
                "shortfall": short_of,
            }
        )
        return
    console = out()
    console.print(f"{study} is valid.", markup=False)
    console.print(trust.cost(spec, cost))
    if line := announced(spec):
        console.print(line, markup=False, soft_wrap=True)
    if not found["F"]:
        console.print(trust.apart(apart(spec, {})), markup=False)
    if short:
        console.print(trust.shortfall(short, spec), markup=False)


app.command("pareto")(pareto.pareto)
app.command("sensitivity")(sensitivity.sensitivity)
app.command("tolerance")(tolerance.tolerance)
app.command("dashboard")(dashboard.dashboard)
app.command("export")(stored.export)
app.command("replay")(stored.replay)


def _report(spec: StudySpec, store: Store, study: str, set_: list[str] | None, as_json: bool) -> None:
    from eiwa.cli import tables

    rows = store.rows()
    if as_json:
        print_json(_summary(spec, store, rows))
        return
    console = out()
    console.print(tables.results(spec, rows))
    for table in (tables.scenarios(spec, rows), tables.assumptions(spec)):
        if table is not None:
            console.print(table)
    for line in remarks(spec, rows):
        console.print(line, markup=False)
    for line in _next(spec, store, study, set_, tables.best(spec, rows)):
        console.print(line, markup=False, soft_wrap=True)


def _summary(spec: StudySpec, store: Store, rows: list[Row]) -> dict[str, Any]:
    from eiwa.study.run import leaders

    trials = [r for r in rows if r["kind"] == "trial"]
    return {
        "study": spec.study.name,
        "hash": spec.hash,
        "folder": str(store.folder),
        "trials": len(trials),
        "target": spec.study.trials,
        "failed": sum(r["state"] == "FAIL" for r in trials),
        "designs": [r for r in rows if r["kind"] == "design"],
        "best": leaders(spec, trials),
        "leaders": [r for r in rows if r["kind"] == "leader"],
        "assumptions": dict(spec.assumptions),
    }


def remarks(spec: StudySpec, rows: Sequence[Row]) -> list[str]:
    """What the reader of the table must know."""
    from eiwa.cli.tables import ranked, ties
    from eiwa.study.sampler import search_size

    trials = [r for r in rows if r["kind"] == "trial"]
    failed = [r for r in trials if r["state"] == "FAIL"]
    lines = []
    if ties(spec, rows):
        of = "design" if ranked(spec) else "trial"
        what = spec.objectives[0].label if spec.objectives else "F"
        lines.append(f"~ {what} cannot be told from the best {of}'s (95 %, paired replicates).")
    skipped = [r for r in trials if r["state"] == "SKIPPED"]
    if skipped:
        lines.append(
            f"{len(skipped)} of {len(trials)} trials break an inequality of parameters and were not evaluated."
        )
    if failed:
        lines.append(f"{len(failed)} of {len(trials)} trials failed; the last said: {failed[-1]['message']}")
    if trials and not any(r["feasible"] for r in trials):
        bounds = ", ".join(c.label for c in spec.constraints)
        lines.append(f"No trial meets the constraints ({bounds}): widen them, or the search.")
    if trials and len(trials) < (target := search_size(spec)):
        lines.append(f"{len(trials)} trials of {target} so far.")
    return lines


def _next(spec: StudySpec, store: Store, study: str, set_: list[str] | None, best: str | None) -> list[str]:
    folder = ["--runs", str(store.folder.parent)] if str(store.folder.parent) != "runs" else []
    options = [*folder, *(word for pair in set_ or [] for word in ("--set", pair))]
    lines = ["Where to look next:", f"  every evaluation  {store.folder / 'trials'}/*.parquet"]
    if len(spec.objectives) > 1 and spec.study.trials:
        lines.append(f"  the Pareto front  {shlex.join([called(), 'study', 'pareto', study, *options])}")
    lines.append(f"  in the browser    {shlex.join([called(), 'study', 'dashboard', study, *options])}")
    if find_spec("optuna_dashboard") is None:
        lines.append(f"                    (first: {pip()} install 'eiwa[dashboard]')")
    design = ["--design", best] if best else []
    design += [word for pair in set_ or [] if not pair.startswith("execution.") for word in ("--set", pair)]
    drawn = shlex.join([called(), "evaluate", study, *design, *folder])
    lines.append(f"  the best design   {drawn} --figure workspace.png")
    return lines
