"""Tables about the numerics: what a run costs, how its numbers converge, and whether they are right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from eiwa.cli.tables import blank, with_error
from eiwa.core.spec import StudySpec
from eiwa.core.tree import lookup

if TYPE_CHECKING:
    from eiwa.study.converge import Point
    from eiwa.study.estimate import Apart, Cost, Shortfall
    from eiwa.study.verify import Check


def cost(spec: StudySpec, cost: Cost) -> Table:
    """What a run will take."""
    table = blank(f"Study {spec.study.name}")
    table.add_column("what")
    table.add_column("how much", justify="right")
    rows = [
        ("cells of E's grid", f"{cost.cells:,}"),
        ("memory for the grids", f"{cost.memory / 2**20:.1f} MiB"),
        ("samples per evaluation", f"{lookup(spec.resolved, 'sampling.samples'):,}"),
        ("scenarios", str(len(spec.scenarios))),
        ("named designs", str(len(spec.designs))),
        ("variables", ", ".join(spec.ranges) or "none"),
        ("trials", str(cost.trials)),
        ("time per trial", f"{cost.seconds_per_trial:.2f} s"),
        ("time for the search", f"{cost.seconds:.0f} s"),
    ]
    for what, much in rows:
        table.add_row(what, much)
    return table


def shortfall(found: Shortfall, spec: StudySpec) -> str:
    """One sentence about voxels that are too fine for their samples."""
    size, samples = lookup(spec.resolved, "voxels.size"), lookup(spec.resolved, "sampling.samples")
    return (
        f"{samples:,} samples are few for voxels of {1e3 * size:g} mm: F = {found.F:.4f} lies about {found.error:.0%} below "
        f'the true F on this grid. estimator = "elites" comes within {found.tolerance:.0%} with about '
        f"{found.evaluations:,} evaluations."
    )


def apart(found: Apart) -> str:
    """Why F may be 0: the two boxes, and what is written wrongly most often."""
    boxes = {"hands": found.hands, "right arm": found.right, "left arm": found.left}
    lines = [
        f"  {name:<9}  " + ",  ".join(f"{axis} {a:5.2f} to {b:5.2f}" for axis, a, b in zip("xyz", *box, strict=True))
        for name, box in boxes.items()
    ]
    return "\n".join(
        [
            "F = 0: nothing dexterous lies where hands are comfortable. In W [m]:",
            *lines,
            "Check [layout], the arm's lengths [m], angles and limits, and the threshold.",
        ]
    )


def convergence(points: Sequence[Point], title: str) -> Table:
    """F: a row per number of samples, a column per voxel size; below, what elites reach."""
    sizes = list(dict.fromkeys(p.size for p in points))
    table = _by_size(title, sizes)
    for samples, row in _sampled(points):
        table.add_row(f"{samples:,}", *(with_error(p.F, p.se) for p in row))
    refined = [p for p in points if p.estimator == "elites"]
    if refined:
        table.add_section()
        table.add_row("elites", *(with_error(p.F, p.se) for p in refined), style="bold")
        table.add_row("may still rise", *(f"{p.remaining or 0:.4f}" for p in refined))
        table.add_row("evaluations", *(f"{p.samples:,}" for p in refined))
    return table


def convergence_of_volume(points: Sequence[Point], title: str) -> Table:
    """The dexterous volume of one arm [m3], laid out alike: counted voxels, and below what it is without their border."""
    table = _by_size(title, list(dict.fromkeys(p.size for p in points)))
    for samples, row in _sampled(points):
        table.add_row(f"{samples:,}", *(with_error(p.dexterous_volume, None) for p in row))
    corrected = [p for p in points if p.estimator == "elites"]
    if corrected:
        table.add_section()
        table.add_row("corrected", *(with_error(p.dexterous_volume, None) for p in corrected), style="bold")
    return table


def _by_size(title: str, sizes: Sequence[float]) -> Table:
    table = blank(title)
    table.add_column("samples", justify="right", no_wrap=True)
    for size in sizes:
        table.add_column(f"r = {1e3 * size:g} mm", justify="right", no_wrap=True)
    return table


def _sampled(points: Sequence[Point]) -> list[tuple[int, list[Point]]]:
    plain = [p for p in points if p.estimator != "elites"]
    return [(n, [p for p in plain if p.samples == n]) for n in dict.fromkeys(p.samples for p in plain)]


def verification(checks: Sequence[Check]) -> Table:
    """Exact values beside ours."""
    table = blank("eiwa on this machine")
    table.add_column("check")
    for column in ("exact", "found", "error", "allowed"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for c in checks:
        verdict = Text("passed", style="green") if c.passed else Text("FAILED", style="bold red")
        table.add_row(Text(c.name), f"{c.exact:.8g}", f"{c.found:.8g}", f"{c.error:.1e}", f"{c.allowed:.0e}", verdict)
    return table
