"""F by hand for a gantry between two boxes, its bounds, and what replicates share."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eiwa.core.evaluation import Layout, Pair, Replicate, ergonomic_grid, field_stream, joint_stream, metrics
from eiwa.core.filling import Filled, Sampling
from eiwa.core.interfaces import ErgonomicField, Operator
from eiwa.core.workspace import Grid
from eiwa.plugins.metrics.interaction import F, FParameters
from tests.arms import gantry, paper
from tests.core.rig import BACKENDS, Box, One, measured, setup

SUM, UNION = F(FParameters(volume="sum")), F(FParameters(volume="union"))
r = 0.0625


def by_hand(x=(-2, 2), spacing=8, human=(0, 6), alpha=0.5, **changes):
    """Gantries on x, bases ``spacing`` apart, hands on ``human``, all on y and z = [0, 4]; in cells."""
    arm = gantry(*((low * r, high * r) for low, high in (x, (0, 4), (0, 4))))
    return setup(
        arm=arm,
        index=One(),
        layout=Layout(spacing * r, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), alpha=alpha),
        human=Box((human[0] * r, 0.0, 0.0), (human[1] * r, 4 * r, 4 * r)),
        r=r,
        sampling=Sampling(20_000),
        **changes,
    )


# Right arm on x = [2, 6] of [-6, 6], left arm on [-6, -2]: 8 of 12 layers are reached by one arm.
# E_left + E_right = 1/2 in all 12, V_dual = 1/2 in 8 of them: F = 8/12 x 1/2.


def test_F_of_two_arms_that_cover_two_thirds():
    assert SUM(measured(by_hand()))["F"] == pytest.approx(1 / 3, abs=1e-15)


def test_F_of_the_union_counts_cells():
    """The same V_I = 1/2 x 1/2 x 8/12 a cell, over the number of cells."""
    assert UNION(measured(by_hand()))["F"] == pytest.approx(1 / 6, abs=1e-15)


def test_F_is_1_where_both_arms_cover_everything():
    assert SUM(measured(by_hand(x=(-6, 6), spacing=0)))["F"] == 1.0


def test_F_is_0_where_no_arm_comes():
    assert SUM(measured(by_hand(spacing=100)))["F"] == 0.0


def test_F_is_0_for_an_empty_ergonomic_workspace():
    design = by_hand()
    measurement = measured(design)
    first = measurement.first
    empty = replace(first, E=ErgonomicField(0 * first.E.right, 0 * first.E.left))
    assert SUM(replace(measurement, replicates=[empty]))["F"] == 0.0


def test_F_counts_overlapping_hands_twice():
    """Hands in [-2, 6] and [-6, 2] overlap in 4 of 12 layers, where E_left + E_right = 1 and no arm comes."""
    assert SUM(measured(by_hand(human=(-2, 6))))["F"] == pytest.approx(8 * 0.25 / (8 * 0.5 + 4 * 1.0), abs=1e-15)


@pytest.mark.parametrize("alpha", [0.25, 1.0])
def test_F_is_proportional_to_alpha(alpha):
    assert SUM(measured(by_hand(alpha=alpha)))["F"] == pytest.approx(2 * alpha / 3, abs=1e-15)


def test_F_with_a_mirrored_second_arm():
    """The right arm on x = [3, 7] reaches 3 of 6 layers; translated, the left one would be on [-5, -1]."""
    layout = Layout(8 * r, (r, 0.0, 0.0), (0.0, 0.0, 0.0), second="mirrored")
    assert SUM(measured(replace(by_hand(), layout=layout)))["F"] == pytest.approx(0.25, abs=1e-15)


def test_the_armrest_moves_the_hands_against_the_arms():
    """One of four layers in z leaves the arms' range."""
    assert SUM(measured(by_hand(operator=Operator(armrest=r))))["F"] == pytest.approx(0.25, abs=1e-15)


def test_the_orientation_turns_the_base():
    """Half a turn about z moves the arms to y = [-4, 0], away from the hands."""
    layout = Layout(8 * r, (0.0, 0.0, 0.0), (0.0, 0.0, np.pi))
    assert SUM(measured(replace(by_hand(), layout=layout)))["F"] == 0.0


def test_dual_workspace_is_alpha_times_the_sum_of_both():
    first = measured(by_hand(x=(-3, 3), spacing=4)).first
    layers = first.V_dual[:, 0, 0]
    assert layers.tolist() == [0.0] + [0.5] * 4 + [1.0] * 2 + [0.5] * 4 + [0.0]


# Bounds.


def replicate(E_right, E_left, V_right, V_left):
    grid = Grid(1.0, (0, 0, 0), E_right.shape)
    filled = [Filled(V, V, np.zeros(V.shape, int)) for V in (V_right, V_left)]
    return Replicate(ErgonomicField(E_right, E_left), Pair(grid, *filled), 0.5)


