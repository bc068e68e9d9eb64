"""Where the time of one trial of the paper's study goes.

The study is run with a clock at the doors of its stages, whose time is exclusive: what a stage asks of another one is
the other's. What a compiled flow does inside is found by leaving parts out: the same fill without the index, without
the kinematics, and without all joints but one; the differences are the parts' shares.
"""

from __future__ import annotations

import statistics
import tempfile
import threading
import time
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from optuna.storages.journal import JournalFileBackend

from eiwa.bench.cases import shipped
from eiwa.bench.measure import Contender, Record, Tell, cores, interleaved, keys, others, visit
from eiwa.core import evaluation, outcome
from eiwa.core.dexterity import Dexterity, Family
from eiwa.core.evaluation import Measurement, field_stream
from eiwa.core.filling import fill
from eiwa.core.interfaces import NOTHING, ArmColumns, TracedArm, TracedIndex
from eiwa.core.outcome import measurements
from eiwa.core.sampling import Stream
from eiwa.core.spec import StudySpec, check
from eiwa.core.symbols import Column, absolute, floor
from eiwa.core.transforms import inverse
from eiwa.core.workspace import Target
from eiwa.study.rows import Row
from eiwa.study.run import Run, Silent
from eiwa.study.search import Search
from eiwa.study.store import Store

FILL = "fill"
STAGES: dict[str, list[tuple[Any, str]]] = {
    "design": [(StudySpec, "design")],
    "prepare": [(evaluation, "prepare")],
    FILL: [(evaluation, "fill")],
    "elites": [(evaluation, "refine")],
    "E": [(outcome, "ergonomic_field")],
    "metrics": [(outcome, "metrics")],
    "Optuna": [(Search, "batch"), (Search, "tell")],
    "storage": [(Store, "write"), (JournalFileBackend, "append_logs")],
}
"""Doors of the stages: where a function is looked up when it is called."""
PARTS = ("sampling", "kinematics", "index", "voxels")
FEWEST, MOST = 4, 40
"""Trials of a search; in between, as many as the time allows."""


class SearchOver(Exception):
    """The leaders' turn has come: the rest of the run is of no interest."""


