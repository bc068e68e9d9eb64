"""The forearm on an armrest over wide ranges, each posture with a comfort c(q) in [0, 1]: RULA, LUBA, or quadratic.

A voxel takes its best posture. The shoulder's posture is implied by where the elbow rests: flexion asin(q2 / L_ua),
abduction asin(q1 / L_ua), and the elbow bends by 90 deg + pitch - shoulder flexion.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.compiled import compiled
from eiwa.core.ergonomics import (
    luba_wrist,
    rula_abducted,
    rula_aside,
    rula_comfort,
    rula_lower_arm,
    rula_twist,
    rula_upper_arm,
    rula_wrist,
)
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


class Comfort(ABC):
    """c(q): what it promises for rotations alone, and its largest value in every cell."""

    @abstractmethod
    def promise(self, q: Array) -> Array:
        """How comfortable the rotations of q are, whatever the slides: any increasing measure."""

    @abstractmethod
    def spread(self, E: Array, rotations: Rotations, layers: Array, ends: Array, grid: Grid) -> None:
        """Raise E to the comfort of every rotation, in its layer, in all cells that the slides' ``ends`` (2, 2) reach."""


@dataclass(frozen=True, eq=False)
class Product(Comfort):
    """c = comfort of the rotations x 2^-(sum over the slides of weight (slide - rest)^2)."""

    rotations: Callable[[Array], Array]
    rest: Array
    weights: Array

    def promise(self, q: Array) -> Array:
        """The rotations' factor."""
        return self.rotations(q)

    def spread(self, E: Array, rotations: Rotations, layers: Array, ends: Array, grid: Grid) -> None:
        """The factor of a slide is the same for a whole row or column of the rectangle."""
        c = rotations.promise
        _spread_product(E, rotations.tips, layers, ends, grid.r, *grid.origin[:2], c, self.rest, self.weights)


def luba() -> Product:
    """LUBA scores the wrist alone here, so every place of the elbow is as good as another."""

    def wrist(q: Array) -> Array:
        return luba_wrist(np.degrees(q[:, 7]), np.degrees(q[:, 6]))

    return Product(wrist, np.zeros(2), np.zeros(2))


def quadratic(hard: Forearm) -> Product:
    """c = 2^-(sum of z^2), z a joint's distance from the middle of its comfortable range in half ranges.

    So c is 1 in the middle, and 1/2 where one joint is at the end of its comfortable range.
    """
    middle, half = hard.ranges.mean(axis=1), np.ptp(hard.ranges, axis=1) / 2
    weights = np.divide(1.0, half**2, out=np.zeros(8), where=half > 0)

    def turns(q: Array) -> Array:
        bell: Array = np.exp2(-(weights * (q - middle) ** 2)[:, 2:].sum(axis=1))
        return bell

    return Product(turns, middle[:2], weights[:2])


@dataclass(frozen=True, eq=False)
class Rula(Comfort):
    """c = 1 - (A - 1) / 8, Table A of RULA for a supported arm (:mod:`eiwa.core.ergonomics`).

    Abduction is the elbow's slide to the side, the mid-line x = 0, and "out to the side" a forearm whose yaw is outward.
    """

    upper_arm: float
    toe_in: float
    smoothing: float

    def promise(self, q: Array) -> Array:
        """Low scores of wrist and twist."""
        least: Array = -_hands(q, self.smoothing).sum(axis=1)
        return least

    def spread(self, E: Array, rotations: Rotations, layers: Array, ends: Array, grid: Grid) -> None:
        """Abduction belongs to a column of the rectangle, flexion and the elbow to a row."""
        q, toe_in = rotations.q, float(np.degrees(self.toe_in))
        hands, place = _hands(q, self.smoothing), (grid.r, *grid.origin[:2])
        _spread_rula(
            E, rotations.tips, layers, ends, *place, q[:, 2].copy(), hands, self.upper_arm, toe_in, self.smoothing
        )


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
        return luba() if p.metric == "luba" else quadratic(self.hard)

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


