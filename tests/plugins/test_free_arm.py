"""An arm without an armrest: its chain written out, its volume against plain sampling, and the seat."""

import numpy as np
import pytest
from pydantic import ValidationError

from eiwa.core.evaluation import field_stream
from eiwa.core.interfaces import Operator
from eiwa.core.workspace import Grid
from eiwa.plugins.humans.free_arm import RANGES, FreeArmParameters, to_limits
from tests import humans
from tests.humans import field, own_grid

P = FreeArmParameters()
SHOULDER = np.array([P.shoulder_side, -P.shoulder_back, P.shoulder_height])


def arm(ranges="comfort", **parameters):
    return humans.human("free_arm", ranges=ranges, **parameters)


# The chain, written out.


def turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def grip(flexion, abduction, rotation, elbow, pronation, wrist, deviation):
    """The grip from the shoulder: Rx Ry(-) Rz, down the upper arm, Rx, down the forearm, Rz Ry Rx, down to the grip."""
    R_upper = turn("x", flexion) @ turn("y", -abduction) @ turn("z", rotation)
    R_fore = R_upper @ turn("x", elbow)
    R_hand = R_fore @ turn("z", pronation) @ turn("y", wrist) @ turn("x", deviation)
    return -(R_upper[:, 2] * P.upper_arm + R_fore[:, 2] * P.forearm + R_hand[:, 2] * P.grip)


@pytest.mark.parametrize("ranges", RANGES)
def test_tips_are_the_product_of_the_transforms(ranges):
    u = np.random.default_rng(0).uniform(size=(40, 7))
    low, high = np.radians(RANGES[ranges]).T
    expected = [grip(*q) for q in low + u * (high - low)]
    np.testing.assert_allclose(arm(ranges).chain.tips(u), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("moved", "direction"),
    [
        ({"flexion": 1.0}, [0, 1, 0]),
        ({"abduction": 1.0}, [1, 0, 0]),
        ({"elbow": 1.0}, [0, 1, 0]),
        ({"elbow": np.pi / 2, "rotation": 1.0}, [-1, 0, 0]),
        ({"elbow": np.pi / 2, "wrist": 1.0}, [-1, 0, 0]),
        ({"elbow": np.pi / 2, "deviation": 1.0}, [0, 0, 1]),
    ],
)
def test_directions_are_anatomical(moved, direction):
    """The right hand goes forward, outward, forward; inward, inward with the palm, up with the thumb."""
    names = ("flexion", "abduction", "rotation", "elbow", "pronation", "wrist", "deviation")
    still = {name: (np.pi / 2 if name == "elbow" and "elbow" in moved and len(moved) > 1 else 0.0) for name in names}
    before, after = (grip(*({**still, **change}[name] for name in names)) for change in ({}, moved))
    assert np.dot(after - before, direction) > 0.05


# The cells.


@pytest.mark.parametrize("ranges", RANGES)
def test_the_volume_is_that_of_plain_samples(ranges):
    """Seven joints at random, many at their limits, in cells of 40 mm: the border is fuzzy by what either has missed."""
    human, r = arm(ranges), 0.04
    grid = own_grid(human, r)
    marked = np.zeros(grid.shape, bool)
    for first in range(0, 1 << 21, 1 << 17):
        u = to_limits(field_stream(1, 7).points(first, 1 << 17, 7))
        cells = np.floor((human.chain.tips(u) + SHOULDER) / r).astype(int) - grid.origin
        marked[tuple(cells.T)] = True
    E = field(human, grid).right > 0
    assert np.count_nonzero(marked & ~E) < 0.06 * marked.sum()
    assert E.sum() == pytest.approx(marked.sum(), rel=0.06)


@pytest.mark.parametrize("ranges", RANGES)
def test_random_postures_lie_inside(ranges):
    human = arm(ranges)
    grid = own_grid(human, 0.02)
    u = np.random.default_rng(2).uniform(size=(20_000, 7))
    cells = np.floor((human.chain.tips(u) + SHOULDER) / grid.r).astype(int) - grid.origin
    assert (field(human, grid).right[tuple(cells.T)] > 0).mean() > 0.999


def test_wider_ranges_reach_more():
    grid = own_grid(arm("maximal"), 0.04)
    comfort, functional, maximal = (field(arm(ranges), grid).right > 0 for ranges in RANGES)
    assert np.count_nonzero(comfort & ~functional) + np.count_nonzero(functional & ~maximal) < 0.01 * comfort.sum()


def test_no_cell_lies_beyond_the_arm():
    """But for half a cell's diagonal, and half of one of the half as large cells in which arcs are collected."""
    human, r = arm("maximal"), 0.02
    grid = own_grid(human, r)
    centres = (np.argwhere(field(human, grid).right > 0) + grid.origin + 0.5) * r
    length = P.upper_arm + P.forearm + P.grip
    assert np.linalg.norm(centres - SHOULDER, axis=1).max() < length + r * (3**0.5 / 2 + 2**0.5 / 4)


def test_replicates_agree_on_nearly_all_cells():
    human = arm()
    grid = own_grid(human, 0.02)
    one, other = (field(human, grid, replicate=k).right > 0 for k in (0, 1))
    assert (one != other).sum() <= 0.02 * one.sum()


# The operator.


def test_the_seat_moves_the_hands_back_by_whole_cells():
    human, r = arm(samples=1 << 16), 0.015625
    grid = Grid(r, (-40, -30, -25), (80, 60, 52))
    near, far = field(human, grid).right, field(human, grid, Operator(seat=4 * r)).right
    np.testing.assert_array_equal(far[:, :-4], near[:, 4:])


def test_the_seat_and_the_armrest_move_the_bounds():
    """Its height follows the seat's, which follows the armrest's."""
    human = arm()
    moved = human.bounds(Operator(seat=0.1, armrest=0.05)) - human.bounds(Operator())
    np.testing.assert_allclose(moved, [[0, -0.1, 0.05]] * 2, atol=1e-15)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"ranges": "wide"}, "'comfort', 'functional' or 'maximal'"),
        ({"upper_arm": -0.3}, "greater than 0"),
        ({"comfort": 0.0}, "greater than 0"),
        ({"samples": 3}, "greater than or equal to 1024"),
    ],
)
def test_parameters_that_cannot_be_are_refused(parameters, message):
    with pytest.raises(ValidationError, match=message):
        FreeArmParameters(**parameters)
