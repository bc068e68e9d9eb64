"""What a run leaves behind: rows that can be replayed, equal wherever they were made, and an Optuna study that agrees."""

import json
import math
import os

import optuna
import pytest
from optuna.trial import TrialState

from eiwa.core.errors import EiwaError, SpecError
from eiwa.core.outcome import MISFIT_FLOOR, evaluate, misfit
from eiwa.core.spec import load
from eiwa.study import journal, rows
from eiwa.study.rows import VOLATILE, metric_column
from eiwa.study.run import LEADERS, leaders
from tests.study import small
from tests.study.conftest import instead


@pytest.fixture(scope="module")
def spec():
    return small.spec(extra=small.SCENARIOS + '[designs.near]\n"layout.spacing" = 0.25\n"layout.offset.1" = 0.7\n')


@pytest.fixture(scope="module")
def finished(spec, tmp_path_factory):
    return small.run(spec, tmp_path_factory.mktemp("runs"))


def of_kind(store, kind):
    return [r for r in store.rows() if r["kind"] == kind]


def optunas(store):
    return optuna.load_study(study_name="small", storage=journal.storage(store.journal))


# Rows


def test_every_row_is_complete(finished):
    for row in finished.rows():
        assert row["state"] == "COMPLETE"
        assert row["message"] is None
        assert 0 <= row["metrics.F"] <= 1
        assert row["metrics.singletons"] is not None


def test_rows_say_how_they_were_made(finished, spec):
    for row in finished.rows():
        assert row["spec_hash"] == spec.hash
        assert row["seed"] == 1
        assert {"eiwa", "numpy", "numba", "optuna"} <= json.loads(row["versions"]).keys()
        assert row["seconds"] > 0
        assert row["pid"] > 0
        assert row["host"]
        assert row["started"].utcoffset().total_seconds() == 0


def test_trials_are_numbered(finished):
    assert [r["number"] for r in of_kind(finished, "trial")] == list(range(8))
    assert {r["replicates"] for r in of_kind(finished, "trial")} == {1}


def test_values_are_what_the_overrides_put_there(finished):
    for row in of_kind(finished, "trial"):
        reach, split = row["parameters.reach"], row["parameters.split"]
        assert row["values.arm.joints.upper.a"] == reach * split
        assert row["values.arm.joints.fore.a"] == reach * (1 - split)
        assert row["values.layout.spacing"] == row["parameters.layout.spacing"]
        assert row["values.layout.offset.1"] is None
        assert json.loads(row["overrides"]).keys() == {"arm.joints.upper.a", "arm.joints.fore.a", "layout.spacing"}


def test_the_constraint_is_the_reach_beyond_its_bound(finished):
    for row in finished.rows():
        assert row["constraints.0"] == pytest.approx(row["metrics.reach"] - 0.40, abs=2e-9)
        assert row["feasible"] is (row["metrics.reach"] <= 0.40 + 1e-9)


def test_the_objective_is_the_metric_at_the_reference(finished):
    assert all(row["objectives.0"] == row["metrics.F"] for row in finished.rows())


def test_every_row_can_be_replayed(finished, spec):
    """The overrides of a row give its numbers again."""
    for row in finished.rows():
        outcome = evaluate(spec, json.loads(row["overrides"]), row["replicates"], named=row["kind"] == "design")
        for label, numbers in outcome.scenarios.items():
            assert {n: row[metric_column(n, label)] for n in numbers} == numbers
        assert outcome.objectives == [row["objectives.0"]]
        assert outcome.violations == [row["constraints.0"]]


# Named designs


def test_named_designs_have_all_replicates(finished):
    designs = of_kind(finished, "design")
    assert [r["name"] for r in designs] == ["optimum", "near"]
    assert all(r["replicates"] == 2 and r["metrics.F_se"] is not None for r in designs)
    assert all(r["number"] is None for r in designs)


def test_named_designs_are_never_told_to_optuna(finished):
    trials = optunas(finished).get_trials()
    assert len(trials) == 8
    designs = {r["metrics.F"] for r in of_kind(finished, "design")}
    assert not designs & {t.values[0] for t in trials}


