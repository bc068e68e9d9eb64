"""One design under one scenario: from parts to the interaction workspace, Eq. (3) and (4), and its metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.dexterity import Dexterity, Family, prepare
from eiwa.core.elites import Refinement, refine
from eiwa.core.errors import blaming
from eiwa.core.filling import Filled, Sampling, fill
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
from eiwa.core.memory import require_memory
from eiwa.core.sampling import Stream
from eiwa.core.transforms import Transform, roll_pitch_yaw, translation
from eiwa.core.workspace import Grid, Target, pooled

JOINT_STREAM, FIELD_STREAM = 0, 1
"""Last word of a stream's seed path: joint samples, and the human model's samples."""
VOLUME_SAMPLES = 1 << 20
"""Whole workspaces on the study's own grid are counted, not refined: with elites from at most so many plain samples."""
ACROSS_REACH = 40
"""Cells along the reach in which volumes are measured, whatever the study's own voxels are."""
VOLUME_EVALUATIONS, VOLUME_TOLERANCE = 1 << 23, 0.01
OBLIQUE: Transform = roll_pitch_yaw(0.4, 0.7, 1.1)
MIRROR: Transform = np.diag([-1.0, 1.0, 1.0, 1.0])


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

    @property
    def Ts_world_base(self) -> tuple[Transform, Transform]:
        """Right and left; the left one is a reflection when the arms are mirrored."""
        right = self.T_world_base(+1)
        return right, MIRROR @ right if self.second == "mirrored" else self.T_world_base(-1)


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything that one evaluation needs, built and validated; the keys tell dexterities and operators apart."""

    arm: Arm
    index: DexterityIndex
    index_key: str
    normaliser: float | None
    threshold: float
    layout: Layout
    human: HumanModel
    human_key: str
    operator: Operator
    backend: VoxelBackend
    r: float
    sampling: Sampling
    estimator: Literal["plain", "sobol", "elites"]
    seed: int
    metrics: Mapping[str, Metric]


@dataclass(frozen=True, eq=False)
class Pair:
    """V of the right and the left arm on one grid in W."""

    grid: Grid
    right: Filled
    left: Filled


@dataclass(frozen=True, eq=False)
class Reached:
    """Which cells of edge ``h`` [m] each arm reaches above the threshold, on one grid whose shape is a multiple of 4.

    The grid stands obliquely in W: no face of a workspace lies along its cells, so that borders cut them evenly.
    """

    h: float
    right: NDArray[np.bool_]
    left: NDArray[np.bool_]

    @property
    def one_arm(self) -> float:
        """Volume of the right arm's dexterous workspace [m3]."""
        return self._volume(self.right)

    @property
    def shared(self) -> float:
        """Volume that is dexterous for both arms [m3]."""
        return self._volume(self.right, self.left)

    def _volume(self, *sets: NDArray[np.bool_]) -> float:
        """Cells that are in every set, without the layer that counting cells adds at the border.

        Counted in cells of h, 2 h and 4 h, what is linear and quadratic in h cancels in (8 V(h) - 6 V(2 h) + V(4 h)) / 3.
        """
        middle = [pooled(cells) for cells in sets]
        scales = (sets, middle, [pooled(cells) for cells in middle])
        V, V2, V4 = (int(np.logical_and.reduce(cells).sum()) * (self.h * 2**k) ** 3 for k, cells in enumerate(scales))
        return float(max(0.0, (8 * V - 6 * V2 + V4) / 3))


@dataclass(frozen=True, eq=False)
class Replicate:
    """The interaction workspace of one replicate, on E's grid; ``refinement`` where elites searched it."""

    E: ErgonomicField
    V: Pair
    alpha: float
    refinement: Refinement | None = None

    @property
    def V_dual(self) -> Array:
        """Eq. (3) on E's grid: alpha (V_right + V_left)."""
        return self.alpha * (self.V.right.values + self.V.left.values)

    @property
    def V_dual_half(self) -> Array | None:
        """The same from the first half of the samples, where they were drawn evenly."""
        if self.V.right.half is None or self.V.left.half is None:
            return None
        return self.alpha * (self.V.right.half + self.V.left.half)

    @property
    def E_sum(self) -> Array:
        """E_left + E_right."""
        return self.E.left + self.E.right


