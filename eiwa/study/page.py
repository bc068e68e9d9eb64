"""What optuna-dashboard shows of a study: its rows, as an Optuna storage that can only be read.

Rows are the truth of a study, so the page is made from them and from nothing else: it opens while another process runs
the study, shows new rows within seconds, and nothing that is clicked in it reaches a file.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from optuna.storages import BaseStorage
from optuna.study import StudyDirection
from optuna.study._frozen import FrozenStudy
from optuna.trial import FrozenTrial, TrialState

from eiwa.core.errors import StoreError
from eiwa.core.spec import StudySpec
from eiwa.study.front import nondominated
from eiwa.study.rows import Row
from eiwa.study.run import parameters
from eiwa.study.sampler import distributions
from eiwa.study.store import Store

STUDY = 0
STATES = {"COMPLETE": TrialState.COMPLETE, "FAIL": TrialState.FAIL, "SKIPPED": TrialState.PRUNED}
READ_ONLY = "This page only shows the study: nothing can be changed here. Write to the study file instead."
"""What is said to everything that would change something."""


@dataclass(frozen=True)
class Description:
    """What the page says beside the trials: Markdown on the study and on some trials, figures as plotly's JSON."""

    note: str
    notes: Mapping[int, str]
    figures: Mapping[str, Any]


Describe = Callable[[Sequence[Row]], Iterable[Description]]
"""Rows -> descriptions, each a better one; the first one comes at once."""


