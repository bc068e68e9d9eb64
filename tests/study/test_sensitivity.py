"""Sensitivities: importances of known studies, closed forms of Sobol indices and slopes."""

import numpy as np
import pytest

from eiwa.core.errors import EiwaError, SpecError
from eiwa.study import probe, sensitivity
from eiwa.study.sensitivity import importances, sobol
from tests.study import linear, small


def ishigami(x, a=7.0, b=0.1):
    return np.sin(x[:, 0]) + a * np.sin(x[:, 1]) ** 2 + b * x[:, 2] ** 4 * np.sin(x[:, 0])


def ishigami_indices(a=7.0, b=0.1):
    """Variance, first order, total order (Ishigami and Homma 1990)."""
    V = a**2 / 8 + b * np.pi**4 / 5 + b**2 * np.pi**8 / 18 + 0.5
    V1, V2, V13 = 0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8, b**2 * np.pi**8 * 8 / 225
    return V, [V1 / V, V2 / V, 0.0], [(V1 + V13) / V, V2 / V, V13 / V]


# Sobol indices


def test_the_indices_of_ishigamis_function():
    V, first, total = ishigami_indices()
    (found,) = sobol(lambda x: ishigami(x)[:, None], [(-np.pi, np.pi)] * 3, 2048, seed=1)
    assert found.variance == pytest.approx(V, rel=0.03)
    assert [i.value for i in found.first] == pytest.approx(first, abs=0.03)
    assert [i.value for i in found.total] == pytest.approx(total, abs=0.03)
    for index, exact in zip([*found.first, *found.total], [*first, *total], strict=True):
        assert index.low - 0.02 <= exact <= index.high + 0.02


def test_the_indices_of_a_line():
    """Shares of a linear function's variance are (b_j width_j)^2, and there is no interaction."""
    b, limits = np.array([1.0, -2.0, 0.5]), [(0.0, 3.0), (1.0, 2.0), (0.0, 4.0)]
    exact = (b * [3, 1, 4]) ** 2 / np.sum((b * [3, 1, 4]) ** 2)
    (found,) = sobol(lambda x: (x @ b)[:, None], limits, 4096, seed=2)
    assert [i.value for i in found.first] == pytest.approx(exact, abs=0.02)
    assert [i.value for i in found.total] == pytest.approx(exact, abs=0.02)


def test_intervals_hold_the_truth_and_shrink():
    _, first, _ = ishigami_indices()
    few, many = (sobol(lambda x: ishigami(x)[:, None], [(-np.pi, np.pi)] * 3, n, seed=1)[0] for n in (64, 1024))
    width = lambda found: np.mean([i.high - i.low for i in found.first])  # noqa: E731
    assert width(few) == pytest.approx(4 * width(many), rel=0.5)
    assert few.first[1].low < first[1] < few.first[1].high


def test_the_same_seed_gives_the_same_indices():
    once, again = (sobol(lambda x: ishigami(x)[:, None], [(-3, 3)] * 3, 32, seed=5) for _ in range(2))
    assert once == again
    assert once != sobol(lambda x: ishigami(x)[:, None], [(-3, 3)] * 3, 32, seed=6)


def test_an_output_that_does_not_vary_has_no_indices():
    found = sobol(lambda x: np.column_stack([x[:, 0], 0 * x[:, 0] + 0.3]), [(0, 1)] * 2, 16, seed=1)
    assert found[0] is not None
    assert found[1] is None


def test_one_variable_alone():
    """All of the variance is its own."""
    (found,) = sobol(lambda x: x, [(0.0, 1.0)], 1024, seed=1)
    assert found.variance == pytest.approx(1 / 12, rel=0.05)
    assert [len(found.first), len(found.total)] == [1, 1]
    assert (found.first[0].value, found.total[0].value) == pytest.approx((1.0, 1.0), abs=0.05)


@pytest.mark.parametrize(("n", "cost"), [(0, 0), (1, 5), (64, 320)])
def test_the_cost_of_sobol_indices(n, cost):
    assert sensitivity.cost_of_sobol(small.spec(), n) == cost


def test_the_base_sample_is_a_power_of_two():
    with pytest.raises(EiwaError, match="--sobol 48: must be a power of two, such as 32 or 64"):
        sensitivity.cost_of_sobol(small.spec(), 48)


