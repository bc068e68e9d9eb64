"""The paper's operator: its chain written out, its volume, its symmetry, and how it answers to its parameters.

Volumes and extents: facts of the project for the default lengths (ANSUR II) and ranges.
"""

import numpy as np
import pytest
from pydantic import ValidationError

from eiwa.core.anthropometry import lengths
from eiwa.core.evaluation import field_stream
from eiwa.core.forearm import to_ends
from eiwa.core.interfaces import Operator
from eiwa.core.workspace import Grid
from eiwa.plugins.humans.ehem import EhemParameters, PersonParameters, person
from tests import humans
from tests.humans import field, litres, own_grid

DEG = np.pi / 180
DEFAULT = EhemParameters()


def ehem(samples=1 << 18, **parameters):
    return humans.human("ehem", samples=samples, **parameters)


def full():
    return humans.human("ehem")


# The chain, written out.


def turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def grip(p, q1, q2, q3, q4, q5, q6, q7, q8):
    """Trans(x_e + q1, q2, z_f) Ry(q4) Rz(toe_in + q5) Rx(q3) Trans(0, L_fw, 0) Ry(q6) Rx(q7) Rz(q8) Trans(0, L_g, 0)."""
    fulcrum = np.array([p.half_width + q1, q2, p.fulcrum_height])
    R_arm = turn("y", q4) @ turn("z", p.toe_in * DEG + q5) @ turn("x", q3)
    R_hand = R_arm @ turn("y", q6) @ turn("x", q7) @ turn("z", q8)
    return fulcrum + R_arm @ [0, p.forearm, 0] + R_hand @ [0, p.grip, 0]


def between(ends, u):
    return ends[0] + u * (ends[1] - ends[0])


@pytest.mark.parametrize(
    "parameters", [{}, {"yaw": [-15.0, 15.0], "toe_in": 5.0, "grip": 0.06}], ids=["default", "yaw"]
)
def test_tips_are_the_product_of_the_transforms(parameters):
    human, p = ehem(**parameters), EhemParameters(**parameters)
    u = np.random.default_rng(0).uniform(size=(50, 6))
    ranges = (p.roll, p.yaw, p.pitch, p.pronation, p.deviation, p.flexion)
    angles = [between(np.array(r) * DEG, np.sin(np.pi / 2 * u[:, k]) ** 2) for k, r in enumerate(ranges)]
    q4, q5, q3, q6, q7, q8 = angles
    expected = [grip(p, 0, 0, *row) for row in zip(q3, q4, q5, q6, q7, q8, strict=True)]
    np.testing.assert_allclose(human.forearm.tips(to_ends(u)), expected, rtol=0, atol=1e-14)


# Volume and extent of one hand.


@pytest.mark.parametrize(("r", "expected"), [(0.02, 25.2), (0.01, 22.3), (0.005, 20.7)])
def test_volume_of_one_hand(r, expected):
    human = full()
    assert litres(field(human, own_grid(human, r)).right, r) == pytest.approx(expected, rel=0.01)


@pytest.fixture(scope="module")
def fine():
    """The default model at 5 mm: cells of the right hand (n, 3) in units of r, and r."""
    human = full()
    grid = own_grid(human, 0.005)
    return np.argwhere(field(human, grid).right > 0) + grid.origin, 0.005


@pytest.mark.parametrize(("axis", "span"), [(0, 0.406), (1, 0.236), (2, 0.371)])
def test_one_hand_spans_the_known_box(fine, axis, span):
    cells, r = fine
    assert np.ptp(cells[:, axis]) * r == pytest.approx(span, abs=2 * r)


def test_postures_are_centred_where_they_should_be():
    """The mean over uniform joints, slides at the middle of their ranges."""
    tips = full().forearm.tips(field_stream(1, 0).points(0, 1 << 16, 6))
    slides = [np.mean(DEFAULT.slide_side), np.mean(DEFAULT.slide_forward), 0.0]
    np.testing.assert_allclose(tips.mean(axis=0) + slides, [0.158, 0.421, 0.125], atol=1e-3)


def test_bounds_are_tight_in_y_and_z(fine):
    cells, r = fine
    low, high = full().bounds(Operator())
    np.testing.assert_allclose(cells.min(axis=0)[1:] * r, low[1:], atol=1.5 * r)
    np.testing.assert_allclose((cells.max(axis=0)[1:] + 1) * r, high[1:], atol=1.5 * r)


