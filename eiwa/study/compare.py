"""Whether two designs differ by more than the error of their difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from eiwa.core.errors import SpecError
from eiwa.core.interval import Difference, paired
from eiwa.core.outcome import Outcome, evaluate
from eiwa.core.spec import StudySpec
from eiwa.core.tree import did_you_mean
from eiwa.study.rows import Row
from eiwa.study.run import parameters


def overrides_of(spec: StudySpec, name: str, rows: Sequence[Row]) -> Mapping[str, Any]:
    """The design behind a name: a named design, or ``trial N`` / ``N`` of the study's results.

    Raises
    ------
    SpecError
        Neither.
    """
    if name in spec.designs:
        return spec.designs[name].overrides
    number = name.removeprefix("trial").strip()
    trials = {str(r["number"]): r for r in rows if r["kind"] == "trial"}
    if number in trials:
        return spec.overrides(parameters(trials[number]))
    known = [*spec.designs, *(f"trial {n}" for n in list(trials)[:3])]
    raise SpecError(f"{name}: neither a named design nor a trial of this study{did_you_mean(name, known)}")


def compare(
    spec: StudySpec, a: Mapping[str, Any], b: Mapping[str, Any], replicates: int
) -> tuple[list[Outcome], Difference]:
    """Both designs evaluated on the same random streams, and F(a) - F(b) with its error."""
    outcomes = [evaluate(spec, overrides, replicates, named=True) for overrides in (a, b)]
    rest = max(o.scenarios[""].get("F_remaining") or 0.0 for o in outcomes)
    first, second = (o.replicated[""]["F"] for o in outcomes)
    return outcomes, paired(first, second, rest)


def tied(best: Row, other: Row, objective: int = 0) -> bool | None:
    """Whether two stored rows' objectives (F where there is none) cannot be told apart; None where not replicated alike."""
    column = (
        f"replicated.objectives.{objective}"
        if best.get(f"replicated.objectives.{objective}")
        else "replicated.metrics.F"
    )
    a, b = best.get(column), other.get(column)
    if not a or not b or len(a) != len(b) or len(a) < 2:
        return None
    rest = max(best.get("metrics.F_remaining") or 0.0, other.get("metrics.F_remaining") or 0.0)
    return not paired(a, b, rest).real
