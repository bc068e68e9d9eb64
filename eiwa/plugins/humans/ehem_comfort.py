"""The forearm on an armrest over wide ranges, each posture with a comfort c(q) in [0, 1]: RULA, LUBA, or quadratic.

A voxel takes its best posture. The shoulder's posture is implied by where the elbow rests: flexion asin(q2 / L_ua),
abduction asin(q1 / L_ua), and the elbow bends by 90 deg + pitch - shoulder flexion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.comfort import Comfort, Rula, luba, quadratic
from eiwa.core.forearm import Forearm, Rotations, slides
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, ErgonomicField, HumanModel, Operator
from eiwa.core.sampling import Stream
from eiwa.core.workspace import Grid

MEANS = "ANSUR II (2012), mean of men's and women's means"

RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "comfort": {
        "abduction": (-10, 20), "shoulder": (0, 25), "pitch": (-5, 30), "pronation": (-50, 50), "deviation": (-10, 10),
        "flexion": (-30, 30),
    },
    "functional": {
        "abduction": (-10, 45), "shoulder": (0, 60), "pitch": (-5, 40), "pronation": (-50, 50), "deviation": (-30, 10),
        "flexion": (-40, 40),
    },
    "maximal": {
        "abduction": (-10, 90), "shoulder": (0, 90), "pitch": (-5, 53), "pronation": (-76, 82), "deviation": (-36, 22),
        "flexion": (-75, 76),
    },
}  # fmt: skip
"""Shoulder abduction and flexion (which make the slides), pitch, and the wrist [deg]. ``comfort`` is the hard EHEM's.

Functional: Morrey 1981 (elbow to 130, rotation), Ryu 1991 (wrist), free_arm's shoulder. Maximal: Boone and Azen 1979
(elbow to 143, rotation, wrist); an elbow slides no further than the upper arm is long. In all three the forearm comes down
to the surface, the elbow goes back to the edge and in by 10 deg, and the roll keeps +-20 deg: no score looks at it.
"""

ROLL = (-20, 20)
HARD_SAMPLES = 1 << 18


class ComfortParameters(Parameters):
    """The ehem over wider ranges, every posture weighted by its comfort (RULA, LUBA, quadratic)."""

    metric: Literal["rula", "luba", "quadratic"] = quantity(
        "rula", source="McAtamney and Corlett 1993; Kee and Karwowski 2001", description="What c(q) is."
    )
    ranges: Literal["functional", "maximal"] = quantity(
        "functional", source="Morrey 1981, Ryu 1991; Boone and Azen 1979", description="Where E > 0 can be."
    )
    smoothing: float = quantity(
        2.5, gt=0, unit="deg", source="assumed", description="Scale of the sigmoids that soften RULA's bands."
    )
    mean: float | None = quantity(
        None, gt=0, lt=1,
        description="Scale E, capped at 1, to this mean over the cells of the hard ehem of the same lengths (the paper's "
        "constant is 0.5); none: E is c.",
    )  # fmt: skip
    half_width: float = quantity(
        0.223, ge=0, unit="m", source=MEANS, description="x_e: half the distance between the forearms' fulcra."
    )
    fulcrum_height: float = quantity(
        0.0457, unit="m", source=MEANS, description="z_f: forearm radius, the fulcrum's height above the armrest."
    )
    toe_in: float = quantity(
        15.0, unit="deg", source="JIGSAWS, distance between the hands", description="Constant inward yaw."
    )
    upper_arm: float = quantity(0.3232, gt=0, unit="m", source=MEANS, description="L_ua: acromion to elbow.")
    forearm: float = quantity(0.273, gt=0, unit="m", source=MEANS, description="L_fw: fulcrum to wrist.")
    grip: float = quantity(
        0.113, ge=0, unit="m", source=f"palm length, {MEANS}; assumed to be the pinch point",
        description="L_g: wrist to grip.",
    )  # fmt: skip
    samples: int = quantity(1 << 20, ge=1 << 10, description="Rotations tried; the slides are chosen for each voxel.")


def forearm(p: ComfortParameters, ranges: str) -> Forearm:
    """The chain over a preset's ranges."""
    r = RANGES[ranges]
    turns = np.radians([r["pitch"], ROLL, (0, 0), r["pronation"], r["deviation"], r["flexion"]])
    reach = np.vstack([slides(p.upper_arm, r["abduction"], r["shoulder"]), turns])
    return Forearm(p.half_width, p.fulcrum_height, float(np.radians(p.toe_in)), p.forearm, p.grip, reach)


@dataclass(frozen=True, eq=False)
class EhemComfort(HumanModel):
    """E = the largest c(q) of all postures with the grip in the voxel."""

    parameters: ComfortParameters

    @cached_property
    def forearm(self) -> Forearm:
        """The chain over the wide ranges."""
        return forearm(self.parameters, self.parameters.ranges)

    @cached_property
    def hard(self) -> Forearm:
        """The chain over the hard ehem's ranges."""
        return forearm(self.parameters, "comfort")

    @cached_property
    def comfort(self) -> Comfort:
        """c(q)."""
        p = self.parameters
        if p.metric == "rula":
            return Rula(p.upper_arm, p.toe_in, p.smoothing)
        return luba() if p.metric == "luba" else quadratic(self.hard.ranges)

    def bounds(self, operator: Operator) -> NDArray[np.float64]:
        """Box of both hands."""
        return self.forearm.bounds(operator.armrest)

    def field(self, grid: Grid, operator: Operator, stream: Stream) -> ErgonomicField:
        """The best rotations of small bins, each with the slides that take it into a voxel."""
        p, E = self.parameters, np.zeros(grid.shape, order="F")  # x fastest, as it is spread
        rotations = self.forearm.best(grid.r, operator.armrest, stream, p.samples, self.comfort.promise)
        layers = np.floor(rotations.tips[:, 2] / grid.r).astype(np.int64) - grid.origin[2]
        inside = (layers >= 0) & (layers < grid.shape[2])
        rotations = Rotations(rotations.q[inside], rotations.tips[inside], rotations.promise[inside])
        self.comfort.spread(E, rotations, layers[inside], self.forearm.ranges[:2], grid)
        if p.mean is not None:
            cells = self.hard.reached(grid, operator.armrest, stream, HARD_SAMPLES)
            E = np.minimum(E * factor(E[cells], p.mean), 1.0)
        right = np.ascontiguousarray(E)
        return ErgonomicField(right, grid.mirrored(right))


def factor(values: Array, mean: float) -> float:
    """The factor that gives values this mean when they are capped at 1 after it."""
    falling = np.sort(values)[::-1]
    others = np.cumsum(falling[::-1])[::-1]
    factors = (mean * len(values) - np.arange(len(values))) / np.maximum(others, 1e-300)  # of the m largest capped
    return float(factors[np.argmax(factors * falling <= 1.0)])


@hookimpl
def eiwa_humans() -> list[Plugin]:
    """The weighted ehem."""
    return [Plugin("ehem_comfort", ComfortParameters, EhemComfort)]
