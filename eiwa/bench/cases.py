"""The work at which everybody is timed: arms as tables, one index, one grid for two bases."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core import registry
from eiwa.core.design import design
from eiwa.core.dexterity import Family, prepare
from eiwa.core.errors import EiwaError
from eiwa.core.evaluation import Setup
from eiwa.core.interfaces import Arm, DexterityIndex
from eiwa.core.workspace import Grid, Target

PRECISIONS: dict[str, Any] = {"f64": np.float64, "f32": np.float32}
K_SCALED = 12270 / 4**6
"""The paper's K of Eq. (1), for any number of joints."""
THRESHOLD = 0.3
BOX = np.array([[-0.38, 0.26, -0.08], [0.38, 0.52, 0.30]])
VOXEL = 0.01


class Missing(EiwaError):
    """Something that a measurement needs is not there; the message says what."""


def shipped(name: str) -> Path:
    """A file of the repository: beside this one when eiwa is installed, in its folder else.

    Raises
    ------
    Missing
        It is at neither place.
    """
    here = Path(__file__).resolve().parent
    for folder in (here, here.parents[1] / "benchmarks", here.parents[1] / "studies"):
        if (folder / name).exists():
            return folder / name
    raise Missing(f"{name} did not come with eiwa")


@dataclass(frozen=True)
class Case:
    """A serial arm of revolute joints by its modified DH table, with the largest index that its postures reach.

    ``alpha`` in degrees, ``a`` and ``d`` in m, ``limits`` ((low, high), ...) in rad; every entry belongs to one joint.
    """

    alpha: tuple[float, ...]
    a: tuple[float, ...]
    d: tuple[float, ...]
    limits: tuple[tuple[float, float], ...]
    normaliser: float | None = None

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.alpha)

    @property
    def K(self) -> float:
        """K of Eq. (1) for this number of joints."""
        return K_SCALED * 4.0**self.joints

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower limits (joints,) [rad]."""
        return np.array(self.limits)[:, 0]

    @property
    def span(self) -> NDArray[np.float64]:
        """Ranges (joints,) [rad]."""
        return np.diff(np.array(self.limits), axis=1)[:, 0]

    @property
    def rows(self) -> NDArray[np.float64]:
        """alpha [rad], a, d [m] of every joint, shape (joints, 3)."""
        return np.array([np.deg2rad(self.alpha), self.a, self.d]).T

    @cached_property
    def setup(self) -> Setup:
        """The arm, the index and the rest, built through the plugins that a study would use."""
        joints = [
            {"name": f"j{j}", "alpha": alpha, "a": a, "d": d, "limits": list(limits)}
            for j, ((alpha, a, d), limits) in enumerate(zip(self.rows.tolist(), self.limits, strict=True))
        ]
        tree = {
            "arm": {"kind": "dh", "convention": "modified", "angles": "rad", "joints": joints},
            "layout": {"spacing": 0.2, "offset": [0.0, 0.802, 0.1], "orientation": [0.0, 0.0, -90.0]},
            "human": {"kind": "ehem"},
            "dexterity": {"kind": "yoshikawa", "K_scaled": K_SCALED, "threshold": THRESHOLD},
            "voxels": {"kind": "auto", "size": VOXEL},
        }
        return design(tree, registry.load()).setup(0)

    def family(self, arm: Arm | None = None, index: DexterityIndex | None = None) -> Family:
        """Eq. (1) for this arm; ``arm`` and ``index`` take the places of eiwa's own."""
        parts = arm or self.setup.arm, index or self.setup.index
        return Family((prepare(*parts, self.normaliser, THRESHOLD),))

    def targets(self, r: float = VOXEL) -> list[Target]:
        """The grid of cells of r [m] in W, for the right and for the left base."""
        grid = Grid.covering(BOX, r)
        return [Target(grid, self.setup.layout.T_world_base(side)) for side in (+1, -1)]


PAPER = Case(
    alpha=(0, 90, -90, 0, -90, 90),
    a=(0, 0, 0.26, 0.18, 0, 0),
    d=(0,) * 6,
    limits=((-np.pi * 2 / 3, np.pi * 2 / 3),) * 6,
    normaliser=0.01034799448,
)
"""The paper's optimum."""
PANDA = Case(
    alpha=(0, -90, 90, 90, -90, 90, 90),
    a=(0, 0, 0, 0.0825, -0.0825, 0, 0.088),
    d=(0.333, 0, 0.316, 0, 0.384, 0, 0.107),
    limits=((-2.8973, 2.8973), (-1.7628, 1.7628), (-2.8973, 2.8973), (-3.0718, -0.0698), (-2.8973, 2.8973),
            (-0.0175, 3.7525), (-2.8973, 2.8973)),
    normaliser=0.109593544,
)  # fmt: skip
"""Franka Emika's Panda, from its data sheet."""
CASES = {case.joints: case for case in (PAPER, PANDA)}


def chain(joints: int) -> Case:
    """An arm of that many joints: twists of 90 degrees in turn, 0.44 m of links in all."""
    alpha = tuple(90.0 * (-1) ** j for j in range(joints))
    return Case(alpha, (0.0,) + (0.44 / max(1, joints - 1),) * (joints - 1), (0.02,) * joints, ((-2.0, 2.0),) * joints)