@dataclass
class Clock(Silent):
    """Exclusive seconds of stages, while a study searches; everything else is ``rest``."""

    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    _running: bool = False
    _stack: list[str] = field(default_factory=lambda: ["rest"])
    _since: float = 0.0

    def say(self, line: str) -> None:
        """Nothing."""

    def begin(self, stage: str, total: int, done: int, known: Iterable[Row] = ()) -> None:
        """The search starts, or it is over.

        Raises
        ------
        SearchOver
            The leaders are next.
        """
        self._lap()
        self._running = stage == "search"
        if stage == "leaders":
            raise SearchOver

    def __call__(self, stage: str, row: Row) -> None:
        """An evaluation is done."""

    def at(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function with the clock at its door."""

        @wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            if threading.current_thread() is not threading.main_thread():
                return function(*arguments, **named)
            self._lap()
            self._stack.append(stage)
            try:
                return function(*arguments, **named)
            finally:
                self._lap()
                self._stack.pop()

        return timed

    def _lap(self) -> None:
        now = time.perf_counter()
        if self._running:
            self.seconds[self._stack[-1]] += now - self._since
        self._since = now


class Scattered(TracedArm):
    """Tips spread evenly over a box by u_1 alone, and a Jacobian that costs nothing."""

    def __init__(self, joints: int, low: NDArray[Any], size: NDArray[Any]) -> None:
        self.dof = joints
        self.limited = (True,) * joints
        self.constants = np.concatenate([low, size])
        self.structure = ("benchmark: scattered", joints)

    def columns(self, u: Sequence[Column], p: Sequence[Column]) -> ArmColumns:
        """Three fractions of multiples of u_1."""
        multiples = [u[0] * factor for factor in (1.0, 97.0, 9409.0)]
        tip = [p[k] + p[3 + k] * (m - floor(m)) for k, m in enumerate(multiples)]
        rotation = [[float(i == j) for j in range(3)] for i in range(3)]
        return ArmColumns(u, u, tip, rotation, [[1.0] * self.dof] * 6, self.limited)


class Sum(TracedIndex):
    """The sum of the Jacobian's entries: nothing of the kinematics can be left out, next to no index."""

    structure = "benchmark: sum"

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """One addition per entry."""
        total: Column = 0.0
        for row in arm.jacobian:
            for entry in row:
                total = total + entry
        return absolute(total)


def records(threads: Sequence[int], seconds: float, tell: Tell, quick: bool = False) -> list[Record]:
    """Seconds and share of every stage of a trial, on each number of threads."""
    tree = tomllib.loads(shipped("paper.toml").read_text())
    kept = {k: v for k, v in tree.items() if k not in ("designs", "assumptions")}
    spec = check(kept, Path("paper.toml"))
    tell("preparing the paper's study")
    measured = [m for _, m in measurements(spec, {}, spec.scenarios)]
    setup, grid = measured[0].setup, measured[0].first.V.grid
    start = time.perf_counter()
    setup.human.field(grid, setup.operator, field_stream(setup.seed, 0))
    E = (time.perf_counter() - start) / spec.study.trials
    found: list[Record] = []
    for t in threads:
        load: list[float] = []
        tell(f"running the paper's study on {t} threads")
        with others(load), cores(t):
            runs = _searches(spec, seconds / len(threads) / 2, quick)
        record = Record("share", "eiwa", "", "trial", setup.arm.dof, "f64", t, setup.sampling.samples, setup.r)
        record = replace(record, others=None if load[0] < 0 else load[0])
        times = {stage: [run.get(stage, 0.0) for run in runs] for stage in ("rest", *STAGES)}
        times["E"] = [E] * len(runs)
        parts = _parts(measured, t, seconds / len(threads) / 2, tell)
        whole = times.pop(FILL)
        times |= {part: [share * value for value in whole] for part, share in parts.items()}
        total = [sum(values) for values in zip(*times.values(), strict=True)]
        order = (*PARTS, *(s for s in STAGES if s != FILL), "rest")
        found += [_record(record, stage, times[stage], total) for stage in order]
        found.append(_record(record, "trial", total, total))
    return found


def _record(record: Record, stage: str, times: Sequence[float], total: Sequence[float]) -> Record:
    lower, middle, upper = (float(q) for q in np.quantile(times, (0.25, 0.5, 0.75)))
    ratio = statistics.median(a / b for a, b in zip(times, total, strict=True))
    found = {"visits": len(times), "seconds": middle, "least": min(times), "lower": lower, "upper": upper}
    return replace(record, part=stage, ratio=ratio, **found)  # type: ignore[arg-type]


def _searches(spec: StudySpec, seconds: float, quick: bool) -> list[dict[str, float]]:
    """Seconds per trial of every stage, of searches until the time has passed; at least one."""
    start = time.perf_counter()
    outcome.evaluate(spec, {"layout.spacing": 0.21})
    trials = FEWEST if quick else int(np.clip(seconds / (time.perf_counter() - start), FEWEST, MOST))
    spec = check({**spec.tree, "study": {**spec.tree["study"], "trials": trials}}, spec.path)
    found: list[dict[str, float]] = []
    end = time.perf_counter() + seconds
    while not found or time.perf_counter() < end:
        clock = Clock()
        with tempfile.TemporaryDirectory() as folder, ExitStack() as patches:
            for stage, doors in STAGES.items():
                for owner, name in doors:
                    patches.enter_context(patch.object(owner, name, clock.at(stage, getattr(owner, name))))
            with suppress(SearchOver):
                Run(spec, Store(Path(folder) / "paper"), clock).execute()
        found.append({stage: value / trials for stage, value in clock.seconds.items()})
    return found


def _parts(measured: Sequence[Measurement], threads: int, seconds: float, tell: Tell) -> dict[str, float]:
    """Shares of the parts of one fill of E's grid."""
    setup, grid = measured[0].setup, measured[0].first.V.grid
    family = measured[0].volumes.family
    targets = [Target(grid, setup.layout.T_world_base(side)) for side in (+1, -1)]
    hits = measured[0].first.V.right.hits
    assert hits is not None
    inside = float(hits.sum()) / setup.sampling.samples
    dof = setup.arm.dof
    families = {
        "all": family,
        "without index": _family(setup.arm, len(measured)),
        "without kinematics": _family(_scattered(dof, targets, inside), len(measured)),
        "one joint": _family(_scattered(1, targets, inside), len(measured)),
    }
    contenders = [Contender(_named(measured[0], who, threads), _visit(f, targets, measured[0]))
                  for who, f in families.items()]  # fmt: skip
    full, no_index, no_kinematics, one = (r.least or 0.0 for r in interleaved(contenders, seconds, tell))
    sampling = (no_kinematics - one) * dof / (dof - 1)
    spent = (sampling, no_index - no_kinematics, full - no_index, no_kinematics - sampling)
    return {part: max(0.0, value) / full for part, value in zip(PARTS, spent, strict=True)}


def _named(measured: Measurement, who: str, threads: int) -> Record:
    setup = measured.setup
    return Record("share", who, "fill", "sample", setup.arm.dof, "f64", threads, setup.sampling.samples, setup.r)


def _visit(family: Family, targets: Sequence[Target], measured: Measurement) -> Callable[[], float]:
    setup = measured.setup

    def call(samples: int) -> None:
        fill(family, targets, setup.backend, Stream("plain", next(keys)), replace(setup.sampling, samples=samples))

    call(1)
    return visit(call, setup.sampling.samples)


def _family(arm: Any, members: int) -> Family:
    return Family(tuple(Dexterity(arm, Sum(), NOTHING, 1.0, 0.3) for _ in range(members)))


def _scattered(joints: int, targets: Sequence[Target], inside: float) -> Scattered:
    """Tips in a box around the grid, as seen from the middle of the bases; about ``inside`` of them in the grid."""
    grid = targets[0].grid
    T_world_base = np.mean([t.T_grid_base for t in targets], axis=0)
    low = np.array(grid.origin) * grid.r
    size = np.array(grid.shape) * grid.r
    corners = np.array([[*(low + size * [i, j, k]), 1.0] for i, j, k in np.ndindex(2, 2, 2)]) @ inverse(T_world_base).T
    least, most = corners[:, :3].min(axis=0), corners[:, :3].max(axis=0)
    centre, wide = (least + most) / 2, (most - least) * inside ** (-1 / 3)
    return Scattered(joints, centre - wide / 2, wide)
