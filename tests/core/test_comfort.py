"""RULA's table and bands, LUBA's scores: the published entries, exactly."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eiwa.core.comfort import (
    luba_wrist,
    rula_abducted,
    rula_aside,
    rula_comfort,
    rula_lower_arm,
    rula_twist,
    rula_upper_arm,
    rula_wrist,
)

SHARP = 1e-6

# Table A again, as its worksheet prints it: rows upper arm, lower arm; columns wrist 1 to 4, each with twist 1 and 2.
WORKSHEET = """
11 1 2 2 2 2 3 3 3
12 2 2 2 2 3 3 3 3
13 2 3 3 3 3 3 4 4
21 2 3 3 3 3 4 4 4
22 3 3 3 3 3 4 4 4
23 3 4 4 4 4 4 5 5
31 3 3 4 4 4 4 5 5
32 3 4 4 4 4 4 5 5
33 4 4 4 4 4 5 5 5
41 4 4 4 4 4 5 5 5
42 4 4 4 4 4 5 5 5
43 4 4 4 5 5 5 6 6
51 5 5 5 5 5 6 6 7
52 5 6 6 6 6 7 7 7
53 6 6 6 7 7 7 7 8
61 7 7 7 7 7 8 8 9
62 8 8 8 8 8 9 9 9
63 9 9 9 9 9 9 9 9
"""
ENTRIES = {
    (int(name[0]), int(name[1]), column // 2 + 1, column % 2 + 1): int(score)
    for name, *scores in map(str.split, WORKSHEET.strip().splitlines())
    for column, score in enumerate(scores)
}


@pytest.mark.parametrize("row", sorted({key[:2] for key in ENTRIES}))
def test_whole_scores_give_the_entries_of_table_A(row):
    found = {key: 9 - 8 * rula_comfort(*(score - 1.0 for score in key)) for key in ENTRIES if key[:2] == row}
    assert found == {key: ENTRIES[key] for key in found}


def test_between_two_entries_the_table_is_linear():
    """Upper arm 1 1/2, lower arm 1, wrist 4, twist 1: between 3 and 4."""
    assert rula_comfort(0.5, 0.0, 3.0, 0.0) == pytest.approx(1 - (3.5 - 1) / 8)


@given(*(st.floats(-1, 8) for _ in range(4)))
def test_comfort_lies_in_the_unit_interval(upper_arm, lower_arm, wrist, twist):
    assert 0.0 <= rula_comfort(upper_arm, max(lower_arm, 0.0), max(wrist, 0.0), max(twist, 0.0)) <= 1.0


@pytest.mark.parametrize(
    ("flexion", "abduction", "supported", "score"),
    [
        (0, 0, False, 1), (-30, 0, False, 2), (30, 0, False, 2), (60, 0, False, 3), (100, 0, False, 4),
        (0, 30, False, 2), (60, 30, False, 4), (30, 0, True, 1), (60, 30, True, 3), (0, 30, True, 1),
    ],
)  # fmt: skip
def test_upper_arm(flexion, abduction, supported, score):
    bands = rula_upper_arm(float(flexion), supported, SHARP) + rula_abducted(float(abduction), SHARP)
    assert max(bands, 0.0) + 1 == score


@pytest.mark.parametrize(
    ("elbow", "out", "across", "score"),
    [(80, 0, False, 1), (40, 0, False, 2), (120, 0, False, 2), (80, 0, True, 2), (80, 30, False, 2), (80, 30, True, 2),
     (120, 30, False, 3)],
)  # fmt: skip
def test_lower_arm(elbow, out, across, score):
    assert rula_lower_arm(float(elbow), SHARP) + rula_aside(float(out), across, SHARP) + 1 == score


@pytest.mark.parametrize(
    ("flexion", "deviation", "score"), [(0, 0, 1), (10, 0, 2), (-10, 0, 2), (30, 0, 3), (0, -20, 2), (-30, 20, 4)]
)
def test_wrist(flexion, deviation, score):
    assert rula_wrist(float(flexion), float(deviation), SHARP) + 1 == score


@pytest.mark.parametrize(("supination", "score"), [(0, 1), (39, 1), (-37, 1), (60, 2), (-60, 2)])
def test_twist(supination, score):
    assert rula_twist(float(supination), SHARP) + 1 == score


def test_a_soft_edge_is_half_way_at_the_edge():
    assert rula_upper_arm(45.0, False, 2.5) == pytest.approx(1.5, abs=1e-3)


@pytest.mark.parametrize(
    ("flexion", "deviation", "scores"),
    [
        (0, 0, (1, 1)), (20, 0, (1, 1)), (40, 0, (2, 1)), (70, 0, (5, 1)), (-20, 0, (1, 1)), (-30, 0, (2, 1)),
        (-60, 0, (7, 1)), (0, 10, (1, 1)), (0, 20, (1, 3)), (0, 40, (1, 7)), (0, -10, (1, 1)), (0, -15, (1, 3)),
        (0, -30, (1, 6)), (-60, 40, (7, 7)),
    ],
)  # fmt: skip
def test_luba(flexion, deviation, scores):
    """c = 1 - sum(score - 1) / sum(largest score - 1); the largest are extension beyond 45 and radial beyond 30 deg."""
    (c,) = luba_wrist(np.array([float(flexion)]), np.array([float(deviation)]))
    assert c == pytest.approx(1 - (scores[0] - 1 + scores[1] - 1) / 12, abs=1e-15)


def test_luba_is_nothing_at_its_worst_and_1_at_its_best():
    np.testing.assert_array_equal(luba_wrist(np.array([-75.0, 0.0]), np.array([35.0, 0.0])), [0.0, 1.0])
