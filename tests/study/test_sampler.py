"""Samplers propose the same designs whenever they are asked, from finished trials alone."""

import warnings
from importlib.util import find_spec

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution

from eiwa.core.errors import SpecError
from eiwa.core.interfaces import Operator
from eiwa.core.outcome import Outcome
from eiwa.core.sections import RangeSection
from eiwa.study import rows, sampler
from eiwa.study.generations import generations
from eiwa.study.run import Silent
from eiwa.study.sampler import distributions, grid_points, search_size
from eiwa.study.store import Store
from tests.study import small
from tests.study.conftest import instead

STEPS = {
    "high = 0.44 }": "high = 0.44, step = 0.12 }",
    "high = 0.80 }": "high = 0.80, step = 0.25 }",
    "high = 0.60 }": "high = 0.60, step = 0.20 }",
}
RANGES = {"reach": (0.20, 0.44), "split": (0.30, 0.80), "layout.spacing": (0.20, 0.60)}


OPTIONS = {
    "tpe": "startup_trials = 6",
    "nsga2": "population_size = 6, mutation_probability = 0.4",
    "nsga3": "population_size = 6, divisions = 2",
    "cmaes": "population_size = 4",
    "gp": "startup_trials = 18",
}
TORCH = pytest.mark.skipif(find_spec("torch") is None, reason="gp needs torch")
"""The extra is too large for every machine that tests."""


def searching(name, trials=8, changes=None, batch=4):
    written = {"batch = 4": f"batch = {batch}\nsampler = {options(name)}", "trials = 8": f"trials = {trials}"}
    return small.spec(written | (changes or {}))


def options(name):
    return f'{{ kind = "{name}", {OPTIONS[name]} }}' if name in OPTIONS else f'"{name}"'


def chosen(spec, folder):
    return small.parameters(small.run(spec, folder))


@pytest.fixture(autouse=True)
def _no_work(no_work):
    pass


INSTALLED = ["tpe", "random", "qmc", "grid", "nsga2", "nsga3", "cmaes"]
SAMPLERS = [*INSTALLED, pytest.param("gp", marks=TORCH)]
TRIALS = 24


def study_of(name, trials=TRIALS, changes=None):
    return searching(name, trials, (STEPS if name == "grid" else {}) | (changes or {}))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted run of each sampler, kept."""
    runs = {}

    def whole_run(name):
        if name not in runs:
            runs[name] = small.run(study_of(name), tmp_path_factory.mktemp(name))
        return runs[name]

    return whole_run


@pytest.mark.parametrize("name", SAMPLERS)
def test_the_same_seed_gives_the_same_designs(name, whole, tmp_path):
    assert chosen(study_of(name), tmp_path) == small.parameters(whole(name))


@pytest.mark.parametrize("name", [name for name in INSTALLED if name != "grid"])
def test_another_seed_gives_other_designs(name, whole, tmp_path):
    other = chosen(study_of(name, 4, {"seed = 1": "seed = 2"}), tmp_path)
    assert other[0] != small.parameters(whole(name))[0]


@pytest.mark.parametrize("name", SAMPLERS)
def test_designs_lie_within_their_ranges(name, whole):
    for row in whole(name).rows():
        if row["kind"] == "trial":
            assert all(low <= row[f"parameters.{v}"] <= high for v, (low, high) in RANGES.items())


@pytest.mark.parametrize("name", SAMPLERS)
def test_no_design_comes_twice(name, whole):
    assert len({tuple(v) for v in small.parameters(whole(name)).values()}) == TRIALS


class StopError(Exception):
    pass


class StopAfter(Silent):
    """A listener that stops a run after so many trials."""

    def __init__(self, trials):
        self.left = trials

    def __call__(self, stage, row):
        self.left -= stage == "search"
        if self.left == 0:
            raise StopError


@pytest.mark.parametrize("name", SAMPLERS)
@pytest.mark.parametrize("trials", [5, 16])
def test_resuming_in_the_middle_gives_the_same_designs(name, trials, whole, tmp_path):
    with pytest.raises(StopError):
        small.run(study_of(name), tmp_path, StopAfter(trials))
    assert chosen(study_of(name), tmp_path) == small.parameters(whole(name))


@pytest.mark.parametrize("name", SAMPLERS)
def test_raising_the_trials_at_the_end_of_a_batch_gives_the_same_designs(name, whole, tmp_path):
    for trials in (4, 16, TRIALS):
        result = chosen(study_of(name, trials), tmp_path)
    assert result == small.parameters(whole(name))


@pytest.mark.parametrize("name", SAMPLERS)
def test_raising_the_trials_within_a_batch_gives_the_same_designs(name, whole, tmp_path):
    for trials in (7, 14, TRIALS):
        result = chosen(study_of(name, trials), tmp_path)
    assert result == small.parameters(whole(name))


def test_batches_are_asked_together(tmp_path):
    """TPE's proposals follow from the batches before, not from what is finished within one."""
    one, eight = (chosen(searching("tpe", 16, batch=k), tmp_path / str(k)) for k in (1, 8))
    assert one != eight


