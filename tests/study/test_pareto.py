"""The Pareto set of rows: goals, members, ties within errors, several runs."""

from pathlib import Path

import pytest

from eiwa.core.errors import EiwaError, SpecError, StoreError
from eiwa.study.pareto import goals, pareto
from tests.study import small

pytest.importorskip("moocore")

LENGTH = '[[objectives]]\nmetric = "total_link_length"\ndirection = "minimize"\n\n'
BOTH = {small.OBJECTIVE: small.OBJECTIVE + LENGTH}
COLUMNS = ["objectives.0", "metrics.F", "metrics.F@dexterity.K=50", "metrics.reach", "metrics.singletons"]


class Stored:
    """A store of given rows, as a study would have written them."""

    def __init__(self, spec, rows, folder="runs/small"):
        self.spec, self.folder, self._rows = spec, Path(folder), rows

    def table(self):
        import pyarrow as pa

        columns = dict.fromkeys(column for row in self._rows for column in row)
        return pa.Table.from_pylist([{c: row.get(c) for c in columns} for row in self._rows])

    def exists(self):
        return True

    def changes(self, spec):
        from eiwa.core.spec import differences

        return differences(self.spec.identity, spec.identity)


@pytest.fixture(scope="module")
def spec():
    return small.spec(BOTH)


def trial(number, F, length, *, kind="trial", feasible=True, state="COMPLETE", **more):
    values = {"objectives.0": F, "objectives.1": length, "metrics.F": F, "metrics.F_remaining": None}
    return {"kind": kind, "number": number, "state": state, "feasible": feasible, "name": None, **values, **more}


def leader(number, F, length):
    """A trial with all replicates: lists."""
    lists = {"replicated.objectives.0": F, "replicated.objectives.1": length}
    return trial(number, F[0], length[0], kind="leader", **lists)


def found(spec, rows, chosen=None):
    return pareto(spec, [Stored(spec, rows)], chosen)


def numbers(found):
    return [m.row["number"] for m in found.members]


# Goals


def test_goals_are_the_studys_objectives(spec):
    assert [(g.name, g.maximised, g.unit) for g in goals(spec, None, [])] == [
        ("F", True, ""),
        ("total_link_length", False, "m"),
    ]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("F,reach", [("metrics.F", True), ("metrics.reach", False)]),
        ("+reach,-F", [("metrics.reach", True), ("metrics.F", False)]),
        ("F@dexterity.K=50, singletons", [("metrics.F@dexterity.K=50", True), ("metrics.singletons", False)]),
    ],
)
def test_goals_by_name(text, wanted):
    assert [(g.column, g.maximised) for g in goals(small.spec(), text, COLUMNS)] == wanted


def test_an_objective_that_is_no_metric_by_its_label():
    study = small.spec(
        {small.OBJECTIVE: small.OBJECTIVE[:-1] + 'over = "scenarios"\naggregate = "min"\n'}, small.SCENARIOS
    )
    assert [(g.column, g.maximised) for g in goals(study, "min F,-F", COLUMNS)] == [
        ("objectives.0", True),
        ("metrics.F", False),
    ]


def test_a_scenario_may_hold_a_list():
    columns = [*COLUMNS, "metrics.F@layout.offset=[0.0, 0.8, 0.1]"]
    found = goals(small.spec(), "F@layout.offset=[0.0, 0.8, 0.1],reach", columns)
    assert [g.name for g in found] == ["F@layout.offset=[0.0, 0.8, 0.1]", "reach"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "the study has F. Name them, as in --objectives"),
        ("F", "two or more different numbers"),
        ("F,F", "two or more different numbers"),
        ("F,reech", "did you mean 'reach'"),
        ("F,++reach", "no such number"),
        ("F,", "no such number"),
    ],
)
def test_goals_that_are_none(text, said):
    with pytest.raises(SpecError, match=said):
        goals(small.spec(), text, COLUMNS)


# Members


def test_members_are_sorted_by_the_first_objective_and_marked(spec):
    rows = [trial(0, 0.2, 0.30), trial(1, 0.5, 0.44), trial(2, 0.1, 0.40), trial(3, 0.45, 0.31), trial(4, 0.1, 0.29)]
    front = found(spec, rows)
    assert numbers(front) == [1, 3, 0, 4]
    assert [m.best for m in front.members] == [("F",), (), (), ("total_link_length",)]
    assert [m.knee for m in front.members] == [False, True, False, False]
    assert front.reference == pytest.approx((0.1 - 0.04, 0.44 + 0.015))


@pytest.mark.parametrize(
    "outside",
    [
        trial(9, 0.9, 0.1, feasible=False),
        trial(9, None, None, feasible=None, state="FAIL"),
        trial(9, None, None, feasible=False, state="SKIPPED"),
        trial(9, 0.9, None),
        trial(9, 0.9, 0.1, kind="design"),
        trial(9, 0.9, 0.1, kind="leader"),
    ],
    ids=["infeasible", "failed", "skipped", "without a value", "named design", "leader"],
)
def test_only_feasible_complete_trials_are_on_the_front(outside, spec):
    assert numbers(found(spec, [trial(0, 0.2, 0.3), outside])) == [0]


