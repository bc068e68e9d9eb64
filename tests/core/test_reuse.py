"""Samples that a change does not move are not computed again, and give the same bits."""

from dataclasses import replace

import numpy as np
import pytest

from eiwa.core import reuse
from eiwa.core.evaluation import Layout
from eiwa.core.filling import Sampling
from tests.arms import paper
from tests.core.rig import BACKENDS, ArrayIndex, measured, setup


@pytest.fixture
def kept(monkeypatch):
    monkeypatch.setattr(reuse, "samples", reuse.Kept())
    return reuse.samples


def spaced(spacing, **changes):
    return setup(layout=Layout(spacing, (0.0, 0.5, 0.0), (0.0, 0.0, -np.pi / 2)), **changes)


@pytest.mark.parametrize("aggregate", ["max", "mean"])
@pytest.mark.parametrize("estimator", ["plain", "sobol"])
def test_reused_samples_give_the_same_bits(kept, aggregate, estimator):
    designs = [spaced(d, backend=BACKENDS[aggregate], estimator=estimator) for d in (0.2, 0.25, 0.3, 0.3)]
    last = [measured(design).first.V_dual for design in designs][-1]
    assert kept.hits == 2
    reuse.samples = reuse.Kept()
    np.testing.assert_array_equal(last, measured(designs[-1]).first.V_dual)


def test_another_spacing_finds_them_from_the_third_evaluation_on(kept):
    for spacing in (0.2, 0.25, 0.3, 0.35):
        measured(spaced(spacing))
    assert (kept.hits, kept.misses) == (2, 2)


def test_another_arm_does_not(kept):
    for length in (0.2, 0.21, 0.22, 0.23):
        measured(setup(arm=paper(length, 0.18, limits=(-2.0, 2.0))))
    assert kept.hits == 0
    assert kept.bytes() == 0


def test_another_seed_does_not(kept):
    for seed in (1, 2, 3):
        measured(setup(seed=seed))
    assert kept.hits == 0


def test_a_threshold_is_applied_to_reused_samples(kept):
    for _ in range(3):
        measured(setup())
    assert kept.hits == 1
    strict = measured(replace(setup(), threshold=0.5)).first.V.right.values
    assert kept.hits == 2
    assert strict[strict > 0].min() >= 0.5


def test_an_index_in_plain_numpy_is_never_reused(kept):
    index = ArrayIndex(lambda postures: np.ones(len(postures.u)))
    for _ in range(3):
        measured(setup(index=index, sampling=Sampling(1 << 12)))
    assert kept.hits == 0


def test_memory_is_bounded():
    kept = reuse.Kept(capacity=10_000)
    for key in range(20):
        kept.room(key, (4, 100), np.float64)
        room = kept.room(key, (4, 100), np.float64)
        kept.keep(key, room)
        assert kept.bytes() <= 10_000
    assert kept.find(19) is not None
    assert kept.find(0) is None


def test_what_does_not_fit_is_not_recorded():
    kept = reuse.Kept(capacity=100)
    kept.room("key", (4, 100), np.float64)
    assert kept.room("key", (4, 100), np.float64) is None
