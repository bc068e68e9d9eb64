"""A study's rows for other programs: one Parquet file, CSV, or a study of Optuna's."""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Sequence
from datetime import timedelta
from itertools import count
from pathlib import Path
from typing import Any

import optuna
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from optuna.trial import FrozenTrial, TrialState

from eiwa.core.errors import StoreError
from eiwa.core.spec import StudySpec
from eiwa.study import journal
from eiwa.study.leaders import parameters
from eiwa.study.rows import Row
from eiwa.study.sampler import distributions
from eiwa.study.storages import refusals
from eiwa.study.store import Store, write_atomically, writing

STATES = {"COMPLETE": TrialState.COMPLETE, "FAIL": TrialState.FAIL, "SKIPPED": TrialState.PRUNED}
"""A design that was not evaluated has no values, as a pruned trial."""
ELSEWHERE = "choose another name."
TOLD = ("kind", "number", "state", "started")
"""Columns, besides parameters, objectives and constraints, that Optuna has a place for."""


def export(spec: StudySpec, store: Store, target: str) -> int:
    """Write the rows to a new ``.parquet``, ``.csv`` or ``.log`` (Optuna's journal) file, or an Optuna storage's URL.

    Returns the number of rows, or of trials, written.

    Raises
    ------
    StoreError
        The target is none of these, exists already, or cannot be written; or rows are of another study file.
    """
    if "://" in target:
        return _to_database(spec, store.rows(), target)
    path = Path(target)
    if path.suffix not in (".parquet", ".csv", ".log"):
        raise StoreError(
            f"{target}: write the name of a file that ends in .parquet, .csv or .log, or a URL such as sqlite:///study.db"
        )
    if path.exists():
        raise StoreError(f"{path}: exists already. Move it away, or choose another name.")
    if not path.parent.is_dir():
        raise StoreError(f"{path}: there is no folder {path.parent}. Make it, or choose another name.")
    if path.suffix == ".log":
        return _to_journal(spec, store.rows(), path)
    table, sink = store.table(), pa.BufferOutputStream()
    if path.suffix == ".parquet":
        pq.write_table(table, sink, compression="zstd")
    else:
        pyarrow.csv.write_csv(flat(table), sink)
    write_atomically(path, sink.getvalue().to_pybytes(), ELSEWHERE)
    return int(table.num_rows)


def flat(table: pa.Table) -> pa.Table:
    """The table with lists as JSON."""
    columns = [
        pa.array([None if v is None else json.dumps(v) for v in column.to_pylist()], pa.string())
        if pa.types.is_list(column.type)
        else column
        for column in table.columns
    ]
    return pa.table(dict(zip(table.column_names, columns, strict=True)))


def _to_journal(spec: StudySpec, rows: Sequence[Row], path: Path) -> int:
    """A journal that is whole or not there, and nothing beside it."""
    with writing(path, ELSEWHERE), tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
        written = Path(folder) / path.name
        count = _to_optuna(spec, rows, journal.storage(written), str(path))
        written.replace(path)
    return count


def _to_database(spec: StudySpec, rows: Sequence[Row], url: str) -> int:
    from sqlalchemy import make_url
    from sqlalchemy.exc import SQLAlchemyError

    shown = url
    try:
        shown = make_url(url).render_as_string(hide_password=True)
        storage = optuna.storages.get_storage(url)
    except (SQLAlchemyError, ImportError, ValueError) as error:
        raise StoreError(f"{shown}: cannot be opened: {str(error).splitlines()[0]}") from None
    with refusals(shown):
        return _to_optuna(spec, rows, storage, shown)


def _to_optuna(spec: StudySpec, rows: Sequence[Row], storage: Any, target: str) -> int:
    known = {r["number"]: r for r in rows if r["kind"] == "trial"}
    # Numbers are Optuna's own: behind a trial that is not finished yet, none can keep its number.
    trials = [known[n] for n in range(next(n for n in count() if n not in known))]
    if any(r["spec_hash"] != spec.hash for r in trials):
        raise StoreError(
            f"{spec.path}: has changed since its trials were run. Export with the file that they were run with."
        )
    if spec.study.name in optuna.get_all_study_names(storage):
        raise StoreError(
            f"{target}: has a study {spec.study.name} already. Choose another place, or another study.name."
        )
    journal.quiet()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        directions = [o.direction for o in spec.objectives]
        study = optuna.create_study(storage=storage, study_name=spec.study.name, directions=directions)
        study.set_metric_names([o.label for o in spec.objectives])
    study.set_user_attr("constraints", [c.label for c in spec.constraints])
    study.set_user_attr("spec_hash", spec.hash)
    study.set_user_attr("study", json.loads(json.dumps(spec.resolved, default=str)))
    study.add_trials([_trial(spec, r) for r in trials])
    return len(trials)


def _trial(spec: StudySpec, r: Row) -> FrozenTrial:
    """A finished trial: violations where Optuna and its dashboard read them, all other columns as user attributes."""
    complete = r["state"] == "COMPLETE"
    told = ("parameters.", "objectives.", "constraints.")
    others = {k: v for k, v in r.items() if v is not None and k not in TOLD and not k.startswith(told)}
    violations = [r[f"constraints.{i}"] or 0.0 for i in range(len(spec.constraints))]
    return FrozenTrial(
        number=r["number"],
        trial_id=-1,
        state=STATES[r["state"]],
        value=None,
        values=[r[f"objectives.{i}"] for i in range(len(spec.objectives))] if complete else None,
        params=parameters(r),
        distributions=distributions(spec),
        user_attrs=others,
        system_attrs={"constraints": violations} if r["state"] != "FAIL" else {},
        intermediate_values={},
        datetime_start=r["started"],
        datetime_complete=r["started"] + timedelta(seconds=r["seconds"] or 0.0),
    )
