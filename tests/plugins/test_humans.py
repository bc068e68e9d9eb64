"""What every human model owes: a box that holds E, E in [0, 1], mirrored hands, the same bits on any number of threads."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eiwa.core.interfaces import Operator
from tests import humans
from tests.humans import field, own_grid, wider

SAMPLES = {"samples": 1 << 16}
MODELS = {
    "ehem": ("ehem", SAMPLES),
    "woman": ("ehem_percentile", {"sex": "female", "percentile": 5.0, **SAMPLES}),
    "man": ("ehem_percentile", {"sex": "male", "percentile": 95.0, "mode": "each", **SAMPLES}),
    "rula": ("ehem_comfort", SAMPLES),
    "luba": ("ehem_comfort", {"metric": "luba", "ranges": "maximal", **SAMPLES}),
    "quadratic": ("ehem_comfort", {"metric": "quadratic", "mean": 0.5, **SAMPLES}),
    "free": ("free_arm", SAMPLES),
    "free, maximal": ("free_arm", {"ranges": "maximal", **SAMPLES}),
    "points": ("points", {"file": "hands.csv", "hands": "mirrored"}),
}
R = 0.02


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """Models by the names above; the points are random."""
    folder = tmp_path_factory.mktemp("humans")
    cloud = np.random.default_rng(0).normal([0.14, 0.42, 0.1], [0.04, 0.02, 0.03], (500, 3))
    np.savetxt(folder / "hands.csv", cloud, delimiter=",", header="x,y,z", comments="")
    return lambda name: humans.human(MODELS[name][0], folder, **MODELS[name][1])


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("operator", [Operator(), Operator(armrest=0.07, seat=0.11)], ids=["origin", "moved"])
def test_the_bounds_hold_all_of_E(build, name, operator):
    human = build(name)
    own = own_grid(human, R, operator)
    inside, around = field(human, own, operator), field(human, wider(own), operator)
    for E, E_around in ((inside.right, around.right), (inside.left, around.left)):
        np.testing.assert_array_equal(E_around[3:-3, 3:-3, 3:-3], E)
        assert np.count_nonzero(E_around) == np.count_nonzero(E) > 0


@settings(max_examples=8)
@given(
    kind=st.sampled_from(["ehem", "ehem_comfort", "free_arm"]),
    forearm=st.floats(0.2, 0.35),
    grip=st.floats(0.05, 0.2),
    r=st.floats(0.015, 0.04),
    armrest=st.floats(-0.2, 0.2),
    seat=st.floats(-0.2, 0.4),
)
def test_the_bounds_hold_all_of_E_of_any_operator(kind, forearm, grip, r, armrest, seat):
    human = humans.human(kind, forearm=forearm, grip=grip, samples=1 << 14)
    operator = Operator(armrest, seat)
    own = own_grid(human, r, operator)
    around = field(human, wider(own), operator).right
    assert np.count_nonzero(around) == np.count_nonzero(around[3:-3, 3:-3, 3:-3]) > 0


@pytest.mark.parametrize("name", MODELS)
def test_E_lies_in_the_unit_interval(build, name):
    human = build(name)
    E = field(human, own_grid(human, R))
    assert (E.right.shape, E.right.min() >= 0, E.right.max() <= 1, E.right.dtype) == (E.left.shape, True, True, float)


@pytest.mark.parametrize("name", MODELS)
def test_the_left_hand_is_the_flipped_right_one(build, name):
    human = build(name)
    E = field(human, own_grid(human, R))
    np.testing.assert_array_equal(E.left, E.right[::-1])


@pytest.mark.parametrize("name", MODELS)
def test_threads_do_not_matter(build, name, monkeypatch):
    grid = own_grid(build(name), R)
    fields = []
    for threads in ("1", "3"):
        monkeypatch.setenv("EIWA_THREADS", threads)
        fields.append(field(build(name), grid).right)
    np.testing.assert_array_equal(*fields)


@pytest.mark.parametrize(("name", "moves"), [(name, name.startswith("free")) for name in MODELS])
def test_the_seat_moves_the_free_arm_alone(build, name, moves):
    human = build(name)
    grid = own_grid(human, R)
    near, far = field(human, grid).right, field(human, grid, Operator(seat=0.1)).right
    assert bool((near != far).any()) is moves


# Plausibility against hands measured at the masters of a da Vinci (JIGSAWS, 118 trials of 8 surgeons, aggregates only):
# each hand's 5 to 95 % box, and the distance between both hands at its 5th, 50th and 95th percentile.

BOX = (0.123, 0.070, 0.092)
DISTANCES = (0.160, 0.269, 0.381)
OPERATORS = [name for name in MODELS if name != "points"]


def quantiles(E, grid, axis, shares=(0.05, 0.5, 0.95)):
    """Positions below which these shares of E lie."""
    total = np.cumsum(E.sum(axis=tuple(k for k in range(3) if k != axis)))
    return grid.centres(axis)[np.searchsorted(total / total[-1], shares)]


@pytest.mark.parametrize("name", OPERATORS)
def test_E_is_wider_than_what_one_hand_was_seen_to_use(build, name):
    human = build(name)
    grid = own_grid(human, R)
    E = field(human, grid).right
    for axis, used in enumerate(BOX):
        low, _, high = quantiles(E, grid, axis)
        assert high - low > used


@pytest.mark.parametrize("name", [name for name in OPERATORS if name != "free, maximal"])
@pytest.mark.parametrize("distance", DISTANCES)
def test_hands_can_be_as_far_apart_as_they_were_seen(build, name, distance):
    """Both at half the distance from the mid-line, at the median y and z of E (which in the maximal ranges is the body)."""
    human = build(name)
    grid = own_grid(human, R)
    E = field(human, grid).right
    _, y, z = (quantiles(E, grid, axis, (0.5,))[0] for axis in range(3))
    assert E[tuple(np.floor(np.array([distance / 2, y, z]) / R).astype(int) - grid.origin)] > 0


@pytest.mark.parametrize("name", ["ehem", "woman", "quadratic", "free"])
def test_hands_of_comfortable_operators_are_as_far_apart_as_most_were_seen(build, name):
    human = build(name)
    grid = own_grid(human, R)
    (x,) = quantiles(field(human, grid).right, grid, 0, (0.5,))
    assert DISTANCES[0] < 2 * x < DISTANCES[2] + R


def test_the_median_distance_of_the_ehem_s_hands(build):
    human = build("ehem")
    grid = own_grid(human, R)
    (x,) = quantiles(field(human, grid).right, grid, 0, (0.5,))
    assert 2 * x == pytest.approx(0.30, abs=R)