def test_designs_do_not_change_the_search(finished, tmp_path):
    without = small.run(small.spec({small.DESIGN: ""}, small.SCENARIOS), tmp_path)
    common = set(without.table().column_names)
    with_them = [{k: v for k, v in r.items() if k in common} for r in small.results(finished, "trial")]
    assert small.results(without, "trial") == with_them


def test_a_new_design_is_evaluated_by_the_next_run(tmp_path, no_work):
    before = small.results(small.run(small.spec(), tmp_path))
    store = small.run(small.spec(extra='[designs.wide]\n"layout.spacing" = 0.5\n'), tmp_path)
    assert [r["name"] for r in of_kind(store, "design")] == ["optimum", "wide"]
    assert len(store.rows()) == len(before) + 1


def test_a_changed_design_is_evaluated_again(tmp_path, no_work):
    small.run(small.spec(), tmp_path)
    store = small.run(small.spec({"= 0.26\npublished": "= 0.25\npublished"}), tmp_path)
    assert [json.loads(r["overrides"]) for r in of_kind(store, "design")] == [
        {"arm.joints.upper.a": 0.26},
        {"arm.joints.upper.a": 0.25},
    ]


def test_a_study_without_a_search(tmp_path):
    store = small.run(small.spec(small.NO_SEARCH), tmp_path)
    assert [r["kind"] for r in store.rows()] == ["design"]
    assert not store.journal.exists()


def test_a_study_of_nothing(tmp_path):
    assert small.run(small.spec(small.NO_SEARCH | {small.DESIGN: ""}), tmp_path).rows() == []


# Leaders


def test_leaders_are_the_best_feasible_trials_with_all_replicates(finished, spec):
    best = sorted((r for r in of_kind(finished, "trial") if r["feasible"]), key=lambda r: -r["objectives.0"])[:LEADERS]
    found = of_kind(finished, "leader")
    assert (
        [r["number"] for r in found]
        == [r["number"] for r in best]
        == [r["number"] for r in leaders(spec, finished.rows())]
    )
    for leader, trial in zip(found, best, strict=True):
        assert leader["replicates"] == 2
        assert leader["metrics.F_se"] is not None
        assert trial["metrics.F_se"] is None
        assert leader["metrics.F"] == trial["metrics.F"]
        assert leader["overrides"] == trial["overrides"]


def test_leaders_of_a_minimisation(tmp_path, no_work):
    store = small.run(small.spec({"maximize": "minimize"}), tmp_path)
    F = sorted(r["objectives.0"] for r in of_kind(store, "trial") if r["feasible"])
    assert [r["objectives.0"] for r in of_kind(store, "leader")] == F[:LEADERS]


def test_no_leader_where_nothing_is_feasible(tmp_path, no_work):
    store = small.run(small.spec({"max = 0.40": "max = 0.10"}), tmp_path)
    assert of_kind(store, "leader") == []


# Optuna


def test_optuna_was_told_every_trial(finished):
    told = {t.number: t for t in optunas(finished).get_trials()}
    for row in of_kind(finished, "trial"):
        trial = told[row["number"]]
        assert trial.state is TrialState.COMPLETE
        assert trial.values == [row["objectives.0"]]
        assert trial.system_attrs["constraints"] == [row["constraints.0"]]
        assert {f"parameters.{k}": v for k, v in trial.params.items()} == {
            k: v for k, v in row.items() if k.startswith("parameters.")
        }


def test_optunas_best_trials_are_feasible(tmp_path):
    """Here the best of all reaches too far."""
    store = small.run(small.spec({"max = 0.40": "max = 0.34"}), tmp_path)
    trials = sorted(of_kind(store, "trial"), key=lambda r: -r["objectives.0"])
    best = next(r["number"] for r in trials if r["feasible"])
    assert not trials[0]["feasible"]
    assert [t.number for t in optunas(store).best_trials] == [best]
    assert optunas(store).best_trial.number == best
    assert of_kind(store, "leader")[0]["number"] == best


# Scenarios


def test_scenario_columns_equal_evaluating_with_the_setting(finished, tmp_path):
    path = small.write(tmp_path)
    for row in finished.rows():
        outcome = evaluate(load(path, {"dexterity.K": 50}), json.loads(row["overrides"]), row["replicates"])
        for name, value in outcome.scenarios[""].items():
            assert row[f"metrics.{name}@dexterity.K=50"] == value
    assert any(row["metrics.F@dexterity.K=50"] != row["metrics.F"] for row in finished.rows())


