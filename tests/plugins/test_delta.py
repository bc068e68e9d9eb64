"""The delta against its constraints solved numerically, its inverse kinematics, finite differences and its symmetry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.optimize import fsolve

from eiwa.core.errors import SpecError
from eiwa.core.outcome import evaluate
from eiwa.core.spec import check
from eiwa.core.symbols import as_columns
from eiwa.core.transforms import rotation_z
from eiwa.plugins.arms.delta import Delta, DeltaParameters
from tests.arms import TRANSLATION, manipulability
from tests.study import small

SMALL = {"base_radius": 0.04, "platform_radius": 0.015, "upper": 0.06, "lower": 0.125}
RANGES = {"limits": [-40.0, 90.0], "slope": [10.0, 85.0]}
THIRDS = [rotation_z(k * 2 * np.pi / 3)[:3, :3] for k in range(3)]


def delta(**changes):
    return Delta(DeltaParameters(**{**SMALL, **RANGES, **changes}))


def columns(arm, q):
    """Tips, linear Jacobians and mask at joint vectors [rad], on NumPy columns."""
    low, span = arm.constants[:2]
    at = arm.columns(as_columns((np.asarray(q, float) - low) / span), list(arm.constants))
    J = np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in at.jacobian[:3]], axis=1)
    return np.stack(at.tip, axis=-1), J, at.valid


def uniform(n, seed=0, arm=None):
    low, span = (arm or delta()).constants[:2]
    return low + span * np.random.default_rng(seed).uniform(size=(n, 3))


def valid(arm, n=500, seed=0):
    """Valid joint vectors."""
    q = uniform(n, seed, arm)
    return q[columns(arm, q)[2]]


def elbows(q, upper=SMALL["upper"], base=SMALL["base_radius"], **_):
    """Ends of the cranks at one joint vector, leg by leg."""
    return [R @ [base + upper * np.cos(a), 0, upper * np.sin(a)] for R, a in zip(THIRDS, q, strict=True)]


def constraints(P, q, platform=SMALL["platform_radius"], lower=SMALL["lower"]):
    """What must vanish: the lower arms' lengths less what they are."""
    joints = [P + R @ [platform, 0, 0] for R in THIRDS]
    return [np.linalg.norm(joint - elbow) - lower for joint, elbow in zip(joints, elbows(q), strict=True)]


# Forward map


def test_the_constraints_hold():
    q = valid(delta())
    tips, _, _ = columns(delta(), q)
    assert len(q) > 100
    np.testing.assert_allclose([constraints(P, row) for P, row in zip(tips, q, strict=True)], 0, atol=1e-15)


def test_the_tip_is_where_a_solver_finds_it():
    """Started in front of the cranks, where the platform is."""
    q = valid(delta(), 60)
    found = [fsolve(constraints, np.mean(elbows(row), axis=0) + [0, 0, 0.12], (row,), xtol=1e-13) for row in q]
    np.testing.assert_allclose(columns(delta(), q)[0], found, atol=1e-11)


@pytest.mark.parametrize("angle", [-0.5, 0.0, 0.7, 1.2])
def test_equal_cranks_put_the_platform_on_the_axis(angle):
    height = 0.06 * np.sin(angle) + np.sqrt(0.125**2 - (0.04 - 0.015 + 0.06 * np.cos(angle)) ** 2)
    np.testing.assert_allclose(columns(delta(), [[angle] * 3])[0], [[0, 0, height]], atol=1e-15)


def test_the_tool_moves_the_tip_and_nothing_else():
    q = valid(delta())
    plain, tooled = columns(delta(), q), columns(delta(tool=[0.01, -0.02, 0.05]), q)
    np.testing.assert_allclose(tooled[0] - plain[0], [[0.01, -0.02, 0.05]] * len(q), atol=1e-16)
    np.testing.assert_array_equal(tooled[1], plain[1])


def inverse_kinematics(P, platform=SMALL["platform_radius"], base=SMALL["base_radius"], upper=0.06, lower=0.125):
    """Both crank angles of every leg that reach P, from the law of cosines in the leg's plane; shape (3, 2)."""
    solutions = []
    for R in THIRDS:
        x, y, z = R.T @ P + [platform - base, 0, 0]
        reach = np.hypot(x, z)
        inner = np.arccos((reach**2 + upper**2 + y**2 - lower**2) / (2 * upper * reach))
        solutions.append(np.arctan2(z, x) + [-inner, inner])
    return np.array(solutions)


def test_the_inverse_finds_the_joint_vector():
    """Of its two solutions a leg, the one whose crank points outwards."""
    q = valid(delta())
    for P, row in zip(columns(delta(), q)[0], q, strict=True):
        np.testing.assert_allclose(inverse_kinematics(P)[:, 0], row, atol=1e-9)


@given(st.lists(st.floats(-40, 90), min_size=3, max_size=3))
@settings(max_examples=200)
def test_a_third_of_a_turn_permutes_the_cranks(angles):
    q = np.deg2rad(angles)
    (tip, J, ok), (turned, J_turned, ok_turned) = (columns(delta(), [v]) for v in (q, np.roll(q, 1)))
    assert ok[0] == ok_turned[0]
    if ok[0]:
        np.testing.assert_allclose(turned[0], THIRDS[1] @ tip[0], atol=1e-14)
        np.testing.assert_allclose(J_turned[0], np.roll(THIRDS[1] @ J[0], 1, axis=1), atol=1e-10)


# Jacobian


