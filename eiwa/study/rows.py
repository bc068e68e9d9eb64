"""What one Parquet row holds: the design, its numbers, and how they were made.

Columns of a row (floats unless said): ``kind`` (design, trial, leader), ``name`` (of a named design), ``number`` (of a
trial), ``state`` (COMPLETE, FAIL, or SKIPPED: an inequality of parameters is broken, so nothing was evaluated),
``message``, ``feasible``, ``parameters.V``, ``values.PATH`` (what the overrides put there), ``objectives.I``,
``constraints.I`` (violation, <= 0 when met), ``metrics.NAME`` at the reference scenario and ``metrics.NAME@SCENARIO``,
``adjusted.armrest`` and ``adjusted.seat`` likewise (what the operator chose), ``replicates``, ``replicated.objectives.I``,
``replicated.metrics.NAME`` and ``replicated.metrics.NAME@SCENARIO`` (lists: the value in every replicate), ``overrides``
(JSON), ``spec_hash``, ``seed``, ``estimator``, ``versions`` (JSON); and what may differ between equal results: ``started`` (UTC),
``seconds``, ``threads``, ``host``, ``pid``, ``cpu``, ``cpu_features``, ``reused`` and ``computed`` (sets of samples).
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from importlib.metadata import version
from typing import Any, Literal

import pyarrow as pa

from eiwa.core import reuse
from eiwa.core.compiled import cpu
from eiwa.core.errors import EiwaError
from eiwa.core.kernel import thread_count
from eiwa.core.named import parted
from eiwa.core.outcome import evaluate
from eiwa.core.spec import StudySpec, digest
from eiwa.core.tree import exists, lookup
from eiwa.core.version import __version__

Kind = Literal["design", "trial", "leader"]
Row = dict[str, Any]

VERSION, VERSION_KEY = 1, b"eiwa.schema"
"""Version of the columns, and where a part's metadata has it; raised when a column changes its meaning or goes."""
VOLATILE = ("started", "seconds", "threads", "host", "pid", "cpu", "cpu_features", "reused", "computed")
"""Columns in which equal results may differ."""


@dataclass(frozen=True)
class Task:
    """One evaluation to do: which design, with how many replicates, and where its row belongs."""

    kind: Kind
    overrides: Mapping[str, Any]
    replicates: int
    name: str | None = None
    number: int | None = None
    parameters: Mapping[str, float] | None = None

    @property
    def label(self) -> str:
        """What a message calls it."""
        return f"{self.kind} {self.number if self.name is None else self.name}"


def schema(spec: StudySpec) -> pa.Schema:
    """The columns of a study's rows."""
    numbers = [n.name for plugin, _ in spec.design({}).metrics.values() for n in plugin.numbers]
    labels = [s.label for s in spec.scenarios]
    valued = [(p, v) for d in spec.designs.values() for p, v in parted(d.overrides)[1].items()]
    paths = dict(sorted([*valued, *((p, 0.0) for p in spec.searched)]))
    reals = [f"parameters.{name}" for name in spec.ranges]
    reals += [f"objectives.{i}" for i in range(len(spec.objectives))]
    reals += [f"constraints.{i}" for i in range(len(spec.constraints))]
    measured = [metric_column(n, label) for label in labels for n in numbers]
    reals += measured
    reals += [f"adjusted.{what}{at(label)}" for label in labels for what in adjustable(spec)]
    lists = [f"replicated.objectives.{i}" for i in range(len(spec.objectives))]
    lists += [f"replicated.{column}" for column in measured]
    resolved = spec.design({}).resolved()
    fields = [
        *((c, pa.string()) for c in ("kind", "name")),
        ("number", pa.int64()),
        *((c, pa.string()) for c in ("state", "message")),
        ("feasible", pa.bool_()),
        *((f"values.{p}", _type(lookup(resolved, p) if exists(resolved, p) else v)) for p, v in paths.items()),
        *((c, pa.float64()) for c in reals),
        ("replicates", pa.int64()),
        *((c, pa.list_(pa.float64())) for c in lists),
        *((c, pa.string()) for c in ("overrides", "spec_hash")),
        ("seed", pa.int64()),
        ("estimator", pa.string()),
        ("versions", pa.string()),
        ("started", pa.timestamp("us", tz="UTC")),
        ("seconds", pa.float64()),
        ("threads", pa.int64()),
        ("host", pa.string()),
        ("pid", pa.int64()),
        ("cpu", pa.string()),
        ("cpu_features", pa.string()),
        ("reused", pa.int64()),
        ("computed", pa.int64()),
    ]
    return pa.schema(fields, metadata=metadata(spec))


def metadata(spec: StudySpec) -> dict[bytes, bytes]:
    """What a part says about itself: the columns' version, and the study with and without its defaults.

    Where it ran and was stored is left out: an address may hold a password.
    """
    resolved, file = ({k: v for k, v in tree.items() if k != "execution"} for tree in (spec.resolved, spec.tree))
    texts = {
        VERSION_KEY.decode(): str(VERSION),
        "eiwa.version": __version__,
        "eiwa.spec_hash": spec.hash,
        "eiwa.study": json.dumps(resolved, sort_keys=True, default=str),
        "eiwa.file": json.dumps(file, default=str),
    }
    return {key.encode(): value.encode() for key, value in texts.items()}


