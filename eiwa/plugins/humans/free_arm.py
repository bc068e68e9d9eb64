"""An arm without an armrest: seven joints from the shoulder to the grip.

T_W_grip = Trans(x_s, -(y_s + seat), z_s) Rx(flexion) Ry(-abduction) Rz(medial rotation) Trans(0, 0, -L_u) Rx(elbow)
           Trans(0, 0, -L_f) Rz(pronation) Ry(wrist flexion) Rx(radial deviation) Trans(0, 0, -L_g)

for the right hand, the left one mirrored in x. With all joints at zero the arm hangs down, the thumb in front, as the
EHEM's hand has it on top.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.chain import Joint, SerialChain
from eiwa.core.compiled import compiled
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, ErgonomicField, HumanModel, Operator
from eiwa.core.optimum import maximum, pilot_points
from eiwa.core.sampling import Stream
from eiwa.core.transforms import frozen, translation
from eiwa.core.workspace import Grid

MEANS = "ANSUR II (2012), mean of men's and women's means"
CHUNK = 1 << 16
FINEST = 0.0025
"""Size [m] below which cells of the arcs do not fall with the voxels: 2^20 samples fill them."""
SECTORS = 12
"""Sectors of 30 deg in which phases are kept apart: narrower than every preset's range of shoulder flexion."""

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
RANGES: dict[str, tuple[tuple[float, float], ...]] = {
    "comfort": ((-20, 25), (0, 20), (-10, 30), (45, 110), (-50, 50), (-30, 30), (-10, 10)),
    "functional": ((-20, 60), (0, 45), (-30, 60), (30, 130), (-50, 50), (-40, 40), (-30, 10)),
    "maximal": ((-62, 167), (0, 184), (-104, 69), (0, 143), (-82, 76), (-75, 76), (-36, 22)),
}
"""Shoulder flexion, abduction and medial rotation, elbow, pronation, wrist flexion, radial deviation [deg].

Comfort: ISO 11064-4 (shoulder, elbow, wrist flexion), RULA's lowest band (-20), Morrey 1981 (pronation), LUBA class 1
(deviation), rotation assumed. Functional: Morrey 1981 (elbow, pronation), Ryu 1991 (wrist), shoulder assumed. Maximal: Boone
and Azen 1979.
"""


class FreeArmParameters(Parameters):
    """A seated operator without an armrest: E constant where a grip can be, within one of three ranges of the joints."""

    ranges: Literal["comfort", "functional", "maximal"] = quantity(
        "comfort", source="ISO 11064-4; Morrey 1981, Ryu 1991; Boone and Azen 1979", description="Ranges of the joints."
    )
    shoulder_side: float = quantity(
        0.195, ge=0, unit="m", source=f"half the biacromial breadth, {MEANS}", description="x_s: mid-line to shoulder."
    )
    shoulder_back: float = quantity(
        0.167, unit="m", source="assumed: half the abdominal depth, 0.121 m, and 0.046 m to the edge",
        description="y_s: edge to shoulder, with the seat at 0.",
    )  # fmt: skip
    shoulder_height: float = quantity(
        0.293, unit="m", source=f"0.85 x (acromial height - elbow rest height), {MEANS}",
        description="z_s: shoulder above the height at which the elbow rests.",
    )  # fmt: skip
    upper_arm: float = quantity(
        0.2747, gt=0, unit="m", source=f"0.85 x (acromion to radiale), {MEANS}; the joint lies below the acromion",
        description="L_u: shoulder to elbow.",
    )  # fmt: skip
    forearm: float = quantity(0.273, gt=0, unit="m", source=MEANS, description="L_f: elbow to wrist.")
    grip: float = quantity(
        0.113, ge=0, unit="m", source=f"palm length, {MEANS}; assumed to be the pinch point",
        description="L_g: wrist to grip.",
    )  # fmt: skip
    comfort: float = quantity(0.5, gt=0, le=1, source="the paper", description="E of each arm.")
    samples: int = quantity(1 << 20, ge=1 << 10, description="Samples of the six joints behind the shoulder's flexion.")


