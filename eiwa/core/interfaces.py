"""What arms, dexterity indices, human models, voxel backends and metrics are to the core.

Every class has an array form (NumPy in, NumPy out), which is always enough. An arm or an index that also writes its
formulas on columns (:mod:`eiwa.core.symbols`) is compiled, together with the rest, into one kernel.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from eiwa.core.kernel import Map
from eiwa.core.sampling import ARRAY_BLOCK, BLOCK
from eiwa.core.symbols import Column, where

if TYPE_CHECKING:
    from eiwa.core.evaluation import Measurement
    from eiwa.core.sampling import Stream
    from eiwa.core.workspace import Grid

Array = NDArray[np.floating[Any]]
NOTHING = np.zeros(0)


@dataclass(frozen=True)
class Postures:
    """n postures of an arm, in its base frame.

    ``u`` (n, dof) in [0, 1]; ``q`` (n, dof) [rad or m]; ``tips`` (n, 3) [m]; ``rotations`` (n, 3, 3);
    ``jacobians`` (n, 6, dof), geometric, at the tip: linear rows [m/rad] above angular rows; ``valid`` (n,) bool:
    False where the joint vector has no solution; ``limited`` (dof): the joints whose limits may be penalised.

    Raises
    ------
    ValueError
        An array has another shape.
    """

    u: Array
    q: Array
    tips: Array
    rotations: Array
    jacobians: Array
    valid: NDArray[np.bool_]
    limited: tuple[bool, ...]

    @property
    def solved(self) -> Postures:
        """Those that are valid."""
        v = self.valid
        if v.all():
            return self
        u, q, tips, rotations, jacobians = self.u[v], self.q[v], self.tips[v], self.rotations[v], self.jacobians[v]
        return Postures(u, q, tips, rotations, jacobians, v[v], self.limited)

    def __post_init__(self) -> None:
        arrays = (self.q, self.tips, self.rotations, self.jacobians, self.valid, self.limited)
        n, dof = np.shape(self.u)
        wanted = ((n, dof), (n, 3), (n, 3, 3), (n, 6, dof), (n,), (dof,))
        seen = tuple(np.shape(array) for array in arrays)
        if seen != wanted:
            k = next(k for k, pair in enumerate(zip(seen, wanted, strict=True)) if pair[0] != pair[1])
            name = ("q", "tips", "rotations", "jacobians", "valid", "limited")[k]
            raise ValueError(f"{name} must have shape {wanted[k]} for {n} postures of {dof} joints, not {seen[k]}")


@dataclass(frozen=True)
class ArmColumns:
    """The same as :class:`Postures`, as columns: ``jacobian[row][joint]``, ``rotation[row][column]``.

    ``reduced``: the Jacobian at a reference point of the arm's choice instead of the tip, where more of its entries are
    zero; with six joints or more, all six rows together have the same volume there. None: no better point is known.
    """

    u: Sequence[Column]
    q: Sequence[Column]
    tip: Sequence[Column]
    rotation: Sequence[Sequence[Column]]
    jacobian: Sequence[Sequence[Column]]
    limited: tuple[bool, ...]
    valid: Column = True
    reduced: Sequence[Sequence[Column]] | None = None

    def postures(self) -> Postures:
        """Postures, from columns that are arrays (or numbers, where a column is the same for every sample)."""
        u = np.stack(self.u, axis=1)

        def stacked(columns: Sequence[Column]) -> Array:
            return np.stack([np.broadcast_to(np.asarray(c, float), len(u)) for c in columns], axis=1)

        return Postures(
            u=u,
            q=stacked(self.q),
            tips=stacked(self.tip),
            rotations=np.stack([stacked(row) for row in self.rotation], axis=1),
            jacobians=np.stack([stacked(row) for row in self.jacobian], axis=1),
            valid=np.broadcast_to(np.asarray(self.valid, bool), len(u)),
            limited=self.limited,
        )


class Arm(ABC):
    """A master manipulator's kinematics.

    Attributes
    ----------
    dof
        Number of joints, the dimension of the unit cube that is sampled.
    limited
        Per joint, whether it has limits that an index may penalise.
    """

    dof: int
    limited: tuple[bool, ...]

    @abstractmethod
    def postures(self, u: Array) -> Postures:
        """Evaluate n points of the unit cube, shape (n, dof)."""

    @property
    def link_length(self) -> float | None:
        """Total length of the links [m]; None for an arm that has no such thing."""
        return None

    def when_singular(self) -> str:
        """What a user should look at when this arm is singular at every posture."""
        return ""


class TracedArm(Arm):
    """An arm that writes its formulas on columns.

    Attributes
    ----------
    constants
        The numbers of this design that the formulas read; shape (k,).
    structure
        A hashable value that two arms share only when their formulas are the same but for ``constants``;
        None has the formulas traced anew for every design, which costs milliseconds.
    """

    constants: NDArray[np.float64] = NOTHING
    structure: Hashable = None

    @abstractmethod
    def columns(self, u: Sequence[Column], p: Sequence[Column]) -> ArmColumns:
        """The arm's formulas; ``p`` are the entries of ``constants``."""

    @cached_property
    def _map(self) -> Map:
        outputs = (self.dof, 3, 9, 6 * self.dof, 1)
        key = (type(self), self.structure, "postures")
        return compiled_map(key, self._flat, self.dof, len(self.constants), outputs=outputs, samples=ARRAY_BLOCK)

    def _flat(self, u: Sequence[Column], p: Sequence[Column]) -> list[Column]:
        arm = self.columns(u, p)
        rotation = [entry for row in arm.rotation for entry in row]
        jacobian = [entry for row in arm.jacobian for entry in row]
        return [*arm.q, *arm.tip, *rotation, *jacobian, where_valid(arm.valid, 1.0, 0.0)]

    def postures(self, u: Array) -> Postures:
        """Evaluate n points of the unit cube with the compiled formulas."""
        n, dof = np.shape(u)
        if dof != self.dof:
            raise ValueError(f"u has {dof} columns, the arm has {self.dof} joints")
        q, tips, rotations, jacobians, valid = self._map.parts(u, self.constants)
        R, J, mask = rotations.reshape(n, 3, 3), jacobians.reshape(n, 6, dof), valid[:, 0] > 0.5
        return Postures(np.asarray(u), q, tips, R, J, mask, self.limited)


