"""Designs under errors of manufacture and with values of a catalogue: closed forms of a straight line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eiwa.core.errors import EiwaError, SpecError
from eiwa.study import probe, tolerance
from eiwa.study.tolerance import NEIGHBOURS, neighbours
from tests.study import linear, small

TOLERANCE = """[tolerance]
"arm.joints.upper.a" = { normal = 0.01 }
"arm.joints.fore.a" = { uniform = 0.02 }
"layout.spacing" = { normal = 0.002 }
"""
CATALOGUE = """[catalogue]
"arm.joints.upper.a" = [0.15, 0.25, 0.30]
"arm.joints.fore.a" = [0.10, 0.18, 0.20]
"""
DESIGN = {"arm.joints.upper.a": 0.26, "arm.joints.fore.a": 0.18, "layout.spacing": 0.20}
MIDDLE = 2 * 0.26 - 0.18 + 0.5 * 0.20


@pytest.fixture
def line(monkeypatch):
    monkeypatch.setattr(tolerance, "evaluate", linear.evaluate)


def made(spec, draws):
    calls = []
    found = tolerance.made(spec, probe.lean(spec), DESIGN, draws, lambda: calls.append(1))
    assert len(calls) == draws + 1
    return found


def test_a_line_under_errors(line):
    """A normal and a uniform error: mean unmoved, variances add, every number within its own error."""
    spec = small.spec(extra=TOLERANCE)
    (spread,) = made(spec, 4096).spreads
    sigma = linear.deviation(spec)
    assert spread.nominal == pytest.approx(MIDDLE)
    assert spread.mean.value == pytest.approx(MIDDLE, abs=4 * spread.mean.error)
    assert spread.deviation.value == pytest.approx(sigma, abs=4 * spread.deviation.error)
    assert spread.mean.error == pytest.approx(sigma / 64, rel=0.05)
    assert spread.deviation.error == pytest.approx(sigma / np.sqrt(2 * 4096), rel=0.2)
    # nearly normal: the uniform error's part is a quarter of the variance
    assert spread.worst.value == pytest.approx(MIDDLE - 1.645 * sigma, abs=0.1 * sigma)


def test_which_error_matters(line):
    spec = small.spec(extra=TOLERANCE)
    (spread,) = made(spec, 512).spreads
    assert [e.path for e in spread.effects] == ["arm.joints.upper.a", "arm.joints.fore.a", "layout.spacing"]
    exact = [0.02, -0.02 / np.sqrt(3), 0.001]
    assert [e.per_deviation.value for e in spread.effects] == pytest.approx(exact, abs=1e-9)
    assert [e.share for e in spread.effects] == pytest.approx(np.square(exact) / np.sum(np.square(exact)), abs=0.08)
    assert spread.linear == pytest.approx(1)


def test_a_minimised_objectives_bad_side_is_above(line):
    (spread,) = made(small.spec({"maximize": "minimize"}, TOLERANCE), 256).spreads[:1]
    assert spread.worst.value > spread.mean.value + spread.deviation.value


def test_devices_that_break_a_constraint_are_counted(line):
    """reach = upper + fore is 0.44 as designed, and its error is symmetric: half of the devices are too long."""
    found = made(small.spec({"max = 0.40": "max = 0.44"}, TOLERANCE), 1024)
    assert found.any_broken == found.broken["reach <= 0.44"]
    assert found.any_broken == pytest.approx(512, abs=4 * 16)


def test_inequalities_of_variables_say_nothing_about_a_device():
    """A device has lengths, no variables: such a constraint is not said to be met by every device."""
    spec = small.spec(extra=TOLERANCE + "[[constraints]]\nexpression = 'reach <= 0.30'\n")
    assert list(made(spec, 2).broken) == ["reach <= 0.4"]


def test_draws_that_are_no_design_are_counted(monkeypatch):
    """An error of 60 degrees turns some limits round."""
    extra = '[tolerance]\n"arm.joints.waist.limits.1" = { normal = 200.0 }\n'
    spec = small.spec(extra=extra)

    def evaluate(spec, overrides, replicates=1):
        spec.design(overrides)
        return linear.evaluate(spec, overrides, replicates)

    monkeypatch.setattr(tolerance, "evaluate", evaluate)
    found = made(spec, 64)
    drawn = tolerance.errors(spec, 64)[:, 0]
    assert found.invalid == np.count_nonzero(120 + drawn <= -120)
    assert 0 < found.invalid == found.any_broken - sum(found.broken.values())


def test_more_draws_add_to_the_first():
    spec = small.spec(extra=TOLERANCE)
    assert np.array_equal(tolerance.errors(spec, 10), tolerance.errors(spec, 99)[:10])


def test_another_paths_tolerance_moves_no_error():
    more = small.spec(extra='[tolerance]\n"layout.alpha" = { normal = 0.01 }\n' + TOLERANCE.split("\n", 1)[1])
    assert np.array_equal(tolerance.errors(more, 5)[:, 1:], tolerance.errors(small.spec(extra=TOLERANCE), 5))


def test_the_seed_moves_every_error():
    one, two = (tolerance.errors(small.spec({"seed = 1": f"seed = {s}"}, TOLERANCE), 5) for s in (1, 2))
    assert not np.isclose(one, two).any()


def test_a_path_that_the_design_lacks(line):
    spec = small.spec(extra=TOLERANCE)
    other = {"arm": {"kind": "delta", "base_radius": 0.04, "platform_radius": 0.015, "upper": 0.06, "lower": 0.125}}
    other["arm"] |= {"limits": [-40, 90], "slope": [20, 85]}
    with pytest.raises(SpecError, match=r"tolerance: arm\.joints\.upper\.a"):
        tolerance.at_paths(spec, other, spec.tolerance, "tolerance")


def test_no_draw_is_a_design(monkeypatch):
    def evaluate(spec, overrides, replicates=1):
        if overrides != DESIGN:
            raise EiwaError("broken")
        return linear.evaluate(spec, overrides, replicates)

    monkeypatch.setattr(tolerance, "evaluate", evaluate)
    with pytest.raises(EiwaError, match="8 of 8 draws are no valid design"):
        made(small.spec(extra=TOLERANCE), 8)


# Catalogue


def test_neighbours_lie_below_and_above():
    found = neighbours({"a": 0.26, "b": 0.18, "c": 0.9}, {"a": [0.15, 0.25, 0.30], "b": [0.10, 0.18], "c": [0.1, 0.5]})
    assert found == [{"a": 0.25, "b": 0.18, "c": 0.5}, {"a": 0.30, "b": 0.18, "c": 0.5}]


@given(
    st.lists(st.floats(0.01, 1), min_size=1, max_size=7), st.lists(st.floats(0, 1), min_size=2, max_size=9, unique=True)
)
def test_the_nearest_neighbour_comes_first(at, offered):
    place, catalogue = {str(k): v for k, v in enumerate(at)}, {str(k): sorted(offered) for k in range(len(at))}
    found = neighbours(place, catalogue)
    assert 1 <= len(found) <= NEIGHBOURS
    for k, v in found[0].items():
        assert abs(v - place[k]) == pytest.approx(min(abs(other - place[k]) for other in offered))
    for values in found:
        for k, v in values.items():
            assert not any(min(v, place[k]) < other < max(v, place[k]) for other in offered)


def test_choices_are_ranked_and_feasible_ones_come_first(line):
    spec = small.spec({"max = 0.40": "max = 0.43"}, CATALOGUE)
    calls = []
    itself, found = tolerance.choices(spec, probe.lean(spec), DESIGN, 3, lambda: calls.append(1))
    assert len(calls) == 3
    assert itself.objectives == pytest.approx([MIDDLE])
    assert [c.values["arm.joints.upper.a"] for c in found] == [0.25, 0.30]
    assert [c.outcome.feasible for c in found] == [True, False]
    assert [c.change.mean for c in found] == pytest.approx([-0.02, 0.08])
    assert [c.tied for c in found] == [True, False]
