"""Runs a study: named designs, the search, the leaders; every step can be interrupted and is continued by the next run.

One process, the master, owns the study: it asks for a batch, hands it to an executor, writes rows as they finish and
tells the batch in order. So results depend neither on threads and workers nor on where a run was interrupted.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from eiwa.core.errors import EiwaError, SpecError, StoreError
from eiwa.core.spec import StudySpec, digest
from eiwa.study.executors import PATIENCE, Executor, executor_of
from eiwa.study.leaders import LEADERS, leaders, parameters
from eiwa.study.rows import Row, Task, schema
from eiwa.study.sampler import announced, require, search_size
from eiwa.study.search import Asked, Search
from eiwa.study.storages import opened
from eiwa.study.store import Store

__all__ = ["LEADERS", "Listener", "Run", "Silent", "leaders", "parameters", "run"]

FIRST_FAILURES, FAILURES_IN_A_ROW = 5, 20


class Listener(Protocol):
    """Hears how a run goes on; stages are designs, search, restored and leaders."""

    def begin(self, stage: str, total: int, done: int, known: Iterable[Row] = ()) -> None:
        """A stage starts, with so many of its evaluations done before, and those of them that are known."""

    def __call__(self, stage: str, row: Row) -> None:
        """An evaluation is done, and its row is on the disk."""

    def say(self, line: str) -> None:
        """Something that the user should know."""


class Silent:
    """Hears nothing."""

    def begin(self, stage: str, total: int, done: int, known: Iterable[Row] = ()) -> None:
        """Nothing."""

    def __call__(self, stage: str, row: Row) -> None:
        """Nothing."""

    def say(self, line: str) -> None:
        """Nothing."""


@dataclass
class Run:
    """A study being run in a folder."""

    spec: StudySpec
    store: Store
    listen: Listener = field(default_factory=Silent)
    rows: list[Row] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.schema = schema(self.spec)
        self.target = search_size(self.spec)
        self._trials: dict[int, Row] = {}
        self._written = 0.0

    def execute(self) -> bool:
        """Do everything that is not done yet; False when there was nothing to do.

        Raises
        ------
        EiwaError
            The folder, the storage or the workers cannot be used, or designs keep failing.
        """
        if self.target:
            require(self.spec)
        with self.store.locked(), executor_of(self.spec, self.listen.say) as executor:
            self.store.open(self.spec)
            self.rows, self._trials = [], {}
            self._know(self.store.rows())
            before = len(self.rows)
            self._designs(executor)
            if self.target:
                if line := announced(self.spec):
                    self.listen.say(line)
                with opened(self.spec, self.store) as storage:
                    self._search(executor, Search(self.spec, storage, self._trials))
                self._leaders(executor)
            with suppress(StoreError):  # a disk without room for the copy holds the parts themselves
                self.store.compact()
            return len(self.rows) > before

    def _know(self, rows: Sequence[Row]) -> None:
        self.rows.extend(rows)
        self._trials.update((r["number"], r) for r in rows if r["kind"] == "trial")

    def _evaluate(self, executor: Executor, stage: str, tasks: Sequence[Task]) -> None:
        """Evaluate, writing rows as they finish: at once, or with others when the last were written a moment ago."""
        pooled: list[Row] = []
        try:
            for finished in executor.rows(tasks):
                pooled += finished
                if time.monotonic() - self._written > PATIENCE:
                    rows, pooled = pooled, []
                    self._keep(stage, rows)
        finally:
            self._keep(stage, pooled)

    def _keep(self, stage: str, rows: Sequence[Row]) -> None:
        if not rows:
            return
        self.store.write(rows, self.schema)
        self._written = time.monotonic()
        self._know(rows)
        for row in rows:
            self.listen(stage, row)

    def _missing_designs(self) -> list[Task]:
        full = self.spec.design({}).tables["sampling"].replicates  # type: ignore[attr-defined]
        present = {(r["name"], _digest(r)) for r in self.rows if r["kind"] == "design" and r["state"] == "COMPLETE"}
        tasks = [Task("design", d.overrides, full, name=name) for name, d in self.spec.designs.items()]
        return [t for t in tasks if (t.name, digest(dict(t.overrides))) not in present]

    def _designs(self, executor: Executor) -> None:
        missing, before = self._missing_designs(), len(self.rows)
        if missing:
            self.listen.begin("designs", len(self.spec.designs), len(self.spec.designs) - len(missing))
        self._evaluate(executor, "designs", missing)
        for result in self.rows[before:]:
            if result["state"] == "FAIL":
                raise EiwaError(f"designs.{result['name']}: {result['message']}")

    def _search(self, executor: Executor, search: Search) -> None:
        self._stop_when_failing()
        if search.told < self.target:
            self.listen.begin("search", self.target, search.told, self._trials.values())
        self._restore_rows(executor, search)
        while search.told < self.target:
            first = search.told - search.told % self.spec.study.batch
            asked = search.batch(range(first, min(first + self.spec.study.batch, self.target)))
            self._evaluate(executor, "search", [self._task(t) for t in asked if t.number not in self._trials])
            search.tell(asked)
            self._stop_when_failing()

    def _task(self, trial: Asked) -> Task:
        values: dict[str, float] = {}
        with suppress(SpecError):  # an expression without a value there: the row finds it again, and says so
            values = self.spec.overrides(trial.parameters)
        return Task("trial", values, 1, number=trial.number, parameters=trial.parameters)

    def _restore_rows(self, executor: Executor, search: Search) -> None:
        """Evaluate again the finished trials whose rows are gone."""
        lost = [t for t in search.finished() if t.number not in self._trials]
        if lost:
            self.listen.begin("restored", len(lost), 0)
        self._evaluate(executor, "restored", [self._task(t) for t in lost])

    def _stop_when_failing(self) -> None:
        numbers = sorted(self._trials)
        tail = 0
        while tail < len(numbers) and self._trials[numbers[-1 - tail]]["state"] == "FAIL":
            tail += 1
        if (tail == len(numbers) and tail >= FIRST_FAILURES) or tail >= FAILURES_IN_A_ROW:
            last = self._trials[numbers[-1]]["message"]
            raise EiwaError(f"the last {tail} trials failed, so the study stops. The last one said: {last}")

    def _leaders(self, executor: Executor) -> None:
        """The best trials, with all replicates."""
        full = self.spec.design({}).tables["sampling"].replicates  # type: ignore[attr-defined]
        present = {r["number"] for r in self.rows if r["kind"] == "leader" and r["state"] == "COMPLETE"}
        best = [(r["number"], parameters(r)) for r in leaders(self.spec, list(self._trials.values()))]
        missing = [
            Task("leader", self.spec.overrides(values), full, number=number, parameters=values)
            for number, values in best
            if number not in present
        ]
        if missing:
            self.listen.begin("leaders", len(missing), 0)
        self._evaluate(executor, "leaders", missing)


def run(spec: StudySpec, runs: Path, listen: Listener | None = None) -> Store:
    """Run a study to its target and return its store."""
    store = Store(runs / spec.study.name)
    Run(spec, store, listen or Silent()).execute()
    return store


def _digest(result: Row) -> str:
    return digest(json.loads(result["overrides"]))