class DexterityIndex(ABC):
    """A non-negative index of how well a posture can be moved from; 0 means not at all."""

    def prepare(self, arm: Arm, pilot: Postures) -> NDArray[np.float64]:
        """Numbers that the index needs for this arm, learned from the valid postures of a fixed pilot; shape (k,)."""
        return NOTHING

    @abstractmethod
    def values(self, postures: Postures, prepared: NDArray[np.float64]) -> Array:
        """The index of n postures, shape (n,), not normalised."""


class TracedIndex(DexterityIndex):
    """An index that writes its formula on columns; ``structure`` as in :class:`TracedArm`."""

    structure: Hashable = None

    @abstractmethod
    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """The index's formula; ``p`` are the entries that :meth:`prepare` returned, zeros may follow."""

    def values(self, postures: Postures, prepared: NDArray[np.float64]) -> Array:
        """The compiled formula on arrays."""
        n, dof = postures.u.shape
        widths = (dof, dof, 3, 9, 6 * dof)

        def formula(columns: Sequence[Column], p: Sequence[Column]) -> list[Column]:
            u, q, tip, R, J = parted(columns, widths)
            arm = ArmColumns(u, q, tip, parted(R, (3, 3, 3)), parted(J, [dof] * 6), postures.limited)
            return [self.columns(arm, p)]

        structure = None if self.structure is None else (self.structure, postures.limited)
        function = compiled_map((type(self), structure, "values"), formula, widths, len(prepared))
        rotations, jacobians = postures.rotations.reshape(n, 9), postures.jacobians.reshape(n, 6 * dof)
        return function(postures.u, postures.q, postures.tips, rotations, jacobians, prepared)[:, 0]


@dataclass(frozen=True)
class Operator:
    """Where the operator sits: armrest height above, seat behind the origin of W [m]."""

    armrest: float = 0.0
    seat: float = 0.0


@dataclass(frozen=True)
class ErgonomicField:
    """E of both hands on a grid in W: arrays of the grid's shape with values in [0, 1]."""

    right: Array
    left: Array


class HumanModel(ABC):
    """Where the operator's hands are comfortable."""

    @abstractmethod
    def bounds(self, operator: Operator) -> NDArray[np.float64]:
        """A box in W that holds E > 0 of both hands: [[x, y, z] low, [x, y, z] high], shape (2, 3) [m]."""

    @abstractmethod
    def field(self, grid: Grid, operator: Operator, stream: Stream) -> ErgonomicField:
        """E on a grid that covers :meth:`bounds`; ``stream`` is the replicate's randomness, if the model needs any."""


class VoxelBackend(ABC):
    """Keeps, for every cell, what the samples that fell into it left there.

    A *store* is one thread's NumPy array or tuple of arrays. ``deposit`` is called for blocks of cell numbers and
    values, where the value -1 stands for a sample below the threshold (counted as a hit, not a survivor). A backend
    whose ``deposit`` is a numba function is linked into the compiled flow.
    """

    deposit: Any
    """``deposit(store, cells, values, count)``; a static function."""

    def suited(self, cells: int) -> VoxelBackend:
        """The backend to use for so many cells: itself, unless it chooses by size."""
        return self

    @abstractmethod
    def open(self, cells: int) -> Any:
        """An empty store for cells 0 ... cells - 1."""

    def ready(self, store: Any, deposits: int) -> Any:
        """The store, grown where it could not take so many more deposits as it is."""
        return store

    @abstractmethod
    def merge(self, into: Any, other: Any) -> Any:
        """The store with another thread's added; the result may not depend on the order of merging."""

    @abstractmethod
    def values(self, store: Any) -> Array:
        """The aggregate per cell, shape (cells,); 0 where nothing survived."""

    @abstractmethod
    def hits(self, store: Any) -> NDArray[np.int64]:
        """Samples that fell into each cell before any threshold, shape (cells,)."""

    bytes_per_cell: int
    """Memory that one store takes per cell; eiwa asks for it before it opens a store."""


class Metric(ABC):
    """Numbers per design."""

    @abstractmethod
    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The metric's numbers by name, as its record declares them; None where one does not apply."""


def where_valid(valid: Column, a: Column, b: Column) -> Column:
    """:func:`where` that folds a mask which is the constant True."""
    return a if valid is True else where(valid, a, b)


def parted(columns: Sequence[Column], widths: Sequence[int]) -> list[list[Column]]:
    """The columns one after another as lists of so many."""
    rest = iter(columns)
    return [[*islice(rest, width)] for width in widths]


_maps: dict[Hashable, Map] = {}


def compiled_map(
    key: tuple[Any, ...],
    function: Any,
    inputs: int | tuple[int, ...],
    parameters: int,
    dtype: Any = float,
    outputs: tuple[int, ...] = (),
    samples: int = BLOCK,
) -> Map:
    """The compiled map of a function, kept while its structure is known (no None in the key)."""
    full = (*key, inputs, parameters, np.dtype(dtype))
    if full not in _maps or None in key:
        made = Map(function, inputs, parameters, dtype, outputs=outputs, samples=samples)
        if None in key:
            return made
        _maps[full] = made
    return _maps[full]
