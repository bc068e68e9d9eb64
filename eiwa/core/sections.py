"""The tables of a study file that belong to eiwa itself, as pydantic models (plugins bring their own)."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from eiwa.core.hookspecs import Parameters, quantity
from eiwa.core.samplers import SamplerParameter, Tpe

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
    sampler: SamplerParameter = quantity(
        Tpe(), description="How the search proposes designs: a kind, or a table with a kind and its options."
    )


class ExecutionSection(Parameters):
    """Where evaluations run and what Optuna stores; it changes no number."""

    workers: int = quantity(0, ge=0, le=1024, description="Worker processes on this machine; 0 and 1: this one alone.")
    executor: Literal["local", "dask"] = quantity("local", description="This machine, or a Dask cluster.")
    threads: int | None = quantity(
        None, ge=1, le=1024, description="Threads of one worker; without it the processors are shared evenly."
    )
    scheduler: str | None = quantity(
        None, pattern=r"^[a-z]+://", description="Address of the Dask scheduler, as tcp://HOST:8786."
    )
    retries: int = quantity(2, ge=0, le=100, description="Times that a design whose worker died is tried again.")
    storage: str | None = quantity(
        None,
        pattern=r"^(sqlite:///.|postgresql)",
        description="URL of Optuna's storage, as postgresql://HOST/DATABASE or sqlite:///FILE; without it a journal file.",
    )

    @model_validator(mode="after")
    def _dask_has_a_scheduler(self) -> Self:
        if self.executor == "dask" and self.scheduler is None:
            raise ValueError("executor = 'dask' needs scheduler")
        if self.executor != "dask" and self.scheduler is not None:
            raise ValueError("scheduler needs executor = 'dask'")
        if self.executor == "dask" and self.workers:
            raise ValueError("a Dask cluster has its own number of workers: leave workers out")
        return self


FAR = 20.0
"""No part of a master console is so far away [m]: such a length is in mm."""
Place = Annotated[list[Annotated[float, Field(ge=-FAR, le=FAR)]], Field(min_length=3, max_length=3)]


class LayoutSection(Parameters):
    """Where the two bases stand in the operator frame W."""

    spacing: float = quantity(ge=0, le=FAR, unit="m", description="D: distance of the bases along x.")
    offset: Place = quantity(unit="m", description="R: operator origin to the midpoint of the bases.")
    orientation: Vector = quantity([0.0, 0.0, 0.0], unit="deg", description="Roll, pitch, yaw of T_world_base.")
    second: Literal["translated", "mirrored"] = quantity("translated", description="Left arm: Eq. (3) or mirror image.")
    alpha: float = quantity(0.5, gt=0, le=0.5, description="Factor of Eq. (3); at most 1/2, so that V_dual <= 1.")


MOST_STEPS = 101


class GridSection(Parameters):
    """Evenly spaced values: low, low + step, ... up to high."""

    low: float
    high: float
    step: float = quantity(gt=0, description="Distance of neighbouring values.")

    @model_validator(mode="after")
    def _some_values(self) -> Self:
        if not self.low <= self.high:
            raise ValueError(f"low must not be above high, as {self.low} is above {self.high}")
        if (self.high - self.low) / self.step > MOST_STEPS:
            raise ValueError(f"at most {MOST_STEPS} values: take a larger step than {self.step}")
        return self

    @property
    def values(self) -> list[float]:
        """The values, without the rounding of repeated addition."""
        count = int((self.high - self.low) / self.step + 1e-9) + 1
        return [round(self.low + k * self.step, 12) for k in range(count)]


class AdjustSection(Parameters):
    """What an operator sets to their own liking: every design is seen at the values that give the largest F."""

    armrest: GridSection | None = quantity(None, description="Values to try for the armrest [m].")
    seat: GridSection | None = quantity(None, description="Values to try for the seat [m].")


class OperatorSection(Parameters):
    """How the operator sits."""

    armrest: float = quantity(
        0.0, ge=-FAR, le=FAR, unit="m", description="Armrest above the reference plane: moves E in z."
    )
    seat: float = quantity(0.0, ge=-FAR, le=FAR, unit="m", description="Seat behind the origin.")
    adjust: AdjustSection = quantity(AdjustSection(), description="What the operator adjusts to their own liking.")


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
        if self.step is not None and self.step > self.high - self.low:
            raise ValueError(
                f"a step of {self.step:g} leads from {self.low:g} beyond {self.high:g}: take a smaller one"
            )
        return self


class DesignSection(Parameters):
    """A named design: paths with values, sections with whole tables, and what was published about it."""

    overrides: dict[str, float | int | str | list[float] | dict[str, Any]]
    published: dict[str, float] = quantity({}, description="Metric -> published value.")
