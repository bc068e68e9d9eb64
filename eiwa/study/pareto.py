"""The Pareto set of a study's trials, from its stored rows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eiwa.core.errors import EiwaError, SpecError, StoreError
from eiwa.core.interfaces import Array
from eiwa.core.interval import paired
from eiwa.core.spec import StudySpec
from eiwa.core.tree import did_you_mean
from eiwa.study import front
from eiwa.study.rows import Row
from eiwa.study.store import Store

EXAMPLE = "as in --objectives F,-total_link_length"


@dataclass(frozen=True)
class Goal:
    """One axis of a front: a column of the rows, and which way is better."""

    name: str
    column: str
    maximised: bool
    unit: str
    metric: str | None

    @property
    def sign(self) -> float:
        """Turns values into ones that are the better the smaller they are."""
        return -1.0 if self.maximised else 1.0


@dataclass(frozen=True)
class Member:
    """A trial of the front.

    ``errors`` are standard deviations over replicates, None where the trial was not evaluated with all of them.
    ``contribution`` is the share of the hypervolume that only this trial dominates. ``best`` names the goals that none
    reaches better. ``doubtful`` says that within the errors another member is at least as good in every goal; None where
    that cannot be told.
    """

    run: str
    row: Row
    values: tuple[float, ...]
    errors: tuple[float | None, ...]
    contribution: float
    knee: bool
    best: tuple[str, ...]
    doubtful: bool | None


@dataclass(frozen=True)
class Trials:
    """The trials of one run, in the order of their numbers."""

    run: str
    rows: Sequence[Row]
    leaders: Mapping[int, Row]
    points: Sequence[Array | None]
    """The smaller the better; None where a trial is not feasible, failed, or has no value."""


@dataclass(frozen=True)
class Pareto:
    """The front over one or several runs: members by the first goal, the best first."""

    goals: Sequence[Goal]
    runs: Sequence[Trials]
    members: Sequence[Member]
    reference: tuple[float, ...]
    """In the goals' own signs."""
    hypervolume: float
    box: float
    """Volume between the ideal point and the reference point."""

    @cached_property
    def histories(self) -> Mapping[str, Sequence[float]]:
        """Hypervolume of every run against its number of trials, with one reference point for all."""
        signs = np.array([goal.sign for goal in self.goals])
        return {t.run: front.history(t.points, signs * self.reference) for t in self.runs}

    @property
    def last_quarter(self) -> float | None:
        """Share of the first run's hypervolume that its last quarter of trials added; None for fewer than 4 trials."""
        volumes = next(iter(self.histories.values()))
        if len(volumes) < 4 or not volumes[-1]:
            return None
        return 1.0 - volumes[len(volumes) * 3 // 4 - 1] / volumes[-1]


def pareto(spec: StudySpec, stores: Sequence[Store], chosen: str | None = None) -> Pareto:
    """The front of the feasible, complete trials.

    Parameters
    ----------
    spec
        The study; it says what its objectives are.
    stores
        Its results first, then those of other runs with the same objectives.
    chosen
        Goals in the grammar of :func:`goals`; the study's objectives when not given.

    Raises
    ------
    EiwaError
        A goal is not in the rows, a run has other objectives, no trial is feasible, or moocore is missing.
    """
    folders = [store.folder.resolve() for store in stores]
    for number, folder in enumerate(folders):
        if folder in folders[:number]:
            raise StoreError(f"{stores[number].folder}: is part of the front already. Give every run once.")
    tables = [store.table() for store in stores]
    wanted = goals(spec, chosen, tables[0].column_names)
    runs = []
    for store, table in zip(stores, tables, strict=True):
        if store is not stores[0]:
            _same_goals(spec, store, wanted, table.column_names)
        runs.append(_trials(str(store.folder), table.to_pylist(), wanted))
    return _front(wanted, runs)


def goals(spec: StudySpec, chosen: str | None, columns: Sequence[str]) -> list[Goal]:
    """``[+|-]NAME,[+|-]NAME,...``: numbers of metrics by their name or ``NAME@SCENARIO``, objectives by their label.

    ``+`` says that larger is better, ``-`` that smaller is. Without a sign the study's objective of that name or metric
    decides; what no objective names is a cost, so smaller is better.

    Raises
    ------
    SpecError
        A name is not in the rows, or there are fewer than two.
    """
    objectives = [goal_of(spec, i) for i in range(len(spec.objectives))]
    if chosen is None:
        if len(objectives) < 2:
            listed = ", ".join(g.name for g in objectives) or "none"
            raise SpecError(f"objectives: a front needs two or more, the study has {listed}. Name them, {EXAMPLE}.")
        return objectives
    # A scenario's label may hold a list, whose commas separate no names.
    found = [_named(spec, text.strip(), objectives, columns) for text in re.split(r",(?![^\[]*\])", chosen)]
    if len({goal.column for goal in found}) < max(2, len(found)):
        raise SpecError(f"--objectives {chosen}: a front needs two or more different numbers, {EXAMPLE}.")
    return found


def goal_of(spec: StudySpec, i: int) -> Goal:
    """An objective of the study, with its unit where it has one."""
    objective = spec.objectives[i]
    known = spec.registry.numbers()
    unit = known[objective.metric][1].unit if objective.metric in known and objective.level is None else ""
    return Goal(objective.label, f"objectives.{i}", objective.direction == "maximize", unit, objective.metric)


def _named(spec: StudySpec, text: str, objectives: Sequence[Goal], columns: Sequence[str]) -> Goal:
    name = text.lstrip("+-")
    sign = text[: len(text) - len(name)]
    known = {g.name: g for g in reversed(objectives)}
    metrics = [c.removeprefix("metrics.") for c in columns if c.startswith("metrics.")]
    if len(sign) > 1 or not (name in known or name in metrics):
        near = did_you_mean(name, [*known, *(m for m in metrics if "@" not in m)])
        remedy = "A number is in the rows when the study file has a table [metrics.NAME] for it."
        raise SpecError(f"--objectives {text}: no such number in the rows{near} {remedy}")
    metric = name.split("@")[0]
    like = known.get(name) or next((g for g in objectives if g.metric == metric), None)
    maximised = sign == "+" or (not sign and like is not None and like.maximised)
    if name in metrics:
        return Goal(name, f"metrics.{name}", maximised, spec.registry.numbers()[metric][1].unit, metric)
    return replace(known[name], maximised=maximised)


def _same_goals(spec: StudySpec, other: Store, wanted: Sequence[Goal], columns: Sequence[str]) -> None:
    """Refuse a run whose goals are not this study's."""
    if not other.exists():
        raise StoreError(f"{other.folder}: holds no study. Give the folder of a study, such as runs/{spec.study.name}.")
    metrics, named = spec.registry.numbers(), {goal.column for goal in wanted}
    read = [f"metrics.{metrics[goal.metric][0]}." for goal in wanted if goal.metric in metrics]
    read += [f"objectives.{o.name or i}." for i, o in enumerate(spec.objectives) if f"objectives.{i}" in named]
    differing = [change for change in other.changes(spec) if change.startswith(tuple(read))]
    differing += [f"{goal.column}: absent" for goal in wanted if goal.column not in columns]
    if differing:
        shown = "\n".join(f"  {line}" for line in differing)
        remedy = "Only runs with the same objectives have a common front; --objectives names numbers that both have."
        raise StoreError(f"{other.folder}: its objectives are not those of {spec.study.name}:\n{shown}\n{remedy}")


def _trials(run: str, rows: Sequence[Row], goals: Sequence[Goal]) -> Trials:
    trials = sorted((r for r in rows if r["kind"] == "trial"), key=lambda r: r["number"])
    leaders = {r["number"]: r for r in rows if r["kind"] == "leader" and r["state"] == "COMPLETE"}
    return Trials(run, trials, leaders, [_point(r, goals) if r["feasible"] else None for r in trials])


def _point(row: Row, goals: Sequence[Goal]) -> Array | None:
    values = [row.get(goal.column) for goal in goals]
    if row["state"] != "COMPLETE" or any(value is None for value in values):
        return None
    return np.array([goal.sign * value for goal, value in zip(goals, values, strict=True)])  # type: ignore[operator]


def _front(goals: Sequence[Goal], runs: Sequence[Trials]) -> Pareto:
    found = [(t, row, p) for t in runs for row, p in zip(t.rows, t.points, strict=True) if p is not None]
    if not found:
        raise EiwaError("no feasible trial has all of these numbers, so there is no front: see eiwa study show.")
    kept = front.nondominated(np.array([p for *_, p in found]))
    members = sorted((f for f, keep in zip(found, kept, strict=True) if keep), key=lambda f: tuple(f[2]))
    points = np.array([p for *_, p in members])
    reference = front.reference(points)
    volume = front.hypervolume(points, reference)
    shares = front.contributions(points, reference) / volume
    knee, best = front.knee(points), points.min(axis=0)
    signs = np.array([goal.sign for goal in goals])
    return Pareto(
        goals, runs,
        [
            Member(
                t.run, row, tuple(map(float, signs * p)), _errors(t.leaders.get(row["number"]), goals), float(shares[i]),
                i == knee, tuple(g.name for g, value, top in zip(goals, p, best, strict=True) if value == top),
                _doubtful(t, row, [other for of, other, _ in members if of is t], goals),
            )
            for i, (t, row, p) in enumerate(members)
        ],
        tuple(map(float, signs * reference)), volume, float(np.prod(reference - best)),
    )  # fmt: skip


def _errors(leader: Row | None, goals: Sequence[Goal]) -> tuple[float | None, ...]:
    values = [(leader or {}).get(f"replicated.{goal.column}") for goal in goals]
    return tuple(float(np.std(v, ddof=1)) if v and len(v) > 1 else None for v in values)


def _doubtful(trials: Trials, row: Row, members: Sequence[Row], goals: Sequence[Goal]) -> bool | None:
    """Whether another member of the run is nowhere really worse, over the replicates that both share."""
    others = [trials.leaders.get(other["number"]) for other in members if other is not row]
    verdicts = [_nowhere_better(trials.leaders.get(row["number"]), other, goals) for other in others]
    known = [verdict for verdict in verdicts if verdict is not None]
    return any(known) if known else None


def _nowhere_better(a: Row | None, b: Row | None, goals: Sequence[Goal]) -> bool | None:
    """Whether a is better than b in no goal by more than the error of their difference."""
    if a is None or b is None:
        return None
    better = []
    for goal in goals:
        of_a, of_b = (row.get(f"replicated.{goal.column}") for row in (a, b))
        if not of_a or not of_b or len(of_a) != len(of_b) or len(of_a) < 2:
            return None
        rest = max(row.get(f"metrics.{goal.metric}_remaining") or 0.0 for row in (a, b))
        difference = paired(of_a, of_b, rest)
        better.append(difference.real and goal.sign * difference.mean < 0)
    return not any(better)
