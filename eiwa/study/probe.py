"""A study looked at around one of its designs: which design, and how to evaluate its objectives and nothing more."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from eiwa.core.design import ALWAYS
from eiwa.core.errors import SpecError
from eiwa.core.interval import Difference, paired
from eiwa.core.outcome import Outcome
from eiwa.core.spec import StudySpec, check
from eiwa.core.tree import lookup
from eiwa.study.compare import overrides_of
from eiwa.study.estimate import estimate
from eiwa.study.leaders import leaders, parameters
from eiwa.study.rows import Row

Told = Callable[[], None]
"""Called after every evaluation."""
AS_WRITTEN = "the design as written"


@dataclass(frozen=True)
class Centre:
    """A design to look around: its name, its values at paths, and of a trial what the sampler chose."""

    name: str
    overrides: Mapping[str, Any]
    chosen: Mapping[str, float] | None = None


def centre(spec: StudySpec, rows: Sequence[Row], name: str | None = None) -> Centre:
    """The design of a name (``NAME``, ``trial N``); without one the best trial, or the study file's own values.

    Raises
    ------
    SpecError
        No such design or trial.
    """
    if name is None:
        best = leaders(spec, rows)
        if not best:
            return Centre(AS_WRITTEN, {})
        name = f"trial {best[0]['number']}"
    if name in spec.designs:
        return Centre(name, spec.designs[name].overrides)
    overrides = overrides_of(spec, name, rows)
    number = int(name.removeprefix("trial"))
    (row,) = (r for r in rows if r["kind"] == "trial" and r["number"] == number)
    return Centre(f"trial {number}", overrides, parameters(row))


def variables_at(spec: StudySpec, at: Centre) -> dict[str, float]:
    """The variables that give a design: a trial's own, or those whose expressions come to the design's values.

    Raises
    ------
    SpecError
        The search does not contain the design.
    """
    if at.chosen is not None:
        return dict(at.chosen)
    resolved = spec.design(at.overrides).resolved()
    wanted = np.array([lookup(resolved, path) for path in spec.searched], float)
    low, high = (np.array([getattr(r, end) for r in spec.ranges.values()]) for end in ("low", "high"))
    scale = np.maximum(np.abs(wanted), 1e-9)

    def misses(u: Any) -> Any:
        found = spec.overrides(dict(zip(spec.ranges, low + u * (high - low), strict=True)))
        return (np.array([found[path] for path in spec.searched]) - wanted) / scale

    fit = least_squares(misses, np.full(len(low), 0.5), bounds=(-1e-9, 1 + 1e-9), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    if np.abs(fit.fun).max() > 1e-6:
        k = int(np.argmax(np.abs(fit.fun)))
        path = list(spec.searched)[k]
        raise SpecError(
            f"{at.name}: lies outside the search, which does not reach {path} = {wanted[k]:g} together with its other "
            "values. Give a trial, or widen [variables] and [search]."
        )
    return {n: float(v) for n, v in zip(spec.ranges, np.clip(low + fit.x * (high - low), low, high), strict=True)}


def lean(spec: StudySpec) -> StudySpec:
    """The study with nothing to compute but its objectives, F among them, and its constraints."""
    tree = {k: v for k, v in spec.tree.items() if k not in ("assumptions", "tolerance", "catalogue")}
    tree["study"] = {**tree["study"], "trials": 0}
    if not any(o.metric == "F" and o.over == "reference" for o in spec.objectives):
        tree["objectives"] = [*tree.get("objectives", []), {"metric": "F", "direction": "maximize"}]
    numbers = spec.registry.numbers()
    kept = {*ALWAYS, *(numbers[name][0] for name in spec.needed)}
    tree["metrics"] = {name: table for name, table in tree.get("metrics", {}).items() if name in kept}
    looks = {o.over for o in spec.objectives} | {c.over for c in spec.constraints}
    dropped = [table for table, over in (("scenarios", "scenarios"), ("designs", "designs")) if over not in looks]
    return check({k: v for k, v in tree.items() if k not in dropped}, spec.path)


def difference(spec: StudySpec, k: int, a: Outcome, b: Outcome, scale: float = 1.0) -> Difference:
    """Objective k of a less that of b, times a factor; without replicates its error is not a number."""
    lists = [o.replicated_objectives[k] if o.replicated_objectives else None for o in (a, b)]
    if lists[0] and lists[1]:
        reads_F = "F" in spec.objectives[k].numbers
        rest = max(o.scenarios[""].get("F_remaining") or 0.0 for o in (a, b)) if reads_F else 0.0
        found = paired(lists[0], lists[1], rest)
        return Difference(scale * found.mean, abs(scale) * found.half_width)
    value_a, value_b = a.objectives[k], b.objectives[k]
    assert value_a is not None and value_b is not None
    return Difference(scale * (value_a - value_b), float("nan"))


def seconds_per_design(spec: StudySpec, rows: Sequence[Row]) -> float:
    """What one evaluation with one replicate takes: as the study's trials took, or measured."""
    took = [r["seconds"] for r in rows if r["kind"] == "trial" and r["state"] == "COMPLETE"]
    return float(median(took)) if took else estimate(lean(spec)).seconds_per_trial