@st.composite
def replicates(draw):
    """E up to 1/2 a hand and V up to 1, with many zeros."""
    numbers = np.random.default_rng(draw(st.integers(0, 10**6)))
    share = draw(st.floats(0, 1))
    fields = (numbers.uniform(size=(4, 3, 4, 5)) < share) * numbers.uniform(size=(4, 3, 4, 5))
    return replicate(0.5 * fields[0], 0.5 * fields[1], *fields[2:])


@given(replicates())
def test_F_lies_between_0_and_1(first):
    assert 0.0 <= SUM.ratio(first.E_sum, first.V_dual) <= 1.0


@given(replicates())
def test_F_of_the_union_is_not_above_F_of_the_sum(first):
    """The union counts a cell as 1, the sum as E_left + E_right <= 1."""
    assert UNION.ratio(first.E_sum, first.V_dual) <= SUM.ratio(first.E_sum, first.V_dual) + 1e-15


@pytest.fixture(scope="module")
def by_threshold():
    """F of the paper's arm between two boxes, for rising thresholds."""
    thresholds = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0)
    return [SUM(measured(setup(threshold=threshold)))["F"] for threshold in thresholds]


def test_F_does_not_rise_with_the_threshold(by_threshold):
    assert by_threshold == sorted(by_threshold, reverse=True)


def test_F_falls_with_the_threshold_somewhere(by_threshold):
    assert by_threshold[0] > by_threshold[4] > by_threshold[-1]


@pytest.mark.parametrize("aggregate", BACKENDS)
def test_F_of_the_papers_arm_lies_between_0_and_1(aggregate):
    assert 0.0 < SUM(measured(setup(backend=BACKENDS[aggregate])))["F"] < 1.0


# Replicates.


def test_one_replicate_has_no_standard_error():
    assert SUM(measured(by_hand()))["F_se"] is None


def test_standard_error_is_the_standard_deviation_over_replicates():
    measurement = measured(setup(), replicates=3)
    values = [SUM.ratio(each.E_sum, each.V_dual) for each in measurement.replicates]
    assert SUM(measurement)["F_se"] == pytest.approx(np.std(values, ddof=1), rel=1e-12)


def test_replicates_differ():
    assert SUM(measured(setup(), replicates=2))["F_se"] > 0.0


def test_F_is_that_of_replicate_0():
    assert SUM(measured(setup(), replicates=3))["F"] == SUM(measured(setup(), replicates=1))["F"]


def test_drift_is_the_change_from_half_the_samples():
    whole, half = (SUM(measured(setup(sampling=Sampling(n)))) for n in (1 << 16, 1 << 15))
    assert whole["F_drift"] == pytest.approx(whole["F"] - half["F"], abs=1e-15)


def test_all_designs_share_the_stream_of_replicate_0():
    other = setup(arm=paper(0.2, 0.24, limits=(-2.0, 2.0)), layout=Layout(0.4, (0.0, 0.6, 0.0), (0.0, 0.0, 0.0)))
    assert joint_stream(setup(), 0) == joint_stream(other, 0)


def test_streams_of_joints_and_fields_differ():
    assert joint_stream(setup(estimator="sobol"), 0) != field_stream(1, 0)


def test_another_seed_is_another_stream():
    assert joint_stream(setup(), 0) != joint_stream(setup(seed=2), 0)


def test_F_depends_on_the_seed_only_through_the_samples():
    same = [SUM(measured(setup(seed=seed)))["F"] for seed in (5, 5)]
    assert same[0] == same[1]


# Grids and metrics.


def test_the_ergonomic_grid_holds_all_boxes():
    boxes = [np.array([[-1.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), np.array([[-0.5, -1.0, 0.5], [2.0, 0.5, 3.0]])]
    assert ergonomic_grid(boxes, 0.5) == Grid(0.5, (-4, -2, 0), (8, 4, 6))


@given(st.floats(-1, 1), st.floats(1e-6, 1), st.sampled_from([0.01, 0.03, 0.05]))
@settings(max_examples=50)
def test_the_ergonomic_grid_is_symmetric(low, width, size):
    box = np.array([[low, 0.0, 0.0], [low + width, 1.0, 1.0]])
    assert ergonomic_grid([box], size).symmetric


def test_the_whole_workspace_holds_every_sample_of_both_arms():
    whole = measured(setup()).whole
    assert [whole.right.hits.sum(), whole.left.hits.sum()] == [1 << 16] * 2


def test_one_arms_workspace_holds_every_sample():
    assert measured(setup()).mmdw.hits.sum() == 1 << 16


def test_metrics_joins_the_numbers_of_all_metrics():
    numbers = metrics(measured(by_hand(metrics={"F": SUM, "other": lambda measurement: {"x": None}})))
    assert set(numbers) == {"F", "F_se", "F_low", "F_high", "F_drift", "F_remaining", "evaluations", "x"}