def test_nothing_is_lost_on_the_models_own_grid():
    human = ehem()
    own = own_grid(human, 0.02)
    wide = Grid(0.02, tuple(o - 3 for o in own.origin), tuple(n + 6 for n in own.shape))
    inner = field(human, wide).right[3:-3, 3:-3, 3:-3]
    assert (np.count_nonzero(inner), inner.tolist()) == (
        np.count_nonzero(field(human, wide).right),
        field(human, own).right.tolist(),
    )


def test_random_postures_of_the_whole_chain_lie_inside():
    """Slides and rotations at random, uniform: all but a few at the border, which the field's own samples missed."""
    human, grid = full(), own_grid(full(), 0.01)
    p, u = DEFAULT, np.random.default_rng(3).uniform(size=(20_000, 8))
    rotations = (p.pitch, p.roll, p.yaw, p.pronation, p.deviation, p.flexion)
    ends = np.array([p.slide_side, p.slide_forward, *(np.array(r) * DEG for r in rotations)])
    grips = np.array([grip(p, *row) for row in ends[:, 0] + u * (ends[:, 1] - ends[:, 0])])
    cells = np.floor(grips / grid.r).astype(int) - grid.origin
    assert (field(human, grid).right[tuple(cells.T)] > 0).mean() > 0.9999


def test_every_rotation_marks_its_rectangle_of_slides():
    """Cell by cell, for 2^10 rotations."""
    human, r = ehem(samples=1 << 10), 0.02
    grid, p = own_grid(human, r), DEFAULT
    tips = human.forearm.tips(to_ends(field_stream(1, 0).points(0, 1 << 10, 6)))
    expected = np.zeros(grid.shape, bool)
    for x, y, z in tips:
        first = np.floor((np.array([x + p.slide_side[0], y + p.slide_forward[0], z])) / r).astype(int) - grid.origin
        last = np.floor((np.array([x + p.slide_side[1], y + p.slide_forward[1], z])) / r).astype(int) - grid.origin
        expected[first[0] : last[0] + 1, first[1] : last[1] + 1, first[2]] = True
    np.testing.assert_array_equal(field(human, grid).right > 0, expected)


def still(**parameters):
    """An operator who can hardly turn: the grip stands at (0.3052, 0.3912, 0.055), slides aside.

    x = 0.41 - 0.405 sin 15 deg, y = 0.405 cos 15 deg.
    """
    turns = ("pitch", "roll", "pronation", "deviation", "flexion")
    locked = {name: [-1e-9, 1e-9] for name in turns}
    lengths = {"half_width": 0.41, "fulcrum_height": 0.055, "forearm": 0.3, "grip": 0.105}
    return ehem(samples=1 << 10, **{**locked, **lengths, **parameters})


def test_without_rotations_one_hand_is_a_rectangle():
    """x = 0.2452 to 0.3452, y = 0.3912 to 0.4512: with 0.02 m, cells 12 to 17, 19 to 22, and z in cell 2."""
    human = still(slide_side=[-0.06, 0.04], slide_forward=[0.0, 0.06])
    grid = Grid(0.02, (-20, 15, 0), (40, 15, 5))
    expected = np.zeros(grid.shape)
    expected[12 + 20 : 18 + 20, 19 - 15 : 23 - 15, 2] = 0.5
    np.testing.assert_array_equal(field(human, grid).right, expected)


def test_without_slides_one_hand_is_a_cell():
    human = still(slide_side=[0.0, 0.0], slide_forward=[0.0, 0.0])
    right = field(human, Grid(0.02, (-20, 15, 0), (40, 15, 5))).right
    assert np.argwhere(right > 0).tolist() == [[15 + 20, 19 - 15, 2]]


# The left hand is the mirror image.


def test_the_left_hand_is_the_flipped_right_one():
    human = ehem()
    both = field(human, own_grid(human, 0.02))
    np.testing.assert_array_equal(both.left, both.right[::-1])


def test_the_left_hand_on_a_grid_that_is_not_symmetric():
    """Columns -6 to -1 of a grid that starts at -6 are the mirror image of columns 5 to 0."""
    human = ehem()
    symmetric, lopsided = Grid(0.05, (-10, 4, -3), (20, 8, 12)), Grid(0.05, (-6, 4, -3), (16, 8, 12))
    np.testing.assert_array_equal(field(human, lopsided).left[:6], field(human, symmetric).left[4:10])


def test_bounds_are_symmetric():
    low, high = ehem().bounds(Operator())
    assert low[0] == -high[0]


