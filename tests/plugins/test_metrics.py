"""Metrics of a gantry whose workspaces are boxes."""

import numpy as np
import pytest

from eiwa.core.evaluation import Layout
from eiwa.core.filling import Sampling
from eiwa.core.interval import interval
from eiwa.plugins.metrics.interaction import (
    F,
    FParameters,
    FVolume,
    FVolumeParameters,
    MeanDexterity,
    MeanDexterityParameters,
    Singletons,
    SingletonsParameters,
)
from eiwa.plugins.metrics.size import (
    DexterousVolume,
    DexterousVolumeParameters,
    LinkLength,
    LinkLengthParameters,
    Reach,
    ReachParameters,
    SharedVolume,
    SharedVolumeParameters,
)
from tests.arms import ArrayArm, gantry, paper
from tests.core.rig import Box, One, measured, setup

r = 0.0625


@pytest.fixture(scope="module")
def measurement():
    """Arms on x = [-1, 5] and [-5, 1] cells of [-6, 6], hands in [0, 6] and [-6, 0]."""
    return measured(
        setup(
            arm=gantry((-3 * r, 3 * r), (0.0, 4 * r), (0.0, 4 * r)),
            index=One(),
            layout=Layout(4 * r, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            human=Box((0.0, 0.0, 0.0), (6 * r, 4 * r, 4 * r)),
            r=r,
            sampling=Sampling(20_000),
        )
    )


@pytest.mark.parametrize(("isovalue", "share"), [(0.3, 10 / 12), (0.5, 10 / 12), (0.75, 2 / 12), (0.0, 1.0)])
def test_F_volume_counts_cells_at_or_above_the_isovalue(measurement, isovalue, share):
    metric = FVolume(FVolumeParameters(isovalue=isovalue))
    assert metric(measurement)["F_volume"] == pytest.approx(share, abs=1e-15)


def test_mean_dexterity_weighs_every_ergonomic_cell_alike(measurement):
    mean = MeanDexterity(MeanDexterityParameters())(measurement)["mean_dexterity"]
    assert mean == pytest.approx((8 * 0.5 + 2 * 1.0) / 12, abs=1e-15)


@pytest.fixture(scope="module")
def refined():
    amount = Sampling(1 << 18, tolerance=0.05)
    return F(FParameters())(measured(setup(sampling=amount, estimator="elites", threshold=0.3), replicates=3))


def test_the_interval_of_elites_is_F_less_its_error_to_F_and_what_remains(refined):
    assert (refined["F_low"], refined["F_high"]) == interval(refined["F"], refined["F_se"], refined["F_remaining"], 3)


def test_plain_samples_have_no_interval():
    plain = F(FParameters())(measured(setup(sampling=Sampling(256)), replicates=2))
    assert (plain["F_low"], plain["F_high"]) == (None, None)


def test_no_sample_is_alone_where_many_fall(measurement):
    assert Singletons(SingletonsParameters())(measurement)["singletons"] == 0.0


def test_one_sample_is_alone():
    alone = measured(setup(arm=gantry(*((-r, r),) * 3), index=One(), r=4.0, sampling=Sampling(1)))
    assert Singletons(SingletonsParameters())(alone)["singletons"] == 1.0


def test_no_sample_in_the_grid_is_the_worst_case():
    away = measured(setup(layout=Layout(0.2, (0.0, 50.0, 0.0), (0.0, 0.0, 0.0)), sampling=Sampling(256)))
    assert Singletons(SingletonsParameters())(away)["singletons"] == 1.0


def test_counted_shared_volume_is_the_overlap_of_both_arms(measurement):
    volume = SharedVolume(SharedVolumeParameters(counting="cells"))(measurement)["shared_volume"]
    assert volume == pytest.approx(2 * 4 * 4 * r**3, rel=1e-12)


def test_counted_dexterous_volume_is_one_arms_box(measurement):
    volume = DexterousVolume(DexterousVolumeParameters(counting="cells"))(measurement)["dexterous_volume"]
    assert volume == pytest.approx(6 * 4 * 4 * r**3, rel=1e-12)


def test_shared_volume_is_the_overlap_of_both_arms(measurement):
    volume = SharedVolume(SharedVolumeParameters())(measurement)["shared_volume"]
    assert volume == pytest.approx(2 * 4 * 4 * r**3, rel=0.06)


def test_dexterous_volume_is_one_arms_box(measurement):
    volume = DexterousVolume(DexterousVolumeParameters())(measurement)["dexterous_volume"]
    assert volume == pytest.approx(6 * 4 * 4 * r**3, rel=0.05)


def test_shared_volume_of_arms_far_apart_is_zero():
    apart = measured(setup(layout=Layout(2.0, (0.0, 0.6, 0.0), (0.0, 0.0, 0.0)), sampling=Sampling(256)))
    assert SharedVolume(SharedVolumeParameters())(apart)["shared_volume"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.05, 0.01])
def test_dexterous_volume_of_the_papers_arm_is_known(size):
    """8 pi L1^2 L2 for full turns; counted voxels are 7 to 40 % above it."""
    design = setup(arm=paper(), index=One(), threshold=0.0, r=size, sampling=Sampling(256))
    volume = DexterousVolume(DexterousVolumeParameters())(measured(design))["dexterous_volume"]
    assert volume == pytest.approx(8 * np.pi * 0.26**2 * 0.18, rel=0.03)


def test_reach_is_the_farthest_corner(measurement):
    expected = np.linalg.norm([3 * r, 4 * r, 4 * r])
    assert Reach(ReachParameters())(measurement)["reach"] == pytest.approx(expected, abs=1e-9)


def test_link_length_of_the_papers_arm():
    length = LinkLength(LinkLengthParameters())(measured(setup(sampling=Sampling(256))))
    assert length["total_link_length"] == pytest.approx(0.44, abs=1e-15)


def test_link_length_of_an_arm_that_has_none():
    design = setup(arm=ArrayArm(paper(limits=(-2.0, 2.0))), sampling=Sampling(256))
    assert LinkLength(LinkLengthParameters())(measured(design))["total_link_length"] is None