@dataclass(frozen=True, eq=False)
class Volumes:
    """Whole workspaces of a family, filled when a metric or a figure asks for them (replicate 0)."""

    setup: Setup
    family: Family

    @cached_property
    def reach(self) -> float:
        """Largest distance of the tip from the base origin [m]."""
        return self.family.members[0].reach

    @cached_property
    def whole(self) -> list[Pair]:
        """Both arms' dexterous workspaces on a grid in W that holds all of them, of every member."""
        grid = _grid_of_both_arms(self.setup.layout, self.reach, self.setup.r)
        require_memory(grid.cells * len(self.family.members), self.setup.backend, self.setup.r)
        return fill_pairs(self.setup, self.family, grid, 0, self._amount)

    @cached_property
    def mmdw(self) -> list[Filled]:
        """The dexterous workspace of one arm on a grid in its base frame, of every member."""
        corner = np.full(3, self.reach)
        target = Target(Grid.covering(np.array([-corner, corner]), self.setup.r), np.eye(4))
        require_memory(target.grid.cells * len(self.family.members), self.setup.backend, self.setup.r)
        filled = fill(self.family, [target], self.setup.backend, joint_stream(self.setup, 0), self._amount)
        return [one for (one,) in filled]

    @cached_property
    def reached(self) -> list[Reached]:
        """Which cells the arms reach, of every member: elites fill the holes that plain samples leave."""
        h = self.reach / ACROSS_REACH
        right, left = (OBLIQUE @ T for T in self.setup.layout.Ts_world_base)
        bases = np.array([right[:3, 3], left[:3, 3]])
        box = np.array([bases.min(axis=0) - self.reach, bases.max(axis=0) + self.reach])
        grid = Grid.covering(box, 4 * h).halved.halved
        amount = replace(self.setup.sampling, samples=VOLUME_EVALUATIONS, tolerance=VOLUME_TOLERANCE)
        targets, stream = [Target(grid, right), Target(grid, left)], joint_stream(self.setup, 0)
        refined = refine(self.family, targets, [np.ones(grid.shape)], stream, amount, reached=True)
        return [Reached(h, *(side.values > 0 for side in sides)) for sides, _ in refined]

    @property
    def _amount(self) -> Sampling:
        amount = self.setup.sampling
        if self.setup.estimator != "elites":
            return amount
        return replace(amount, samples=min(amount.samples, VOLUME_SAMPLES))


@dataclass(frozen=True, eq=False)
class Measurement:
    """What metrics look at: the design, its replicates, and whole workspaces on demand.

    ``replicates[0]`` uses the random stream that all designs share.
    """

    setup: Setup
    dexterity: Dexterity
    replicates: Sequence[Replicate]
    volumes: Volumes
    member: int

    @property
    def first(self) -> Replicate:
        """Replicate 0."""
        return self.replicates[0]

    @property
    def whole(self) -> Pair:
        """Both arms' dexterous workspaces on a grid in W that holds all of them."""
        return self.volumes.whole[self.member]

    @property
    def mmdw(self) -> Filled:
        """The dexterous workspace of one arm on a grid in its base frame."""
        return self.volumes.mmdw[self.member]

    @property
    def reached(self) -> Reached:
        """Which cells each arm reaches, for volumes that depend neither on N nor on r."""
        return self.volumes.reached[self.member]


def measure(setups: Sequence[Setup], grid: Grid, fields: Sequence[Sequence[ErgonomicField]]) -> list[Measurement]:
    """Evaluate setups that differ in their dexterity and operator alone, from the same samples and kinematics.

    Parameters
    ----------
    setups
        One or more; arm, layout, voxels and sampling of the first serve all.
    grid
        E's grid in W, common to all of them.
    fields
        For every setup E on that grid, of replicates 0, 1, ... (:func:`eiwa.core.outcome.ergonomic_field`); setups with
        one operator have the same objects.
    """
    members: dict[str, Dexterity] = {}
    for s in setups:
        if s.index_key not in members:
            members[s.index_key] = prepare(s.arm, s.index, s.normaliser, s.threshold)
    family = Family(tuple(members.values()))
    volumes = Volumes(setups[0], family)
    numbers = {key: number for number, key in enumerate(members)}
    replicates: list[list[Replicate]] = [[] for _ in setups]
    for number, Es in enumerate(zip(*fields, strict=True)):
        distinct = {id(E): E for E in Es}
        found = _replicates(setups[0], family, grid, list(distinct.values()), number)
        for mine, setup, E in zip(replicates, setups, Es, strict=True):
            mine.append(found[numbers[setup.index_key], list(distinct).index(id(E))])
    return [
        Measurement(s, members[s.index_key], mine, volumes, numbers[s.index_key])
        for s, mine in zip(setups, replicates, strict=True)
    ]