@dataclass(frozen=True, eq=False)
class FreeArm(HumanModel):
    """E = comfort in every cell that a grip can reach.

    The first joint turns about an axis fixed in W, so the cells follow from the other six joints' grips in cylindrical
    coordinates about it: x, radius, and the interval of phases, extended by the range of that joint.
    """

    parameters: FreeArmParameters

    @cached_property
    def chain(self) -> SerialChain:
        """All seven joints, from the shoulder."""
        p, down = self.parameters, [translation(0, 0, -length) for length in self._lengths]
        I = np.eye(4)  # noqa: E741
        steps = [
            ("flexion", X, I), ("abduction", (0.0, -1.0, 0.0), I), ("rotation", Z, I), ("elbow", X, down[0]),
            ("pronation", Z, down[1]), ("wrist_flexion", Y, I), ("deviation", X, I),
        ]  # fmt: skip
        limits = np.radians(RANGES[p.ranges])
        joints = tuple(
            Joint(name, "revolute", frozen(T), (float(low), float(high)), axis)
            for (name, axis, T), (low, high) in zip(steps, limits, strict=True)
        )
        return SerialChain(joints, frozen(down[2]), frozen(I))

    @property
    def _lengths(self) -> tuple[float, float, float]:
        return self.parameters.upper_arm, self.parameters.forearm, self.parameters.grip

    def _shoulder(self, operator: Operator) -> Array:
        """The right shoulder in W; its height follows the seat's, which follows the armrest's (elbow rest height)."""
        p = self.parameters
        return np.array([p.shoulder_side, -p.shoulder_back - operator.seat, p.shoulder_height + operator.armrest])

    @cached_property
    def _box(self) -> NDArray[np.float64]:
        """Bounds of the right grip from the shoulder, shape (2, 3)."""
        u, tips = pilot_points(self.chain.dof), self.chain.tips
        farthest = [
            [maximum(lambda v, k=axis, s=sign: s * tips(v)[:, k], u, smallest_step=2.0**-10) for axis in range(3)]  # type: ignore[misc]
            for sign in (-1, 1)
        ]
        box: NDArray[np.float64] = np.array(farthest) * [[-1], [1]] + [[-1e-5], [1e-5]]
        return box

    def bounds(self, operator: Operator) -> NDArray[np.float64]:
        """Box of both hands."""
        low, high = self._box + self._shoulder(operator)
        wide = max(-low[0], high[0])
        return np.array([[-wide, low[1], low[2]], [wide, high[1], high[2]]])

    def field(self, grid: Grid, operator: Operator, stream: Stream) -> ErgonomicField:
        """Paint the arcs of the right hand, mirror them for the left."""
        p, length = self.parameters, sum(self._lengths)
        parts = max(1, int(np.ceil(2 * FINEST / grid.r)))
        size = parts * grid.r / 2
        x, y, z = self._shoulder(operator)
        first = int(np.floor((x - length) / size)) - 1
        cells = int((x + length) / size) - first + 2, int(length / size) + 1
        phases = np.tile([np.pi, -np.pi], (*cells, SECTORS, 1))  # [low, high], empty
        for number in range(0, p.samples, CHUNK):
            u = stream.points(number, min(CHUNK, p.samples - number), 6)
            tips = self.chain.tips(np.column_stack([np.zeros(len(u)), to_limits(u)]))
            _collect(phases, (tips + [x, 0, 0]) / size, first)
        reached = np.zeros(grid.shape, np.bool_)
        turn = float(self.chain.upper[0] - self.chain.lower[0])
        _paint(reached, phases, turn, parts, first, y, z, self._box + [x, y, z], grid.r, grid.origin)
        right = np.where(reached, p.comfort, 0.0)
        return ErgonomicField(right, grid.mirrored(right))


def to_limits(u: Array) -> Array:
    """Points of the unit cube stretched and clipped, so that many joints stand at a limit, where the border is made."""
    stretched: Array = np.clip(1.6 * u - 0.3, 0.0, 1.0)
    return stretched


@compiled
def _collect(phases: Any, tips: Any, first: Any) -> None:
    """Widen the intervals of phases about x, by cell (x, radius) and sector, to points in units of a cell."""
    for n in range(len(tips)):
        i, j = int(np.floor(tips[n, 0])) - first, int(np.hypot(tips[n, 1], tips[n, 2]))
        phase = np.arctan2(tips[n, 2], tips[n, 1])
        k = min(int((phase + np.pi) * (SECTORS / (2 * np.pi))), SECTORS - 1)
        phases[i, j, k, 0] = min(phases[i, j, k, 0], phase)
        phases[i, j, k, 1] = max(phases[i, j, k, 1], phase)


@compiled
def _paint(
    reached: Any, phases: Any, turn: Any, parts: Any, first: Any, y: Any, z: Any, box: Any, r: Any, origin: Any
) -> None:
    """Mark the cells on the arcs that the intervals become when all turn about the axis at y, z from 0 to ``turn``.

    Two points of one sector are nearer to each other than the turn is wide, so what lies between them is reached. Arcs
    stand half a voxel apart, ``parts`` by ``parts`` of them for a cell.
    """
    nx, ny, nz = reached.shape
    size = r / 2
    for column in range(phases.shape[0] * parts):
        tip_x = (first * parts + column + 0.5) * size
        a = int(np.floor(tip_x / r)) - origin[0]
        if not (0 <= a < nx and box[0, 0] <= tip_x <= box[1, 0]):
            continue
        for row in range(phases.shape[1] * parts):
            radius = (row + 0.5) * size
            begun, start, done = False, 0.0, 0.0
            for low, high in phases[column // parts, row // parts]:
                if low > high:
                    continue
                if not begun:
                    begun, start, done = True, low, low
                low, high = max(low, done), min(high + turn, start + 2 * np.pi)
                steps = int(np.ceil(max(high - low, 0.0) * radius / size)) + 1
                for step in range(steps + 1):
                    phase = low + (high - low) * step / steps
                    tip_y, tip_z = y + radius * np.cos(phase), z + radius * np.sin(phase)
                    if box[0, 1] <= tip_y <= box[1, 1] and box[0, 2] <= tip_z <= box[1, 2]:
                        b, c = int(np.floor(tip_y / r)) - origin[1], int(np.floor(tip_z / r)) - origin[2]
                        if 0 <= b < ny and 0 <= c < nz:
                            reached[a, b, c] = True
                done = max(done, high)


@hookimpl
def eiwa_humans() -> list[Plugin]:
    """The free arm."""
    return [Plugin("free_arm", FreeArmParameters, FreeArm)]
