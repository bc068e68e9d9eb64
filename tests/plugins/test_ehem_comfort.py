"""Comfort of postures: the formulas, what a voxel takes of them, and the scale."""

import numpy as np
import pytest
from pydantic import ValidationError

from eiwa.core.comfort import (
    luba_wrist,
    quadratic,
    rula_abducted,
    rula_aside,
    rula_comfort,
    rula_lower_arm,
    rula_twist,
    rula_upper_arm,
    rula_wrist,
)
from eiwa.core.evaluation import field_stream
from eiwa.core.forearm import Rotations, slides
from eiwa.core.interfaces import Operator
from eiwa.core.workspace import Grid
from eiwa.plugins.humans.ehem_comfort import RANGES, ComfortParameters, EhemComfort, factor
from tests import humans
from tests.humans import field, own_grid

METRICS = ("rula", "luba", "quadratic")
P = ComfortParameters()


def model(metric="rula", ranges="functional", samples=1 << 18, **parameters):
    return humans.human("ehem_comfort", metric=metric, ranges=ranges, samples=samples, **parameters)


# The formulas, posture by posture.


def rula(q, x):
    """Scores of one supported arm, then the table."""
    angles = np.degrees(q)
    flexion, abduction = (np.degrees(np.arcsin(min(q[k] / P.upper_arm, 1.0))) for k in (1, 0))
    upper_arm = rula_upper_arm(flexion, True, P.smoothing) + rula_abducted(abduction, P.smoothing)
    lower_arm = rula_lower_arm(90 + angles[2] - flexion, P.smoothing) + rula_aside(-P.toe_in, bool(x < 0), P.smoothing)
    return rula_comfort(
        upper_arm, lower_arm, rula_wrist(angles[7], angles[6], P.smoothing), rula_twist(angles[5], P.smoothing)
    )


def luba(q, x):
    return luba_wrist(*np.degrees([[q[7]], [q[6]]]))[0]


def bell(q, x):
    """2^-(sum of z^2), z in half ranges of the hard ehem."""
    r = RANGES["comfort"]
    turns = [r["pitch"], (-20, 20), r["pronation"], r["deviation"], r["flexion"]]
    ends = np.vstack([slides(P.upper_arm, r["abduction"], r["shoulder"]), np.radians(turns)])
    z = (q[[0, 1, 2, 3, 5, 6, 7]] - ends.mean(axis=1)) / (np.ptp(ends, axis=1) / 2)
    return 2.0 ** -(z**2).sum()


COMFORT = {"rula": rula, "luba": luba, "quadratic": bell}


def postures(human, n, seed=0):
    """q (n, 8) at random and their grips (n, 3)."""
    u = np.random.default_rng(seed).uniform(size=(n, 8))
    arm = human.forearm
    q = arm.angles(u[:, :6])
    q[:, :2] = arm.ranges[:2, 0] + u[:, 6:] * np.ptp(arm.ranges[:2], axis=1)
    grips = arm.tips(u[:, :6])
    grips[:, :2] += q[:, :2]
    return q, grips


@pytest.mark.parametrize("joint", [2, 3, 5, 6, 7])
def test_quadratic_comfort_is_a_half_at_the_end_of_one_comfortable_range(joint):
    hard = model().hard
    q = hard.ranges.mean(axis=1)
    q[joint] = hard.ranges[joint, 1]
    assert quadratic(hard.ranges).promise(q[None])[0] == pytest.approx(0.5)


@pytest.mark.parametrize("metric", METRICS)
def test_no_posture_is_more_comfortable_than_its_voxel(metric):
    """Random postures of the whole chain; the few that are better fell into what the search has missed."""
    human, r = model(metric, samples=1 << 20), 0.02
    grid = own_grid(human, r)
    E = field(human, grid).right
    q, grips = postures(human, 4000)
    c = np.array([COMFORT[metric](*posture) for posture in zip(q, grips[:, 0], strict=True)])
    cells = np.floor(grips / r).astype(int) - grid.origin
    short = c - E[tuple(cells.T)]
    assert ((short > 0.02).mean(), short.mean() < 0) == (pytest.approx(0, abs=0.005), True)


@pytest.mark.parametrize("metric", METRICS)
def test_every_voxel_takes_the_best_slide_of_a_rotation(metric):
    """Three rotations against all slides of a fine lattice: no cell has less than the lattice, nor more by a step of it."""
    human, r = model(metric), 0.02
    shares = np.array([[0.5] * 6, [0.9] * 6, [0.2, 0.5, 0.3, 0.6, 0.1, 0.4]])
    tips, q = human.forearm.tips(shares), human.forearm.angles(shares)
    grid = own_grid(human, r)
    E = np.zeros(grid.shape)
    layers = np.floor(tips[:, 2] / r).astype(int) - grid.origin[2]
    rotations = Rotations(q, tips, human.comfort.promise(q))
    human.comfort.spread(E, rotations, layers, human.forearm.ranges[:2], grid)
    expected = np.zeros(grid.shape)
    (low_x, high_x), (low_y, high_y) = human.forearm.ranges[:2]
    for posture, tip in zip(q, tips, strict=True):
        for posture[0] in np.linspace(low_x, high_x, 60):
            for posture[1] in np.linspace(low_y, high_y, 60):
                cell = tuple(np.floor((tip + [*posture[:2], 0]) / r).astype(int) - grid.origin)
                expected[cell] = max(expected[cell], COMFORT[metric](posture, tip[0] + posture[0]))
    both = expected > 0
    assert (E - expected)[both].min() > -1e-2 and (E - expected)[both].max() < 0.06
    assert np.count_nonzero((E > 0) & ~both) <= 0.05 * both.sum()  # corners that the lattice has missed


