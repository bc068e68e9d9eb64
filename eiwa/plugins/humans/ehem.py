"""The paper's Equivalent Human Ergonomic Model (EHEM), of an average operator and of a person by sex and percentile.

The chain stands in :mod:`eiwa.core.forearm`. The paper gives the motions in words only; every number here is an
assumption with a source.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from eiwa.core.anthropometry import lengths
from eiwa.core.chain_parameters import Range
from eiwa.core.forearm import Forearm, slides
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, ErgonomicField, HumanModel, Operator
from eiwa.core.sampling import Stream
from eiwa.core.workspace import Grid

ANSUR = "ANSUR II (2012)"
MEANS = f"{ANSUR}, mean of men's and women's means"
LUBA = "LUBA (Kee and Karwowski 2001)"
ISO = "ISO 11064-4 as quoted in NUREG-0700 r3, 11.1.1-5"


class _Motions(Parameters):
    """What does not depend on the person: the rotations' ranges and E."""

    pitch: Range = quantity(
        [-5.0, 30.0], unit="deg", source="forearm on the surface; RULA lower arm", description="q3: pitch, up positive."
    )
    roll: Range = quantity(
        [-20.0, 20.0], unit="deg", source=f"{ISO}, abduction; assumed", description="q4: roll about the forward axis."
    )
    toe_in: float = quantity(
        15.0, unit="deg", source="JIGSAWS, distance between the hands", description="Constant inward yaw."
    )
    yaw: Range = quantity(
        [0.0, 0.0], unit="deg", source="not in the paper's words: locked", description="q5: yaw about the fulcrum."
    )
    pronation: Range = quantity([-50.0, 50.0], unit="deg", source="Morrey 1981", description="q6: forearm rotation.")
    deviation: Range = quantity(
        [-10.0, 10.0], unit="deg", source=f"{LUBA}, class 1", description="q7: wrist, radial positive."
    )
    flexion: Range = quantity([-30.0, 30.0], unit="deg", source=ISO, description="q8: wrist flexion.")
    comfort: float = quantity(0.5, gt=0, le=1, source="the paper", description="E of each arm.")
    samples: int = quantity(1 << 22, ge=1 << 10, description="Samples of the rotations; the slides are marked exactly.")

    @model_validator(mode="after")
    def _ranges_increase(self) -> Self:
        for name, value in self:
            if isinstance(value, list) and value[0] > value[1]:
                raise ValueError(f"{name} must be [low, high] with low <= high, not [{value[0]}, {value[1]}]")
        return self

    def rotations(self) -> Array:
        """Ranges of q3 ... q8 [rad], shape (6, 2)."""
        return np.radians([self.pitch, self.roll, self.yaw, self.pronation, self.deviation, self.flexion])


class EhemParameters(_Motions):
    """The paper's operator: two forearms on an armrest, E constant where a comfortable grip can be."""

    half_width: float = quantity(
        0.223, ge=0, unit="m", source=MEANS, description="x_e: half the distance between the forearms' fulcra."
    )
    fulcrum_height: float = quantity(
        0.0457, unit="m", source=MEANS, description="z_f: forearm radius, the fulcrum's height above the armrest."
    )
    slide_side: Range = quantity(
        [-0.056, 0.111], unit="m", source=f"upper arm x sin 10, sin 20 deg; {LUBA}; {ISO}",
        description="q1: slide along the edge, outward positive.",
    )  # fmt: skip
    slide_forward: Range = quantity(
        [0.0, 0.137], unit="m", source=f"upper arm x sin 25 deg; {ISO}", description="q2: slide forward."
    )
    forearm: float = quantity(0.273, gt=0, unit="m", source=MEANS, description="L_fw: fulcrum to wrist.")
    grip: float = quantity(
        0.113, ge=0, unit="m", source=f"palm length, {MEANS}; assumed to be the pinch point",
        description="L_g: wrist to grip.",
    )  # fmt: skip


class PersonParameters(_Motions):
    """The paper's operator with one person's lengths: sex and percentile of ANSUR II; the slides follow the upper arm."""

    sex: Literal["female", "male"] = quantity(description="Whose lengths.", examples=["female"])
    percentile: float = quantity(
        ge=1, le=99, description="Of stature; with mode = 'each' of every length.", examples=[50.0]
    )
    mode: Literal["stature", "each", "random"] = quantity(
        "stature",
        source=f"regressions and deviations, {ANSUR}",
        description="Lengths by regression on stature, each at its own percentile, or by regression with a person's "
        "own deviations.",
    )
    seed: int = quantity(0, ge=0, description="Which person: draws the deviations of mode = 'random'.")
    grip: float = quantity(
        0.60, ge=0, le=1, source=f"palm over hand length, {ANSUR}; assumed to be the pinch point",
        description="L_g, wrist to grip, as a share of the hand's length.",
    )  # fmt: skip


def average(p: EhemParameters) -> Forearm:
    """The forearm that the parameters spell out."""
    ranges = np.vstack([p.slide_side, p.slide_forward, p.rotations()])
    return Forearm(p.half_width, p.fulcrum_height, float(np.radians(p.toe_in)), p.forearm, p.grip, ranges)


def person(p: PersonParameters) -> Forearm:
    """The forearm of one person: the fulcrum a forearm's radius above the armrest and inside the forearms' breadth."""
    m = lengths(p.sex, p.percentile, p.mode, p.seed)
    radius = m["forearm_circumference"] / (2 * np.pi)
    half_width = max(0.0, m["forearm_breadth"] / 2 - radius)
    ranges = np.vstack([slides(m["upper_arm"]), p.rotations()])
    return Forearm(half_width, radius, float(np.radians(p.toe_in)), m["forearm"], p.grip * m["hand"], ranges)


@dataclass(frozen=True, eq=False)
class Ehem(HumanModel):
    """E = comfort in every cell that a grip can reach."""

    forearm: Forearm
    comfort: float
    samples: int

    def bounds(self, operator: Operator) -> NDArray[np.float64]:
        """Box of both hands."""
        return self.forearm.bounds(operator.armrest)

    def field(self, grid: Grid, operator: Operator, stream: Stream) -> ErgonomicField:
        """Mark the right hand's cells, mirror them for the left."""
        reached = self.forearm.reached(grid, operator.armrest, stream, self.samples)
        right = np.where(reached, self.comfort, 0.0)
        return ErgonomicField(right, grid.mirrored(right))


@hookimpl
def eiwa_humans() -> list[Plugin]:
    """The paper's human model, average and personal."""
    return [
        Plugin("ehem", EhemParameters, lambda p: Ehem(average(p), p.comfort, p.samples)),
        Plugin("ehem_percentile", PersonParameters, lambda p: Ehem(person(p), p.comfort, p.samples)),
    ]
