"""Contracts of human models."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from eiwa.core.evaluation import ergonomic_grid, field_stream
from eiwa.core.interfaces import Array, ErgonomicField, HumanModel, Operator
from eiwa.core.workspace import Grid
from eiwa.testing.contract import Contract, Violation
from eiwa.testing.subject import Subject

SIZE = 0.04
"""Voxel size [m] at which most is looked at; half and twice of it are compared."""
MARGIN = 2
"""Layers of cells around the bounds in which E must be 0."""
LIFT = 3 * SIZE
OPERATORS = {
    "as it is": Operator(),
    "armrest raised": Operator(armrest=LIFT),
    "armrest lowered": Operator(armrest=-LIFT),
    "seat moved back": Operator(seat=LIFT),
}


def builds(subject: Subject) -> str:
    """build(parameters) returns a HumanModel."""
    if not isinstance(subject.part, HumanModel):
        cause = "build is a function that does not return what it makes, or the class does not derive from HumanModel."
        raise Violation("an eiwa.core.interfaces.HumanModel", f"{type(subject.part).__name__}", cause)
    return type(subject.part).__name__


def has_bounds(subject: Subject) -> str:
    """bounds(operator) is a finite box [[low x, y, z], [high x, y, z]] in metres."""
    box = np.asarray(subject.part.bounds(Operator()))
    if box.shape != (2, 3) or not np.isfinite(box).all() or not (box[0] < box[1]).all():
        raise Violation("an array (2, 3) of finite numbers, low below high", f"{box.tolist()}")
    if np.abs(box).max() > 10:
        raise Violation("a box that hands can reach, in metres", f"{box.tolist()}", "millimetres or centimetres.")
    return " x ".join(f"{size:.3g}" for size in box[1] - box[0]) + " m"


def has_the_grids_shape(subject: Subject) -> str:
    """field(grid, operator, stream) gives E of both hands in the grid's shape, within [0, 1], not 0 everywhere."""
    grid = _grid(subject, SIZE)
    field = _field(subject, grid)
    if not isinstance(field, ErgonomicField):
        raise Violation("an ErgonomicField", f"{type(field).__name__}")
    for hand, E in (("right", field.right), ("left", field.left)):
        if np.shape(E) != grid.shape:
            cause = "axes in another order: E[i, j, k] belongs to x, y, z."
            raise Violation(f"E of the {hand} hand in shape {grid.shape}", f"{np.shape(E)}", cause)
        if not (np.isfinite(E).all() and np.min(E) >= 0 and np.max(E) <= 1):
            raise Violation(f"E of the {hand} hand in [0, 1]", f"{np.min(E):.4g} to {np.max(E):.4g}")
        if not np.any(E):
            cause = "cell indices instead of metres, or a grid origin that is left out."
            raise Violation(f"cells where the {hand} hand is comfortable", "E = 0 everywhere", cause)
    right, left = (np.count_nonzero(E) * grid.r**3 * 1e3 for E in (field.right, field.left))
    return f"E up to {max(field.right.max(), field.left.max()):.3g}; {right:.3g} l right, {left:.3g} l left"


def stays_within_its_bounds(subject: Subject) -> str:
    """E is 0 outside bounds(operator), whatever the operator."""
    for name, operator in OPERATORS.items():
        box = subject.part.bounds(operator)
        grid = _grid(subject, SIZE, operator)
        field = _field(subject, grid, operator)
        for hand, E in (("right", field.right), ("left", field.left)):
            for axis in range(3):
                faces = grid.faces(axis)
                outside = (faces[1:] < box[0][axis] - 1e-9) | (faces[:-1] > box[1][axis] + 1e-9)
                if np.moveaxis(np.asarray(E), axis, 0)[outside].any():
                    cause = "bounds without the operator's armrest or seat, or without one hand; positions without grid.origin."
                    seen = f"{hand} hand, {'xyz'[axis]} axis, operator {name}: E > 0 outside {box[:, axis].tolist()}"
                    raise Violation("E = 0 outside the bounds", seen, cause)
    return ", ".join(OPERATORS)