def _replicates(
    setup: Setup, family: Family, grid: Grid, fields: Sequence[ErgonomicField], number: int
) -> dict[tuple[int, int], Replicate]:
    """One replicate of every member with every field."""
    alpha = setup.layout.alpha
    if setup.estimator != "elites":
        pairs = fill_pairs(setup, family, grid, number, setup.sampling)
        return {(m, f): Replicate(E, pair, alpha) for m, pair in enumerate(pairs) for f, E in enumerate(fields)}
    targets, stream = _targets(setup.layout, grid), joint_stream(setup, number)
    weights = [E.left + E.right for E in fields]
    if len(targets) == 1:  # the mirror image falls on the mirrored cells
        weights = [(w + w[::-1]) / 2 for w in weights]
    result: dict[tuple[int, int], Replicate] = {}
    for m, (sides, refinements) in enumerate(refine(family, targets, weights, stream, setup.sampling)):
        pair = _pair(grid, sides)
        result |= {(m, f): Replicate(E, pair, alpha, refinements[f]) for f, E in enumerate(fields)}
    return result


def metrics(measurement: Measurement) -> dict[str, float | None]:
    """All numbers of the setup's metrics, by name; None where a number does not apply."""
    numbers: dict[str, float | None] = {}
    for metric in measurement.setup.metrics.values():
        with blaming(metric):
            numbers.update(metric(measurement))
    return numbers


def fill_pairs(setup: Setup, family: Family, grid: Grid, replicate: int, amount: Sampling) -> list[Pair]:
    """V of both arms on a symmetric grid in W from one replicate's samples, of every member of the family."""
    targets = _targets(setup.layout, grid)
    filled = fill(family, targets, setup.backend, joint_stream(setup, replicate), amount)
    return [_pair(grid, sides) for sides in filled]


def _targets(layout: Layout, grid: Grid) -> list[Target]:
    """The right arm's grid, and the left arm's where it is not a mirror image."""
    sides = (+1,) if layout.second == "mirrored" else (+1, -1)
    return [Target(grid, layout.T_world_base(side)) for side in sides]


def _pair(grid: Grid, sides: Sequence[Filled]) -> Pair:
    right, *left = sides
    return Pair(grid, right, left[0] if left else _mirrored(right))


def joint_stream(setup: Setup, replicate: int) -> Stream:
    """The stream of joint samples of one replicate."""
    sequence: Literal["plain", "sobol"] = "sobol" if setup.estimator == "sobol" else "plain"
    return Stream.of(sequence, setup.seed, replicate, JOINT_STREAM)


def field_stream(seed: int, replicate: int) -> Stream:
    """The stream of one replicate's ergonomic field."""
    return Stream.of("sobol", seed, replicate, FIELD_STREAM)


def ergonomic_grid(boxes: Sequence[NDArray[np.float64]], r: float) -> Grid:
    """The grid that covers all boxes in W and is symmetric in x, so that mirroring is an index flip."""
    low = np.min([box[0] for box in boxes], axis=0)
    high = np.max([box[1] for box in boxes], axis=0)
    high[0] = max(high[0], -low[0], r)
    low[0] = -high[0]
    return Grid.covering(np.array([low, high]), r)


def _grid_of_both_arms(layout: Layout, reach: float, r: float) -> Grid:
    low, high = np.array(layout.offset) - reach, np.array(layout.offset) + reach
    low[0] -= abs(layout.spacing) / 2
    high[0] += abs(layout.spacing) / 2
    return ergonomic_grid([np.array([low, high])], r)


def _mirrored(right: Filled) -> Filled:
    """The mirror image in x of what stands on a symmetric grid."""
    half = None if right.half is None else right.half[::-1]
    return Filled(right.values[::-1], half, None if right.hits is None else right.hits[::-1])
