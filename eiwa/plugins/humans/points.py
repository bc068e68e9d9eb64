"""A lab's own measured positions of the hands, from a CSV or Parquet file, smoothed into E."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo, field_validator

from eiwa.core.compiled import compiled
from eiwa.core.hookspecs import DataFile, FileParameter, Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, ErgonomicField, HumanModel, Operator
from eiwa.core.sampling import Stream
from eiwa.core.workspace import Grid

AXES = ("x", "y", "z")
FARTHEST = 10.0
"""A coordinate beyond so many metres is one in other units."""


class PointsParameters(Parameters):
    """Measured positions of the hands: a file with columns x, y, z (metres, in W) and, if known, weight and hand."""

    hands: Literal["measured", "mirrored"] = quantity(
        "measured",
        description="'measured': each hand from its own points, told apart by the column hand ('right', 'left'), else by "
        "the sign of x (right: x >= 0). 'mirrored': both hands from all points, those of the left mirrored in x.",
    )
    radius: float = quantity(
        0.03, ge=0, unit="m", source="assumed",
        description="A point counts 1 - (d / radius)^2 times its weight in a cell at distance d < radius, and fully in its own.",
    )  # fmt: skip
    rule: Literal["max", "mean", "reached"] = quantity(
        "max",
        description="From counts to E: in proportion, with 'comfort' as the largest E, or as the mean over the cells with "
        "E > 0 before it is capped at 1; or 'comfort' wherever there is a count.",
    )
    comfort: float = quantity(0.5, gt=0, le=1, source="the paper", description="Largest or mean E, as the rule says.")
    file: FileParameter = quantity(description="CSV or Parquet file, relative to the study file.")

    @field_validator("file")
    @classmethod
    def _can_be_read(cls, file: DataFile, info: ValidationInfo) -> DataFile:
        read(file, info.data.get("hands", "mirrored"))
        return file


@dataclass(frozen=True, eq=False)
class Positions:
    """Right and left: positions (n, 3) [m] in W and weights (n,) in (0, 1]."""

    right: tuple[Array, Array]
    left: tuple[Array, Array]


@lru_cache(maxsize=8)
def read(file: DataFile, hands: str) -> Positions:
    """The points of a file, by hand.

    Raises
    ------
    ValueError
        The file is none of the two kinds, lacks a column, holds what is no finite number, a negative weight, nothing
        that weighs, an unknown hand or, with ``measured``, none of one hand.
    """
    columns = _columns(file)
    points = np.column_stack([_numbers(columns, name) for name in AXES])
    weights = _numbers(columns, "weight") if "weight" in columns else np.ones(len(points))
    if not len(points):
        raise ValueError("the file has no rows")
    if (weights < 0).any():
        raise ValueError(f"row {np.argmax(weights < 0) + 1} has a negative weight: weights are 0 or more")
    if not (weights > 0).any():
        raise ValueError("all weights are zero: nothing is left to make E of")
    row, axis = np.unravel_index(np.abs(points).argmax(), points.shape)
    if abs(points[row, axis]) > FARTHEST:
        raise ValueError(
            f"row {row + 1} has {AXES[axis]} = {points[row, axis]:g}: write metres in the operator frame W"
        )
    right = _is_right(columns["hand"]) if "hand" in columns else points[:, 0] >= 0
    used = weights > 0
    points, weights, right = points[used], weights[used] / weights.max(), right[used]
    if hands == "mirrored":
        points = np.where(right[:, None], points, points * [-1, 1, 1])
        return Positions((points, weights), (points * [-1, 1, 1], weights))
    for name, mine in (("right", right), ("left", ~right)):
        if not mine.any():
            raise ValueError(f"no point of the {name} hand: measure both, or write hands = 'mirrored'")
    return Positions((points[right], weights[right]), (points[~right], weights[~right]))


def _columns(file: DataFile) -> dict[str, Any]:
    """The file's columns by name, as pyarrow arrays."""
    import pyarrow as pa
    from pyarrow import csv, parquet

    kind = file.path.suffix.lower()
    if kind not in (".csv", ".parquet"):
        raise ValueError("must be a .csv or a .parquet file")
    try:
        table = csv.read_csv(file.path) if kind == ".csv" else parquet.ParquetFile(file.path).read()
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"the file cannot be read as {kind[1:]} ({str(error).splitlines()[0]})") from None
    missing = [name for name in AXES if name not in table.column_names]
    if missing:
        raise ValueError(f"has no column {', '.join(missing)} (it has {', '.join(table.column_names)})")
    return dict(zip(table.column_names, table.columns, strict=True))


