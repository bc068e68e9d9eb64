"""Which trials are evaluated again with all replicates."""

import numpy as np
import pytest

from eiwa.study.leaders import SPREAD, leaders
from tests.study import small

TWO = {small.OBJECTIVE: small.OBJECTIVE + small.OBJECTIVE.replace("F", "reach").replace("maximize", "minimize")}


def trial(number, *objectives, state="COMPLETE", feasible=True):
    values = {f"objectives.{i}": v for i, v in enumerate(objectives)}
    return {"kind": "trial", "number": number, "state": state, "feasible": feasible, **values}


def chosen(changes, rows):
    return [r["number"] for r in leaders(small.spec(changes), rows)]


def test_one_objective_has_the_three_best_feasible_ties_by_number():
    rows = [trial(0, 0.3), trial(1, 0.9, feasible=False), trial(2, 0.5), trial(3, 0.5), trial(4, 0.1), trial(5, 0.4)]
    rows += [trial(6, None, state="FAIL", feasible=None), trial(7, None, state="SKIPPED", feasible=False)]
    assert chosen({}, rows) == [2, 3, 5]
    assert chosen({"maximize": "minimize"}, rows) == [4, 0, 5]


@pytest.mark.parametrize("changes", [{}, TWO])
def test_nothing_feasible_has_no_leaders(changes):
    assert chosen(changes, []) == chosen(changes, [trial(0, 0.3, 0.2, feasible=False)]) == []


def test_two_objectives_have_members_of_the_front():
    rows = [trial(0, 0.5, 0.5), trial(1, 0.4, 0.6), trial(2, 0.9, 0.9), trial(3, 0.1, 0.1), trial(4, 0.5, 0.5)]
    assert chosen(TWO, rows) == [2, 0, 3]


def test_a_large_front_is_thinned_evenly_from_end_to_end():
    x = np.random.default_rng(1).uniform(size=400)
    rows = [trial(i, v, v**2) for i, v in enumerate(x)] + [trial(400 + i, v, v**2 + 0.1) for i, v in enumerate(x)]
    found = chosen(TWO, rows)
    picked = x[found]
    assert len(found) == SPREAD == 9
    assert (picked[0], picked[-1]) == (x.max(), x.min())
    assert np.all(np.diff(picked) < 0)
    assert np.abs(picked - np.linspace(x.max(), x.min(), SPREAD)).max() < 0.02


def test_the_front_is_that_of_the_definition():
    values = np.random.default_rng(2).integers(0, 12, size=(60, 2)) / 12
    rows = [trial(i, *map(float, v)) for i, v in enumerate(values)]
    better = [[a[0] >= b[0] and a[1] <= b[1] and tuple(a) != tuple(b) for a in values] for b in values]
    front = {tuple(v) for v, dominated in zip(values, better, strict=True) if not any(dominated)}
    assert len(front) <= SPREAD
    assert {tuple(values[n]) for n in chosen(TWO, rows)} <= front
