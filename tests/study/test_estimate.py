"""How far a study's samples leave F below the true F on its grid, told before anything is run."""

import pytest

from eiwa.core.outcome import evaluate
from eiwa.study.estimate import SEARCHED, shortfall
from tests.study import small


def spec(size, samples, estimator="plain", aggregate="max"):
    sampling = f'[sampling]\nestimator = "{estimator}"\nsamples = {samples}\n'
    return small.spec(
        {
            "[sampling]\nsamples = 4096\n": sampling,
            'kind = "dense"\nsize = 0.05\n': f'kind = "dense"\nsize = {size}\naggregate = "{aggregate}"\n',
        }
    )


@pytest.fixture(scope="module")
def few():
    return shortfall(spec(0.03, 1 << 14))


def test_few_samples_fall_short(few):
    assert few.error > 0.5


def test_the_error_is_that_of_F(few):
    """Against elites with a tolerance ten times as small."""
    study = spec(0.03, 1 << 24, "elites")
    true_F = evaluate(study, {"sampling.tolerance": SEARCHED / 10}).scenarios[""]["F"]
    assert few.error == pytest.approx(1 - few.F / true_F, abs=SEARCHED)


def test_the_evaluations_are_enough(few):
    numbers = evaluate(spec(0.03, few.evaluations, "elites"), {"sampling.tolerance": 1e-6}).scenarios[""]
    assert numbers["F_remaining"] <= 1.01 * few.tolerance * numbers["F"]


def test_many_samples_in_large_voxels_do_not_fall_short():
    assert shortfall(spec(0.16, 1 << 20), coarse=0.1) is None


def test_elites_that_may_not_finish_fall_short():
    found = shortfall(spec(0.03, 1 << 18, "elites"))
    assert found.error > found.tolerance
    assert found.evaluations > 1 << 18


def test_elites_that_finish_do_not():
    assert shortfall(spec(0.08, 1 << 24, "elites")) is None


def test_means_are_not_judged():
    assert shortfall(spec(0.03, 1 << 14, aggregate="mean")) is None