def test_an_operators_scenario_moves_the_hands(tmp_path):
    """E moves with the armrest; on the common grid its cells are the same."""
    extra = '[scenarios]\n"operator.armrest" = [0.05, 0.15]\n'
    numbers = evaluate(small.spec(extra=extra), {}).scenarios
    for armrest in (0.0, 0.05, 0.15):
        label = f"operator.armrest={armrest:g}" if armrest else ""
        path = small.write(tmp_path)
        alone = evaluate(load(path, {"operator.armrest": armrest}), {}).scenarios[""]
        assert numbers[label]["F"] == pytest.approx(alone["F"], rel=1e-12)


@pytest.mark.parametrize(("aggregate", "function"), [("min", min), ("max", max), ("mean", lambda v: sum(v) / len(v))])
def test_an_objective_over_scenarios(aggregate, function):
    changes = {'"maximize"': f'"maximize"\nover = "scenarios"\naggregate = "{aggregate}"'}
    outcome = evaluate(small.spec(changes, small.SCENARIOS), {})
    values = [numbers["F"] for numbers in outcome.scenarios.values()]
    assert len(set(values)) == 2
    assert outcome.objectives == [function(values)]


@pytest.mark.parametrize("values", ["[50, 50, 12270]", "[1234567.0, 1234568.0]"])
def test_scenarios_whose_names_look_alike(values, tmp_path, no_work):
    """A value written twice, or two that differ in the seventh digit: refused, or told apart, but never unreadable."""
    try:
        spec = small.spec(extra=f'[scenarios]\n"dexterity.K" = {values}\n')
    except SpecError:
        return
    store = small.run(spec, tmp_path)
    names = store.table().column_names
    assert len(set(names)) == len(names)


# The misfit

PUBLISHED = """[designs.original]
"arm.joints.upper.a" = 0.15
"arm.joints.fore.a" = 0.15
published = { F = 0.0057, reach = 0.30 }
"""
SEARCH = (
    '[search]\n"layout.offset.1" = { low = 0.7, high = 0.9 }\n"dexterity.K" = { low = 10, high = 1e5, log = true }\n'
)
MISFIT = small.MISFIT | {small.SEARCH: SEARCH}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    return small.run(small.spec(MISFIT, PUBLISHED), tmp_path_factory.mktemp("runs"))


def test_the_misfit_is_the_formulas(fitted):
    """Root mean square of ln((value + 1e-4) / (published + 1e-4)) over designs with the trial's values on top."""
    spec = small.spec(small.NO_SEARCH, PUBLISHED)
    assert MISFIT_FLOOR == 1e-4
    for row in of_kind(fitted, "trial"):
        squares = []
        for design in spec.designs.values():
            numbers = evaluate(spec, {**design.overrides, **json.loads(row["overrides"])}).scenarios[""]
            for name, published in design.published.items():
                squares.append(math.log((numbers[name] + 1e-4) / (published + 1e-4)) ** 2)
        assert len(squares) == 3
        assert row["objectives.0"] == pytest.approx(math.sqrt(sum(squares) / 3), rel=1e-12)


def test_a_perfect_fit_has_no_misfit():
    F = evaluate(small.spec(small.NO_SEARCH), {"arm.joints.upper.a": 0.26}).scenarios[""]["F"]
    spec = small.spec(MISFIT | {"published = { F = 0.2732 }": f"published = {{ F = {F!r} }}"})
    assert misfit(spec, {}) == 0.0


def test_a_named_design_has_no_misfit_of_its_own(fitted):
    assert [r["objectives.0"] for r in of_kind(fitted, "design")] == [None, None]


def test_the_least_misfit_leads(fitted):
    found = of_kind(fitted, "leader")
    values = sorted(r["objectives.0"] for r in of_kind(fitted, "trial") if r["feasible"])
    assert [r["objectives.0"] for r in found] == values[:LEADERS]


# Designs that fail


@pytest.fixture
def failing(tmp_path):
    """A study of a plugin arm that raises, and the rows that its run leaves."""
    path = small.broken_arm(tmp_path)
    with pytest.raises(EiwaError) as error:
        small.run(load(path, {"study.trials": 40}), tmp_path / "runs")
    return path, small.Store(tmp_path / "runs/small"), str(error.value)