# The field.


@pytest.mark.parametrize("metric", METRICS)
def test_E_lies_in_the_unit_interval_and_comes_close_to_1(metric):
    human = model(metric)
    E = field(human, own_grid(human, 0.02)).right
    assert E.min() == 0.0 and 0.97 < E.max() <= 1.0


@pytest.mark.parametrize("ranges", ["functional", "maximal"])
def test_E_is_positive_where_the_wide_ranges_reach(ranges):
    human, r = model("rula", ranges, samples=1 << 20), 0.02
    grid = own_grid(human, r)
    reached = human.forearm.reached(grid, 0.0, field_stream(1, 0), 1 << 20)
    assert np.count_nonzero((field(human, grid).right > 0) ^ reached) < 0.03 * reached.sum()


@pytest.mark.parametrize("metric", METRICS)
def test_wider_ranges_are_never_less_comfortable(metric):
    wide = model(metric, "maximal", samples=1 << 20)
    grid = own_grid(wide, 0.02)
    narrow = field(model(metric, samples=1 << 20), grid).right
    short = narrow - field(wide, grid).right
    assert short[narrow > 0].mean() < 0.002


@pytest.mark.parametrize("metric", METRICS)
def test_replicates_agree(metric):
    """The sampling error that the documentation states: 0.01 of a voxel's E on average, 1 % of their sum."""
    human = model(metric, samples=1 << 20)
    grid = own_grid(human, 0.02)
    one, other = (field(human, grid, replicate=k).right for k in (0, 1))
    assert np.abs(one - other)[one > 0].mean() < 0.01
    assert one.sum() == pytest.approx(other.sum(), rel=0.01)


def test_across_the_mid_line_rula_is_less_comfortable():
    """A step at x = 0, where the right hand comes from its own side to the other."""
    human = model()
    grid = own_grid(human, 0.02)
    E, zero = field(human, grid).right, -grid.origin[0]
    both = (E[zero] > 0) & (E[zero - 1] > 0)
    assert (E[zero] - E[zero - 1])[both].mean() > 0.02


def test_luba_scores_the_wrist_alone():
    """Wherever a straight wrist comes to, c is 1: the comfort of the elbow is not asked."""
    human = model("luba")
    E = field(human, own_grid(human, 0.02)).right
    assert (E == 1.0).sum() > 0.5 * (E > 0).sum()


# The scale.


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("mean", [0.5, 0.8])
def test_the_mean_over_the_hard_ehem_is_as_asked(metric, mean):
    human = model(metric, mean=mean)
    grid = own_grid(human, 0.02)
    E = field(human, grid).right
    hard = human.hard.reached(grid, 0.0, field_stream(1, 0), 1 << 18)
    assert (E[hard].mean(), E.max() <= 1.0) == (pytest.approx(mean, abs=1e-12), True)


@pytest.mark.parametrize(("values", "mean", "expected"), [([0.2, 0.4], 0.6, 2.0), ([0.1, 0.1, 1.0], 0.5, 2.5)])
def test_factor(values, mean, expected):
    """By hand: 0.4 and 0.8; then 0.25, 0.25 and one that is capped at 1."""
    assert factor(np.array(values), mean) == pytest.approx(expected)


def test_the_hard_ehem_is_the_paper_s():
    """Same cells but for the rounding of the slides to millimetres."""
    human, r = model(), 0.01
    grid = own_grid(human, r)
    hard = human.hard.reached(grid, 0.0, field_stream(1, 0), 1 << 20)
    ehem = field(humans.human("ehem", samples=1 << 20), grid).right > 0
    assert np.count_nonzero(hard ^ ehem) < 0.02 * ehem.sum()


# Parameters.


def test_both_ranges_hold_the_comfortable_ones():
    for name, (low, high) in RANGES["comfort"].items():
        for wide in ("functional", "maximal"):
            assert RANGES[wide][name][0] <= low and high <= RANGES[wide][name][1]


def test_the_armrest_moves_E_by_whole_cells():
    human, r = model(), 0.015625
    grid = Grid(r, (-40, 10, -12), (80, 40, 50))
    low, high = field(human, grid).right, field(human, grid, Operator(armrest=5 * r)).right
    np.testing.assert_allclose(high[:, :, 5:], low[:, :, :-5], atol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"metric": "reba"}, "'rula', 'luba' or 'quadratic'"),
        ({"ranges": "comfort"}, "'functional' or 'maximal'"),
        ({"smoothing": 0.0}, "greater than 0"),
        ({"mean": 1.0}, "less than 1"),
        ({"upper_arm": 0.0}, "greater than 0"),
        ({"samples": 10}, "greater than or equal to 1024"),
    ],
)
def test_parameters_that_cannot_be_are_refused(parameters, message):
    with pytest.raises(ValidationError, match=message):
        ComfortParameters(**parameters)


def test_the_record_builds_the_model():
    assert isinstance(model(), EhemComfort)