def does_not_depend_on_the_grids_extent(subject: Subject) -> str:
    """A larger grid of the same cells has the same E in them."""
    tight, wide = _grid(subject, SIZE, margin=0), _grid(subject, SIZE, margin=3)
    small, large = _field(subject, tight), _field(subject, wide)
    shift = np.array(tight.origin) - wide.origin
    part = tuple(slice(s, s + n) for s, n in zip(shift, tight.shape, strict=True))
    for hand, E, whole in (("right", small.right, large.right), ("left", small.left, large.left)):
        change = np.abs(np.asarray(whole)[part] - E)
        if change.max() > 1e-9:
            cause = "positions computed from cell numbers without grid.origin, or a normalisation over the grid."
            seen = f"E of the {hand} hand differs in {np.count_nonzero(change)} cells, by up to {change.max():.3g}"
            raise Violation("the same E on a grid with 3 more layers", seen, cause)
    return "same cells, same E"


def agrees_between_voxel_sizes(subject: Subject) -> str:
    """Finer and coarser grids show the same body: hardly a cell without its counterpart, and the same middle."""
    grids = [_grid(subject, size) for size in (SIZE / 2, SIZE, 2 * SIZE)]
    fields = [_field(subject, grid) for grid in grids]
    volumes = []
    for hand in ("right", "left"):
        E = [np.asarray(getattr(field, hand)) for field in fields]
        volumes.append(", ".join(f"{np.count_nonzero(e) * g.r**3 * 1e3:.3g}" for e, g in zip(E, grids, strict=True)))
        for k in (0, 1):
            lost = _without_counterpart(E[k], grids[k], E[k + 1], grids[k + 1])
            moved = np.abs(_middle(E[k], grids[k]) - _middle(E[k + 1], grids[k + 1])).max()
            if lost > 0.02 or moved > grids[k + 1].r:
                seen = f"{hand} hand, r = {grids[k].r:g} and {grids[k + 1].r:g} m: {lost:.0%} of the fine cells lie outside "
                cause = "lengths in cells instead of metres, or too few samples for the finer grid."
                raise Violation(
                    "one body at every size", f"{seen}the coarse ones, the middle moves by {moved:.3g} m", cause
                )
    sizes = ", ".join(f"{1e3 * g.r:g}" for g in grids)
    return f"at {sizes} mm: right {volumes[0]} l, left {volumes[1]} l"


def follows_the_operator(subject: Subject) -> str:
    """A raised armrest lifts E by as much, or leaves it alone (a model that does not rest on it); so for the seat."""
    said = []
    still = _field(subject, _common_grid(subject))
    for name, operator, axis in (
        ("armrest", OPERATORS["armrest raised"], 2),
        ("seat", OPERATORS["seat moved back"], 1),
    ):
        grid = _common_grid(subject)
        moved = _field(subject, grid, operator)
        shifts = [_middle(getattr(moved, h), grid) - _middle(getattr(still, h), grid) for h in ("right", "left")]
        if not np.isfinite(shifts).all():
            raise Violation(f"hands that are comfortable somewhere when the {name} moves", "E = 0 everywhere")
        shift = np.mean(shifts, axis=0)
        if name == "armrest" and shift[2] < -SIZE / 2:
            seen = f"E moves down by {-shift[2]:.3g} m when the armrest rises by {LIFT:g} m"
            raise Violation("E that rises with the armrest", seen, "the sign of operator.armrest.")
        said.append(f"{name} {LIFT:g} m: E moves {shift[axis]:+.3f} m in {'xyz'[axis]}")
    return "; ".join(said)


def is_deterministic(subject: Subject) -> str:
    """The same stream gives the same E, from this model and from another one built alike."""
    grid = _grid(subject, SIZE)
    first = _field(subject, grid)
    kept = np.array(first.right), np.array(first.left)
    again, other = _field(subject, grid), subject.build().field(grid, Operator(), field_stream(1, 0))
    for who, field in (("asked again", again), ("built again", other)):
        for hand, one, two in (("right", kept[0], field.right), ("left", kept[1], field.left)):
            if not np.array_equal(one, two):
                cause = "random numbers that do not come from the stream that is handed over."
                raise Violation("the same E for the same stream", f"{who}, E of the {hand} hand differs", cause)
    return "bit by bit"


def keeps_nothing_between_calls(subject: Subject) -> str:
    """E does not depend on the operator, grid or stream of the call before, and is left alone afterwards."""
    grid = _grid(subject, SIZE, OPERATORS["armrest raised"], margin=6)
    answer = _field(subject, grid)
    kept = np.array(answer.right), np.array(answer.left)
    _field(subject, grid, OPERATORS["armrest raised"])
    subject.part.field(_grid(subject, SIZE / 2), Operator(), field_stream(2, 1))
    if not (np.array_equal(kept[0], answer.right) and np.array_equal(kept[1], answer.left)):
        cause = "the same array is filled and returned every time. Return a new one."
        raise Violation("fields that are left alone once they are returned", "E changed with the next call", cause)
    again = _field(subject, grid)
    if not (np.array_equal(kept[0], again.right) and np.array_equal(kept[1], again.left)):
        cause = "something kept on self: a cache must know the grid, the operator and the stream it was made for."
        raise Violation("the same E whatever was asked before", "E differs after other calls", cause)
    return "nothing kept between calls"


