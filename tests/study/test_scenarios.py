"""Named scenarios, aggregates, adjustables, inequalities of parameters, expressions of metrics, replicated numbers."""

import json

import numpy as np
import pytest

from eiwa.core.errors import SpecError
from eiwa.core.outcome import evaluate
from eiwa.core.spec import load
from tests.study import small

PEOPLE = """
[scenarios.woman]
human = { kind = "ehem_percentile", sex = "female", percentile = 5, samples = 4096 }

[scenarios.man]
human = { kind = "ehem_percentile", sex = "male", percentile = 95, samples = 4096 }
"""
ADJUST = "[operator]\nadjust = { armrest = { low = 0.0, high = 0.10, step = 0.05 } }\n"
ELITES = {"samples = 4096\nreplicates = 2": 'estimator = "elites"\nsamples = 300_000\nreplicates = 2'}


def goal(aggregate, direction="maximize"):
    return {'"maximize"': f'"{direction}"\nover = "scenarios"\naggregate = {aggregate}'}


# Named tables


def test_a_named_scenario_replaces_a_table():
    spec = small.spec(extra=PEOPLE)
    assert [s.label for s in spec.scenarios] == ["", "woman", "man"]
    found = evaluate(spec, {}).scenarios
    for name in ("woman", "man"):
        human = next(s.overrides["human"] for s in spec.scenarios if s.label == name)
        alone = evaluate(small.spec(), {"human": human}).scenarios[""]
        assert found[name]["F"] == pytest.approx(alone["F"], rel=1e-12)


def test_named_scenarios_combine_with_listed_values():
    labels = [
        s.label
        for s in small.spec(
            extra=PEOPLE.replace("\n[scenarios.woman]", small.SCENARIOS + "[scenarios.woman]", 1)
        ).scenarios
    ]
    assert labels == ["", "dexterity.K=50", "woman dexterity.K=50", "woman", "man dexterity.K=50", "man"]


def test_a_named_scenario_that_changes_nothing_names_the_reference():
    spec = small.spec(
        extra='[scenarios.usual]\nhuman = { kind = "ehem", samples = 4096 }\n[scenarios.far]\n"layout.spacing" = 0.3\n'
    )
    assert [(s.label, s.title) for s in spec.scenarios] == [("", "usual"), ("far", "")]


def test_evenly_spaced_values():
    spec = small.spec(extra='[scenarios]\n"operator.armrest" = { low = 0.0, high = 0.1, step = 0.05 }\n')
    assert [dict(s.overrides) for s in spec.scenarios] == [{}, {"operator.armrest": 0.05}, {"operator.armrest": 0.1}]


@pytest.mark.parametrize(
    ("extra", "path", "words"),
    [
        ('[scenarios.a]\n"dexterity.KK" = 3\n', 'scenarios.a."dexterity.KK"', "did you mean 'K'"),
        ('[scenarios.a]\nhuman = { kind = "eham" }\n', "scenarios.a: human.kind", "did you mean 'ehem'"),
        ('[scenarios.a]\n"dexterity.K" = -3\n', "scenarios a: dexterity.K = -3", "greater than 0"),
        ("[scenarios.a]\nlayout.spacing = 3\n", "scenarios.a.layout", "Quote the whole path"),
        ('[scenarios.a]\npublished = { F = 1.0 }\n', "scenarios.a.published", "only designs"),
        ('[scenarios]\n"human" = [{ kind = "ehem" }]\n', 'scenarios."human"', "name a table"),
        ('[scenarios]\n"operator.armrest" = { low = 0.1, high = 0.0, step = 0.1 }\n', 'scenarios."operator.armrest"', "low"),
    ],
)  # fmt: skip
def test_what_no_scenario_says(extra, path, words):
    with pytest.raises(SpecError) as caught:
        small.spec(extra=extra)
    assert any(line.startswith(path) and words in line for line in caught.value.findings), caught.value.findings


# Aggregates


@pytest.mark.parametrize(
    ("aggregate", "direction", "combined"),
    [
        ('"cvar"\ntail = 0.5', "maximize", lambda v: (sorted(v)[0] + 0.5 * sorted(v)[1]) / 1.5),
        ('"cvar"\ntail = 0.5', "minimize", lambda v: (sorted(v)[2] + 0.5 * sorted(v)[1]) / 1.5),
        ('"cvar"\ntail = 1.0', "maximize", np.mean),
        ('"share_above"\nlevel = 0.0', "maximize", lambda v: 1.0),
        ('"share_above"\nlevel = 2.0', "maximize", lambda v: 0.0),
    ],
)
def test_an_aggregate(aggregate, direction, combined):
    outcome = evaluate(small.spec(goal(aggregate, direction), PEOPLE), {})
    values = [numbers["F"] for numbers in outcome.scenarios.values()]
    assert len(set(values)) == 3
    assert outcome.objectives[0] == pytest.approx(combined(values), rel=1e-12)