def test_log_ranges_are_sampled_in_their_logarithm(tmp_path):
    changes = {
        '"layout.spacing" = { low = 0.20, high = 0.60 }': '"dexterity.K" = { low = 1.0, high = 1e8, log = true }'
    }
    rows = small.run(searching("qmc", 32, changes), tmp_path).rows()
    K = [r["parameters.dexterity.K"] for r in rows if r["kind"] == "trial"]
    assert 0.4 < np.mean(np.array(K) < 1e4) < 0.6


# Sobol's points


def test_qmc_is_determined_by_the_number(tmp_path):
    """More trials are a continuation, whatever their number."""
    few, many = chosen(searching("qmc", 9), tmp_path / "a"), chosen(searching("qmc", 20), tmp_path / "b")
    assert few == {number: many[number] for number in few}


def test_qmc_fills_the_ranges_evenly(tmp_path):
    values = np.array(list(chosen(searching("qmc", 32), tmp_path).values()))
    unit = (values - values.min(axis=0)) / np.ptp(values, axis=0)
    counts = [np.histogram(unit[:, k], bins=4)[0] for k in range(unit.shape[1])]
    assert np.min(counts) >= 7


# The grid


def test_the_grid_covers_all_points(tmp_path):
    spec = searching("grid", 1000, STEPS)
    values = {tuple(v) for v in chosen(spec, tmp_path).values()}
    axes = {"layout.spacing": (0.2, 0.4, 0.6), "reach": (0.2, 0.32, 0.44), "split": (0.3, 0.55, 0.8)}
    assert len(values) == 27 == search_size(spec)
    for k, name in enumerate(axes):
        assert sorted({v[k] for v in values}) == pytest.approx(axes[name])


def test_fewer_trials_than_the_grid_has_points(tmp_path):
    assert len(chosen(searching("grid", 5, STEPS), tmp_path)) == 5


@pytest.mark.parametrize(
    ("low", "high", "step", "expected"),
    [
        (0.0, 1.0, 0.5, [0.0, 0.5, 1.0]),
        (0.0, 1.0, 0.1, [k / 10 for k in range(11)]),
        (0.2, 0.6, 0.15, [0.2, 0.35, 0.5]),
    ],
)
def test_points_of_one_axis(low, high, step, expected):
    points = grid_points({"x": RangeSection(low=low, high=high, step=step)})
    assert [p["x"] for p in points] == pytest.approx(expected)


def test_the_last_variable_moves_fastest():
    ranges = {name: RangeSection(low=0.0, high=1.0, step=1.0) for name in "ab"}
    assert [(p["a"], p["b"]) for p in grid_points(ranges)] == [(0, 0), (0, 1), (1, 0), (1, 1)]


