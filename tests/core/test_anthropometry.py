"""Lengths of people against the survey's own percentiles, and their regressions."""

import numpy as np
import pytest

from eiwa.core.anthropometry import LENGTHS, STATURE, lengths

SEXES = ("female", "male")

# Percentiles counted in ANSUR II [mm].
STATURES = {
    "male": {1: 1601.6, 5: 1648, 25: 1710, 50: 1755, 75: 1802, 95: 1870},
    "female": {1: 1482.5, 5: 1525, 25: 1586.2, 50: 1626, 75: 1672, 95: 1740},
}
COUNTED = {
    "male": {
        "upper_arm": (307, 365), "forearm": (263, 314), "hand": (177, 210), "forearm_breadth": (497.1, 666.9),
        "forearm_circumference": (275, 347.9),
    },
    "female": {
        "upper_arm": (283.2, 340), "forearm": (235, 285), "hand": (165, 199), "forearm_breadth": (432, 563.8),
        "forearm_circumference": (235, 296),
    },
}  # fmt: skip


@pytest.mark.parametrize(("sex", "percentile"), [(sex, p) for sex in SEXES for p in STATURES["male"]])
def test_stature_is_within_6_mm_of_the_counted_percentile(sex, percentile):
    assert lengths(sex, percentile)["stature"] * 1000 == pytest.approx(STATURES[sex][percentile], abs=6)


@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("name", LENGTHS["male"])
def test_each_length_is_within_a_seventh_of_a_deviation_of_its_counted_percentile(sex, name):
    sd = LENGTHS[sex][name].sd
    for percentile, counted in zip((5, 95), COUNTED[sex][name], strict=True):
        assert lengths(sex, percentile, "each")[name] * 1000 == pytest.approx(counted, abs=sd / 7)


@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("name", LENGTHS["male"])
def test_the_regression_passes_through_the_means(sex, name):
    assert lengths(sex, 50)[name] * 1000 == pytest.approx(LENGTHS[sex][name].mean, abs=0.5)


@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("name", LENGTHS["male"])
def test_regression_and_residual_make_the_whole_spread(sex, name):
    """sd^2 = (slope sd_stature)^2 + residual^2, as for any linear regression."""
    length = LENGTHS[sex][name]
    assert np.hypot(length.slope * STATURE[sex][1], length.residual) == pytest.approx(length.sd, rel=0.01)


@pytest.mark.parametrize("sex", SEXES)
def test_lengths_follow_stature_by_their_slope(sex):
    short, tall = lengths(sex, 5), lengths(sex, 95)
    for name, length in LENGTHS[sex].items():
        slope = (tall[name] - short[name]) / (tall["stature"] - short["stature"])
        assert slope == pytest.approx(length.slope, abs=1e-12)


def test_random_people_deviate_by_the_residual():
    people = [lengths("female", 30, "random", seed) for seed in range(2000)]
    regressed = lengths("female", 30)
    for name, length in LENGTHS["female"].items():
        values = np.array([person[name] for person in people]) * 1000
        assert values.mean() == pytest.approx(regressed[name] * 1000, abs=4 * length.residual / 2000**0.5)
        assert values.std() == pytest.approx(length.residual, rel=0.08)


def test_the_same_seed_is_the_same_person():
    assert lengths("male", 50, "random", 7) == lengths("male", 50, "random", 7)


def test_a_seed_matters_to_random_people_alone():
    assert lengths("male", 50, "stature", 1) == lengths("male", 50, "stature", 2)
