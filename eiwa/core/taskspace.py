"""Which rows of a Jacobian an index looks at, and the length by which its linear rows are divided.

Linear rows are in m/rad, angular rows in rad/rad. Singular values of both together mean something only once the linear
rows are divided by a characteristic length L.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from eiwa.core.hookspecs import Parameters, quantity
from eiwa.core.interfaces import Postures
from eiwa.core.linear import Matrix
from eiwa.core.symbols import Column

Row = Literal["x", "y", "z", "rx", "ry", "rz"]
ROWS: tuple[Row, ...] = ("x", "y", "z", "rx", "ry", "rz")
LINEAR = 3
"""The first rows are linear, the others angular."""
_NAMED: dict[str, Sequence[Row]] = {"all": ROWS, "translation": ROWS[:LINEAR], "rotation": ROWS[LINEAR:]}


def _distinct(rows: str | list[Row]) -> str | list[Row]:
    if not isinstance(rows, str) and (not rows or len(set(rows)) < len(rows)):
        raise ValueError("must name at least one row, each once")
    return rows


RowsParameter = Annotated[Literal["all", "translation", "rotation"] | list[Row], AfterValidator(_distinct)]
"""Type of a parameter that chooses rows of the Jacobian; see :func:`row_numbers`."""
ROWS_FIELD: Any = quantity("all", description="Rows of the Jacobian that the index looks at.")
LengthParameter = Literal["auto"] | Annotated[float, Field(gt=0)]
"""Type of a parameter that gives a characteristic length; see :func:`characteristic_length`."""
LENGTH_FIELD: Any = quantity(
    "auto",
    unit="m",
    description="Characteristic length by which linear rows are divided, so that units do not mix; 'auto': RMS of the "
    "linear over RMS of the angular entries in the chosen rows, over the pilot's valid postures; 1 where there is only "
    "one kind.",
)


class TaskSpace(Parameters):
    """Parameters of an index of singular values: which rows, in which length."""

    rows: RowsParameter = ROWS_FIELD
    length: LengthParameter = LENGTH_FIELD


def row_numbers(rows: str | Sequence[Row]) -> tuple[int, ...]:
    """Numbers of the chosen rows, ascending."""
    return tuple(sorted(ROWS.index(name) for name in (_NAMED[rows] if isinstance(rows, str) else rows)))


def characteristic_length(length: float | Literal["auto"], rows: Sequence[int], pilot: Postures) -> float:
    """The length L [m] by which linear rows are divided.

    With ``auto``, L = RMS of the linear over RMS of the angular entries in the chosen rows of the pilot's Jacobians, so
    that both kinds weigh the same on average; 1 where one kind is not chosen or zero at every posture.
    """
    if length != "auto":
        return float(length)
    chosen = np.asarray(rows)
    linear, angular = (
        float(np.mean(np.square(pilot.jacobians[:, kind, :]))) if len(kind) else 0.0
        for kind in (chosen[chosen < LINEAR], chosen[chosen >= LINEAR])
    )
    return float(np.sqrt(linear / angular)) if linear > 0 and angular > 0 else 1.0


def scaled(jacobian: Matrix, rows: Sequence[int], inverse_length: Column) -> list[list[Column]]:
    """The chosen rows, linear ones times ``inverse_length`` [1/m]."""
    return [[entry * inverse_length for entry in jacobian[k]] if k < LINEAR else list(jacobian[k]) for k in rows]
