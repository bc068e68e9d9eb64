"""Closed forms on the user's own machine: what eiwa computes here, beside what it must be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from eiwa.core import registry
from eiwa.core.chain import SerialChain
from eiwa.core.design import design
from eiwa.core.dexterity import Family, prepare
from eiwa.core.elites import refine
from eiwa.core.evaluation import Setup, Volumes
from eiwa.core.filling import Sampling
from eiwa.core.linear import volume
from eiwa.core.sampling import Stream
from eiwa.core.symbols import as_columns
from eiwa.core.workspace import Grid, Target

L1, L2 = 0.26, 0.18


@dataclass(frozen=True)
class Check:
    """One quantity: its exact value, eiwa's, and how far apart they may be (relative)."""

    name: str
    exact: float
    found: float
    allowed: float

    @property
    def error(self) -> float:
        """Relative error."""
        return abs(self.found - self.exact) / abs(self.exact)

    @property
    def passed(self) -> bool:
        """Whether the error is allowed."""
        return self.error <= self.allowed


def checks() -> Iterator[Check]:
    """Every check, one after another (a few seconds in all)."""
    paper = _setup([(0, 0), (90, 0), (-90, L1), (0, L2), (-90, 0), (90, 0)], "all", None)
    yield from _kinematics(paper)
    yield from _volumes(paper)
    yield from _planar()


def _kinematics(setup: Setup) -> Iterator[Check]:
    """The paper's arm: w = L1 L2 |cos q2| |sin q3| |L1 + L2 cos q3| |sin q5|, reach^2 by the law of cosines."""
    arm = setup.arm
    assert isinstance(arm, SerialChain)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (4096, 6))
    tips, _, J = arm.forward(q)
    w = volume([as_columns(J[:, row, :]) for row in range(6)])
    A = L1 + L2 * np.cos(q[:, 2])
    exact = np.abs(L1 * L2 * np.cos(q[:, 1]) * np.sin(q[:, 2]) * A * np.sin(q[:, 4]))
    worst = int(np.argmax(np.abs(w - exact)))
    yield Check("manipulability, worst of 4096 postures", float(exact[worst]), float(w[worst]), 1e-10)
    squares = L1**2 + L2**2 + 2 * L1 * L2 * np.cos(q[:, 2])
    worst = int(np.argmax(np.abs((tips**2).sum(axis=1) - squares)))
    yield Check("squared reach, worst of 4096 postures", float(squares[worst]), float((tips[worst] ** 2).sum()), 1e-12)
    unpenalised = prepare(arm, setup.index, None, 0.0)
    # d/dq3 (sin q3 (L1 + L2 cos q3)) = 0 has the root below.
    cosine = (-L1 + np.sqrt(L1**2 + 8 * L2**2)) / (4 * L2)
    largest = L1 * L2 * np.sqrt(1 - cosine**2) * (L1 + L2 * cosine)
    yield Check("largest manipulability", float(largest), unpenalised.normaliser, 1e-8)


def _volumes(setup: Setup) -> Iterator[Check]:
    """The reachable volume of the paper's arm, 8 pi L1^2 L2."""
    family = Family((prepare(setup.arm, setup.index, None, 0.0),))
    found = Volumes(setup, family).reached[0].one_arm
    yield Check("reachable volume, without the border's layer [m3]", 8 * np.pi * L1**2 * L2, found, 0.05)


def _planar() -> Iterator[Check]:
    """A planar arm without limits: w depends on the distance from the base alone, largest at sqrt(L1^2 + L2^2)."""
    a, b, r = 0.30, 0.20, 0.02
    setup = _setup([(0, 0), (0, a)], ["x", "y"], b)
    grid = Grid(r, (-26, -26, 0), (52, 52, 1))
    T = np.eye(4)
    T[2, 3] = r / 2
    dexterity = prepare(setup.arm, setup.index, None, 0.0)
    amount = Sampling(1 << 19, tolerance=1e-9)
    ((filled,), _), *_ = refine(
        Family((dexterity,)), [Target(grid, T)], [np.ones(grid.shape)], Stream("plain", 1), amount
    )
    supremum = _planar_suprema(a, b, r, grid) / (a * b)
    yield Check("planar arm, sum of the largest Dex per voxel", float(supremum.sum()), float(filled.values.sum()), 0.02)


def _planar_suprema(a: float, b: float, r: float, grid: Grid) -> Any:
    """Largest a b |sin q2| over every cell, from the range of distances that the cell spans."""
    low = np.stack(np.meshgrid(grid.faces(0)[:-1], grid.faces(1)[:-1], indexing="ij"), axis=-1)
    near = np.where((low <= 0) & (low + r >= 0), 0.0, np.minimum(np.abs(low), np.abs(low + r)))
    far = np.maximum(np.abs(low), np.abs(low + r))
    nearest, farthest = np.linalg.norm(near, axis=-1), np.linalg.norm(far, axis=-1)
    distance = np.clip(np.hypot(a, b), np.maximum(nearest, abs(a - b)), np.minimum(farthest, a + b))
    cosine = (distance**2 - a**2 - b**2) / (2 * a * b)
    reached = (farthest >= abs(a - b)) & (nearest <= a + b)
    return np.where(reached, a * b * np.sqrt(np.clip(1 - cosine**2, 0, None)), 0.0)


def _setup(rows: list[tuple[float, float]], index_rows: Any, tool: float | None) -> Setup:
    """An arm from (alpha [deg], a [m]) rows without limits, built through the plugins that a study would use."""
    joints = [{"name": f"j{i}", "alpha": float(alpha), "a": float(a)} for i, (alpha, a) in enumerate(rows)]
    tree = {
        "arm": {"kind": "dh", "convention": "modified", "joints": joints, "tool": [tool or 0.0, 0.0, 0.0]},
        "layout": {"spacing": 0.2, "offset": [0.0, 0.8, 0.1]},
        "human": {"kind": "ehem"},
        "dexterity": {"kind": "yoshikawa", "K_scaled": 50.0, "rows": index_rows},
        "voxels": {"kind": "dense", "size": 0.02},
    }
    return design(tree, registry.load()).setup(0)
