"""``eiwa study tolerance``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eiwa.cli.console import AsJson, Runs, Settings, StudyFile, listen_to_log, out, print_json, settings
from eiwa.cli.sensitivity import Around, progress, record

if TYPE_CHECKING:
    from rich.table import Table

    from eiwa.core.outcome import Outcome
    from eiwa.core.spec import StudySpec
    from eiwa.study.tolerance import Choice, Estimate, Made, Spread

MISSING = """[tolerance], [catalogue]: the study has neither. Write what manufacture does to the design, such as
[tolerance]
"arm.joints.upper.a" = { normal = 0.0005 }
"arm.joints.upper.limits.1" = { uniform = 1.0 }
[catalogue]
"arm.joints.upper.a" = [0.15, 0.18, 0.20]"""


def tolerance(
    study: StudyFile,
    design: Around = None,
    draws: Annotated[int, typer.Option("--draws", min=2, help="Devices made, each with errors of its own.")] = 64,
    runs: Runs = "runs",
    set_: Settings = None,
    as_json: AsJson = False,
) -> None:
    """Show what is left of a design once it is made: errors of manufacture, and values of a catalogue."""
    from eiwa.core.errors import EiwaError
    from eiwa.core.spec import load
    from eiwa.study import probe
    from eiwa.study import tolerance as analysis
    from eiwa.study.store import Store

    listen_to_log()
    spec = load(Path(study), settings(set_))
    if not (spec.tolerance or spec.catalogue):
        raise EiwaError(MISSING)
    rows = Store(Path(runs) / spec.study.name).rows()
    centre, alone = probe.centre(spec, rows, design), probe.lean(spec)
    replicates = max(2, alone.resolved["sampling"]["replicates"])
    beside = len(
        analysis.neighbours(analysis.at_paths(alone, centre.overrides, spec.catalogue, "catalogue"), spec.catalogue)
    )
    costs = [f"{draws} draws"] if spec.tolerance else []
    costs += (
        [f"{beside} design{'s' * (beside != 1)} of the catalogue with {replicates} replicates"]
        if spec.catalogue
        else []
    )
    once = (draws + 1 if spec.tolerance else 0, beside + 1 if spec.catalogue else 0)
    seconds = (once[0] + once[1] * replicates) * probe.seconds_per_design(spec, rows)
    with progress("tolerance", sum(once), " and ".join(costs), seconds) as told:
        made = analysis.made(spec, alone, centre.overrides, draws, told) if spec.tolerance else None
        chosen = analysis.choices(spec, alone, centre.overrides, replicates, told) if spec.catalogue else None
    if as_json:
        labels = [o.label for o in alone.objectives]
        made_of = made and {**asdict(made), "spreads": {s.label: asdict(s) for s in made.spreads}}
        itself = chosen and {"objectives": dict(zip(labels, chosen[0].objectives, strict=True))}
        beside_it = [_record(labels, choice) for choice in chosen[1]] if chosen else []
        print_json(
            {"study": spec.study.name, "design": centre.name, "made": made_of, "itself": itself, "catalogue": beside_it}
        )
        return
    console = out()
    if made:
        console.print(_spreads(made, centre.name))
        for spread in made.spreads:
            if spread.effects:
                console.print(_effects(spec, spread))
        for line in _remarks(made):
            console.print(line, markup=False)
    if chosen:
        console.print(_choices(alone, *chosen, centre.name))
        console.print("! breaks a constraint.  ~ cannot be told from the best of these.", markup=False)
        console.print(f"± is the 95 % interval of the change ({replicates} paired replicates).", markup=False)


def _spreads(made: Made, name: str) -> Table:
    from eiwa.cli import tables

    columns = ["objective", "as\ndesigned", "mean", "deviation", "5 % are\nworse than"]
    rows = [
        [s.label, tables.with_error(s.nominal, None), *(_estimate(e) for e in (s.mean, s.deviation, s.worst))]
        for s in made.spreads
    ]
    return tables.plain(f"{name}, made {made.draws} times", columns, rows)


def _estimate(found: Estimate) -> str:
    return f"{found.value:.4f} ± {found.error:.4f}"


def _effects(spec: StudySpec, spread: Spread) -> Table:
    from eiwa.cli import tables

    rows = [
        [
            tables.short(e.path),
            f"{spec.tolerance[e.path].deviation:.3g}",
            f"{e.per_deviation.value:+.3g} ± {e.per_deviation.error:.1g}",
            f"{e.share:.0%}",
        ]
        for e in spread.effects
    ]
    columns = ["path", "deviation", "change per deviation", "of the variance"]
    return tables.plain(f"{spread.label}: which error matters", columns, rows)


def _remarks(made: Made) -> list[str]:
    lines = [f"{made.any_broken} of {made.draws} devices break a constraint" + (":" if made.broken else ".")]
    lines += [f"  {label}: {count}" for label, count in made.broken.items()]
    if made.invalid:
        lines.append(f"  no valid design at all: {made.invalid}")
    lines.append("± is the standard error that the number of draws leaves.")
    for spread in made.spreads:
        if spread.linear is None:
            lines.append(f"{spread.label}: too few draws to tell which error matters, or nothing varies.")
        else:
            lines.append(f"{spread.label}: a straight line in the errors explains {spread.linear:.0%} of the variance.")
    return lines


def _choices(spec: StudySpec, itself: Outcome, choices: Sequence[Choice], name: str) -> Table:
    from eiwa.cli import tables

    paths = list(choices[0].values)
    columns = [
        "",
        *(tables.short(path).replace(" ", "\n") for path in paths),
        *(o.label for o in spec.objectives),
        "change",
    ]
    rows = [[name, *("" for _ in paths), *map(_value, itself.objectives), ""]]
    for number, choice in enumerate(choices, 1):
        mark = " ~" if choice.tied and number > 1 else "" if choice.outcome.feasible else " !"
        change = f"{choice.change.mean:+.4f} ± {choice.change.half_width:.4f}"
        values = [f"{choice.values[path]:g}" for path in paths]
        rows.append([f"choice {number}{mark}", *values, *map(_value, choice.outcome.objectives), change])
    return tables.plain(f"{name}, with values of the catalogue", columns, rows)


def _value(value: float | None) -> str:
    from eiwa.cli.tables import with_error

    return with_error(value, None)


def _record(labels: Sequence[str], choice: Choice) -> dict[str, Any]:
    return {
        "values": dict(choice.values),
        "objectives": dict(zip(labels, choice.outcome.objectives, strict=True)),
        "feasible": choice.outcome.feasible,
        "change": record(choice.change),
        "tied": choice.tied,
    }