def tells_its_spread_over_streams(subject: Subject) -> str:
    """How much the volume with E > 0 changes from one stream to the next."""
    grid = _grid(subject, SIZE)
    volumes = [np.sum(subject.part.field(grid, Operator(), field_stream(1, k)).right) for k in range(3)]
    return f"{np.ptp(volumes) / np.mean(volumes):.2%} of its sum"


def tells_its_symmetry(subject: Subject) -> str:
    """Whether the left hand is the mirror image of the right one; it need not be."""
    grid = _grid(subject, SIZE)
    field = _field(subject, grid)
    apart = np.abs(np.asarray(field.right)[::-1] - field.left)
    return (
        "mirror images"
        if apart.max() <= 1e-9
        else f"E differs by up to {apart.max():.3g} in {(apart > 1e-9).sum()} cells"
    )


def tells_its_speed(subject: Subject) -> str:
    """How long one field takes; it is computed once per operator and replicate."""
    grid = _grid(subject, SIZE / 2)
    start = time.perf_counter()
    _field(subject, grid)
    return f"{time.perf_counter() - start:.2g} s for {grid.cells:,} cells of {1e3 * grid.r:g} mm"


def _grid(subject: Subject, r: float, operator: Operator | None = None, margin: int = MARGIN) -> Grid:
    """The grid that a study would make, with some more layers of cells."""
    grid = ergonomic_grid([np.asarray(subject.part.bounds(operator or Operator()), float)], r)
    x, y, z = (o - margin for o in grid.origin)
    nx, ny, nz = (n + 2 * margin for n in grid.shape)
    return replace(grid, origin=(x, y, z), shape=(nx, ny, nz))


def _common_grid(subject: Subject) -> Grid:
    """A grid that covers every operator."""
    return ergonomic_grid([np.asarray(subject.part.bounds(operator), float) for operator in OPERATORS.values()], SIZE)


def _field(subject: Subject, grid: Grid, operator: Operator | None = None) -> ErgonomicField:
    field: ErgonomicField = subject.part.field(grid, operator or Operator(), field_stream(1, 0))
    return field


def _middle(E: Array, grid: Grid) -> NDArray[np.float64]:
    """Centre of the cells with E > 0 [m]."""
    cells = np.argwhere(np.asarray(E) > 0)
    if not len(cells):
        return np.full(3, np.nan)
    return np.asarray((cells.mean(axis=0) + grid.origin + 0.5) * grid.r)


def _without_counterpart(fine: Array, fine_grid: Grid, coarse: Array, coarse_grid: Grid) -> float:
    """Share of the cells with E > 0 on one grid that are not in or beside one on the other grid; the larger share."""
    centres = (np.argwhere(fine > 0) + fine_grid.origin + 0.5) * fine_grid.r
    shrunk, kept = np.zeros(coarse.shape, bool), coarse > 0
    shrunk[tuple((np.floor(centres / coarse_grid.r).astype(int) - coarse_grid.origin).T)] = True
    return max(float((one & ~_grown(other)).sum() / one.sum()) for one, other in ((shrunk, kept), (kept, shrunk)))


def _grown(body: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells of a body and their neighbours."""
    padded = np.pad(body, 1)
    grown: NDArray[np.bool_] = np.zeros(body.shape, bool)
    for start in np.ndindex(3, 3, 3):
        grown = grown | padded[tuple(slice(s, s + n) for s, n in zip(start, body.shape, strict=True))]
    return grown


BASIC: tuple[Contract, ...] = (builds, has_bounds, has_the_grids_shape, stays_within_its_bounds)
CONTRACTS: tuple[Contract, ...] = (
    *BASIC,
    is_deterministic,
    keeps_nothing_between_calls,
    does_not_depend_on_the_grids_extent,
    agrees_between_voxel_sizes,
    follows_the_operator,
    tells_its_spread_over_streams,
    tells_its_symmetry,
    tells_its_speed,
)
