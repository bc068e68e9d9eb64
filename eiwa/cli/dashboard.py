"""``eiwa study dashboard``."""

from __future__ import annotations

import json
import shlex
import time
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eiwa.cli.console import Runs, Settings, StudyFile, err, listen_to_log, out, settings

if TYPE_CHECKING:
    from eiwa.core.spec import StudySpec
    from eiwa.study.page import Description
    from eiwa.study.rows import Row

EVERY = 60.0
"""Seconds between two drawings of the best design while a search is on: each one evaluates it anew."""


def dashboard(
    study: StudyFile,
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="Port to listen on; 0 takes a free one.")
    ] = 8080,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen on; only this machine can reach the default one.")
    ] = "127.0.0.1",
    open_: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the web browser.")] = False,
    runs: Runs = "runs",
    set_: Settings = None,
) -> None:
    """Show the results in the web browser with optuna-dashboard; a running study's as they come. Ctrl-C ends it."""
    from eiwa.core.errors import StoreError
    from eiwa.core.spec import load
    from eiwa.study.dashboard import listening, require, serve
    from eiwa.study.page import Page
    from eiwa.study.store import Store

    listen_to_log()
    require()
    spec = load(Path(study), settings(set_))
    store = Store(Path(runs) / spec.study.name)
    if not store.exists():
        raise StoreError(f"{store.folder}: has no results yet. Run: eiwa study run {shlex.quote(study)}")
    if changed := store.changes(spec):
        lines = [f"{store.folder}: holds results of another study file:", *(f"  {c}" for c in changed[:8])]
        raise StoreError("\n".join([*lines, "Run the study with --fresh, or give it another name."]))
    page = Page(spec, store, Cards(spec))
    updates = page.updates()
    next(updates)
    server = listening(page, host, port)
    address = f"http://{host}:{server.server_port}/dashboard/studies/0"
    with suppress(KeyboardInterrupt):
        out().print(f"{spec.study.name}: {address} (Ctrl-C ends it)", markup=False, soft_wrap=True)
        if open_ and not webbrowser.open(address):
            err().print("No web browser could be opened here.", markup=False)
        serve(server, updates)


@dataclass
class Cards:
    """Notes and figures of a study; the best design is evaluated once more to draw its workspace."""

    spec: StudySpec
    _workspace: dict[str, Any] = field(default_factory=dict)
    _of: str | None = None
    _when: float = float("-inf")

    def __call__(self, rows: Sequence[Row]) -> Iterator[Description]:
        """What can be said at once; then the same with the workspace of the best design, where that is a new one."""
        from eiwa.cli import tables
        from eiwa.core.errors import EiwaError
        from eiwa.report import cards
        from eiwa.study.run import leaders

        full = {r["number"]: r for r in rows if r["kind"] == "leader" and r["state"] == "COMPLETE"}
        best = [full.get(r["number"], r) for r in leaders(self.spec, rows)]
        shown = [(f"trial {r['number']}", r) for r in best] + [(r["name"], r) for r in tables.designs(self.spec, rows)]
        yield self._said(rows, shown)
        if not (shown and self._is_due(shown[0][1])):
            return
        name, row = shown[0]
        self._of, self._when = row["overrides"], time.monotonic()
        with suppress(EiwaError):  # rows tell of designs that fail
            self._workspace = {"workspace": cards.workspace(self.spec, json.loads(row["overrides"]), name)}
            yield self._said(rows, shown)

    def _is_due(self, row: Row) -> bool:
        """Whether to draw a design: at once when the search is over, else at most every so often."""
        return row["overrides"] != self._of and (row["kind"] != "trial" or time.monotonic() - self._when > EVERY)

    def _said(self, rows: Sequence[Row], shown: Sequence[tuple[str, Row]]) -> Description:
        from eiwa.cli import notes, tables
        from eiwa.cli.study import remarks
        from eiwa.report import cards
        from eiwa.study.page import Description

        spec = self.spec
        figures: dict[str, Any] = {}
        if any(r["kind"] == "trial" for r in rows):
            figures = cards.fronts(spec, rows, shown) or {"history": cards.history(spec, rows, shown)}
        if len(spec.scenarios) > 1 and shown:
            labels = {s.label: tables.scenario_label(spec, s.label) for s in spec.scenarios}
            metric = next((o.metric for o in spec.objectives if o.metric), "F")
            figures["scenarios"] = cards.scenarios(metric, labels, shown)
        best = [row for _, row in shown if row["kind"] != "design"]
        about = {row["number"]: notes.trial_note(spec, row, self._rank(n)) for n, row in enumerate(best, 1)}
        return Description(notes.study_note(spec, rows, remarks(spec, rows)), about, figures | self._workspace)

    def _rank(self, place: int) -> str:
        if len(self.spec.objectives) > 1:
            return "No other trial that meets the constraints is better in every objective"
        return f"Number {place} by {self.spec.objectives[0].label} among the trials that meet the constraints"