def metric_column(number: str, label: str = "") -> str:
    """Column of a metric's number under a scenario."""
    return f"metrics.{number}{at(label)}"


def at(label: str) -> str:
    """What a column's name ends with under a scenario."""
    return f"@{label}" if label else ""


@lru_cache(maxsize=8)
def adjustable(spec: StudySpec) -> tuple[str, ...]:
    """What operators adjust under some scenario."""
    found = [spec.design(s.overrides).adjust for s in spec.scenarios]
    return tuple(what for what in ("armrest", "seat") if any(getattr(adjust, what) for adjust in found))


def row(spec: StudySpec, task: Task) -> Row:
    """Evaluate a task; a design that cannot be evaluated gives a FAIL row with its message."""
    started, clock = datetime.now(UTC), time.perf_counter()
    hits, misses = reuse.samples.hits, reuse.samples.misses
    result = _asked(spec, task)
    try:
        result |= _numbers(spec, task)
    # A plugin may raise anything, or call sys.exit; one design's failure must not end the study.
    except (Exception, SystemExit) as error:
        result |= {"state": "FAIL", "message": _message(error)}
    volatile = {
        "started": started,
        "seconds": time.perf_counter() - clock,
        "reused": reuse.samples.hits - hits,
        "computed": reuse.samples.misses - misses,
    }
    return {**result, **provenance(spec), **volatile}


def failed(spec: StudySpec, task: Task, message: str) -> Row:
    """The FAIL row of a task whose evaluation ended without an answer."""
    volatile = {"started": datetime.now(UTC), "seconds": None, "reused": None, "computed": None}
    return {**_asked(spec, task), "state": "FAIL", "message": message, **provenance(spec), **volatile}


def _asked(spec: StudySpec, task: Task) -> Row:
    return {
        "kind": task.kind,
        "name": task.name,
        "number": task.number,
        "replicates": task.replicates,
        "overrides": json.dumps(dict(task.overrides), sort_keys=True),
        "estimator": task.overrides.get("sampling.estimator", spec.defaults["sampling"]["estimator"]),
        **{f"values.{path}": value for path, value in parted(task.overrides)[1].items()},
        **{f"parameters.{name}": value for name, value in (task.parameters or {}).items()},
    }


def _numbers(spec: StudySpec, task: Task) -> Row:
    parameters = task.parameters or {}
    violations = spec.inequalities(task.overrides, parameters)
    broken = [c.label for c, v in zip(spec.constraints, violations, strict=True) if v is not None and v > 0]
    if broken and task.kind == "trial":
        message = f"not evaluated: {' and '.join(broken)} not met"
        return {"state": "SKIPPED", "message": message, "feasible": False, **_indexed("constraints", violations)}
    outcome = evaluate(spec, task.overrides, task.replicates, parameters=parameters, named=task.kind == "design")
    numbers = {
        metric_column(name, label): value
        for label, metrics in outcome.scenarios.items()
        for name, value in metrics.items()
    }
    replicated = {
        f"replicated.{metric_column(name, label)}": values
        for label, metrics in outcome.replicated.items()
        for name, values in metrics.items()
    }
    adjusted = {
        f"adjusted.{what}{at(label)}": getattr(operator, what)
        for label, operator in outcome.operators.items()
        for what in adjustable(spec)
    }
    return {
        "state": "COMPLETE",
        "feasible": outcome.feasible,
        **numbers,
        **adjusted,
        **_indexed("objectives", outcome.objectives),
        **_indexed("constraints", outcome.violations),
        **_indexed("replicated.objectives", outcome.replicated_objectives),
        **replicated,
    }


def _indexed(kind: str, values: Sequence[Any]) -> Row:
    return {f"{kind}.{i}": value for i, value in enumerate(values)}


def provenance(spec: StudySpec) -> Row:
    """How a row was made."""
    return {**_lasting(spec), "threads": thread_count(), "pid": os.getpid()}


@lru_cache(maxsize=8)
def _lasting(spec: StudySpec) -> Row:
    """What is the same for every row of a process; reading versions takes milliseconds."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "numba", "optuna")}
    versions = {"eiwa": __version__, **libraries, **spec.registry.versions()}
    return {
        "spec_hash": spec.hash,
        "seed": spec.study.seed,
        "versions": json.dumps(versions, sort_keys=True),
        "host": platform.node(),
        "cpu": cpu()[0],
        "cpu_features": digest(cpu()[1]),
    }


def _message(error: BaseException) -> str:
    """What an exception says, as text that a file can hold: a name of a file may stand in it that is not Unicode."""
    try:
        text = str(error)
    except Exception as second:
        text = f"its text cannot be had ({type(second).__name__})"
    said = text if isinstance(error, EiwaError) else f"{type(error).__name__}: {text}"
    return said.encode(errors="backslashreplace").decode()


def _type(value: Any) -> pa.DataType:
    if isinstance(value, str):
        return pa.string()
    return pa.list_(pa.float64()) if isinstance(value, list) else pa.float64()
