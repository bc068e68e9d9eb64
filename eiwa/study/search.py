"""Optuna's side of a study: trials are asked for and told in the order of their numbers, a batch at a time."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

import optuna
from optuna.trial import FrozenTrial, TrialState

from eiwa.core.errors import StoreError
from eiwa.core.spec import StudySpec
from eiwa.study.rows import Row
from eiwa.study.sampler import distributions, sampler_of
from eiwa.study.storages import Storage


class Asked(NamedTuple):
    """A trial that waits for its result."""

    number: int
    id: int
    parameters: Mapping[str, float]


class Search:
    """The Optuna study of a spec; what its storage lacks is rebuilt from rows of trials by number."""

    def __init__(self, spec: StudySpec, storage: Storage, rows: Mapping[int, Row]) -> None:
        self._spec = spec
        self._storage = storage
        self._rows = rows
        self._distributions = distributions(spec)
        self._worst = Worst(spec, rows)
        with self._writing():
            self._study = self._opened()
            self._trials = {t.number: t for t in self._study.get_trials(deepcopy=False)}
            self._rebuild()
        self.told = 0
        """Number of trials that are finished, counted from the first."""
        self._advance()

    def batch(self, numbers: Iterable[int]) -> list[Asked]:
        """The unfinished trials among these: asked for now, or found from a run that was interrupted."""
        with self._writing():
            found = [self._trial(number) for number in numbers]
        return [Asked(t.number, t._trial_id, dict(t.params)) for t in found if t.state is TrialState.RUNNING]

    def tell(self, asked: Iterable[Asked]) -> None:
        """Tell Optuna what the rows of these trials say."""
        with self._writing():
            for trial in asked:
                result = self._rows[trial.number]
                if result["state"] == "FAIL":
                    self._trials[trial.number] = self._study.tell(trial.number, state=TrialState.FAIL)
                else:
                    # The list under this name is what Optuna's samplers and optuna-dashboard both read.
                    self._storage.optuna.set_trial_system_attr(trial.id, "constraints", self._violations(result))
                    self._trials[trial.number] = self._study.tell(trial.number, self._objectives(result))
        self._advance()

    def finished(self) -> list[Asked]:
        """All finished trials."""
        return [Asked(t.number, t._trial_id, dict(t.params)) for t in self._trials.values() if t.state.is_finished()]

    def _advance(self) -> None:
        while self.told in self._trials and self._trials[self.told].state.is_finished():
            self.told += 1

    @contextmanager
    def _writing(self) -> Iterator[None]:
        with self._storage.transaction(), warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            yield

    def _opened(self) -> optuna.Study:
        name, storage = self._spec.study.name, self._storage.optuna
        if name in optuna.get_all_study_names(storage):
            study = optuna.load_study(study_name=name, storage=storage)
            if self._storage.shared and study.user_attrs.get("spec_hash") != self._spec.hash:
                raise StoreError(
                    f"{self._storage.place}: holds a study {name!r} that another study file made; its numbers would "
                    "differ. Give this study another name (study.name), or another storage (execution.storage)."
                )
        else:
            directions = [o.direction for o in self._spec.objectives]
            study = optuna.create_study(storage=storage, study_name=name, directions=directions)
        for key, value in (("spec_hash", self._spec.hash), ("constraints", [c.label for c in self._spec.constraints])):
            if key not in study.user_attrs:
                study.set_user_attr(key, value)
        if study.metric_names is None:
            study.set_metric_names([o.label for o in self._spec.objectives])
        return study

    def _rebuild(self) -> None:
        """Add finished trials that only rows know, as far as none before them is missing."""
        while (number := len(self._trials)) in self._rows:
            self._trials[number] = self._storage.optuna.get_trial(self._created(number))

    def _trial(self, number: int) -> FrozenTrial:
        """The trial of a number: known, known of an interrupted run, or new."""
        self._study.sampler = sampler_of(self._spec, number)
        known = self._trials.get(number)
        if known is None:
            trial_id = self._created(number)
        elif known.state is TrialState.RUNNING:
            trial_id = self._adopted(known)
        else:
            return known
        self._trials[number] = self._storage.optuna.get_trial(trial_id)
        return self._trials[number]

    def _created(self, number: int) -> int:
        if number in self._rows:
            return self._storage.optuna.create_new_trial(self._study._study_id, self._frozen(self._rows[number]))
        return self._study.ask(self._distributions)._trial_id

    def _adopted(self, orphan: FrozenTrial) -> int:
        """Suggest what an interruption left unsuggested, with the random numbers in step with an uninterrupted run."""
        if orphan.params.keys() != self._distributions.keys():
            trial = optuna.trial.Trial(self._study, orphan._trial_id)
            for name, distribution in self._distributions.items():
                if name not in orphan.params:
                    trial._suggest(name, distribution)
                elif name not in trial.relative_params:
                    self._study.sampler.sample_independent(self._study, orphan, name, distribution)
        return orphan._trial_id

    def _frozen(self, result: Row) -> FrozenTrial:
        """The finished trial of a row."""
        failed = result["state"] == "FAIL"
        return optuna.trial.create_trial(
            state=TrialState.FAIL if failed else TrialState.COMPLETE,
            values=None if failed else self._objectives(result),
            params={name: result[f"parameters.{name}"] for name in self._spec.ranges},
            distributions=self._distributions,
            system_attrs={} if failed else {"constraints": self._violations(result)},
        )

    def _objectives(self, result: Row) -> list[float]:
        """A row's objectives; a skipped design has the worst values known when its batch was asked for."""
        if result["state"] != "SKIPPED":
            return [result[f"objectives.{i}"] for i in range(len(self._spec.objectives))]
        return self._worst(result["number"] - result["number"] % self._spec.study.batch)

    def _violations(self, result: Row) -> list[float]:
        """A row's violations; a skipped design has no value for those that need an evaluation."""
        return [result.get(f"constraints.{i}") or 0.0 for i in range(len(self._spec.constraints))]


class Worst:
    """The worst objectives of trials below a number that only grows; 0 before there are any."""

    def __init__(self, spec: StudySpec, rows: Mapping[int, Row]) -> None:
        self._rows = rows
        self._worse = [min if o.direction == "maximize" else max for o in spec.objectives]
        self._values: list[float] = []
        self._next = 0

    def __call__(self, end: int) -> list[float]:
        """Of the evaluated trials with smaller numbers than ``end``."""
        for number in range(self._next, end):
            result = self._rows.get(number)
            if result is not None and result["state"] == "COMPLETE":
                values = [result[f"objectives.{i}"] for i in range(len(self._worse))]
                self._values = [w(v) for w, *v in zip(self._worse, values, self._values or values, strict=True)]
        self._next = max(self._next, end)
        return self._values or [0.0] * len(self._worse)
