"""How the search proposes designs: what a study may ask for, and what ``auto`` becomes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from eiwa.core.errors import SpecError
from eiwa.core.findings import validated
from eiwa.core.hookspecs import Parameters, quantity
from eiwa.core.parts import WITHIN

if TYPE_CHECKING:
    from collections.abc import Mapping

    from eiwa.core.sections import RangeSection
    from eiwa.core.spec import StudySpec


class Auto(Parameters):
    """Chosen from the study file alone: by the rule above."""

    kind: Literal["auto"] = "auto"


class Tpe(Parameters):
    """Tree-structured Parzen estimator: densities of good and of other designs. Any objectives and constraints."""

    kind: Literal["tpe"] = "tpe"
    startup_trials: int = quantity(10, ge=1, description="Random trials before the densities are used.")
    candidates: int = quantity(24, ge=1, description="Candidates of which the most promising one is proposed.")
    multivariate: bool = quantity(True, description="One density over all variables together, not one for each.")


class Random(Parameters):
    """Uniform draws."""

    kind: Literal["random"] = "random"


class Qmc(Parameters):
    """Scrambled Sobol points: an even sweep."""

    kind: Literal["qmc"] = "qmc"


class Grid(Parameters):
    """Every combination of the stepped values; ends when there are no more."""

    kind: Literal["grid"] = "grid"


class Nsga2(Parameters):
    """NSGA-II: generations of crossover and mutation, kept by dominance and crowding. Any objectives and constraints."""

    kind: Literal["nsga2"] = "nsga2"
    population_size: int = quantity(50, ge=2, description="Parents of a generation; a generation has at least as many.")
    crossover_probability: float = quantity(0.9, ge=0, le=1, description="Share of children that have two parents.")
    mutation_probability: float | None = quantity(
        None, ge=0, le=1, description="Share of values that mutate; left out: one over the number of variables."
    )


class Nsga3(Nsga2):
    """NSGA-III: as NSGA-II, but kept by reference directions; for more than three objectives."""

    kind: Literal["nsga3"] = "nsga3"  # type: ignore[assignment]
    divisions: int = quantity(3, ge=1, le=20, description="Divisions of each axis between reference directions.")


class Cmaes(Parameters):
    """CMA-ES: a normal distribution that adapts itself. One objective; feasible designs rank before others."""

    kind: Literal["cmaes"] = "cmaes"
    population_size: int | None = quantity(
        None, ge=4, description="Designs of a generation; left out: 4 + 3 ln(variables), up to a whole batch."
    )
    sigma: float = quantity(1 / 6, gt=0, le=1, description="First standard deviation, as a share of each range.")


class Gp(Parameters):
    """A Gaussian process and expected improvement: for few, expensive trials. Any objectives and constraints."""

    kind: Literal["gp"] = "gp"
    startup_trials: int = quantity(10, ge=1, description="Random trials before the process is fitted.")
    deterministic: bool = quantity(False, description="Take the objectives as free of noise, rather than estimate it.")


SAMPLERS: Mapping[str, type[Parameters]] = {
    "auto": Auto, "tpe": Tpe, "random": Random, "qmc": Qmc, "grid": Grid,
    "nsga2": Nsga2, "nsga3": Nsga3, "cmaes": Cmaes, "gp": Gp,
}  # fmt: skip


def _sampler(value: Any) -> Any:
    """A kind, or a table with a kind and its options."""
    table = {"kind": value} if isinstance(value, str) else value
    if isinstance(value, Parameters):
        return value
    model = SAMPLERS.get(str(table.get("kind"))) if isinstance(table, dict) else None
    if model is None:
        *first, last = (repr(kind) for kind in SAMPLERS)
        raise ValueError(f"must be {', '.join(first)} or {last}, or a table with such a kind and its options")
    try:
        return validated(model, table, "")
    except SpecError as error:
        raise PydanticCustomError(WITHIN, "nested", {"findings": error.findings}) from None


Chosen = Tpe | Random | Qmc | Grid | Nsga2 | Nsga3 | Cmaes | Gp
Kind = Literal["auto", "tpe", "random", "qmc", "grid", "nsga2", "nsga3", "cmaes", "gp"]
SamplerParameter = Annotated[
    Auto | Tpe | Random | Qmc | Grid | Nsga2 | Nsga3 | Cmaes | Gp,
    BeforeValidator(
        _sampler, json_schema_input_type=Kind | Auto | Tpe | Random | Qmc | Grid | Nsga2 | Nsga3 | Cmaes | Gp
    ),
]
"""Type of ``study.sampler``: a kind, or a table with a kind and its options."""

MANY = 1000
"""Trials from which a genetic algorithm finds as good designs as TPE."""
PROPOSING = (0.007, 0.0145, 0.087)
"""Milliseconds of a TPE proposal per trial of the search, on the mean, with one, two, and more objectives."""
EVALUATING = 2e-5
"""Milliseconds per sample and scenario."""


def automatic(spec: StudySpec) -> tuple[Chosen, str]:
    """What ``auto`` becomes, and why; from the study file alone, so that it is the same on every machine."""
    trials, objectives = spec.study.trials, len(spec.objectives)
    if spec.ranges and (points := grid_size(spec.ranges)) and points <= trials:
        return Grid(), f"all {points} combinations of the steps fit into {trials} trials"
    proposing = PROPOSING[min(objectives, 3) - 1] * trials if objectives else 0.0
    evaluating = EVALUATING * spec.defaults["sampling"]["samples"] * len(spec.scenarios)
    if trials < MANY:
        return Tpe(), f"{trials} trials are fewer than {MANY}"
    if proposing <= evaluating:
        return Tpe(), f"evaluating a design (about {evaluating:.0f} ms) takes longer than proposing one"
    many = f"{trials} trials of about {evaluating:.0f} ms are many and cheap"
    if objectives > 3:
        return Nsga3(), f"{many}, with {objectives} objectives"
    return Nsga2(), many


def grid_size(ranges: Mapping[str, RangeSection]) -> int:
    """Number of combinations of the stepped values; 0 where a variable has no step."""
    return math.prod(steps(r) + 1 if r.step is not None else 0 for r in ranges.values())


def steps(r: RangeSection) -> int:
    """How many steps fit into a range."""
    assert r.step is not None
    return math.floor((r.high - r.low) / r.step + 1e-9)
