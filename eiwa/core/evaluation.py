"""One design under one scenario: from parts to the interaction workspace, Eq. (3) and (4), and its metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.estimators import Dexterity, Filled, Sampling, fill, prepare
from eiwa.core.interfaces import (
    Arm,
    Array,
    DexterityIndex,
    ErgonomicField,
    HumanModel,
    Metric,
    Operator,
    VoxelBackend,
)
from eiwa.core.sampling import Sequence as SequenceName
from eiwa.core.sampling import Stream
from eiwa.core.transforms import Transform, roll_pitch_yaw, translation
from eiwa.core.workspace import Grid, Target

JOINT_STREAM, FIELD_STREAM = 0, 1
"""Last word of a stream's seed path: joint samples, and the human model's samples."""


@dataclass(frozen=True)
class Layout:
    """Where the two bases stand in W.

    ``offset`` R: operator origin to the midpoint of the bases [m]; ``spacing`` D [m]; ``orientation``: roll, pitch, yaw
    of T_world_base [rad]; ``second``: the left arm is the right one translated by D (Eq. 3) or mirrored in x; ``alpha``:
    the factor of Eq. (3).
    """

    spacing: float
    offset: tuple[float, float, float]
    orientation: tuple[float, float, float]
    second: Literal["translated", "mirrored"] = "translated"
    alpha: float = 0.5

    def T_world_base(self, side: int) -> Transform:
        """Pose of the right (+1) or left (-1, when translated) base."""
        x, y, z = self.offset
        return translation(x + side * self.spacing / 2, y, z) @ roll_pitch_yaw(*self.orientation)


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything that one evaluation needs, built and validated."""

    arm: Arm
    index: DexterityIndex
    normaliser: float | None
    threshold: float
    layout: Layout
    human: HumanModel
    human_key: str
    operator: Operator
    backend: VoxelBackend
    r: float
    sampling: Sampling
    sequence: SequenceName
    seed: int
    metrics: Mapping[str, Metric]


@dataclass(frozen=True, eq=False)
class Pair:
    """V of the right and the left arm on one grid in W."""

    grid: Grid
    right: Filled
    left: Filled


@dataclass(frozen=True, eq=False)
class Replicate:
    """The interaction workspace of one replicate, on E's grid."""

    E: ErgonomicField
    V: Pair
    alpha: float

    @property
    def V_dual(self) -> Array:
        """Eq. (3) on E's grid: alpha (V_right + V_left)."""
        return self.alpha * (self.V.right.values + self.V.left.values)

    @property
    def V_dual_half(self) -> Array:
        """The same from the first half of the samples."""
        return self.alpha * (self.V.right.half + self.V.left.half)

    @property
    def E_sum(self) -> Array:
        """E_left + E_right."""
        return self.E.left + self.E.right


@dataclass(frozen=True, eq=False)
class Measurement:
    """What metrics look at: the design, its replicates, and whole workspaces on demand.

    ``replicates[0]`` uses the random stream that all designs share.
    """

    setup: Setup
    dexterity: Dexterity
    replicates: Sequence[Replicate]

    @property
    def first(self) -> Replicate:
        """Replicate 0."""
        return self.replicates[0]

    @cached_property
    def whole(self) -> Pair:
        """Both arms' dexterous workspaces on a grid in W that holds all of them (replicate 0)."""
        return fill_pair(
            self.setup,
            self.dexterity,
            _grid_of_both_arms(self.setup.layout, self.dexterity.reach, self.setup.r),
            0,
        )

    @cached_property
    def mmdw(self) -> Filled:
        """The dexterous workspace of one arm on a grid in its base frame (replicate 0)."""
        reach = np.full(3, self.dexterity.reach)
        target = Target(Grid.covering(np.array([-reach, reach]), self.setup.r), np.eye(4))
        stream = joint_stream(self.setup, 0)
        return fill(self.dexterity, [target], self.setup.backend, stream, self.setup.sampling)[0]


def measure(setup: Setup, grid: Grid, fields: Sequence[ErgonomicField]) -> Measurement:
    """Evaluate one design: one replicate per ergonomic field.

    Parameters
    ----------
    setup
        The design.
    grid
        E's grid in W, common to all scenarios.
    fields
        E on that grid, of replicates 0, 1, ... (:func:`ergonomic_field`).
    """
    dexterity = prepare(setup.arm, setup.index, setup.normaliser, setup.threshold)
    replicates = [
        Replicate(field, fill_pair(setup, dexterity, grid, number), setup.layout.alpha)
        for number, field in enumerate(fields)
    ]
    return Measurement(setup, dexterity, replicates)


def metrics(measurement: Measurement) -> dict[str, float | None]:
    """All numbers of the setup's metrics, by name; None where a number does not apply."""
    numbers: dict[str, float | None] = {}
    for metric in measurement.setup.metrics.values():
        numbers.update(metric(measurement))
    return numbers


def fill_pair(setup: Setup, dexterity: Dexterity, grid: Grid, replicate: int) -> Pair:
    """V of both arms on a grid in W, from the same samples."""
    sides = (+1,) if setup.layout.second == "mirrored" else (+1, -1)
    targets = [Target(grid, setup.layout.T_world_base(side)) for side in sides]
    stream = joint_stream(setup, replicate)
    right, *left = fill(dexterity, targets, setup.backend, stream, setup.sampling)
    return Pair(grid, right, left[0] if left else _mirrored(right))


def joint_stream(setup: Setup, replicate: int) -> Stream:
    """The stream of joint samples of one replicate."""
    return Stream.of(setup.sequence, setup.seed, replicate, JOINT_STREAM)


def field_stream(seed: int, replicate: int) -> Stream:
    """The stream of one replicate's ergonomic field."""
    return Stream.of("sobol", seed, replicate, FIELD_STREAM)


def ergonomic_grid(boxes: Sequence[NDArray[np.float64]], r: float) -> Grid:
    """The grid that covers all boxes in W and is symmetric in x, so that mirroring is an index flip."""
    low = np.min([box[0] for box in boxes], axis=0)
    high = np.max([box[1] for box in boxes], axis=0)
    high[0] = max(high[0], -low[0])
    low[0] = -high[0]
    return Grid.covering(np.array([low, high]), r)


def _grid_of_both_arms(layout: Layout, reach: float, r: float) -> Grid:
    low, high = np.array(layout.offset) - reach, np.array(layout.offset) + reach
    low[0] -= abs(layout.spacing) / 2
    high[0] += abs(layout.spacing) / 2
    return ergonomic_grid([np.array([low, high])], r)


def _mirrored(right: Filled) -> Filled:
    return Filled(right.values[::-1], right.half[::-1], right.hits[::-1])