def test_a_raising_plugin_makes_failed_rows_with_its_message(failing):
    _, store, _ = failing
    for row in store.rows():
        assert row["state"] == "FAIL"
        assert row["message"] == "Broken (broken_arm.py) raised RuntimeError: the elbow is stuck (line 13)"
        assert row["metrics.F"] is None
        assert row["parameters.arm.length"] is not None


def test_the_study_stops_when_its_first_trials_fail(failing):
    _, store, message = failing
    assert 5 <= len(store.rows()) <= 8
    assert "trials failed, so the study stops" in message
    assert "RuntimeError: the elbow is stuck" in message


def test_failed_trials_are_told_as_failed(failing):
    _, store, _ = failing
    trials = optunas(store).get_trials()
    assert {t.number for t in trials if t.state is TrialState.FAIL} == {r["number"] for r in store.rows()}


def test_running_it_again_does_not_go_on(failing):
    path, store, _ = failing
    before = len(store.rows())
    with pytest.raises(EiwaError, match="the elbow is stuck"):
        small.run(load(path, {"study.trials": 40}), store.folder.parent)
    assert len(store.rows()) <= before + 4


def test_a_named_design_that_fails_stops_the_study(tmp_path, monkeypatch):
    def raising(*arguments, **options):
        raise RuntimeError("out of gears")

    monkeypatch.setattr(rows, "evaluate", raising)
    with pytest.raises(EiwaError) as error:
        small.run(small.spec(), tmp_path)
    assert str(error.value) == "designs.optimum: RuntimeError: out of gears"


def test_a_named_design_that_failed_is_tried_again(tmp_path, monkeypatch, no_work):
    with monkeypatch.context() as broken:
        broken.setattr(rows, "evaluate", lambda *arguments, **options: 1 / 0)
        with pytest.raises(EiwaError):
            small.run(small.spec(), tmp_path)
    store = small.run(small.spec(), tmp_path)
    assert [r["state"] for r in of_kind(store, "design")] == ["FAIL", "COMPLETE"]


@pytest.mark.parametrize(("good", "stops"), [(0, True), (1, True), (6, False)])
def test_twenty_failures_in_a_row_stop_a_study(good, stops, tmp_path, monkeypatch, no_work):
    """``good`` of 25 trials succeed: the first, or every fifth."""
    whole = rows.evaluate
    left = {"good": good, "asked": -1}

    def sometimes(spec, overrides, replicates=1, *, parameters=None, named=False):
        left["asked"] += not named
        if named or (left["good"] and left["asked"] % 5 == 0):
            left["good"] -= not named
            return whole(spec, overrides, replicates, named=named)
        raise RuntimeError("out of gears")

    monkeypatch.setattr(rows, "evaluate", sometimes)
    spec = small.spec({"trials = 8": "trials = 25", "max = 0.40": "max = 9"})
    if not stops:
        assert len(of_kind(small.run(spec, tmp_path), "trial")) == 25
        return
    with pytest.raises(EiwaError, match="out of gears"):
        small.run(spec, tmp_path)
    assert len(of_kind(small.Store(tmp_path / "small"), "trial")) == (24 if good else 8)


# Equal results


def test_running_again_changes_nothing(finished, spec):
    before = finished.rows()
    assert not small.Run(spec, finished).execute()
    assert finished.rows() == before


def test_volatile_columns_are_columns(finished):
    assert set(VOLATILE) <= set(finished.table().column_names)


def test_raising_the_trials_continues(tmp_path):
    whole = small.run(small.spec(), tmp_path / "whole")
    small.run(small.spec({"trials = 8": "trials = 4"}), tmp_path / "raised")
    raised = small.run(small.spec(), tmp_path / "raised")
    assert small.results(raised, "trial") == small.results(whole, "trial")
    assert small.results(raised, "design") == small.results(whole, "design")
    best = [r["number"] for r in leaders(small.spec(), whole.rows())]
    found = {r["number"]: r for r in small.results(raised, "leader")}
    assert [found[number] for number in best] == [
        {r["number"]: r for r in small.results(whole, "leader")}[number] for number in best
    ]


