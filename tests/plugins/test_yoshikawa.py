"""Eq. (1): its manipulability, its penalty, and what changes neither."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from eiwa.core.chain import Joint, SerialChain
from eiwa.core.dexterity import Dexterity
from eiwa.core.interfaces import Postures
from eiwa.core.transforms import roll_pitch_yaw, translation
from eiwa.plugins.dexterity.yoshikawa import YoshikawaParameters, eiwa_dexterities
from tests import arms
from tests.arms import ROTATION, TRANSLATION, forward, manipulability, postures, printed

SATURATED = 60.0
"""A scale-free K whose factor at mid-range is 1 up to 1e-26."""


def index(**parameters):
    (plugin,) = eiwa_dexterities()
    return plugin.build(YoshikawaParameters(**parameters))


def dex(arm, q, **parameters):
    """Eq. (1) at joint vectors, limits not regarded by the kinematics."""
    at, chosen = postures(arm, np.atleast_2d(np.asarray(q, float))), index(**parameters)
    return chosen.values(at, chosen.prepare(arm, at))


def w(arm, q, rows="all"):
    """Manipulability alone: joints without limits are not penalised."""
    free = SerialChain(
        tuple(Joint(j.name, j.kind, j.T_parent_joint, None, j.axis) for j in arm.joints),
        arm.T_last_tip,
        arm.T_base_first,
    )
    return dex(free, q, K_scaled=SATURATED, rows=rows)


# The paper's arm, limits +-pi, K = 50 (facts-kinematics).


@pytest.mark.parametrize(
    ("q", "value"),
    [
        ((0, 0, np.pi / 2, 0, np.pi / 2, 0), "8.326483113066e-5"),
        ((0.1, 0.2, 0.7, 0.3, 0.9, 0.4), "9.457679229415e-5"),
        ((0,) * 6, "0.0e-15"),
    ],
)
def test_equation_1_on_the_papers_arm(q, value):
    assert dex(arms.paper(), q, K=50.0)[0] == printed(value)


def test_compiled_equation_1_equals_the_arrays():
    arm, chosen = arms.paper(limits=(-2.0, 2.0)), index(K=50.0)
    u = np.random.default_rng(0).uniform(size=(1000, 6))
    at = arm.postures(u)
    prepared = chosen.prepare(arm, at)
    np.testing.assert_allclose(
        Dexterity(arm, chosen, prepared, 1.0, 0.0).raw(u)[1], chosen.values(at, prepared), rtol=1e-12, atol=1e-18
    )


def test_12270_5_gives_a_factor_of_095_at_mid_range_of_six_joints():
    arm = arms.paper(limits=(-1.0, 2.0))
    q = np.full((1, 6), 0.5)
    assert dex(arm, q, K=12270.5)[0] / w(arm, q)[0] == pytest.approx(0.95, abs=1e-6)


def test_K_50_never_gives_more_than_001213():
    arm = arms.paper()
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (2000, 6))
    assert (dex(arm, q, K=50.0) <= 0.012133 * w(arm, q)).all()


@pytest.mark.parametrize("dof", [2, 6])
def test_K_scaled_is_K_over_4_to_the_number_of_joints(dof):
    arm = arms.paper() if dof == 6 else limited_planar()
    q = np.full((1, dof), 0.3)
    scaled, plain = dex(arm, q, K_scaled=3.0, rows=["x", "y"]), dex(arm, q, K=3.0 * 4**dof, rows=["x", "y"])
    assert scaled[0] == pytest.approx(plain[0], rel=1e-14)


def limited_planar(*limits):
    """A 2R arm in the plane, links 0.3 and 0.2 m, limits +-1 unless given."""
    pairs = limits or ((-1.0, 1.0),) * 2
    joints = [Joint("j1", "revolute", np.eye(4), pairs[0])]
    joints.append(Joint("j2", "revolute", translation(0.3, 0, 0), pairs[1]))
    return SerialChain(tuple(joints), translation(0.2, 0, 0), np.eye(4))


PLANAR_ROWS = ["x", "y"]


def factor(arm, q, K_scaled=3.0):
    """The penalty factor of a planar arm."""
    return dex(arm, q, K_scaled=K_scaled, rows=PLANAR_ROWS)[0] / w(arm, q, PLANAR_ROWS)[0]


def test_the_factor_at_mid_range_is_1_minus_exp_of_minus_K_scaled():
    assert factor(limited_planar((-1.0, 1.0), (0.0, 2.0)), (0.0, 1.0)) == pytest.approx(-np.expm1(-3.0), rel=1e-13)


@pytest.mark.parametrize("q2", [1.0, -1.0])
def test_the_index_is_zero_at_a_limit(q2):
    assert factor(limited_planar(), (0.0, q2)) == 0.0


@pytest.mark.parametrize("q", [(0.0, 1.5), (-1.1, 0.5), (5.0, 0.5)])
def test_the_index_is_zero_with_one_joint_out(q):
    assert factor(limited_planar(), q) == 0.0


@pytest.mark.parametrize("q", [(1.5, 1.5), (-1.5, 1.5), (-1.5, -1.5)])
def test_the_index_is_zero_with_two_joints_out(q):
    """The product of two negative margins is positive again."""
    assert factor(limited_planar(), q) == 0.0


def test_a_joint_without_limits_leaves_the_product():
    free_waist = limited_planar(None, (-1.0, 1.0))
    assert factor(free_waist, (2.5, 0.5)) == pytest.approx(-np.expm1(-3.0 * 4 * 0.75 * 0.25), rel=1e-13)


def test_a_joint_without_limits_is_not_counted_in_K():
    free_waist = limited_planar(None, (-1.0, 1.0))
    K = dex(free_waist, (0.0, 0.5), K=12.0, rows=PLANAR_ROWS)
    assert K[0] == pytest.approx(dex(free_waist, (0.0, 0.5), K_scaled=3.0, rows=PLANAR_ROWS)[0], rel=1e-14)


def test_a_joint_of_zero_range_leaves_the_product():
    locked = Joint("lock", "revolute", np.eye(4), (0.1, 0.1))
    arm = SerialChain((locked, *limited_planar().joints), translation(0.2, 0, 0), np.eye(4))
    q, u = np.array([[0.1, 0.0, 0.5]]), np.array([[0.3, 0.5, 0.75]])
    at = Postures(u, q, *forward(arm, q), np.ones(1, bool), arm.limited)
    chosen = index(K_scaled=3.0, rows=PLANAR_ROWS)
    penalty = -np.expm1(-3.0 * 4 * 0.75 * 0.25)
    expected = manipulability(at.jacobians, slice(0, 2))[0] * penalty
    assert chosen.values(at, chosen.prepare(arm, at))[0] == pytest.approx(expected, rel=1e-12)


def test_an_arm_without_limits_is_not_penalised():
    assert factor(arms.planar(0.3, 0.2), (0.4, 0.7)) == pytest.approx(-np.expm1(-3.0) / -np.expm1(-SATURATED))


# Rows.

PANDA_Q = np.array([0, -0.3, 0, -2.2, 0, 2.0, np.pi / 4])


@pytest.mark.parametrize(
    ("rows", "value"),
    [("all", "0.0837515097"), ("translation", "0.1438403199"), ("rotation", "2.7455821831")],
)
def test_named_rows_of_the_panda(rows, value):
    assert w(arms.panda(), PANDA_Q, rows)[0] == printed(value)


@pytest.mark.parametrize(
    ("listed", "named"),
    [(["x", "y", "z"], "translation"), (["rz", "rx", "ry"], "rotation"), (["z", "ry", "x", "rx", "y", "rz"], "all")],
)
def test_listed_rows_in_any_order_equal_named_ones(listed, named):
    assert w(arms.panda(), PANDA_Q, listed)[0] == w(arms.panda(), PANDA_Q, named)[0]


def test_one_row_is_its_length():
    J = forward(arms.panda(), PANDA_Q[None])[2][0]
    assert w(arms.panda(), PANDA_Q, ["z"])[0] == pytest.approx(np.linalg.norm(J[2]), rel=1e-14)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.05, 1), st.floats(0.05, 1))
def test_translation_of_a_planar_2r_arm(q1, q2, L1, L2):
    value = w(arms.planar(L1, L2), (q1, q2), PLANAR_ROWS)[0]
    assert value == pytest.approx(L1 * L2 * abs(np.sin(q2)), abs=1e-15, rel=1e-12)


def test_fewer_joints_than_rows_use_the_jacobians_columns():
    """A planar 2R arm in three translation rows: z stays 0, and w = L1 L2 |sin q2| all the same."""
    assert w(arms.planar(0.3, 0.2), (0.4, 0.7), "translation")[0] == pytest.approx(0.06 * np.sin(0.7), rel=1e-12)


@pytest.mark.parametrize("dof", range(1, 6))
def test_fewer_joints_than_six_give_the_product_of_all_singular_values(dof):
    arm = arms.ur5()
    short = SerialChain(arm.joints[:dof], translation(0.1, 0.2, 0.3), np.eye(4))
    q = np.full((1, dof), 0.6)
    singular = np.linalg.svd(forward(short, q)[2][0], compute_uv=False)
    assert w(short, q)[0] == pytest.approx(singular.prod(), rel=1e-12)


def test_fewer_joints_than_rows_reach_zero_at_a_singularity():
    """The second joint's axis passes through the tip and coincides with the third's."""
    joints = [Joint(f"j{k}", "revolute", translation(x, 0, 0)) for k, x in enumerate((0.0, 0.3, 0.0))]
    arm = SerialChain(tuple(joints), np.eye(4), np.eye(4))
    assert w(arm, (0.1, 0.2, 0.3))[0] < 1e-15


# Invariances of all rows, for 6 and 7 joints; translation rows alone do see the tool.

ANGLE, LENGTH = st.floats(-3, 3), st.floats(-0.5, 0.5)
POSES = st.builds(lambda x, y, z, *rpy: translation(x, y, z) @ roll_pitch_yaw(*rpy), *[LENGTH] * 3, *[ANGLE] * 3)
MANY_JOINTED = {"puma": arms.puma(), "panda": arms.panda(), "mtm": arms.mtm(), "ur5": arms.ur5()}
FEW = settings(max_examples=25)
ON_MANY = pytest.mark.parametrize("arm", MANY_JOINTED.values(), ids=MANY_JOINTED)


def posture(arm):
    return np.linspace(0.4, 1.3, arm.dof)


@ON_MANY
@FEW
@given(T_last_tip=POSES)
def test_w_does_not_see_the_tool(arm, T_last_tip):
    moved = SerialChain(arm.joints, T_last_tip, arm.T_base_first)
    assert w(moved, posture(arm))[0] == pytest.approx(w(arm, posture(arm))[0], rel=1e-10)


@ON_MANY
@pytest.mark.parametrize("rows", ["all", "translation", "rotation"])
@FEW
@given(T_base_first=POSES)
def test_w_does_not_see_the_base(arm, rows, T_base_first):
    moved = SerialChain(arm.joints, arm.T_last_tip, T_base_first)
    assert w(moved, posture(arm), rows)[0] == pytest.approx(w(arm, posture(arm), rows)[0], rel=1e-10)


@ON_MANY
@pytest.mark.parametrize("joint", [0, -1], ids=["first", "last"])
@FEW
@given(turn=ANGLE)
def test_w_does_not_see_the_first_and_the_last_joint(arm, joint, turn):
    turned = posture(arm)
    turned[joint] += turn
    assert w(arm, turned)[0] == pytest.approx(w(arm, posture(arm))[0], rel=1e-10)


@ON_MANY
def test_translation_alone_does_see_the_tool(arm):
    moved = SerialChain(arm.joints, translation(0.1, 0.2, 0.3), arm.T_base_first)
    before, after = (manipulability(forward(a, posture(arm)[None])[2], TRANSLATION)[0] for a in (arm, moved))
    assert abs(after / before - 1) > 0.05


@ON_MANY
@FEW
@given(T_last_tip=POSES)
def test_rotation_alone_does_not_see_the_tool(arm, T_last_tip):
    moved = SerialChain(arm.joints, T_last_tip, arm.T_base_first)
    before, after = (manipulability(forward(a, posture(arm)[None])[2], ROTATION)[0] for a in (arm, moved))
    assert after == pytest.approx(before, rel=1e-12)


@given(st.floats(0.1, 10))
def test_w_scales_with_the_cube_of_the_lengths(scale):
    q = (0.1, 0.2, 0.7, 0.3, 0.9, 0.4)
    assert w(arms.paper(0.26 * scale, 0.18 * scale), q)[0] == pytest.approx(scale**3 * w(arms.paper(), q)[0], rel=1e-11)


# Parameters.


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "exactly one of K and K_scaled"),
        ({"K": 50.0, "K_scaled": 3.0}, "exactly one of K and K_scaled"),
        ({"K": 0.0}, "greater than 0"),
        ({"K_scaled": -1.0}, "greater than 0"),
        ({"K": np.inf}, "finite"),
        ({"K": 50.0, "rows": []}, "at least one row"),
        ({"K": 50.0, "rows": ["x", "x"]}, "each once"),
        ({"K": 50.0, "rows": ["w"]}, "rows"),
        ({"K": 50.0, "rows": "linear"}, "rows"),
        ({"K": 50.0, "k": 1.0}, "k"),
    ],
)
def test_parameters_that_cannot_be_are_refused(parameters, message):
    with pytest.raises(ValidationError, match=message):
        YoshikawaParameters(**parameters)


def test_a_whole_number_is_a_number():
    assert YoshikawaParameters(K=12270).K == 12270.0
