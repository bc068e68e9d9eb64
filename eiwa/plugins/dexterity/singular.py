"""Indices of the Jacobian's singular values: how evenly, and how well at worst, an arm moves in all directions."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eiwa.core.hookspecs import Plugin, hookimpl
from eiwa.core.interfaces import Arm, ArmColumns, Postures, TracedIndex
from eiwa.core.linear import Matrix
from eiwa.core.singular import extremes, inverse_condition, isotropy
from eiwa.core.symbols import Column
from eiwa.core.taskspace import TaskSpace, characteristic_length, row_numbers, scaled


class ConditionParameters(TaskSpace):
    """Inverse condition number: smallest over largest singular value of J."""


class SmallestParameters(TaskSpace):
    """Smallest singular value of J: tip speed per joint speed in the worst direction."""


class IsotropyParameters(TaskSpace):
    """Geometric over arithmetic mean of J's singular values."""


@dataclass(frozen=True)
class SingularValueIndex(TracedIndex):
    """A function of the singular values of J's chosen rows, linear rows divided by the characteristic length.

    There are min(rows, joints) singular values: with fewer joints than rows, those of the motions that exist.
    """

    rows: tuple[int, ...]
    length: float | Literal["auto"]

    @property
    def structure(self) -> tuple[int, ...]:  # type: ignore[override]
        """The chosen rows; the length is a parameter of the kernel."""
        return self.rows

    def prepare(self, arm: Arm, pilot: Postures) -> NDArray[np.float64]:
        """1 / L."""
        return np.array([1.0 / characteristic_length(self.length, self.rows, pilot)])

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """The index on columns."""
        return self.of(scaled(arm.jacobian, self.rows, p[0]))

    @abstractmethod
    def of(self, J: Matrix) -> Column:
        """The index of a Jacobian."""


class Condition(SingularValueIndex):
    """1 / cond J in [0, 1]: 1 where all directions are equal, 0 at a singularity."""

    def of(self, J: Matrix) -> Column:
        """Smallest over largest singular value."""
        return inverse_condition(J)


class Smallest(SingularValueIndex):
    """The smallest singular value, 0 at a singularity."""

    def of(self, J: Matrix) -> Column:
        """Smallest singular value."""
        return extremes(J)[0]


class Isotropy(SingularValueIndex):
    """Geometric over arithmetic mean in [0, 1]: 1 where all directions are equal, 0 at a singularity."""

    def of(self, J: Matrix) -> Column:
        """Geometric over arithmetic mean."""
        return isotropy(J)


def _plugin(name: str, parameters: type[TaskSpace], index: type[SingularValueIndex]) -> Plugin:
    return Plugin(name, parameters, lambda given: index(row_numbers(given.rows), given.length))


@hookimpl
def eiwa_dexterities() -> list[Plugin]:
    """Three views of the singular values."""
    return [
        _plugin("condition", ConditionParameters, Condition),
        _plugin("smallest_singular_value", SmallestParameters, Smallest),
        _plugin("isotropy", IsotropyParameters, Isotropy),
    ]