class Page(BaseStorage):
    """One study as Optuna's readers see it, its number :data:`STUDY`; everything that would write is refused.

    A trial's id is its number. One whose row is not there yet, or gone, is RUNNING; one that was never evaluated because
    its parameters alone break a constraint is PRUNED.
    """

    def __init__(self, spec: StudySpec, store: Store, describe: Describe) -> None:
        self._spec, self._store, self._describe = spec, store, describe
        self._parts: set[Path] | None = None
        self._rows: list[Row] = []
        self._finished: dict[int, FrozenTrial] = {}
        self._trials: list[FrozenTrial] = []
        self._directions = [StudyDirection[o.direction.upper()] for o in spec.objectives] or [StudyDirection.MAXIMIZE]
        self._attributes: dict[str, Any] = {}

    def updates(self) -> Iterator[bool]:
        """Show what is new, step by step and without end; False where nothing was.

        Raises
        ------
        StoreError
            The rows cannot be read at first; later they are looked at again.
        """
        fresh = self._read()
        while True:
            for description in self._describe(self._rows) if fresh else ():
                self._attributes = self._said(description)
                yield True
            yield False
            fresh = False
            with suppress(OSError, pa.ArrowException, StoreError):  # a part that is being replaced
                fresh = self._read()

    def _read(self) -> bool:
        """Read rows that were not there before; parts never change, but may be replaced by one that holds them all."""
        parts = set(self._store.parts)
        if parts == self._parts:
            return False
        if self._parts is not None and self._parts <= parts:
            self._rows += [r for part in sorted(parts - self._parts) for r in pq.read_table(part).to_pylist()]
        else:
            rows = self._store.rows()
            if set(self._store.parts) != parts:  # some were written while we read
                return self._read()
            self._rows, self._finished = rows, {}
        self._parts = parts
        for row in self._rows:
            if row["kind"] == "trial" and row["number"] not in self._finished:
                self._finished[row["number"]] = self._frozen(row)
        count = max(self._finished, default=-1) + 1
        self._trials = [self._finished.get(n) or _trial(n, TrialState.RUNNING) for n in range(count)]
        return True

    def _frozen(self, row: Row) -> FrozenTrial:
        state = STATES[row["state"]]
        objectives = [row.get(f"objectives.{i}") for i in range(len(self._directions))]
        violations = [row.get(f"constraints.{i}") or 0.0 for i in range(len(self._spec.constraints))]
        values = parameters(row)
        return _trial(
            row["number"],
            state,
            values=objectives if state is TrialState.COMPLETE else None,
            datetime_start=row["started"],
            datetime_complete=row["started"] + timedelta(seconds=row["seconds"] or 0.0),
            params=values,
            distributions={n: d for n, d in distributions(self._spec).items() if n in values},
            user_attrs=self._numbers(row),
            # The list under this name is the only one that optuna-dashboard reads.
            system_attrs={} if state is TrialState.FAIL else {"constraints": violations},
        )

    def _numbers(self, row: Row) -> dict[str, Any]:
        """What the page lists of a trial: broken constraints, every metric at the reference, needed ones everywhere."""
        if row["state"] == "FAIL":
            return {"message": row["message"]}
        violations = {c.label: row.get(f"constraints.{i}") or 0.0 for i, c in enumerate(self._spec.constraints)}
        broken = {f"breaks {label} by": v for label, v in violations.items() if v > 0}
        prefix = "metrics."
        named = {k.removeprefix(prefix): v for k, v in row.items() if k.startswith(prefix) and v is not None}
        needed = self._spec.needed | {"F"}
        return broken | {name: v for name, v in named.items() if "@" not in name or name.split("@")[0] in needed}

    def _said(self, description: Description) -> dict[str, Any]:
        """A description in the study's system attributes, under the names that optuna-dashboard knows."""
        said: dict[str, Any] = {"study:metric_names": [o.label for o in self._spec.objectives] or ["no objective"]}
        for of, text in {"": description.note, **{f"{n}:": t for n, t in description.notes.items()}}.items():
            said |= {f"dashboard:{of}note_ver": 1, f"dashboard:{of}note_str:0": text}
        for name, figure in description.figures.items():
            said[f"dashboard:plot_data:{name}:0"] = json.dumps(figure, allow_nan=False, separators=(",", ":"))
        return said

    def get_best_trial(self, study_id: int) -> FrozenTrial:
        """The best trial that meets the constraints; the least infeasible one where none does."""
        complete = self.get_all_trials(study_id, states=(TrialState.COMPLETE,))
        if not complete:
            raise ValueError("no trial is complete")
        sign = -1.0 if self._directions[0] is StudyDirection.MAXIMIZE else 1.0
        return min(complete, key=lambda t: (max(0.0, *_violations(t), 0.0), sign * t.values[0]))

    def get_all_trials(
        self, study_id: int, deepcopy: bool = False, states: Container[TrialState] | None = None
    ) -> list[FrozenTrial]:
        """Trials by number."""
        return self._trials if states is None else [t for t in self._trials if t.state in states]

    def get_trial(self, trial_id: int) -> FrozenTrial:
        """One trial."""
        if not 0 <= trial_id < len(self._trials):
            raise KeyError(trial_id)
        return self._trials[trial_id]

    def get_all_studies(self) -> list[FrozenStudy]:
        """The study."""
        name, attributes = self._spec.study.name, self.get_study_user_attrs(STUDY)
        return [FrozenStudy(name, None, attributes, self._attributes, STUDY, directions=self._directions)]

    def get_study_id_from_name(self, study_name: str) -> int:
        """Its number."""
        if study_name != self._spec.study.name:
            raise KeyError(study_name)
        return STUDY

    def get_study_name_from_id(self, study_id: int) -> str:
        """Its name."""
        return self._of(study_id).study_name

    def get_study_directions(self, study_id: int) -> list[StudyDirection]:
        """Whether each objective is minimised or maximised."""
        return self._of(study_id).directions

    def get_study_user_attrs(self, study_id: int) -> dict[str, Any]:
        """What tells the study from others."""
        constraints = ", ".join(c.label for c in self._spec.constraints)
        return {"spec hash": self._spec.hash, "seed": self._spec.study.seed, "constraints": constraints or "none"}

    def get_study_system_attrs(self, study_id: int) -> dict[str, Any]:
        """Names of objectives, notes, figures."""
        return self._of(study_id).system_attrs

    def _of(self, study_id: int) -> FrozenStudy:
        if study_id != STUDY:
            raise KeyError(study_id)
        return self.get_all_studies()[0]

    def _refused(self, *_: Any, **__: Any) -> NoReturn:
        raise StoreError(READ_ONLY)

    create_new_study = delete_study = set_study_user_attr = set_study_system_attr = _refused
    create_new_trial = set_trial_param = set_trial_state_values = set_trial_intermediate_value = _refused
    set_trial_user_attr = set_trial_system_attr = _refused


def _trial(number: int, state: TrialState, **known: Any) -> FrozenTrial:
    unknown = dict.fromkeys(("value", "datetime_start", "datetime_complete"))
    empty: dict[str, Any] = {n: {} for n in ("params", "distributions", "user_attrs", "system_attrs")}
    return FrozenTrial(
        number=number, state=state, intermediate_values={}, trial_id=number, **{**unknown, **empty, **known}
    )


def _violations(trial: FrozenTrial) -> list[float]:
    violations: list[float] = trial.system_attrs.get("constraints", [])
    return violations


def front(trials: Sequence[FrozenTrial], directions: Sequence[StudyDirection]) -> list[FrozenTrial]:
    """Complete trials that meet the constraints and that no other such trial dominates, by number."""
    met = [t for t in trials if t.state is TrialState.COMPLETE and max(_violations(t), default=0.0) <= 0]
    signs = [-1.0 if d is StudyDirection.MAXIMIZE else 1.0 for d in directions]
    points = np.array([t.values for t in met]).reshape(len(met), len(signs)) * signs
    return [met[k] for k in np.flatnonzero(nondominated(points))]
