"""Intervals and paired differences against scipy and by simulation."""

import numpy as np
import pytest
from scipy import stats

from eiwa.core.interval import interval, paired


def test_an_interval_without_error_is_the_value_and_what_remains():
    assert interval(0.25, 0.0, 0.5, 4) == (0.25, 0.75)


def test_an_interval_uses_students_t():
    low, high = interval(0.0, 1.0, 0.0, 4)
    assert (low, high) == (pytest.approx(-stats.t.ppf(0.975, 3)), pytest.approx(stats.t.ppf(0.975, 3)))


def test_a_paired_difference_is_scipys_interval():
    a, b = np.random.default_rng(0).normal(size=(2, 6))
    expected = stats.ttest_rel(a, b).confidence_interval(0.95)
    found = paired(a, b)
    assert found.mean - found.half_width == pytest.approx(expected.low)
    assert found.mean + found.half_width == pytest.approx(expected.high)


def test_common_noise_cancels():
    noise = np.random.default_rng(1).normal(size=8)
    assert paired(0.301 + noise, 0.3 + noise).real


def test_equal_designs_are_told_apart_as_seldom_as_stated():
    numbers = np.random.default_rng(2)
    false = sum(paired(*numbers.normal(size=(2, 4))).real for _ in range(2000))
    assert false / 2000 == pytest.approx(0.05, abs=0.015)


def test_what_remains_widens_the_error():
    assert not paired([0.31, 0.311], [0.30, 0.301], remaining=0.05).real