def test_equal_trials_are_shown_once(spec):
    assert numbers(found(spec, [trial(0, 0.2, 0.3), trial(1, 0.2, 0.3)])) == [0]


def test_no_feasible_trial(spec):
    with pytest.raises(EiwaError, match="there is no front"):
        found(spec, [trial(0, 0.2, 0.3, feasible=False)])


def test_the_last_quarter_is_counted_in_trials(spec):
    rows = [trial(0, 0.1, 0.2), *(trial(n, 0.0, 0.5, feasible=False) for n in range(1, 7)), trial(7, 0.3, 0.4)]
    front = found(spec, rows)
    (volumes,) = front.histories.values()
    assert len(volumes) == 8
    assert front.last_quarter == pytest.approx(1 - volumes[5] / volumes[7])
    assert volumes[0] == volumes[6] < volumes[7] == front.hypervolume


# Errors


def test_errors_are_deviations_over_replicates(spec):
    rows = [trial(0, 0.2, 0.3), leader(0, [0.2, 0.3, 0.1], [0.3, 0.3, 0.3])]
    assert found(spec, rows).members[0].errors == pytest.approx((0.1, 0.0))


def test_a_member_that_another_beats_within_errors_is_doubtful(spec):
    """Trial 1 has more F in its first replicate only, and is longer."""
    rows = [trial(0, 0.20, 0.30), trial(1, 0.21, 0.40), trial(2, 0.6, 0.5)]
    rows += [leader(0, [0.20, 0.22, 0.24], [0.30] * 3), leader(1, [0.21, 0.21, 0.235], [0.40] * 3)]
    rows += [leader(2, [0.60, 0.61, 0.63], [0.50] * 3)]
    front = found(spec, rows)
    assert {m.row["number"]: m.doubtful for m in front.members} == {0: False, 1: True, 2: False}


def test_members_without_replicates_cannot_be_told(spec):
    rows = [trial(0, 0.20, 0.30), trial(1, 0.21, 0.40), trial(2, 0.6, 0.5)]
    rows += [leader(0, [0.20, 0.22, 0.24], [0.30] * 3), leader(2, [0.60, 0.61, 0.63], [0.50] * 3)]
    assert {m.row["number"]: m.doubtful for m in found(spec, rows).members} == {0: False, 1: None, 2: False}


def test_what_elites_may_still_gain_counts_as_error(spec):
    rows = [trial(0, 0.20, 0.30), trial(1, 0.25, 0.40)]
    rows += [leader(0, [0.20, 0.22, 0.24], [0.30] * 3), leader(1, [0.25, 0.27, 0.29], [0.40] * 3)]
    assert not found(spec, rows).members[0].doubtful
    rows[-1]["metrics.F_remaining"] = 0.06
    assert found(spec, rows).members[0].doubtful


# Several runs


def test_a_front_over_two_runs(spec):
    stores = [
        Stored(spec, [trial(0, 0.2, 0.30), trial(1, 0.3, 0.40)], "runs/a"),
        Stored(spec, [trial(0, 0.3, 0.35), trial(1, 0.2, 0.30)], "runs/b"),
    ]
    front = pareto(spec, stores)
    assert [(m.run, m.row["number"]) for m in front.members] == [("runs/b", 0), ("runs/a", 0)]
    assert list(front.histories) == ["runs/a", "runs/b"]
    assert front.histories["runs/b"][-1] == pytest.approx(front.hypervolume)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"maximize": "minimize"}, "objectives.0.direction: minimize -> maximize"),
        ({"[voxels]": '[metrics.F]\nvolume = "union"\n[voxels]'}, "metrics.F.volume: union -> sum"),
    ],
)
def test_runs_with_other_objectives_are_refused(changes, said, spec):
    other, rows = small.spec({**BOTH, **changes}), [trial(0, 0.2, 0.3)]
    with pytest.raises(StoreError, match=said):
        pareto(spec, [Stored(spec, rows), Stored(other, rows, "runs/b")])


def test_a_run_given_twice_is_refused(spec):
    """Twice the same trials: none would add anything."""
    rows = [trial(0, 0.2, 0.3)]
    with pytest.raises(StoreError, match="part of the front already"):
        pareto(spec, [Stored(spec, rows), Stored(spec, rows)])


def test_a_run_whose_named_objective_differs_is_refused():
    named = {small.OBJECTIVE: small.OBJECTIVE[:-1] + 'name = "share"\n\n' + LENGTH}
    spec, other, rows = small.spec(named), small.spec({**named, "maximize": "minimize"}), [trial(0, 0.2, 0.3)]
    with pytest.raises(StoreError, match=r"objectives\.share\.direction"):
        pareto(spec, [Stored(spec, rows), Stored(other, rows, "runs/b")])


def test_a_run_without_the_number_is_refused(spec):
    rows = [trial(0, 0.2, 0.3, **{"metrics.reach": 0.4})]
    bare = [{k: v for k, v in row.items() if k != "metrics.reach"} for row in rows]
    with pytest.raises(StoreError, match=r"metrics\.reach: absent"):
        pareto(spec, [Stored(spec, rows), Stored(spec, bare, "runs/b")], "F,reach")
