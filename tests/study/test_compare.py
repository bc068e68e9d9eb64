"""Comparing designs, convergence, closed forms on this machine."""

import pytest

from eiwa.core.errors import SpecError
from eiwa.study.compare import compare, overrides_of, tied
from eiwa.study.converge import Point, recommendation
from eiwa.study.verify import checks


def point(estimator, samples, F, remaining=None):
    return Point(estimator, samples, 0.02, F, 0.001, None, remaining)


def test_every_closed_form_holds_here():
    assert [c.name for c in checks() if not c.passed] == []


def test_verify_would_notice_a_wrong_answer():
    from dataclasses import replace

    check = next(iter(checks()))
    assert not replace(check, found=check.found * 1.001).passed


def test_rows_with_the_same_replicates_are_tied():
    row = {"replicated.metrics.F": [0.30, 0.31, 0.29], "metrics.F_remaining": None}
    assert tied(row, {**row, "replicated.metrics.F": [0.31, 0.30, 0.295]})


def test_rows_that_differ_in_every_replicate_alike_are_not_tied():
    row = {"replicated.metrics.F": [0.30, 0.31, 0.29], "metrics.F_remaining": None}
    assert tied(row, {**row, "replicated.metrics.F": [0.25, 0.26, 0.241]}) is False


def test_rows_without_replicates_cannot_be_compared():
    assert tied({"replicated.metrics.F": None}, {"replicated.metrics.F": [0.1, 0.2]}) is None


def test_the_cheapest_sufficient_setting_is_recommended():
    found = [point("plain", 1 << 16, 0.2), point("plain", 1 << 18, 0.299), point("elites", 1 << 20, 0.3, 0.001)]
    assert recommendation(found, 0.01) == "r = 0.02 m: plain, samples = 262_144"


def test_elites_are_recommended_where_plain_samples_do_not_suffice():
    found = [point("plain", 1 << 16, 0.2), point("elites", 1 << 20, 0.3, 0.001)]
    assert 'estimator = "elites"' in recommendation(found, 0.01)


@pytest.fixture(scope="module")
def paper():
    from pathlib import Path

    from eiwa.core.spec import load

    small = {"sampling.samples": 1 << 16, "scenarios": {}, "metrics": {}}
    return load(Path(__file__).parents[2] / "studies" / "paper.toml", small)


def test_the_published_designs_differ(paper):
    original, optimum = (overrides_of(paper, name, []) for name in ("original", "optimum"))
    _, difference = compare(paper, optimum, original, replicates=4)
    assert difference.real
    assert difference.mean > 0.05


def test_a_design_does_not_differ_from_itself(paper):
    optimum = overrides_of(paper, "optimum", [])
    _, difference = compare(paper, optimum, optimum, replicates=3)
    assert difference.mean == 0
    assert not difference.real


def test_an_unknown_design_is_refused(paper):
    with pytest.raises(SpecError, match="did you mean 'optimum'"):
        overrides_of(paper, "optimun", [])
