"""Differences of an arm's tips agree with Jacobians that are right, and tell those that are wrong."""

from dataclasses import replace

import numpy as np
import pytest

from eiwa.core.derivative import differentiate, on_arrays
from eiwa.core.interfaces import Arm
from tests import arms


def points(arm, n=32):
    return np.random.default_rng(0).random((n, arm.dof))


@pytest.mark.parametrize("make", [arms.paper, arms.panda, arms.mtm, arms.puma, arms.touch, arms.ur5])
def test_serial_arms_agree_with_their_differences(make):
    derivative = differentiate(make(), points(make()))
    assert derivative.trusted.all()
    assert derivative.mismatch.max() < 1e-9


def test_a_planar_arm_by_hand():
    """Tip of (0.3, 0.2): dx/dq_1 = -0.3 sin q_1 - 0.2 sin(q_1 + q_2), and the handle turns by q_1 + q_2."""
    derivative = differentiate(arms.planar(0.3, 0.2), points(arms.planar(0.3, 0.2)))
    q1, q2 = derivative.postures.q.T
    assert derivative.rates == pytest.approx(np.broadcast_to(2 * np.pi * np.eye(2), (32, 2, 2)), abs=1e-9)
    wanted = -0.3 * np.sin(q1) - 0.2 * np.sin(q1 + q2)
    assert derivative.twists[:, 0, 0] / (2 * np.pi) == pytest.approx(wanted, abs=1e-9)
    assert derivative.twists[:, 5] / (2 * np.pi) == pytest.approx(np.ones((32, 2)), abs=1e-9)
    assert derivative.twists[:, 3:5] == pytest.approx(np.zeros((32, 2, 2)), abs=1e-9)


class Changed(Arm):
    """The paper's arm with its postures changed."""

    def __init__(self, change):
        self.arm, self.change = arms.paper(), change
        self.dof, self.limited = self.arm.dof, self.arm.limited

    def postures(self, u):
        return self.change(on_arrays(self.arm, u))


@pytest.mark.parametrize("error", [1e-6, 1e-3, 0.1])
def test_a_wrong_column_is_seen_by_its_size(error):
    def change(postures):
        J = np.array(postures.jacobians)
        J[:, 5, 0] += error  # of the waist, whose right entry is 1
        return replace(postures, jacobians=J)

    derivative = differentiate(Changed(change), points(arms.paper()))
    assert derivative.mismatch.max() == pytest.approx(error / (1 + error), rel=1e-3)
    assert np.unravel_index(derivative.mismatch.max(axis=0).argmax(), (6, 6)) == (5, 0)


def test_beside_postures_without_a_solution_nothing_is_trusted():
    arm = Changed(lambda postures: replace(postures, valid=postures.u[:, 0] > 0.5))
    u = points(arms.paper())
    assert differentiate(arm, u).trusted.tolist() == (u[:, 0] > 0.5).tolist()


def test_where_tips_jump_nothing_is_trusted():
    arm = Changed(lambda p: replace(p, tips=p.tips + (p.u[:, :1] > 0.5)))
    u = np.array([[0.5] * 6, [0.2] * 6])
    assert differentiate(arm, u).trusted.tolist() == [False, True]


@pytest.mark.parametrize("make", [arms.paper, arms.touch])
def test_formulas_on_numpy_columns_are_the_compiled_ones(make):
    u = points(make())
    compiled, plain = make().postures(u), on_arrays(make(), u)
    for name in ("u", "q", "tips", "rotations", "jacobians"):
        assert getattr(plain, name) == pytest.approx(getattr(compiled, name), abs=1e-12)
    assert (plain.valid == compiled.valid).all()