def test_variables_searched_by_their_logarithm_are_uniform_in_that(monkeypatch):
    """F = 2 upper + spacing / 2: the variance of a log-uniform number is known."""
    log = {small.SEARCH: DIRECT[small.SEARCH].replace("low = 0.1, high = 0.3", "low = 0.01, high = 0.3, log = true")}
    monkeypatch.setattr(sensitivity, "evaluate", linear.evaluate)
    spec = probe.lean(small.spec(log))
    limits = sensitivity.box(spec, AT, None)
    (found,) = sensitivity.sobol_of_objectives(spec, {}, limits, 2048, lambda: None)
    ratio = np.log(30)
    upper = 4 * ((0.3**2 - 0.01**2) / (2 * ratio) - ((0.3 - 0.01) / ratio) ** 2)
    spacing = 0.25 * 0.4**2 / 12
    assert found.variance == pytest.approx(upper + spacing, rel=0.02)
    assert found.first[0].value == pytest.approx(upper / (upper + spacing), abs=0.02)


def test_the_neighbourhood_of_a_logarithm_is_a_factor():
    log = {small.SEARCH: DIRECT[small.SEARCH].replace("low = 0.1, high = 0.3", "low = 0.01, high = 1.0, log = true")}
    limits = sensitivity.box(small.spec(log), {**AT, "arm.joints.upper.a": 0.1}, 0.25)
    assert limits["arm.joints.upper.a"] == pytest.approx((0.1 / 10**0.5, 0.1 * 10**0.5))


# Importances


def trials(spec, count=200):
    """Trials at random points, whose F depends on reach alone; best where the reach is longest."""
    rng = np.random.default_rng(0)
    rows = []
    for number in range(count):
        chosen = {f"parameters.{n}": float(rng.uniform(r.low, r.high)) for n, r in spec.ranges.items()}
        F = chosen["parameters.reach"]
        rows.append(
            {"kind": "trial", "number": number, "state": "COMPLETE", "feasible": True, "objectives.0": F, **chosen}
        )
    return rows


def test_the_variable_that_decides_is_important():
    spec = small.spec()
    found = importances(spec, trials(spec), 0)
    assert found["reach"] > 0.8
    assert sum(found.values()) == pytest.approx(1)


@pytest.mark.parametrize(("direction", "decides"), [("maximize", "split"), ("minimize", "reach")])
def test_a_maximised_objective_is_ranked_by_its_high_values(direction, decides):
    """F is large where split is, and small where reach is: the wrong sign would name the other variable."""
    spec = small.spec({"maximize": direction})
    rows = trials(spec)
    for row in rows:
        reach, split = (
            (row[f"parameters.{n}"] - low) / span for n, low, span in (("reach", 0.2, 0.24), ("split", 0.3, 0.5))
        )
        row["objectives.0"] = split if split > 0.8 else -reach if reach > 0.8 else 0.01 * row["number"] / 200
    found = importances(spec, rows, 0)
    assert max(found, key=found.get) == decides


def test_infeasible_and_failed_trials_do_not_count():
    spec = small.spec()
    rows = trials(spec, 30)
    wrong = [{**r, "feasible": False, "objectives.0": -1.0} for r in rows] + [{**r, "state": "FAIL"} for r in rows]
    assert importances(spec, rows + wrong, 0) == importances(spec, rows, 0)


def test_few_trials_have_no_importances():
    spec = small.spec()
    assert importances(spec, trials(spec, 19), 0) is None


# One variable at a time

DIRECT = {
    small.SEARCH: '[search]\n"arm.joints.upper.a" = { low = 0.1, high = 0.3 }\n"layout.spacing" = { low = 0.2, high = 0.6 }\n\n'
}
AT = {"arm.joints.upper.a": 0.16, "layout.spacing": 0.2}


def moved(monkeypatch, share=None):
    monkeypatch.setattr(sensitivity, "evaluate", linear.evaluate)
    spec, calls = probe.lean(small.spec(DIRECT)), []
    limits = sensitivity.box(spec, AT, share)
    effects = sensitivity.one_at_a_time(spec, {}, AT, limits, 3, lambda: calls.append(1))
    assert len(calls) == sensitivity.cost_of_one_at_a_time(spec)
    return effects


