"""What a study optimises and what it demands: objectives and constraints, as pydantic models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Self

from pydantic import model_validator
from pydantic_core import PydanticCustomError

from eiwa.core.aggregates import Aggregate, cvar, mean, share_above
from eiwa.core.errors import SpecError, finding
from eiwa.core.expressions import ROUNDING, Expression, Inequality
from eiwa.core.hookspecs import Parameters, quantity
from eiwa.core.parts import WITHIN


class Aggregated(Parameters):
    """A number under one scenario or several."""

    over: Literal["reference", "scenarios", "designs"] = quantity("reference", description="Where it is evaluated.")
    aggregate: Aggregate | Literal["misfit"] = quantity("mean", description="How several values become one.")
    tail: float = quantity(0.25, gt=0, le=1, description="For 'cvar': the share of worst scenarios that is averaged.")
    level: float | None = quantity(None, description="For 'share_above': scenarios count that reach this value.")

    @model_validator(mode="after")
    def _level_for_shares(self) -> Self:
        if (self.level is None) == (self.aggregate == "share_above"):
            raise ValueError("aggregate = 'share_above' and a level go together")
        if self.over == "reference" and {"aggregate", "tail"} & self.model_fields_set and self.aggregate != "misfit":
            raise ValueError("an aggregate needs over = 'scenarios'")
        if "tail" in self.model_fields_set and self.aggregate != "cvar":
            raise ValueError(f"tail belongs to aggregate = 'cvar', not to {self.aggregate!r}")
        return self

    def combined(self, values: Sequence[float], *, low_is_bad: bool) -> float:
        """One number of the values under every scenario."""
        if self.aggregate == "cvar":
            return cvar(values, self.tail, low_is_bad=low_is_bad)
        if self.level is not None:
            return share_above(values, self.level)
        return {"min": min, "max": max}.get(self.aggregate, mean)(values)

    def titled(self, what: str) -> str:
        """Short name for tables."""
        if self.over == "reference":
            return what
        return f"share {what} >= {self.level:g}" if self.level is not None else f"{self.aggregate} {what}"


class ObjectiveSection(Aggregated):
    """What the search optimises: a metric, or an expression of metrics."""

    metric: str | None = quantity(
        None, min_length=1, description="The number to optimise; none for aggregate = 'misfit'."
    )
    expression: str | None = quantity(
        None, description="Instead of a metric: arithmetic of several, 'F - 0.1 * reach'."
    )
    name: str | None = quantity(None, description="What tables call it.")
    direction: Literal["maximize", "minimize"]

    @model_validator(mode="after")
    def _misfit_over_designs(self) -> Self:
        if (self.over == "designs") != (self.aggregate == "misfit"):
            raise ValueError("over = 'designs' and aggregate = 'misfit' go together")
        if (self.metric is not None) + (self.expression is not None) + (self.aggregate == "misfit") != 1:
            raise ValueError("give a metric or an expression (misfit compares the published values and takes neither)")
        if self.expression is not None:
            _readable(Expression("expression", self.expression), "metric")
        return self

    @property
    def formula(self) -> Expression | None:
        """What is evaluated under every scenario; none for a misfit."""
        text = self.expression if self.metric is None else self.metric
        return Expression("objectives", text) if text is not None else None

    @property
    def numbers(self) -> frozenset[str]:
        """Metrics' numbers that it reads."""
        return self.formula.names if self.formula else frozenset()

    @property
    def label(self) -> str:
        """Short name for tables."""
        if self.name or self.formula is None:
            return self.name or "misfit"
        return self.titled(self.metric or self.formula.text)

    def value(self, scenarios: Sequence[Mapping[str, float]]) -> float:
        """From the numbers under the scenarios that it looks at."""
        assert self.formula is not None
        values = [self.formula.evaluate(numbers) for numbers in scenarios]
        return self.combined(values, low_is_bad=self.direction == "maximize")


class ConstraintSection(Aggregated):
    """Bounds on a metric, or an inequality of parameters, which is told before anything is evaluated."""

    metric: str | None = quantity(None, min_length=1, description="The number that must lie within min and max.")
    min: float | None = None
    max: float | None = None
    expression: str | None = quantity(
        None, description="Instead: an inequality of variables and paths, 'arm.joints.upper.a <= 2 * reach'."
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.metric is None) == (self.expression is None):
            raise ValueError("give a metric with bounds, or an expression")
        if (self.expression is None) == (self.min is None and self.max is None):
            raise ValueError("give min, max or both" if self.metric else "an expression has its bounds inside")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"nothing can meet min = {self.min} above max = {self.max}")
        if self.over == "designs" or self.aggregate == "misfit":
            raise ValueError("a constraint looks at the reference or at scenarios")
        if self.expression is not None and self.over != "reference":
            raise ValueError("an expression of parameters is the same under every scenario")
        if self.expression is not None:
            _readable(Inequality("expression", self.expression), "variable or path")
        return self

    @property
    def inequality(self) -> Inequality | None:
        """The inequality of parameters."""
        return Inequality("constraints", self.expression) if self.expression is not None else None

    @property
    def label(self) -> str:
        """Short name for tables."""
        if self.expression is not None:
            return self.expression
        low = f"{self.min:g} <= " if self.min is not None else ""
        high = f" <= {self.max:g}" if self.max is not None else ""
        return low + self.titled(self.metric or "") + high

    def violation(self, values: Sequence[float]) -> float:
        """How far outside the bounds the metric lies, <= 0 inside; rounding of 1e-9 is forgiven."""
        value = self.combined(values, low_is_bad=self.max is None)
        over = value - self.max if self.max is not None else float("-inf")
        under = self.min - value if self.min is not None else float("-inf")
        return max(over, under) - ROUNDING


def _readable(text: Expression | Inequality, reads: str) -> None:
    """Refuse what cannot be read, or reads nothing."""
    try:
        if not text.names:
            raise SpecError(finding("expression", f"reads no {reads}, so it never changes.", value=text.text))
    except SpecError as error:
        raise PydanticCustomError(WITHIN, "expression", {"findings": error.findings}) from None
