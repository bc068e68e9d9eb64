"""``eiwa study export`` and ``replay``: what is done with stored rows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from eiwa.cli.console import AsJson, Runs, Settings, StudyFile, listen_to_log, out, print_json, settings

SOURCES = {
    "file": "",
    "stored": "The study file has changed since; replayed with the study that is stored with the row.",
    "changed": "The study has changed since, files that it names included; replayed as far as its stored copy goes.",
}


def export(
    study: StudyFile,
    to: Annotated[
        str, typer.Option("--to", metavar="TARGET", help="A .parquet, .csv or .log (Optuna's journal) file, or a URL.")
    ],
    runs: Runs = "runs",
    set_: Settings = None,
    as_json: AsJson = False,
) -> None:
    """Write all rows to one file, or the search as a study of Optuna's."""
    from eiwa.core.spec import load
    from eiwa.study.export import export as exported
    from eiwa.study.store import Store

    spec = load(Path(study), settings(set_))
    store = Store(Path(runs) / spec.study.name)
    store.require(study)
    count = exported(spec, store, to)
    if as_json:
        print_json({"study": spec.study.name, "to": to, "count": count})
        return
    what = "trials" if "://" in to or to.endswith(".log") else "rows"
    out().print(f"{count} {what} in {to}", markup=False, soft_wrap=True)


def replay(
    study: StudyFile,
    name: Annotated[str, typer.Argument(metavar="NAME", help="A trial's number, a named design, or 'leader N'.")],
    runs: Runs = "runs",
    set_: Settings = None,
    as_json: AsJson = False,
) -> None:
    """Evaluate a stored row again: identical, or what differs (exit code 1)."""
    from eiwa.core.spec import load
    from eiwa.study.replay import replay as replayed
    from eiwa.study.store import Store

    listen_to_log()
    spec = load(Path(study), settings(set_))
    store = Store(Path(runs) / spec.study.name)
    store.require(study)
    found = replayed(spec, store, name)
    if as_json:
        print_json(
            {
                "study": spec.study.name,
                "name": name,
                "source": found.source,
                "identical": not found.differing,
                "differing": _pairs(found.differing),
                "provenance": _pairs(found.provenance),
            }
        )
    else:
        _show(found)
    if found.differing:
        raise typer.Exit(1)


def _pairs(both: dict[str, tuple[Any, Any]]) -> dict[str, dict[str, Any]]:
    return {column: {"stored": a, "now": b} for column, (a, b) in both.items()}


def _show(found: Any) -> None:
    console = out()
    if SOURCES[found.source]:
        console.print(SOURCES[found.source], markup=False)
    if not found.differing:
        console.print("identical", markup=False)
        return
    for title, both in (("differs", found.differing), ("made differently", found.provenance)):
        for column, (a, b) in both.items():
            if column != "versions":
                console.print(f"{title}: {column}: {a} stored, {b} now", markup=False, soft_wrap=True)