def test_the_share_served_counts_those_at_the_level():
    values = [n["F"] for n in evaluate(small.spec(extra=PEOPLE), {}).scenarios.values()]
    level = sorted(values)[1]
    changes = goal(f'"share_above"\nlevel = {level!r}')
    assert evaluate(small.spec(changes, PEOPLE), {}).objectives == [pytest.approx(2 / 3)]


def test_a_constraint_over_scenarios():
    extra = '[[constraints]]\nmetric = "F"\nmin = 0.9\nover = "scenarios"\naggregate = "min"\n' + PEOPLE
    outcome = evaluate(small.spec(extra=extra), {})
    least = min(n["F"] for n in outcome.scenarios.values())
    assert outcome.violations[1] == pytest.approx(0.9 - least, abs=2e-9)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (goal('"share_above"'), "level go together"),
        (goal('"mean"\nlevel = 0.1'), "level go together"),
        ({'"maximize"': '"maximize"\naggregate = "min"'}, "needs over = 'scenarios'"),
        (goal('"cvar"\ntail = 0.0'), "greater than 0"),
    ],
)
def test_what_no_aggregate_says(changes, words):
    with pytest.raises(SpecError, match=words):
        small.spec(changes, PEOPLE)


# Adjustables


@pytest.mark.parametrize("changes", [{}, ELITES], ids=["plain", "elites"])
def test_an_operator_adjusts_the_armrest_to_the_largest_F(changes):
    found = evaluate(small.spec(changes, ADJUST), {})
    each = {
        a: evaluate(small.spec(changes, f"[operator]\narmrest = {a}\n"), {}).scenarios[""]["F"]
        for a in (0.0, 0.05, 0.1)
    }
    assert found.scenarios[""]["F"] == pytest.approx(max(each.values()), rel=1e-12 if not changes else 0.03)
    assert found.operators[""].armrest == max(each, key=each.get)


def test_an_operator_without_an_armrest_adjusts_the_seat():
    free = {'kind = "ehem"\nsamples = 4096': 'kind = "free_arm"'}
    found = evaluate(small.spec(free, "[operator]\nadjust = { seat = { low = -0.2, high = 0.0, step = 0.1 } }\n"), {})
    each = {
        s: evaluate(small.spec(free, f"[operator]\nseat = {s}\n"), {}).scenarios[""]["F"] for s in (-0.2, -0.1, 0.0)
    }
    assert found.operators[""].seat == max(each, key=each.get) == -0.2
    assert found.scenarios[""]["F"] == pytest.approx(each[-0.2], rel=1e-12)


def test_a_scenario_lets_the_operator_adjust():
    extra = '[scenarios.free]\n"operator.adjust.armrest" = { low = 0.0, high = 0.10, step = 0.05 }\n'
    found = evaluate(small.spec(extra=extra), {})
    assert found.operators[""].armrest == 0.0
    assert found.scenarios["free"]["F"] >= found.scenarios[""]["F"]


def test_what_was_adjusted_stands_in_the_row(tmp_path):
    store = small.run(load(small.write(tmp_path, {"trials = 8": "trials = 2"}, ADJUST)), tmp_path)
    for row in store.rows():
        again = evaluate(load(tmp_path / "small.toml"), json.loads(row["overrides"]))
        assert row["adjusted.armrest"] == again.operators[""].armrest


@pytest.mark.parametrize(
    ("adjust", "path", "words"),
    [
        ("{ armrest = { low = 0.1, high = 0.0, step = 0.1 } }", "operator.adjust.armrest", "low must not be above"),
        ("{ armrest = { low = 0.0, high = 1.0, step = 0.001 } }", "operator.adjust.armrest", "at most 101"),
        ("{ armrest = 0.1 }", "operator.adjust.armrest", "must be a table"),
        ("{ elbow = { low = 0.0, high = 1.0, step = 0.1 } }", "operator.adjust.elbow", "unknown key"),
    ],
)
def test_what_no_operator_adjusts(adjust, path, words):
    with pytest.raises(SpecError) as caught:
        small.spec(extra=f"[operator]\nadjust = {adjust}\n")
    assert any(line.startswith(path) and words in line for line in caught.value.findings), caught.value.findings


# Work shared by scenarios


@pytest.mark.parametrize("changes", [{}, ELITES], ids=["plain", "elites"])
def test_operators_share_samples_and_kinematics(changes, monkeypatch):
    from eiwa.core import evaluation

    calls = []
    for name in ("fill_pairs", "refine"):
        function = getattr(evaluation, name)
        monkeypatch.setattr(evaluation, name, lambda *a, f=function, **k: calls.append(1) or f(*a, **k))
    evaluate(small.spec(changes, ADJUST + PEOPLE), {})
    assert len(calls) == 1