@compiled
def _slide(cell: Any, r: Any, tip: Any, low: Any, high: Any, rest: Any) -> Any:
    """The slide in [low, high] nearest to ``rest`` that takes a tip's coordinate into a cell."""
    return min(max(rest, cell * r - tip, low), (cell + 1) * r - tip, high)


@compiled
def _cells(tip: Any, low: Any, high: Any, r: Any, origin: Any, count: Any) -> Any:
    """The cells of one axis of a grid that a tip's coordinate reaches by a slide: first, and one behind the last."""
    return max(int(np.floor((tip + low) / r)) - origin, 0), min(int(np.floor((tip + high) / r)) - origin + 1, count)


@compiled
def _spread_product(
    E: Any, tips: Any, layers: Any, ends: Any, r: Any, ox: Any, oy: Any, rotations: Any, rest: Any, weights: Any
) -> None:
    nx, ny, _ = E.shape
    columns = np.empty(nx)
    for n in range(len(tips)):
        x, y, k = tips[n, 0], tips[n, 1], layers[n]
        first, last = _cells(x, ends[0, 0], ends[0, 1], r, ox, nx)
        for i in range(first, last):
            z = _slide(i + ox, r, x, ends[0, 0], ends[0, 1], rest[0]) - rest[0]
            columns[i] = 2.0 ** -(weights[0] * z * z)
        for j in range(*_cells(y, ends[1, 0], ends[1, 1], r, oy, ny)):
            z = _slide(j + oy, r, y, ends[1, 0], ends[1, 1], rest[1]) - rest[1]
            row = rotations[n] * 2.0 ** -(weights[1] * z * z)
            for i in range(first, last):
                E[i, j, k] = max(E[i, j, k], row * columns[i])


@compiled
def _spread_rula(
    E: Any, tips: Any, layers: Any, ends: Any, r: Any, ox: Any, oy: Any, pitch: Any, hands: Any, length: Any,
    toe_in: Any, s: Any,
) -> None:  # fmt: skip
    nx, ny, _ = E.shape
    abducted, aside = np.empty(nx), np.empty(nx)
    for i in range(nx):
        aside[i] = rula_aside(-toe_in, i + ox < 0, s)
    for n in range(len(tips)):
        x, y, k = tips[n, 0], tips[n, 1], layers[n]
        wrist, twist = hands[n]
        first, last = _cells(x, ends[0, 0], ends[0, 1], r, ox, nx)
        for i in range(first, last):
            abducted[i] = rula_abducted(_shoulder(_slide(i + ox, r, x, ends[0, 0], ends[0, 1], 0.0), length), s)
        for j in range(*_cells(y, ends[1, 0], ends[1, 1], r, oy, ny)):
            for rest in (0.0, ends[1, 1]):  # the upper arm likes the near end of a row, the elbow at times the far one
                flexion = _shoulder(_slide(j + oy, r, y, ends[1, 0], ends[1, 1], rest), length)
                upper_arm = rula_upper_arm(flexion, True, s)
                lower_arm = rula_lower_arm(90.0 + np.degrees(pitch[n]) - flexion, s)
                most = rula_comfort(upper_arm, lower_arm, wrist, twist)
                for i in range(first, last):
                    if most > E[i, j, k]:
                        c = rula_comfort(upper_arm + abducted[i], lower_arm + aside[i], wrist, twist)
                        E[i, j, k] = max(E[i, j, k], c)


@compiled
def _hands(q: Any, s: Any) -> Any:
    """Scores of wrist and twist, less 1, shape (n, 2)."""
    scores = np.empty((len(q), 2))
    for n in range(len(q)):
        scores[n, 0] = rula_wrist(np.degrees(q[n, 7]), np.degrees(q[n, 6]), s)
        scores[n, 1] = rula_twist(np.degrees(q[n, 5]), s)
    return scores


@compiled
def _shoulder(slide: Any, upper_arm: Any) -> Any:
    """The angle [deg] that an elbow's slide implies."""
    return np.degrees(np.arcsin(min(max(slide / upper_arm, -1.0), 1.0)))


@hookimpl
def eiwa_humans() -> list[Plugin]:
    """The weighted ehem."""
    return [Plugin("ehem_comfort", ComfortParameters, EhemComfort)]
