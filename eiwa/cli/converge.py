"""``eiwa converge`` and ``eiwa verify``."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from eiwa.cli.console import (
    AsJson,
    Settings,
    StudyFile,
    err,
    listen_to_log,
    out,
    print_json,
    require_drawable,
    settings,
)


def converge(
    study: StudyFile,
    design: Annotated[str | None, typer.Option("--design", metavar="NAME", help="A named design of the study.")] = None,
    error: Annotated[
        float, typer.Option("--error", min=1e-4, max=0.5, help="Relative error of F that is wanted.")
    ] = 0.01,
    figure: Annotated[str | None, typer.Option("--figure", metavar="FILE", help="Draw F against N.")] = None,
    set_: Settings = None,
    as_json: AsJson = False,
) -> None:
    """Show how F and the dexterous volume depend on samples and voxel size, and recommend a setting."""
    from rich.progress import track

    from eiwa.cli import trust
    from eiwa.core.spec import load
    from eiwa.study.compare import overrides_of
    from eiwa.study.converge import COUNTS, points, recommendation, sizes

    require_drawable(figure)
    listen_to_log()
    spec = load(Path(study), settings(set_))
    overrides = overrides_of(spec, design, []) if design else {}
    total = len(sizes(spec)) * (len(COUNTS) + 1)
    found = list(track(points(spec, overrides, error), "converge", total=total, console=err()))
    if figure:
        from eiwa.report.figure import draw_convergence

        draw_convergence(found, Path(figure), design or "")
        err().print(f"Drew {figure}.", markup=False)
    advice = recommendation(found, error)
    if as_json:
        print_json({"study": spec.study.name, "design": design, "points": [asdict(p) for p in found], "advice": advice})
        return
    console = out()
    name = design or "the design as written"
    console.print(trust.convergence(found, f"F of {name} against N and r"))
    console.print(trust.convergence_of_volume(found, f"Dexterous volume of one arm [m3], {name}"))
    console.print(f"For an error of {error:.2%} in F:", markup=False)
    console.print(advice, markup=False, soft_wrap=True)


def verify(as_json: AsJson = False) -> None:
    """Check closed-form arms on this machine: what eiwa computes beside the exact answer."""
    from eiwa.cli import trust
    from eiwa.study.verify import checks

    listen_to_log()
    found = list(checks())
    if as_json:
        print_json({"checks": [{**asdict(c), "error": c.error, "passed": c.passed} for c in found]})
    else:
        out().print(trust.verification(found))
    if not all(c.passed for c in found):
        sys.exit(1)
