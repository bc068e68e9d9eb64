"""Runs a study: named designs, the search, the leaders; every step can be interrupted and is continued by the next run.

One process owns the study (ask, tell). A batch is asked together, its rows are written, then it is told in order: so
results depend neither on threads nor on where a run was interrupted.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import optuna
from optuna.trial import FrozenTrial, TrialState

from eiwa.core.errors import EiwaError, StoreError
from eiwa.core.spec import StudySpec, digest
from eiwa.study import journal
from eiwa.study.rows import Row, Task, row, schema
from eiwa.study.sampler import announced, distributions, require, sampler_of, search_size
from eiwa.study.store import Store, writing

LEADERS = 3
FIRST_FAILURES, FAILURES_IN_A_ROW = 5, 20


class Listener(Protocol):
    """Hears how a run goes on; stages are designs, search and leaders."""

    def begin(self, stage: str, total: int, done: int) -> None:
        """A stage starts, with so many of its evaluations done before."""

    def __call__(self, stage: str, row: Row) -> None:
        """An evaluation is done."""

    def say(self, line: str) -> None:
        """Something that the user should know."""


class Silent:
    """Hears nothing."""

    def begin(self, stage: str, total: int, done: int) -> None:
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

    def execute(self) -> bool:
        """Do everything that is not done yet; False when there was nothing to do.

        Raises
        ------
        EiwaError
            The folder cannot be used, or designs keep failing.
        """
        with self.store.locked():
            self.store.open(self.spec)
            self.rows = self.store.rows()
            before = len(self.rows)
            self._designs()
            if self.target:
                self._search()
                self._leaders()
            with suppress(StoreError):  # a disk without room for the copy holds the parts themselves
                self.store.compact()
            return len(self.rows) > before

    def _evaluate(self, stage: str, tasks: Sequence[Task]) -> list[Row]:
        """Evaluate and write as one part; what an interruption leaves unwritten is evaluated again."""
        fresh = []
        for task in tasks:
            fresh.append(row(self.spec, task))
            self.listen(stage, fresh[-1])
        if fresh:
            self.store.write(fresh, self.schema)
            self.rows.extend(fresh)
        return fresh

    def _missing_designs(self, rows: Sequence[Row]) -> list[Task]:
        full = self.spec.design({}).tables["sampling"].replicates  # type: ignore[attr-defined]
        present = {(r["name"], _digest(r)) for r in rows if r["kind"] == "design" and r["state"] == "COMPLETE"}
        tasks = [Task("design", d.overrides, full, name=name) for name, d in self.spec.designs.items()]
        return [t for t in tasks if (t.name, digest(dict(t.overrides))) not in present]

    def _designs(self) -> None:
        missing = self._missing_designs(self.rows)
        if missing:
            self.listen.begin("designs", len(self.spec.designs), len(self.spec.designs) - len(missing))
        for task in missing:
            (result,) = self._evaluate("designs", [task])
            if result["state"] == "FAIL":
                raise EiwaError(f"designs.{task.name}: {result['message']}")

    def _search(self) -> None:
        require(self.spec)
        if line := announced(self.spec):
            self.listen.say(line)
        study, storage = self._study()
        begun = self._told(study)
        self._stop_when_failing({r["number"]: r for r in self.rows if r["kind"] == "trial"})
        if begun < self.target:
            self.listen.begin("search", self.target, begun)
        self._restore_rows(study)
        while (begun := self._told(study)) < self.target:
            first = begun - begun % self.spec.study.batch
            last = min(first + self.spec.study.batch, self.target)
            trials = [self._trial(study, number) for number in range(first, last)]
            running = [t for t in trials if t.state is TrialState.RUNNING]
            known = {r["number"]: r for r in self.rows if r["kind"] == "trial"}
            self._evaluate("search", [self._task(t) for t in running if t.number not in known])
            known = {r["number"]: r for r in self.rows if r["kind"] == "trial"}
            for trial in running:
                self._tell(study, storage, trial, known[trial.number])
            self._stop_when_failing(known)

    def _study(self) -> tuple[optuna.Study, optuna.storages.BaseStorage]:
        """The Optuna study; what its journal lacks is rebuilt from the rows."""
        journal.quiet()
        with writing(self.store.journal), warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            storage = journal.storage(self.store.journal)
            name = self.spec.study.name
            if name in optuna.get_all_study_names(storage):
                study = optuna.load_study(study_name=name, storage=storage)
            else:
                directions = [o.direction for o in self.spec.objectives]
                study = optuna.create_study(storage=storage, study_name=name, directions=directions)
            if "constraints" not in study.user_attrs:
                study.set_user_attr("constraints", [c.label for c in self.spec.constraints])
            if study.metric_names is None:
                study.set_metric_names(metric_names(self.spec))
            rows = {r["number"]: r for r in self.rows if r["kind"] == "trial"}
            number = len(study.get_trials(deepcopy=False))
            while number in rows:
                study.add_trial(self._frozen(rows[number]))
                number += 1
        return study, storage

    def _told(self, study: optuna.Study) -> int:
        """Number of trials that are finished, counted from the first."""
        finished = {t.number for t in study.get_trials(deepcopy=False) if t.state.is_finished()}
        number = 0
        while number in finished:
            number += 1
        return number

    def _trial(self, study: optuna.Study, number: int) -> FrozenTrial:
        """The trial of a number: asked for now, or found RUNNING or finished from a run that was interrupted."""
        trials = study.get_trials(deepcopy=False)
        with warnings.catch_warnings(), writing(self.store.journal):
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            study.sampler = sampler_of(self.spec, number)
            if number >= len(trials):
                study.ask(distributions(self.spec))
            elif trials[number].state is TrialState.RUNNING:
                self._adopt(study, trials[number])
        return study.get_trials(deepcopy=False)[number]

    def _adopt(self, study: optuna.Study, orphan: FrozenTrial) -> None:
        """Suggest what an interruption left unsuggested, with the random numbers in step with an uninterrupted run."""
        trial = optuna.trial.Trial(study, orphan._trial_id)
        for name, distribution in distributions(self.spec).items():
            if name not in orphan.params:
                trial._suggest(name, distribution)
            elif name not in trial.relative_params:
                study.sampler.sample_independent(study, orphan, name, distribution)

    def _task(self, trial: FrozenTrial) -> Task:
        parameters = dict(trial.params)
        return Task("trial", self.spec.overrides(parameters), 1, number=trial.number, parameters=parameters)

    def _tell(self, study: optuna.Study, storage: Any, trial: FrozenTrial, result: Row) -> None:
        with writing(self.store.journal):
            if result["state"] == "FAIL":
                study.tell(trial.number, state=TrialState.FAIL)
                return
            # The list under this name is what Optuna's samplers and optuna-dashboard both read.
            storage.set_trial_system_attr(trial._trial_id, "constraints", self._violations(result))
            study.tell(trial.number, self._objectives(result))

    def _frozen(self, result: Row) -> FrozenTrial:
        failed = result["state"] == "FAIL"
        return optuna.trial.create_trial(
            state=TrialState.FAIL if failed else TrialState.COMPLETE,
            values=None if failed else self._objectives(result),
            params={name: result[f"parameters.{name}"] for name in self.spec.ranges},
            distributions=distributions(self.spec),
            system_attrs={} if failed else {"constraints": self._violations(result)},
        )

    def _objectives(self, result: Row) -> list[float]:
        """What Optuna is told; of a design that was not evaluated the worst that was seen before it."""
        if result["state"] != "SKIPPED":
            return [result[f"objectives.{i}"] for i in range(len(self.spec.objectives))]
        first = result["number"] - result["number"] % self.spec.study.batch
        seen = [r for r in self.rows if r["kind"] == "trial" and r["state"] == "COMPLETE" and r["number"] < first]
        worst = [min if o.direction == "maximize" else max for o in self.spec.objectives]
        return [pick((r[f"objectives.{i}"] for r in seen), default=0.0) for i, pick in enumerate(worst)]

    def _violations(self, result: Row) -> list[float]:
        return [result.get(f"constraints.{i}") or 0.0 for i in range(len(self.spec.constraints))]

    def _restore_rows(self, study: optuna.Study) -> None:
        """Evaluate again the finished trials whose rows are gone."""
        known = {r["number"] for r in self.rows if r["kind"] == "trial"}
        lost = [t for t in study.get_trials(deepcopy=False) if t.state.is_finished() and t.number not in known]
        if lost:
            self.listen.begin("restored", len(lost), 0)
        self._evaluate("restored", [self._task(t) for t in lost])

    def _stop_when_failing(self, known: Mapping[int, Row]) -> None:
        states = [known[n]["state"] == "FAIL" for n in sorted(known)]
        tail = next((i for i, failed in enumerate(reversed(states)) if not failed), len(states))
        if (tail == len(states) and tail >= FIRST_FAILURES) or tail >= FAILURES_IN_A_ROW:
            last = known[max(known)]["message"]
            raise EiwaError(f"the last {tail} trials failed, so the study stops. The last one said: {last}")

    def _missing_leaders(self, rows: Sequence[Row]) -> list[Task]:
        full = self.spec.design({}).tables["sampling"].replicates  # type: ignore[attr-defined]
        present = {r["number"] for r in rows if r["kind"] == "leader"}
        return [
            Task(
                "leader",
                self.spec.overrides(parameters(r)),
                full,
                number=r["number"],
                parameters=parameters(r),
            )
            for r in leaders(self.spec, rows)
            if r["number"] not in present
        ]

    def _leaders(self) -> None:
        """The best trials, with all replicates."""
        missing = self._missing_leaders(self.rows)
        if missing:
            self.listen.begin("leaders", len(missing), 0)
        self._evaluate("leaders", missing)


def leaders(spec: StudySpec, rows: Sequence[Row], count: int = LEADERS) -> list[Row]:
    """The best feasible trials by the first objective, best first; ties by number."""
    if not spec.objectives:
        return []
    sign = -1.0 if spec.objectives[0].direction == "maximize" else 1.0
    trials = [r for r in rows if r["kind"] == "trial" and r["state"] == "COMPLETE" and r["feasible"]]
    return sorted(trials, key=lambda r: (sign * r["objectives.0"], r["number"]))[:count]


def parameters(result: Row) -> dict[str, float]:
    """A row's sampled variables."""
    prefix = "parameters."
    return {k.removeprefix(prefix): v for k, v in result.items() if k.startswith(prefix) and v is not None}


def run(spec: StudySpec, runs: Path, listen: Listener | None = None) -> Store:
    """Run a study to its target and return its store."""
    store = Store(runs / spec.study.name)
    Run(spec, store, listen or Silent()).execute()
    return store


def metric_names(spec: StudySpec) -> list[str]:
    """Optuna's names of the objectives: their labels, told apart."""
    labels = [o.label for o in spec.objectives]
    return [f"{name} ({i})" if labels.count(name) > 1 else name for i, name in enumerate(labels)]


def _digest(result: Row) -> str:
    import json

    return digest(json.loads(result["overrides"]))
