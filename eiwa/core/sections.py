"""The tables of a study file that belong to eiwa itself, as pydantic models (plugins bring their own)."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from eiwa.core.hookspecs import Parameters, quantity

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class StudySection(Parameters):
    """Name, seed and search budget."""

    name: str = quantity(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", description="Names the folder of results.")
    seed: int = quantity(0, ge=0, lt=2**32, description="The one source of randomness.")
    trials: int = quantity(
        0,
        ge=0,
        description="Search trials in total; raised by whole batches, a study goes on as if it had never stopped.",
    )
    batch: int = quantity(8, ge=1, le=1024, description="Trials asked together and told in order.")
    sampler: Literal["tpe", "random", "qmc", "grid"] = quantity("tpe", description="How the search proposes designs.")


class LayoutSection(Parameters):
    """Where the two bases stand in the operator frame W."""

    spacing: float = quantity(ge=0, unit="m", description="D: distance of the bases along x.")
    offset: Vector = quantity(unit="m", description="R: operator origin to the midpoint of the bases.")
    orientation: Vector = quantity([0.0, 0.0, 0.0], unit="deg", description="Roll, pitch, yaw of T_world_base.")
    second: Literal["translated", "mirrored"] = quantity("translated", description="Left arm: Eq. (3) or mirror image.")
    alpha: float = quantity(0.5, gt=0, le=0.5, description="Factor of Eq. (3); at most 1/2, so that V_dual <= 1.")


class OperatorSection(Parameters):
    """How the operator sits."""

    armrest: float = quantity(0.0, unit="m", description="Armrest above the reference plane: moves E in z.")
    seat: float = quantity(0.0, unit="m", description="Seat behind the origin.")


class DexteritySection(Parameters):
    """What every dexterity index shares."""

    normaliser: Literal["max"] | Annotated[float, Field(gt=0)] = quantity(
        "max", description="Dex is divided by the design's own maximum, or by this fixed number."
    )
    threshold: float = quantity(0.0, ge=0, le=1, description="Samples with a smaller normalised Dex are dropped.")


class VoxelsSection(Parameters):
    """What every voxel backend shares."""

    size: float = quantity(ge=1e-4, le=1, unit="m", description="r: edge of a voxel.")


class SamplingSection(Parameters):
    """How joint space is sampled."""

    estimator: Literal["plain", "sobol", "elites"] = quantity(
        "plain", description="Pseudo-random points, Sobol points, or elite refinement (for aggregate = 'max')."
    )
    samples: int = quantity(1 << 20, ge=2, le=1 << 31, description="N per replicate; for elites the most.")
    replicates: int = quantity(4, ge=1, le=64, description="Independent streams for the error bar.")
    tolerance: float = quantity(
        0.01, gt=0, lt=1, description="Elites stop when what remains is under this share of max(F, 1e-3)."
    )
    precision: Literal["f64", "f32"] = quantity("f64", description="Floating-point precision of the kernel.")


class RangeSection(Parameters):
    """A number that the search chooses."""

    low: float
    high: float
    step: float | None = quantity(None, gt=0, description="Distance of neighbouring values; required by 'grid'.")
    log: bool = quantity(False, description="Search on a logarithmic scale.")

    @model_validator(mode="after")
    def _low_below_high(self) -> Self:
        if not self.low < self.high:
            raise ValueError(f"low must be below high, not {self.low} and {self.high}")
        if self.log and (self.low <= 0 or self.step is not None):
            raise ValueError("log needs low > 0 and no step")
        return self


class ObjectiveSection(Parameters):
    """What the search optimises."""

    metric: str | None = quantity(None, description="The number to optimise; none for aggregate = 'misfit'.")
    direction: Literal["maximize", "minimize"]
    over: Literal["reference", "scenarios", "designs"] = quantity("reference", description="Where it is evaluated.")
    aggregate: Literal["mean", "min", "max", "misfit"] = quantity("mean", description="How several values become one.")

    @model_validator(mode="after")
    def _misfit_over_designs(self) -> Self:
        if (self.over == "designs") != (self.aggregate == "misfit"):
            raise ValueError("over = 'designs' and aggregate = 'misfit' go together")
        if (self.metric is None) != (self.aggregate == "misfit"):
            raise ValueError("give the metric to optimise (misfit compares the published values and takes none)")
        return self

    @property
    def label(self) -> str:
        """Short name for tables."""
        if self.metric is None:
            return "misfit"
        return self.metric if self.over == "reference" else f"{self.aggregate} {self.metric}"


class ConstraintSection(Parameters):
    """Bounds on a metric, at the reference scenario."""

    metric: str
    min: float | None = None
    max: float | None = None

    @model_validator(mode="after")
    def _some_bound(self) -> Self:
        if self.min is None and self.max is None:
            raise ValueError("give min, max or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"nothing can meet min = {self.min} above max = {self.max}")
        return self

    @property
    def label(self) -> str:
        """Short name for tables."""
        parts = [f"{self.min:g} <= " if self.min is not None else "", self.metric]
        return "".join(parts) + (f" <= {self.max:g}" if self.max is not None else "")

    def violation(self, value: float) -> float:
        """How far outside the bounds a value lies, <= 0 inside; rounding of 1e-9 is forgiven."""
        over = value - self.max if self.max is not None else float("-inf")
        under = self.min - value if self.min is not None else float("-inf")
        return max(over, under) - 1e-9


class DesignSection(Parameters):
    """A named design: paths with values, sections with whole tables, and what was published about it."""

    overrides: dict[str, float | int | str | list[float] | dict[str, Any]]
    published: dict[str, float] = quantity({}, description="Metric -> published value.")
