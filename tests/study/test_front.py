"""Geometry of a front: closed forms, and what must not change it."""

import sys
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from eiwa.core.errors import EiwaError
from eiwa.study import front

moocore = pytest.importorskip("moocore")

POINTS = st.integers(2, 4).flatmap(
    lambda m: st.integers(1, 24).flatmap(lambda n: arrays(float, (n, m), elements=st.integers(0, 9).map(float)))
)


def dominates(a, b):
    return (a <= b).all() and (a < b).any()


def quarter_circle(n):
    """A front that bulges towards the ideal point (0, 0): (1 - cos t, 1 - sin t)."""
    t = np.linspace(0, np.pi / 2, n)
    return np.column_stack([1 - np.cos(t), 1 - np.sin(t)])


# Closed forms


def test_the_hypervolume_of_a_point_is_a_box():
    assert front.hypervolume(np.array([[1.0, 2.0, 3.0]]), np.array([2.0, 4.0, 6.0])) == pytest.approx(1 * 2 * 3)


def test_the_hypervolume_of_two_boxes_counts_their_overlap_once():
    points = np.array([[0.0, 1.0], [1.0, 0.0]])
    assert front.hypervolume(points, np.array([3.0, 3.0])) == pytest.approx(3 * 2 + 2 * 3 - 2 * 2)
    assert front.contributions(points, np.array([3.0, 3.0])) == pytest.approx([2.0, 2.0])


def test_a_fine_front_dominates_the_area_under_its_curve():
    """Below the quarter circle lies 1 - pi/4 of the unit square."""
    points = quarter_circle(20_001)
    assert front.hypervolume(points, np.ones(2)) == pytest.approx(np.pi / 4, abs=1e-4)


def test_the_knee_of_a_quarter_circle_is_its_middle():
    points = quarter_circle(101)
    assert front.knee(points) == 50
    assert front.bulge(points)[50] == pytest.approx(1 - np.sqrt(0.5))


def test_a_straight_front_has_no_knee():
    t = np.linspace(0, 1, 11)
    assert front.knee(np.column_stack([t, 1 - t])) is None


def test_a_front_that_bulges_away_has_no_knee():
    points = 1 - quarter_circle(11)[:, ::-1]
    assert front.nondominated(points).all()
    assert front.knee(points) is None


def test_the_knee_does_not_depend_on_units():
    points = quarter_circle(101) * [1e3, 1e-3] + [7.0, -2.0]
    assert front.knee(points) == 50


def test_the_knee_of_an_eighth_of_a_sphere_is_its_middle():
    """Its plane is x + y + z = 2, through the points where the sphere about (1, 1, 1) touches the axes' planes."""
    middle = np.full((1, 3), 1 - 1 / np.sqrt(3))
    points = np.vstack([[[0, 1, 1], [1, 0, 1], [1, 1, 0]], middle, [[0.3, 0.5, 0.6]]]).astype(float)
    assert front.knee(points) == 3
    assert front.bulge(points)[3] == pytest.approx((2 - 3 * middle[0, 0]) / np.sqrt(3))
    assert front.bulge(points)[:3] == pytest.approx(0)


def test_the_reference_point_lies_a_tenth_of_the_range_behind():
    assert front.reference(np.array([[0.0, 30.0], [2.0, 10.0]])) == pytest.approx([2.2, 32.0])


def test_a_front_of_one_has_a_reference_point_behind_it():
    assert front.reference(np.array([[-4.0, 0.0]])) == pytest.approx([-3.6, 0.1])


# Properties


@given(POINTS)
def test_members_are_those_that_no_other_point_dominates(points):
    kept = front.nondominated(points)
    for i, point in enumerate(points):
        beaten = any(dominates(other, point) for other in points) or any((points[:i] == point).all(axis=1))
        assert kept[i] == (not beaten)


@given(POINTS, st.randoms(use_true_random=False))
def test_the_order_of_trials_does_not_matter(points, random):
    def described(points):
        members = points[front.nondominated(points)]
        members = members[np.lexsort(members.T)]
        at = front.reference(members)
        return members, at, front.hypervolume(members, at), front.contributions(members, at), front.bulge(members)

    order = random.sample(range(len(points)), len(points))
    for a, b in zip(described(points), described(points[order]), strict=True):
        assert np.allclose(a, b, rtol=1e-9, atol=1e-12)


@given(POINTS, st.data())
def test_a_dominated_trial_changes_nothing(points, data):
    worse = points[data.draw(st.integers(0, len(points) - 1))] + data.draw(st.integers(1, 9))
    more = np.vstack([points, worse])
    assert not front.nondominated(more)[-1]
    members = points[front.nondominated(points)]
    assert np.array_equal(more[front.nondominated(more)], members)
    at = front.reference(members)
    assert front.history(list(more), at)[-1] == front.history(list(points), at)[-1]


@given(POINTS)
def test_the_hypervolume_grows_to_the_fronts(points):
    members = points[front.nondominated(points)]
    at = front.reference(members)
    volumes = front.history(list(points), at)
    assert all(b >= a - 1e-12 for a, b in pairwise(volumes))
    assert volumes[-1] == pytest.approx(front.hypervolume(members, at))


@given(POINTS)
def test_a_member_contributes_what_is_lost_without_it(points):
    members = points[front.nondominated(points)]
    at = front.reference(members)
    shares = front.contributions(members, at)
    for k, share in enumerate(shares):
        without = front.hypervolume(np.delete(members, k, axis=0), at)
        assert share == pytest.approx(front.hypervolume(members, at) - without, abs=1e-9)


def test_designs_that_do_not_count_leave_the_hypervolume_as_it_is():
    at = np.array([3.0, 3.0])
    assert front.history([None, np.array([1.0, 1.0]), None], at) == [0.0, 4.0, 4.0]


def test_without_moocore_the_remedy_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "moocore", None)
    with pytest.raises(EiwaError, match=r'pip install "eiwa\[analysis\]"'):
        front.contributions(np.zeros((1, 2)), np.ones(2))


@given(arrays(float, st.tuples(st.integers(0, 12), st.integers(1, 3)), elements=st.integers(0, 4).map(float)))
def test_points_that_no_other_dominates(points):
    """By the definition, on few values, so that many are equal; of equal ones the first."""
    beaten = lambda k, p: any((o <= p).all() and ((o < p).any() or j < k) for j, o in enumerate(points))  # noqa: E731
    assert front.nondominated(points).tolist() == [not beaten(k, p) for k, p in enumerate(points)]