def test_the_jacobian_is_the_derivative_of_the_tip():
    q, step = valid(delta(slope=[20.0, 85.0])), 1e-6
    ends = [(columns(delta(), q + h)[0] - columns(delta(), q - h)[0]) / (2 * step) for h in step * np.eye(3)]
    np.testing.assert_allclose(columns(delta(), q)[1], np.stack(ends, axis=-1), atol=1e-9)


def test_the_platform_does_not_turn():
    at = delta().postures(np.random.default_rng(0).uniform(size=(10, 3)))
    np.testing.assert_array_equal(at.jacobians[:, 3:], 0)
    np.testing.assert_array_equal(at.rotations, np.broadcast_to(np.eye(3), (10, 3, 3)))


def test_manipulability_is_the_determinant():
    J = columns(delta(), valid(delta()))[1]
    whole = np.concatenate([J, np.zeros_like(J)], axis=1)
    np.testing.assert_allclose(manipulability(whole, TRANSLATION), np.abs(np.linalg.det(J)), rtol=1e-9)
    np.testing.assert_allclose(manipulability(whole), np.abs(np.linalg.det(J)), rtol=1e-9)


def test_the_compiled_formulas_are_those_on_arrays():
    arm = delta()
    u = np.random.default_rng(0).uniform(size=(2000, 3))
    at, (tips, J, ok) = arm.postures(u), columns(arm, uniform(2000))
    np.testing.assert_array_equal(at.valid, ok)
    np.testing.assert_allclose(at.tips[ok], tips[ok], atol=1e-15)
    np.testing.assert_allclose(at.jacobians[ok, :3], J[ok], rtol=1e-9, atol=1e-12)


# What is valid


def test_the_slope_is_that_of_the_lower_arms():
    """The same for all three: their angle to the plane of their upper ends, moved inwards by the platform's radius."""
    arm = delta(slope=[52.0, 65.0])
    q = uniform(4000, arm=arm)
    tips, _, ok = columns(arm, q)
    slopes = []
    for P, row in zip(tips[ok], q[ok], strict=True):
        ends = [e - R @ [0.015, 0, 0] for e, R in zip(elbows(row), THIRDS, strict=True)]
        n = np.cross(ends[1] - ends[0], ends[2] - ends[0])
        slopes.append([np.rad2deg(np.arcsin((P - e) @ n / np.linalg.norm(n) / 0.125)) for e in ends])
    np.testing.assert_allclose(slopes, np.array(slopes)[:, :1] * [[1, 1, 1]], atol=1e-9)
    assert 52 <= np.min(slopes) < 52.5
    assert 64.5 < np.max(slopes) <= 65
    assert ok.sum() < columns(delta(slope=[1.0, 90.0]), q)[2].sum()


def test_spheres_that_do_not_meet_are_not_valid():
    arm = delta(lower=0.06, slope=[1.0, 90.0])
    q = uniform(2000, arm=arm)
    tips, _, ok = columns(arm, q)
    outermost = columns(arm, np.zeros((1, 3)))
    assert not outermost[2][0]
    assert 0 < ok.mean() < 1
    np.testing.assert_array_less(np.abs(tips), 1.0)


def test_a_crank_beyond_its_dead_point_is_not_valid():
    """Crank 1 turned so far that the platform could only hang from it stretched the other way."""
    arm = delta(limits=[-90.0, 170.0], slope=[1.0, 90.0])
    q = valid(arm, 4000)
    for P, row in zip(columns(arm, q)[0], q, strict=True):
        turns = (inverse_kinematics(P)[:, 0] - row) / (2 * np.pi)
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-6)


def test_outputs_are_finite_everywhere():
    arm = delta(lower=0.02, limits=[-180.0, 180.0], slope=[1.0, 90.0])
    for values in columns(arm, uniform(5000, arm=arm)):
        assert np.isfinite(values).all()


# In a study


def study(**changes):
    tree = small.tree(small.NO_SEARCH | {small.DESIGN: "", "K = 12270": "K_scaled = 3"})
    tree["arm"] = {"kind": "delta", "base_radius": 0.1, "platform_radius": 0.03, "upper": 0.2, "lower": 0.4, **RANGES}
    tree["layout"] = {"spacing": 0.3, "offset": [0.0, 0.6, 0.1], "orientation": [90, 0, 0]}
    for path, value in changes.items():
        table, key = path.split("_", 1)
        tree[table][key] = value
    return check(tree, small.Path("small.toml"))


def test_a_study_of_a_delta():
    numbers = evaluate(study(dexterity_rows="translation"), {}).scenarios[""]
    assert numbers["F"] > 0
    assert 0 < numbers["valid_share"] <= 1


def test_rows_that_a_delta_does_not_have_are_told():
    assert delta().when_singular().endswith('a delta moves in translation only. Write rows = "translation".')


def test_a_delta_that_cannot_be_assembled_is_told():
    with pytest.raises(SpecError, match="none of 16384 postures"):
        evaluate(study(arm_lower=0.05, arm_upper=0.02, dexterity_rows="translation"), {})


def test_its_lengths_can_be_searched():
    assert study().design({"arm.upper": 0.25}).plugins["arm"][1].upper == 0.25


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"upper": 0.0}, "greater than 0"),
        ({"limits": [90.0, -40.0]}, "must increase"),
        ({"slope": [0.0, 80.0]}, "slope must lie above 0"),
        ({"slope": [10.0, 91.0]}, "not above a right angle"),
    ],
)
def test_parameters_that_cannot_be_are_refused(change, words):
    with pytest.raises(ValidationError, match=words):
        delta(**change)


def test_degrees_and_radians_describe_the_same_delta():
    radians = delta(angles="rad", **{k: list(np.deg2rad(v)) for k, v in RANGES.items()})
    np.testing.assert_allclose(radians.constants, delta().constants, rtol=1e-15)