def test_slopes_and_changes_of_a_line(monkeypatch):
    upper, spacing = moved(monkeypatch)
    assert upper.slopes[0].mean == pytest.approx(2.0)
    assert spacing.slopes[0].mean == pytest.approx(0.5)
    assert upper.levels == pytest.approx([0.10, 0.15, 0.20, 0.25, 0.30])
    assert [c[0].mean for c in upper.changes] == pytest.approx([-0.12, -0.02, 0.08, 0.18, 0.28])


def test_common_random_numbers_cancel(monkeypatch):
    """All designs share the replicates' noise, so that differences have no error."""
    assert all(c[0].half_width < 1e-12 for effect in moved(monkeypatch) for c in effect.changes)


def test_a_share_keeps_within_the_range(monkeypatch):
    upper, spacing = moved(monkeypatch, 0.1)
    assert (upper.levels[0], upper.levels[-1]) == pytest.approx((0.14, 0.18))
    assert (spacing.levels[0], spacing.levels[-1]) == pytest.approx((0.20, 0.24))


def test_what_breaks_a_constraint_is_told(monkeypatch):
    assert moved(monkeypatch)[0].feasible == [True] * 5
    monkeypatch.setattr(small, "SMALL", small.SMALL.replace("max = 0.40", "max = 0.22"))
    assert moved(monkeypatch)[0].feasible == [True, True, True, False, False]


def test_a_design_that_cannot_be_evaluated_is_named(monkeypatch):
    def evaluate(spec, overrides, replicates=1, **rest):
        if overrides["layout.spacing"] > 0.5:
            raise EiwaError("no dexterity.")
        return linear.evaluate(spec, overrides, replicates)

    monkeypatch.setattr(sensitivity, "evaluate", evaluate)
    spec = probe.lean(small.spec(DIRECT))
    with pytest.raises(
        EiwaError, match=r"upper\.a = 0.16, layout\.spacing = 0.6: .* no dexterity\. Stay nearer .* --share"
    ):
        sensitivity.one_at_a_time(spec, {}, AT, sensitivity.box(spec, AT, None), 2, lambda: None)


# The design to look around


def test_a_named_designs_variables_are_found():
    spec = small.spec()
    found = probe.variables_at(spec, probe.centre(spec, [], "optimum"))
    assert found == pytest.approx({"reach": 0.44, "split": 0.26 / 0.44, "layout.spacing": 0.20})


def test_a_design_outside_the_search_is_refused():
    spec = small.spec(extra='[designs.long]\n"arm.joints.upper.a" = 0.5\n')
    with pytest.raises(SpecError, match=r"long: lies outside the search, which does not reach arm\.joints"):
        probe.variables_at(spec, probe.centre(spec, [], "long"))


def test_the_best_trial_is_looked_around():
    spec = small.spec()
    rows = [{**r, "overrides": "{}"} for r in trials(spec, 30)]
    best = max(rows, key=lambda r: r["objectives.0"])
    found = probe.centre(spec, rows)
    assert found.name == f"trial {best['number']}"
    assert probe.variables_at(spec, found)["reach"] == best["parameters.reach"]


def test_without_trials_it_is_the_design_as_written():
    assert probe.centre(small.spec(), []).name == "the design as written"


def test_only_what_objectives_and_constraints_read_is_computed():
    spec = small.spec(extra=small.SCENARIOS + "[metrics.dexterous_volume]\n")
    alone = probe.lean(spec)
    assert [s.label for s in alone.scenarios] == [""]
    assert set(alone.design({}).metrics) == {"F", "singletons", "valid_share", "reach"}
    assert not alone.designs


def test_F_is_looked_at_beside_the_objectives():
    alone = probe.lean(small.spec({'metric = "F"': 'metric = "reach"'}))
    assert [o.label for o in alone.objectives] == ["reach", "F"]


def test_scenarios_stay_where_an_objective_reads_them():
    alone = probe.lean(small.spec({small.OBJECTIVE: small.OBJECTIVE[:-1] + 'over = "scenarios"\n'}, small.SCENARIOS))
    assert len(alone.scenarios) == 2
    assert [o.label for o in alone.objectives] == ["mean F", "F"]