# Inequalities of parameters


def bounded(text):
    return f'[[constraints]]\nexpression = "{text}"\n'


def test_an_inequality_of_variables_and_paths():
    spec = small.spec(extra=bounded("0.1 <= reach * split <= arm.joints.fore.a + layout.offset[2]"))
    parameters = {"reach": 0.4, "split": 0.75, "layout.spacing": 0.3}
    _, violation = spec.inequalities(spec.overrides(parameters), parameters)
    assert violation == pytest.approx(0.3 - (0.1 + 0.10), abs=2e-9)


def test_an_inequality_of_paths_judges_named_designs():
    spec = small.spec(extra=bounded("arm.joints.upper.a <= 0.2"))
    assert evaluate(spec, spec.designs["optimum"].overrides, named=True).violations[1] == pytest.approx(0.06, abs=2e-9)


def test_an_inequality_of_variables_says_nothing_about_named_designs():
    spec = small.spec(extra=bounded("reach <= 0.1"))
    outcome = evaluate(spec, spec.designs["optimum"].overrides, named=True)
    assert outcome.violations[1] is None


def test_what_breaks_an_inequality_is_never_evaluated(tmp_path, monkeypatch):
    from eiwa.study import rows

    evaluated = []
    function = rows.evaluate
    monkeypatch.setattr(rows, "evaluate", lambda s, o, *a, **k: evaluated.append(o) or function(s, o, *a, **k))
    path = small.write(tmp_path, {}, bounded("reach * split <= 0.18"))
    found = small.run(load(path), tmp_path).rows()
    skipped = [r for r in found if r["state"] == "SKIPPED"]
    kept = [r for r in found if r["kind"] == "trial" and r["state"] == "COMPLETE"]
    assert skipped and kept
    assert not [o for o in evaluated if o["arm.joints.upper.a"] > 0.18 + 1e-8 and "arm.joints.fore.a" in o]
    for row in skipped:
        assert row["feasible"] is False and row["objectives.0"] is None and row["metrics.F"] is None
        assert row["constraints.1"] == pytest.approx(row["parameters.reach"] * row["parameters.split"] - 0.18, abs=2e-9)
        assert row["constraints.0"] is None
        assert "reach * split <= 0.18" in row["message"]


@pytest.mark.parametrize(
    ("constraint", "words"),
    [
        ('expression = "reach < 0.3"', "is not an inequality"),
        ('expression = "reach"', "is not an inequality"),
        ('expression = "raech <= 0.3"', "raech is neither a variable nor a path"),
        ('expression = "arm.kind <= 3"', "arm.kind holds no number"),
        ('expression = "reach <= 0.3"\nmax = 0.3', "has its bounds inside"),
        ('expression = "reach <= 0.3"\nmetric = "F"', "give a metric with bounds, or an expression"),
        ('expression = "max(reach, 1) <= 0.3"', "not allowed here"),
    ],
)
def test_what_no_constraint_says(constraint, words):
    with pytest.raises(SpecError, match=words.replace("(", r"\(")):
        small.spec(extra=f"[[constraints]]\n{constraint}\n")


# Objectives of several metrics


def test_an_objective_of_several_metrics():
    outcome = evaluate(small.spec({'metric = "F"': 'expression = "F - 0.5 * reach"\nname = "gain"'}), {})
    numbers = outcome.scenarios[""]
    assert outcome.objectives == [pytest.approx(numbers["F"] - 0.5 * numbers["reach"], rel=1e-12)]


@pytest.mark.parametrize(
    ("objective", "words"),
    [
        ('expression = "F +"', "is not an expression"),
        ('expression = "F - height"', "no metric yields 'height'"),
        ('expression = "F"\nmetric = "F"', "give a metric or an expression"),
    ],
)
def test_what_no_objective_says(objective, words):
    with pytest.raises(SpecError, match=words):
        small.spec({'metric = "F"': objective})


# Replicated numbers


def test_every_number_is_there_of_every_replicate(tmp_path):
    store = small.run(load(small.write(tmp_path, {"trials = 8": "trials = 4"}, small.SCENARIOS)), tmp_path)
    for row in store.rows():
        if row["kind"] == "trial":
            assert row["replicated.metrics.F"] is None and row["replicated.objectives.0"] is None
            continue
        for at in ("", "@dexterity.K=50"):
            values = row[f"replicated.metrics.F{at}"]
            assert values[0] == row[f"metrics.F{at}"]
            assert np.std(values, ddof=1) == pytest.approx(row[f"metrics.F_se{at}"], rel=1e-12)
            assert row[f"replicated.metrics.reach{at}"] == [row["metrics.reach"]] * 2
        assert row["replicated.objectives.0"] == row["replicated.metrics.F"]
