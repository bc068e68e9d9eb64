"""The devices that come with eiwa: their files against the numbers that the tests know, and their ranking."""

from pathlib import Path

import numpy as np
import pytest

from eiwa.core.outcome import measurements
from eiwa.core.spec import load
from eiwa.plugins.arms import delta
from tests import arms

STUDY = Path(__file__).parents[2] / "studies" / "devices.toml"
KNOWN = {
    "paper": arms.paper(limits=tuple(np.deg2rad([-120.0, 120.0]))),
    "mtm": arms.mtm(),
    "touch": arms.touch(),
    "ur5": arms.ur5(),
    "panda": arms.panda(),
}


@pytest.fixture(scope="module")
def spec():
    return load(STUDY)


def built(spec, name):
    return spec.design(spec.designs[name].overrides).setup(1).arm


def test_every_device_is_known(spec):
    assert set(spec.designs) == {*KNOWN, "falcon"}


@pytest.mark.parametrize("quantity", [0, 1, 2], ids=["tips", "orientations", "jacobians"])
@pytest.mark.parametrize("name", KNOWN)
def test_a_device_is_the_arm_of_its_numbers(spec, name, quantity):
    arm, known = built(spec, name), KNOWN[name]
    q = np.random.default_rng(0).uniform(-3, 3, (20, known.dof))
    np.testing.assert_allclose(arms.forward(arm, q)[quantity], arms.forward(known, q)[quantity], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", KNOWN)
def test_a_device_has_the_ranges_of_its_numbers(spec, name):
    """The MTM's are whole degrees in its file, and rounded radians in its source."""
    arm, known = built(spec, name), KNOWN[name]
    np.testing.assert_allclose([arm.lower, arm.upper], [known.lower, known.upper], rtol=0, atol=1e-4)


def test_the_falcon_reaches_its_published_workspace(spec):
    """Its maker states a cube of 4 inches; at mid-height the delta reaches at least as far to every side."""
    arm = built(spec, "falcon")
    assert isinstance(arm, delta.Delta)
    tips = arm.postures(np.random.default_rng(0).uniform(size=(1 << 14, 3))).solved.tips
    middle = tips[np.abs(tips[:, 2] - np.median(tips[:, 2])) < 0.01]
    assert np.ptp(middle[:, 0]) > 0.1
    assert np.ptp(middle[:, 1]) > 0.1
    assert np.ptp(tips[:, 2]) > 0.1


def test_no_replicate_of_the_ur5_ends_on_a_worse_branch(spec):
    """Its inverse kinematics has eight; where the search missed one, F ended 0.01 lower."""
    ((_, measurement),) = measurements(spec, spec.designs["ur5"].overrides, replicates=6)
    F = [float((r.V_dual * r.E_sum).sum() / r.E_sum.sum()) for r in measurement.replicates]
    assert np.ptp(F) < 0.004