def test_both_hands_lie_inside_the_bounds_grid():
    human = ehem()
    assert own_grid(human, 0.02).symmetric


# The operator's seat and armrest.


def test_the_armrest_moves_the_hands_in_z_by_whole_cells():
    human, r = ehem(), 0.015625
    grid = Grid(r, (-30, 10, -10), (60, 30, 40))
    low, high = field(human, grid).right, field(human, grid, Operator(armrest=5 * r)).right
    np.testing.assert_array_equal(high[:, :, 5:], low[:, :, :-5])


def test_the_armrest_moves_the_bounds():
    human = ehem()
    moved = human.bounds(Operator(armrest=0.1)) - human.bounds(Operator())
    np.testing.assert_allclose(moved, [[0, 0, 0.1]] * 2, atol=1e-15)


def test_the_seat_is_immaterial():
    human = ehem()
    grid = own_grid(human, 0.02)
    np.testing.assert_array_equal(field(human, grid, Operator(seat=0.3)).right, field(human, grid).right)


# Narrower ranges.

GRID = Grid(0.02, (-20, 12, -5), (40, 15, 22))


@pytest.mark.parametrize("narrower", [{"slide_side": [-0.03, 0.05]}, {"slide_forward": [0.05, 0.06]}])
def test_shorter_slides_give_a_subset(narrower):
    """Exactly, since the rotations are the same samples."""
    wide, narrow = (field(ehem(**parameters), GRID).right > 0 for parameters in ({}, narrower))
    assert not (narrow & ~wide).any()


@pytest.mark.parametrize(
    "narrower",
    [
        {"pitch": [0.0, 20.0]},
        {"roll": [-10.0, 10.0]},
        {"pronation": [-20.0, 30.0]},
        {"deviation": [-1.0, 1.0]},
        {"flexion": [-10.0, 0.0]},
    ],
)
def test_narrower_rotations_give_a_subset(narrower):
    """But for a few border cells that the samples of the wider ranges missed."""
    wide, narrow = (field(ehem(1 << 20, **parameters), GRID).right > 0 for parameters in ({}, narrower))
    assert (narrow & ~wide).sum() <= 0.005 * wide.sum()


@pytest.mark.parametrize("narrower", [{"pitch": [0.0, 20.0]}, {"roll": [-10.0, 10.0]}, {"slide_side": [0.0, 0.05]}])
def test_narrower_ranges_give_less(narrower):
    wide, narrow = (np.count_nonzero(field(ehem(**parameters), GRID).right) for parameters in ({}, narrower))
    assert narrow < 0.9 * wide


def test_a_yaw_about_the_fulcrum_gives_more():
    grid = Grid(0.02, (-30, 8, -5), (60, 22, 22))
    locked, free = (
        np.count_nonzero(field(ehem(**parameters), grid).right) for parameters in ({}, {"yaw": [-15.0, 15.0]})
    )
    assert free > 1.1 * locked


# E.


@pytest.mark.parametrize("comfort", [0.25, 0.5, 1.0])
def test_E_is_the_comfort_or_nothing(comfort):
    assert set(np.unique(field(ehem(comfort=comfort), GRID).right)) == {0.0, comfort}


def test_replicates_agree_on_nearly_all_cells():
    human = full()
    one, other = (field(human, GRID, replicate=k).right > 0 for k in (0, 1))
    assert (one != other).sum() <= 0.005 * one.sum()


def test_the_same_replicate_gives_the_same_field():
    np.testing.assert_array_equal(field(ehem(), GRID).right, field(ehem(), GRID).right)


# Parameters.


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"pitch": [30.0, -5.0]}, r"pitch must be \[low, high\]"),
        ({"pitch": [30.0]}, "at least 2 items"),
        ({"forearm": 0.0}, "greater than 0"),
        ({"comfort": 1.5}, "less than or equal to 1"),
        ({"comfort": 0.0}, "greater than 0"),
        ({"samples": 10}, "greater than or equal to 1024"),
        ({"roll": [-np.inf, 0.0]}, "finite"),
        ({"elbow": 1.0}, "elbow"),
    ],
)
def test_parameters_that_cannot_be_are_refused(parameters, message):
    with pytest.raises(ValidationError, match=message):
        EhemParameters(**parameters)


def test_every_number_names_its_source():
    without = {
        name for name, field in EhemParameters.model_fields.items() if "source" not in (field.json_schema_extra or {})
    }
    assert without == {"samples"}