@pytest.mark.parametrize("name", SAMPLERS)
def test_a_step_that_does_not_divide_its_range(name, tmp_path):
    """Refused, or neither a warning nor a value off the steps."""
    changes = {**STEPS, "step = 0.20 }": "step = 0.15 }"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            spec = searching(name, 12, changes)
        except SpecError:
            return
        rows = small.run(spec, tmp_path).rows()
    spacings = {round(r["parameters.layout.spacing"], 9) for r in rows if r["kind"] == "trial"}
    assert spacings <= {0.2, 0.35, 0.5}


@pytest.mark.parametrize("name", [name for name in INSTALLED if name != "grid"])
def test_stepped_values_are_on_their_steps(name, tmp_path):
    rows = small.run(searching(name, 12, STEPS), tmp_path).rows()
    spacings = {round(r["parameters.layout.spacing"], 9) for r in rows if r["kind"] == "trial"}
    assert spacings <= {0.2, 0.4, 0.6}


def test_optuna_is_told_the_ranges():
    found = distributions(searching("tpe"))
    assert {name: (d.low, d.high) for name, d in found.items()} == RANGES


def test_every_trial_has_a_sampler_of_its_own():
    spec = searching("tpe")
    first, second = (sampler.sampler_of(spec, number).inner._rng.rng.random() for number in (0, 1))
    assert first != second


# Generations


def generations_of(failed=(), count=12, batch=3, size=4):
    """Numbers by generation, where some trials failed."""
    trials = []
    for number in set(range(count)) - set(failed):
        trials.append(optuna.trial.create_trial(value=0.0))
        trials[-1].number = number
    return [[t.number for t in g] for g in generations(trials, batch, size)]


def test_a_generation_is_batches_until_enough_trials_are_complete():
    assert generations_of() == [[0, 1, 2, 3, 4, 5], [6, 7, 8, 9, 10, 11], []]


def test_a_generation_that_lacks_trials_goes_on():
    assert generations_of(count=9) == [[0, 1, 2, 3, 4, 5], [6, 7, 8]]


def test_failed_trials_do_not_count():
    assert generations_of(failed=(1, 2, 4, 8)) == [[0, 3, 5, 6, 7], [9, 10, 11]]


def test_without_trials_the_first_generation_is_open():
    assert generations_of(count=0) == [[]]


@pytest.mark.parametrize("name", ["nsga2", "nsga3"])
def test_generations_are_optunas(name):
    """Without interruptions, batches belong to the generations that Optuna's own bookkeeping gives them."""
    theirs = {"nsga2": optuna.samplers.NSGAIISampler, "nsga3": optuna.samplers.NSGAIIISampler}[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        told = optuna.create_study(sampler=theirs(population_size=6, seed=1))
    for _ in range(0, TRIALS, 4):
        for trial in [told.ask({"x": FloatDistribution(0, 1)}) for _ in range(4)]:
            told.tell(trial, trial.params["x"])
    noted = [t.system_attrs[theirs._get_generation_key()] for t in told.trials]
    found = generations(told.trials, 4, 6)
    assert [g for g, trials in enumerate(found) for _ in trials] == noted


def test_a_failing_design_does_not_end_a_generation(monkeypatch, tmp_path):
    """The study of a sampler with generations goes on, the same whether or not it was interrupted."""

    def sometimes(spec, overrides, replicates=1, *, parameters=None, named=False):
        if int(1e6 * overrides.get("layout.spacing", 0.2)) % 3 == 0 and not named:
            raise RuntimeError("no such arm")
        return instead(spec, overrides, replicates, parameters=parameters, named=named)

    monkeypatch.setattr(rows, "evaluate", sometimes)
    for name in ("nsga2", "cmaes"):
        whole = small.run(study_of(name), tmp_path / name)
        for trials in (5, 9, TRIALS):
            chunks = small.run(study_of(name, trials), tmp_path / f"{name} chunks")
        assert small.results(chunks, "trial") == small.results(whole, "trial")
        assert {r["state"] for r in chunks.rows()} == {"COMPLETE", "FAIL"}


# Several objectives

TWO = {small.OBJECTIVE: small.OBJECTIVE + small.OBJECTIVE.replace('"F"', '"reach"').replace("max", "min")}


@pytest.mark.parametrize("name", ["tpe", "nsga2", "nsga3", pytest.param("gp", marks=TORCH)])
def test_two_objectives_interrupted_and_rebuilt(name, tmp_path):
    study = study_of(name, changes=TWO)
    whole = small.run(study, tmp_path / "whole")
    with pytest.raises(StopError):
        small.run(study, tmp_path / "parts", StopAfter(10))
    Store(tmp_path / "parts/small").journal.unlink()
    assert small.results(small.run(study, tmp_path / "parts"), "trial") == small.results(whole, "trial")


# Quality

CENTRE = {"reach": 0.30, "split": 0.60, "layout.spacing": 0.50}


def bowl(spec, overrides, replicates=1, *, parameters=None, named=False):
    """F falls with the distance from a design that lies off the middle; the reach is what the overrides say."""
    upper, fore = overrides["arm.joints.upper.a"], overrides.get("arm.joints.fore.a", 0.18)
    at = {
        "reach": upper + fore,
        "split": upper / (upper + fore),
        "layout.spacing": overrides.get("layout.spacing", 0.2),
    }
    widths = {name: high - low for name, (low, high) in RANGES.items()}
    F = 1.0 - sum(((at[name] - CENTRE[name]) / widths[name]) ** 2 for name in CENTRE)
    numbers = {"F": F, "F_se": None, "F_drift": 0.0, "singletons": 0.0, "reach": at["reach"]}
    values = [numbers[o.metric] for o in spec.objectives]
    violations = [constraint.violation([numbers[constraint.metric]]) for constraint in spec.constraints]
    return Outcome({"": numbers}, values, violations, replicates, {"": Operator()})


QUICK = {name: f'{{ kind = "{name}", population_size = 16 }}' for name in ("nsga2", "nsga3")}


def best(name, trials, folder, changes=None):
    """The largest F of a feasible trial."""
    written = {"batch = 4": f"batch = 8\nsampler = {QUICK.get(name, repr(name))}", "trials = 8": f"trials = {trials}"}
    store = small.run(small.spec(written | (changes or {})), folder)
    return max(r["metrics.F"] for r in store.rows() if r["kind"] == "trial" and r["feasible"])


@pytest.mark.parametrize(
    ("name", "trials", "limit"),
    [("tpe", 96, 0.40), ("tpe", 96, 0.26), ("nsga2", 160, 0.40), ("nsga2", 240, 0.26), ("nsga3", 240, 0.26)]
    + [("cmaes", 96, 0.40), ("cmaes", 160, 0.26)],
)
def test_a_sampler_comes_nearer_than_random_draws(name, trials, limit, monkeypatch, tmp_path):
    """At a third of the distance of as many random draws; the constraint, where it holds, binds at the best design."""
    monkeypatch.setattr(rows, "evaluate", bowl)
    changes = {"max = 0.40": f"max = {limit}"}
    top = 1.0 - (max(0.0, CENTRE["reach"] - limit) / 0.24) ** 2
    found, drawn = (best(which, trials, tmp_path / which, changes) for which in (name, "random"))
    assert top - found < (top - drawn) / 3


@TORCH
def test_gp_comes_nearer_than_random_draws_in_few_trials(monkeypatch, tmp_path):
    monkeypatch.setattr(rows, "evaluate", bowl)
    found, drawn = (best(which, 32, tmp_path / which) for which in ("gp", "random"))
    assert 1.0 - found < (1.0 - drawn) / 10


# Options


def inner(text):
    changes = {"batch = 4": f"batch = 4\nsampler = {text}"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return sampler.sampler_of(small.spec(changes), 5).inner


def test_options_reach_the_sampler():
    tpe = inner('{ kind = "tpe", startup_trials = 3, candidates = 7, multivariate = true }')
    assert (tpe._n_startup_trials, tpe._n_ei_candidates, tpe._multivariate) == (3, 7, True)
    nsga2 = inner('{ kind = "nsga2", population_size = 9, crossover_probability = 0.5, mutation_probability = 0.25 }')
    children = nsga2._child_generation_strategy
    assert (nsga2.population_size, children._crossover_prob, children._mutation_prob) == (9, 0.5, 0.25)
    nsga3 = inner('{ kind = "nsga3", divisions = 5 }')
    assert nsga3._elite_population_selection_strategy._dividing_parameter == 5
    cmaes = inner('{ kind = "cmaes", sigma = 0.25 }')
    assert cmaes._beginning()._sigma == 0.25


def test_cmaes_fills_whole_batches():
    """Three variables: 4 + 3 ln 3 = 7 designs, which are two batches of four."""
    assert inner('"cmaes"').population_size == 8
    assert inner('{ kind = "cmaes", population_size = 5 }').population_size == 5


@TORCH
def test_options_reach_gp():
    gp = inner('{ kind = "gp", startup_trials = 3 }')
    assert gp._n_startup_trials == 3


@pytest.mark.parametrize(("name", "package"), [("gp", "torch"), ("cmaes", "cmaes")])
def test_a_sampler_whose_package_is_missing_is_refused_before_anything_is_evaluated(
    name, package, monkeypatch, tmp_path
):
    monkeypatch.setattr(sampler, "find_spec", lambda wanted: None)
    with pytest.raises(
        SpecError, match=rf"study.sampler = '{name}': needs the package {package}.*pip install 'eiwa\[{name}"
    ):
        small.run(searching(name), tmp_path)
    assert not list(tmp_path.rglob("study.json"))


def test_an_option_makes_another_study():
    assert len({searching("nsga2").hash, small.spec({"batch = 4": 'batch = 4\nsampler = "nsga2"'}).hash}) == 2


# Auto

MORE = {small.OBJECTIVE: "".join(small.OBJECTIVE.strip() + f'\nname = "{k}"\n\n' for k in range(4))}


@pytest.mark.parametrize(
    ("trials", "changes", "expected"),
    [
        (8, {}, "tpe"),
        (999, {}, "tpe"),
        (1000, {}, "nsga2"),
        (1000, {"samples = 4096\nreplicates": "samples = 1048576\nreplicates"}, "tpe"),
        (5000, {"samples = 4096\nreplicates": "samples = 1048576\nreplicates"}, "nsga2"),
        (1000, TWO, "nsga2"),
        (1000, MORE, "nsga3"),
        (26, STEPS, "tpe"),
        (27, STEPS, "grid"),
    ],
)
def test_auto_follows_from_the_study_file(trials, changes, expected):
    spec = small.spec({"batch = 4": 'batch = 4\nsampler = "auto"', "trials = 8": f"trials = {trials}"} | changes)
    assert spec.sampler.kind == expected
    assert spec.hash == small.spec({"batch = 4": f'batch = 4\nsampler = "{expected}"'} | changes).hash


def test_auto_says_what_it_has_chosen(tmp_path):
    class Hearing(Silent):
        said = ()

        def say(self, line):
            self.said = (*self.said, line)

    heard, silent = Hearing(), Hearing()
    small.run(small.spec({"batch = 4": 'batch = 4\nsampler = "auto"'}), tmp_path / "auto", heard)
    small.run(small.spec(), tmp_path / "tpe", silent)
    assert heard.said == ("Sampler: auto is tpe, for 8 trials are fewer than 1000.",)
    assert silent.said == ()