def test_fewer_trials_than_there_are(tmp_path, no_work):
    """Lowering the target asks for nothing."""
    small.run(small.spec(), tmp_path)
    store = small.run(small.spec({"trials = 8": "trials = 4"}), tmp_path)
    assert len(of_kind(store, "trial")) == 8


def test_the_name_is_the_folder(tmp_path, no_work):
    assert small.run(small.spec({'"small"': '"other"'}), tmp_path).folder == tmp_path / "other"


MANY = {"samples = 4096\nreplicates": "samples = 262144\nreplicates", "trials = 8": "trials = 4"}
"""Samples enough for two threads to share."""


def test_another_process_with_other_threads_gives_the_same(tmp_path, monkeypatch):
    path = small.write(tmp_path, MANY)
    code, _, err = small.eiwa("study", "run", path, folder=tmp_path, EIWA_THREADS="1")
    assert code == 0, err
    there = small.Store(tmp_path / "runs/small")
    monkeypatch.setenv("EIWA_THREADS", "2")
    here = small.run(load(path), tmp_path / "here")
    assert ({r["threads"] for r in there.rows()}, {r["threads"] for r in here.rows()}) == ({1}, {2})
    assert {r["pid"] for r in there.rows()} != {r["pid"] for r in here.rows()}
    assert small.results(there) == small.results(here)


def test_threads_in_one_process_give_the_same(tmp_path, monkeypatch):
    found = []
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("EIWA_THREADS", threads)
        found.append(small.results(small.run(small.spec(MANY), tmp_path / threads)))
    assert found[0] == found[1] == found[2]


def test_an_expression_without_a_value_fails_its_trial_alone(tmp_path, no_work):
    """Division by zero at one of three values; none of the corners."""
    changes = {
        "split = { low = 0.30, high = 0.80 }": "split = { low = 0.30, high = 0.80 }\nodd = { low = 2, high = 4, step = 1 }",
        '"reach * split"': '"reach * split + 0 / (odd - 3)"',
    }
    rows = of_kind(small.run(small.spec(changes), tmp_path), "trial")
    assert [r["number"] for r in rows] == list(range(8))
    assert {r["parameters.odd"] for r in rows if r["state"] == "FAIL"} == {3.0}
    assert {r["parameters.odd"] for r in rows if r["state"] == "COMPLETE"} == {2.0, 4.0}
    assert all("division by zero" in r["message"] for r in rows if r["state"] == "FAIL")


def test_a_leader_that_failed_is_tried_again(tmp_path, monkeypatch):
    """Its worker may have died of something that is over; the trial itself is as good as it was."""

    def only_trials(spec, overrides, replicates=1, *, parameters=None, named=False):
        if replicates > 1 and not named:
            raise MemoryError
        return instead(spec, overrides, replicates, parameters=parameters, named=named)

    monkeypatch.setattr(rows, "evaluate", only_trials)
    store = small.run(small.spec(), tmp_path)
    assert [r["state"] for r in of_kind(store, "leader")] == ["FAIL"] * 3
    monkeypatch.setattr(rows, "evaluate", instead)
    for _ in range(2):
        small.run(small.spec(), tmp_path)
        assert [r["state"] for r in of_kind(store, "leader")] == ["FAIL"] * 3 + ["COMPLETE"] * 3


class Mute(Exception):
    """Has no text."""

    def __str__(self):
        raise RuntimeError


@pytest.mark.parametrize(
    ("raised", "message"),
    [
        (RuntimeError(os.fsdecode(b"no file \xff")), r"RuntimeError: no file \udcff"),
        (Mute(), "Mute: its text cannot be had (RuntimeError)"),
        (SystemExit(3), "SystemExit: 3"),
    ],
    ids=["not Unicode", "no text", "sys.exit"],
)
def test_whatever_is_raised_fails_one_design(raised, message, tmp_path, monkeypatch):
    failures = iter([raised])

    def once(spec, overrides, replicates=1, *, parameters=None, named=False):
        if not named and (error := next(failures, None)):
            raise error
        return instead(spec, overrides, replicates, parameters=parameters, named=named)

    monkeypatch.setattr(rows, "evaluate", once)
    found = of_kind(small.run(small.spec(), tmp_path), "trial")
    assert [r["message"] for r in found] == [message, *[None] * 7]