# How the volume answers to what the paper leaves open: facts of the project at 10 mm, to a fiftieth.


@pytest.mark.parametrize(
    ("changed", "ratio"),
    [
        ({"roll": [0.0, 0.0]}, 0.73),
        ({"toe_in": 0.01}, 0.88),
        ({"toe_in": 30.0}, 1.15),
        ({"grip": 0.060}, 0.61),
        ({"grip": 0.187}, 1.67),
    ],
)
def test_sensitivity_of_the_volume(changed, ratio):
    volumes = [litres(field(human, own_grid(human, 0.01)).right, 0.01) for human in (ehem(**changed), ehem())]
    assert volumes[0] / volumes[1] == pytest.approx(ratio, abs=0.02)


# A person: ehem_percentile.


def of(sex, percentile, **parameters):
    return humans.human("ehem_percentile", sex=sex, percentile=float(percentile), samples=1 << 18, **parameters)


def volume(human):
    return litres(field(human, own_grid(human, 0.01)).right, 0.01)


def test_the_average_operator_lies_between_the_median_woman_and_man():
    assert volume(of("female", 50)) < volume(ehem()) < volume(of("male", 50))


@pytest.mark.parametrize("sex", ["female", "male"])
@pytest.mark.parametrize("mode", ["stature", "each", "random"])
def test_volume_rises_with_the_percentile(sex, mode):
    low, middle, high = (volume(of(sex, percentile, mode=mode)) for percentile in (5, 50, 95))
    assert low < middle < high


@pytest.mark.parametrize("sex", ["female", "male"])
def test_each_length_at_its_own_percentile_spreads_further_than_stature(sex):
    spread = {mode: volume(of(sex, 95, mode=mode)) - volume(of(sex, 5, mode=mode)) for mode in ("stature", "each")}
    assert spread["each"] > 1.2 * spread["stature"]


def test_the_chain_of_a_person():
    """Slides and fulcrum written out for a man of the 95th percentile of stature."""
    p = PersonParameters(sex="male", percentile=95.0)
    m, arm = lengths("male", 95.0), person(p)
    radius = m["forearm_circumference"] / 2 / np.pi
    assert (arm.length, arm.grip) == (m["forearm"], 0.60 * m["hand"])
    assert (arm.fulcrum_height, arm.half_width) == (radius, m["forearm_breadth"] / 2 - radius)
    angles = [[-10, 20], [0, 25]]
    np.testing.assert_allclose(arm.ranges[:2], m["upper_arm"] * np.sin(np.radians(angles)), rtol=1e-14)
    np.testing.assert_array_equal(arm.ranges[2:], DEFAULT.rotations())


def test_a_person_at_the_means_is_the_average_operator():
    """Half-way between the sexes' means the defaults of ehem stand, as rounded there."""
    men, women = (person(PersonParameters(sex=sex, percentile=50.0)) for sex in ("male", "female"))
    for name, default in (
        ("half_width", DEFAULT.half_width), ("fulcrum_height", DEFAULT.fulcrum_height), ("length", DEFAULT.forearm),
        ("grip", DEFAULT.grip),
    ):  # fmt: skip
        assert (getattr(men, name) + getattr(women, name)) / 2 == pytest.approx(default, abs=1e-3)
    slides = (men.ranges[:2] + women.ranges[:2]) / 2
    np.testing.assert_allclose(slides, [DEFAULT.slide_side, DEFAULT.slide_forward], atol=1e-3)


@pytest.mark.parametrize(("seed", "same"), [(3, True), (4, False)])
def test_a_random_person_is_drawn_by_the_seed(seed, same):
    one, other = (of("male", 50, mode="random", seed=s).forearm for s in (3, seed))
    assert (one.length == other.length) is same


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"sex": "other", "percentile": 50.0}, "'female' or 'male'"),
        ({"sex": "male", "percentile": 0.5}, "greater than or equal to 1"),
        ({"sex": "male", "percentile": 100.0}, "less than or equal to 99"),
        ({"sex": "male"}, "Field required"),
        ({"sex": "male", "percentile": 50.0, "mode": "mean"}, "'stature', 'each' or 'random'"),
        ({"sex": "male", "percentile": 50.0, "forearm": 0.3}, "forearm"),
    ],
)
def test_persons_that_cannot_be_are_refused(parameters, message):
    with pytest.raises(ValidationError, match=message):
        PersonParameters(**parameters)
