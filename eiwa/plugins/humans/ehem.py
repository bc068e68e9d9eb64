"""The paper's Equivalent Human Ergonomic Model (EHEM): a forearm that slides and turns on the armrest.

T_W_grip = Trans(x_e + q1, q2, z_f) Ry(q4) Rz(toe_in + q5) Rx(q3) Trans(0, L_fw, 0) Ry(q6) Rx(q7) Rz(q8) Trans(0, L_g, 0)

for the right hand, the left one mirrored in x. The paper gives the motions in words only; every number here is an
assumption with a source.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from eiwa.core.chain import Joint, SerialChain
from eiwa.core.compiled import compiled
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, ErgonomicField, HumanModel, Operator
from eiwa.core.optimum import maximum, pilot_points
from eiwa.core.sampling import Stream
from eiwa.core.transforms import frozen, rotation_z, translation
from eiwa.core.workspace import Grid

Range = Annotated[list[float], Field(min_length=2, max_length=2)]

ANSUR = "ANSUR II (2012), mean of men's and women's means"
LUBA = "LUBA (Kee and Karwowski 2001)"
ISO = "ISO 11064-4 as quoted in NUREG-0700 r3, 11.1.1-5"
CHUNK = 1 << 16


class EhemParameters(Parameters):
    """The paper's operator: two forearms on an armrest, E constant where a comfortable grip can be."""

    half_width: float = quantity(
        0.223,
        ge=0,
        unit="m",
        source=ANSUR,
        description="x_e: half the distance between the forearms' fulcra.",
    )
    fulcrum_height: float = quantity(
        0.0457,
        unit="m",
        source=ANSUR,
        description="z_f: forearm radius, the fulcrum's height above the armrest.",
    )
    slide_side: Range = quantity(
        [-0.056, 0.111], unit="m", source=f"upper arm x sin 10, sin 20 deg; {LUBA}; {ISO}",
        description="q1: slide along the edge, outward positive.",
    )  # fmt: skip
    slide_forward: Range = quantity(
        [0.0, 0.137], unit="m", source=f"upper arm x sin 25 deg; {ISO}", description="q2: slide forward."
    )
    pitch: Range = quantity(
        [-5.0, 30.0],
        unit="deg",
        source="forearm on the surface; RULA lower arm",
        description="q3: pitch, up positive.",
    )
    roll: Range = quantity(
        [-20.0, 20.0],
        unit="deg",
        source=f"{ISO}, abduction; assumed",
        description="q4: roll about the forward axis.",
    )
    toe_in: float = quantity(
        15.0, unit="deg", source="JIGSAWS, distance between the hands", description="Constant inward yaw."
    )
    yaw: Range = quantity(
        [0.0, 0.0],
        unit="deg",
        source="not in the paper's words: locked",
        description="q5: yaw about the fulcrum.",
    )
    forearm: float = quantity(0.273, gt=0, unit="m", source=ANSUR, description="L_fw: fulcrum to wrist.")
    pronation: Range = quantity([-50.0, 50.0], unit="deg", source="Morrey 1981", description="q6: forearm rotation.")
    deviation: Range = quantity(
        [-10.0, 10.0], unit="deg", source=f"{LUBA}, class 1", description="q7: wrist, radial positive."
    )
    flexion: Range = quantity([-30.0, 30.0], unit="deg", source=ISO, description="q8: wrist flexion.")
    grip: float = quantity(
        0.113, ge=0, unit="m", source=f"palm length, {ANSUR}; assumed to be the pinch point",
        description="L_g: wrist to grip.",
    )  # fmt: skip
    comfort: float = quantity(0.5, gt=0, le=1, source="the paper", description="E of each arm.")
    samples: int = quantity(1 << 22, ge=1 << 10, description="Samples of the rotations; the slides are marked exactly.")

    @model_validator(mode="after")
    def _ranges_increase(self) -> Self:
        for name in (
            "slide_side",
            "slide_forward",
            "pitch",
            "roll",
            "yaw",
            "pronation",
            "deviation",
            "flexion",
        ):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} must be [low, high] with low <= high, not [{low}, {high}]")
        return self