def _numbers(columns: dict[str, Any], name: str) -> Array:
    """One column as finite numbers."""
    import pyarrow as pa

    try:
        values = np.asarray(columns[name].cast(pa.float64()).to_numpy(), float)
    except pa.ArrowException:
        raise ValueError(f"column {name} must hold numbers, not {columns[name].type}") from None
    if not np.isfinite(values).all():
        row = np.argmin(np.isfinite(values))
        raise ValueError(f"row {row + 1} has {name} = {values[row]}: remove it or fill it in")
    return values


def _is_right(hand: Any) -> NDArray[np.bool_]:
    names = np.array([str(name) for name in hand.to_pylist()])
    known = np.isin(names, ("right", "left"))
    if not known.all():
        row = np.argmin(known)
        raise ValueError(f"row {row + 1} has hand = {str(names[row])!r}: must be 'right' or 'left'")
    is_right: NDArray[np.bool_] = names == "right"
    return is_right


@dataclass(frozen=True, eq=False)
class Points(HumanModel):
    """E from counts of measured positions: no posture, no lengths, no symmetry but what was measured."""

    parameters: PointsParameters

    @property
    def positions(self) -> Positions:
        """The points by hand."""
        return read(self.parameters.file, self.parameters.hands)

    def bounds(self, operator: Operator) -> NDArray[np.float64]:
        """Box of all points and what is nearer to them than the radius."""
        points = np.concatenate([self.positions.right[0], self.positions.left[0]])
        # A count at distance 0 alone, or on a face, still has a cell of its own.
        margin = self.parameters.radius + 1e-9
        return np.array([points.min(axis=0) - margin, points.max(axis=0) + margin]) + [0, 0, operator.armrest]

    def field(self, grid: Grid, operator: Operator, stream: Stream) -> ErgonomicField:
        """Counts of both hands, scaled alike."""
        p = self.parameters
        counts = np.zeros((2, *grid.shape))
        for side, (points, weights) in zip(counts, (self.positions.right, self.positions.left), strict=True):
            _count(side, (points + [0, 0, operator.armrest]) / grid.r, weights, p.radius / grid.r, grid.origin)
        if p.hands == "mirrored":
            counts[1] = grid.mirrored(counts[0])
        if p.rule == "reached":
            E = np.where(counts > 0, p.comfort, 0.0)
        else:
            positive = counts[counts > 0]
            E = np.minimum(counts * (p.comfort / (positive.mean() if p.rule == "mean" else positive.max())), 1.0)
        return ErgonomicField(E[0], E[1])


@compiled
def _count(counts: Any, cells: Any, weights: Any, radius: Any, origin: Any) -> None:
    """Add every point to the cells nearer than ``radius`` (all in units of a cell) and to its own."""
    for n in range(len(cells)):
        x, y, z = cells[n]
        for i in range(*_around(x, radius, origin[0], counts.shape[0])):
            for j in range(*_around(y, radius, origin[1], counts.shape[1])):
                for k in range(*_around(z, radius, origin[2], counts.shape[2])):
                    square = _gap(x, i) ** 2 + _gap(y, j) ** 2 + _gap(z, k) ** 2
                    cell = i - origin[0], j - origin[1], k - origin[2]
                    if square < radius * radius:
                        counts[cell] += weights[n] * (1.0 - square / (radius * radius))
                    elif square == 0.0:
                        counts[cell] += weights[n]


@compiled
def _around(x: Any, radius: Any, origin: Any, count: Any) -> Any:
    """The cells of one axis of the grid that are nearer than ``radius``: first, and one behind the last."""
    return max(int(np.floor(x - radius)), origin), min(int(np.floor(x + radius)) + 1, origin + count)


@compiled
def _gap(x: Any, cell: Any) -> Any:
    """Distance of a coordinate to a cell."""
    return max(cell - x, x - (cell + 1), 0.0)


@hookimpl
def eiwa_humans() -> list[Plugin]:
    """Measured points."""
    return [Plugin("points", PointsParameters, Points)]
