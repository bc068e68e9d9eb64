"""Figures as plotly's JSON: what they say is what the rows say."""

import json
import math
from statistics import stdev

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from eiwa.report import cards
from tests.study import small

TWO = small.OBJECTIVE + '[[objectives]]\nmetric = "reach"\ndirection = "minimize"\n\n'


def trial(number, *objectives, violation=-1.0, replicated=(), kind="trial", **more):
    """A row as the store has it, as far as figures look."""
    row = {"kind": kind, "number": number, "state": "COMPLETE", "constraints.0": violation, "feasible": violation <= 0}
    for i, value in enumerate(objectives):
        row |= {f"objectives.{i}": value, f"replicated.objectives.{i}": list(replicated) or None}
    return row | more


def traces(figure):
    return {trace["name"]: trace for trace in figure["data"]}


@pytest.mark.parametrize(("direction", "best"), [("maximize", [1.0, 1.0, 3.0]), ("minimize", [1.0, 0.5, 0.5])])
def test_the_best_so_far_is_that_of_trials_that_meet_the_constraints(direction, best):
    spec = small.spec({'"maximize"': f'"{direction}"'})
    rows = [trial(3, 3.0), trial(0, 1.0), trial(1, 9.0, violation=1.0), trial(2, 0.5)]
    drawn = traces(cards.history(spec, rows, []))
    assert (drawn["best so far"]["x"], drawn["best so far"]["y"]) == ([0, 2, 3], best)
    assert (drawn["trial"]["x"], drawn["trial"]["y"]) == ([0, 2, 3], [1.0, 0.5, 3.0])
    assert drawn["breaks a constraint"]["text"] == ["trial 1 breaks reach <= 0.4"]


def test_errors_are_standard_deviations_over_replicates():
    values = [0.3, 0.5, 0.6]
    shown = [
        ("trial 0", trial(0, 0.3, replicated=values, kind="leader")),
        ("optimum", trial(None, 0.4, replicated=values, kind="design")),
        ("trial 1", trial(1, 0.2)),  # one replicate: it has no error, and stands among the trials already
    ]
    drawn = traces(cards.history(small.spec(), [trial(0, 0.3), trial(1, 0.2)], shown))
    assert drawn["trial 0"]["error_y"]["array"] == pytest.approx([stdev(values)], rel=1e-5)
    assert drawn["optimum"]["error_y"]["array"] == pytest.approx([stdev(values)] * 2, rel=1e-5)
    assert "trial 1" not in drawn


def test_a_front_has_errors_in_both_objectives():
    spec = small.spec({small.OBJECTIVE: TWO})
    rows = [trial(0, 0.3, 0.4), trial(1, 0.5, 0.2, violation=1.0)]
    best = trial(
        0, 0.3, 0.4, kind="leader", **{"replicated.objectives.0": [1.0, 2.0], "replicated.objectives.1": [3.0, 3.5]}
    )
    figures = cards.fronts(spec, rows, [("trial 0", best)])
    drawn = traces(figures["front-1"])
    assert (drawn["trial"]["x"], drawn["trial"]["y"]) == ([0.3], [0.4])
    assert (drawn["breaks a constraint"]["x"], drawn["breaks a constraint"]["y"]) == ([0.5], [0.2])
    assert drawn["best trials"]["error_x"]["array"] == pytest.approx([stdev([1.0, 2.0])], rel=1e-5)
    assert drawn["best trials"]["error_y"]["array"] == pytest.approx([stdev([3.0, 3.5])], rel=1e-5)
    assert cards.fronts(small.spec(), rows, []) == {}


def test_a_history_of_thousands_stays_small():
    rows = [trial(n, math.pi / (n + 1)) for n in range(5000)]
    assert len(json.dumps(cards.history(small.spec(), rows, []))) < 400_000


def test_a_workspace_tells_all_of_V_I(monkeypatch):
    """Shares add up to 100 %, and merging cells moves none of them: their mean place stays."""
    spec = small.spec()
    fine = cards.workspace(spec, {}, "the design")["data"][0]
    monkeypatch.setattr(cards, "MOST_CELLS", 40)
    coarse = cards.workspace(spec, {}, "the design")["data"][0]
    assert len(coarse["x"]) <= 40 < len(fine["x"])
    for drawn in (fine, coarse):
        assert sum(drawn["marker"]["color"]) == pytest.approx(100, abs=0.01)
    for axis in "xyz":
        means = [np.average(drawn[axis], weights=drawn["marker"]["color"]) for drawn in (fine, coarse)]
        assert means[0] == pytest.approx(means[1], abs=0.1)  # the edge of a merged cell


def test_a_workspace_without_any_cell_is_drawn():
    figure = cards.workspace(small.spec({"offset = [0.0, 0.802, 0.10]": "offset = [0.0, 9.0, 0.10]"}), {}, "far away")
    assert figure["data"][0]["x"] == []
    assert "F = 0.0000" in figure["layout"]["title"]["text"]


@given(arrays(float, st.tuples(*[st.integers(1, 5)] * 3), elements=st.integers(0, 9).map(float)))
def test_merging_loses_nothing(values):
    merged = cards.merged(values)
    assert merged.sum() == values.sum()
    assert merged.shape == tuple((n + 1) // 2 for n in values.shape)
    assert merged[0, 0, 0] == values[:2, :2, :2].sum()