@dataclass(frozen=True, eq=False)
class Ehem(HumanModel):
    """E = comfort in every cell that a grip can reach.

    The rotations are sampled, denser towards the ends of their ranges (u -> sin^2(pi u / 2), the arcsine
    distribution), because the ends make the border; the two slides are translations, so the whole rectangle of cells
    that one rotation reaches is marked at once.
    """

    parameters: EhemParameters

    @cached_property
    def _chain(self) -> SerialChain:
        """The rotations of the right arm, with both slides at zero."""
        p, deg = self.parameters, np.pi / 180
        steps = [
            ("roll", (0.0, 1.0, 0.0), p.roll, translation(p.half_width, 0, p.fulcrum_height)),
            ("yaw", (0.0, 0.0, 1.0), p.yaw, rotation_z(p.toe_in * deg)),
            ("pitch", (1.0, 0.0, 0.0), p.pitch, np.eye(4)),
            ("pronation", (0.0, 1.0, 0.0), p.pronation, translation(0, p.forearm, 0)),
            ("deviation", (1.0, 0.0, 0.0), p.deviation, np.eye(4)),
            ("flexion", (0.0, 0.0, 1.0), p.flexion, np.eye(4)),
        ]
        joints = tuple(
            Joint(name, "revolute", frozen(T), (limits[0] * deg, limits[1] * deg), axis)
            for name, axis, limits, T in steps
        )
        return SerialChain(joints, frozen(translation(0, p.grip, 0)), frozen(np.eye(4)))

    def tips(self, u: Array) -> Array:
        """Right-hand grips (n, 3) [m] in W with both slides at zero, for points u (n, 6) of the unit cube."""
        return self._chain.tips(np.sin(np.pi / 2 * u) ** 2)

    @cached_property
    def _box(self) -> NDArray[np.float64]:
        """Bounds of the right hand at armrest 0, shape (2, 3)."""
        p = self.parameters
        u = pilot_points(self._chain.dof)
        high = [maximum(lambda v, k=axis: self.tips(v)[:, k], u) for axis in range(3)]  # type: ignore[misc]
        low = [-maximum(lambda v, k=axis: -self.tips(v)[:, k], u) for axis in range(3)]  # type: ignore[misc]
        slides = np.array([[p.slide_side[0], p.slide_forward[0], 0], [p.slide_side[1], p.slide_forward[1], 0]])
        box: NDArray[np.float64] = np.array([low, high]) + slides + np.array([[-1e-6], [1e-6]])
        return box

    def bounds(self, operator: Operator) -> NDArray[np.float64]:
        """Box of both hands."""
        low, high = self._box
        wide = max(-low[0], high[0])
        return np.array([[-wide, low[1], low[2]], [wide, high[1], high[2]]]) + [0, 0, operator.armrest]

    def field(self, grid: Grid, operator: Operator, stream: Stream) -> ErgonomicField:
        """Mark the right hand's cells, mirror them for the left."""
        p = self.parameters
        slides = np.array([*p.slide_side, *p.slide_forward]) / grid.r
        widths = np.floor([slides[1] - slides[0], slides[3] - slides[2]]).astype(np.int64)
        marks = np.zeros((2, 2, *grid.shape), np.bool_)
        for first in range(0, p.samples, CHUNK):
            u = stream.points(first, min(CHUNK, p.samples - first), self._chain.dof)
            cells = (self.tips(u) + [0, 0, operator.armrest]) / grid.r - np.array(grid.origin)
            _mark(marks, cells, slides, widths)
        reached = _spread(marks, widths)
        right = np.where(reached, p.comfort, 0.0)
        return ErgonomicField(right, _mirrored(right, grid))


@compiled
def _mark(marks: Any, cells: Any, slides: Any, widths: Any) -> None:
    """Mark the first cell of every rectangle, by how many cells it spans beyond ``widths`` (0 or 1) in x and y."""
    _, _, nx, ny, nz = marks.shape
    for s in range(cells.shape[0]):
        i, j = int(np.floor(cells[s, 0] + slides[0])), int(np.floor(cells[s, 1] + slides[2]))
        more_x = int(np.floor(cells[s, 0] + slides[1])) - i - widths[0]
        more_y = int(np.floor(cells[s, 1] + slides[3])) - j - widths[1]
        k = int(np.floor(cells[s, 2]))
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
            marks[more_x, more_y, i, j, k] = True


def _spread(marks: NDArray[np.bool_], widths: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Extend every mark to its rectangle."""
    reached = np.zeros(marks.shape[2:], np.bool_)
    for more_x in range(2):
        for more_y in range(2):
            columns = np.array(marks[more_x, more_y])
            for step in range(1, widths[0] + more_x + 1):
                columns[step:] |= marks[more_x, more_y, :-step]
            reached |= columns
            for step in range(1, widths[1] + more_y + 1):
                reached[:, step:] |= columns[:, :-step]
    return reached


def _mirrored(right: Array, grid: Grid) -> Array:
    """The mirror image in x; cells whose image lies outside the grid are empty."""
    left = np.zeros_like(right)
    source = -1 - (grid.origin[0] + np.arange(grid.shape[0])) - grid.origin[0]
    inside = (source >= 0) & (source < grid.shape[0])
    left[inside] = right[source[inside]]
    return left


@hookimpl
def eiwa_humans() -> list[Plugin]:
    """The paper's human model."""
    return [Plugin("ehem", EhemParameters, Ehem)]
