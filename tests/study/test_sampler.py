"""Samplers propose the same designs whenever they are asked, from finished trials alone."""

import warnings

import numpy as np
import pytest

from eiwa.core.errors import SpecError
from eiwa.core.sections import RangeSection
from eiwa.study import sampler
from eiwa.study.sampler import distributions, grid_points, search_size
from tests.study import small

STEPS = {
    "high = 0.44 }": "high = 0.44, step = 0.12 }",
    "high = 0.80 }": "high = 0.80, step = 0.25 }",
    "high = 0.60 }": "high = 0.60, step = 0.20 }",
}
RANGES = {"reach": (0.20, 0.44), "split": (0.30, 0.80), "layout.spacing": (0.20, 0.60)}


def searching(name, trials=8, changes=None, batch=4):
    written = {"batch = 4": f'batch = {batch}\nsampler = "{name}"', "trials = 8": f"trials = {trials}"}
    return small.spec(written | (changes or {}))


def chosen(spec, folder):
    return small.parameters(small.run(spec, folder))


@pytest.fixture(autouse=True)
def _no_work(no_work):
    pass


SAMPLERS = ["tpe", "random", "qmc", "grid"]
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


@pytest.mark.parametrize("name", ["tpe", "random", "qmc"])
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


class StopAfter:
    """A listener that stops a run after so many trials."""

    def __init__(self, trials):
        self.left = trials

    def begin(self, stage, total, done):
        pass

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


# TPE looks at the trials of the broken batch, which are finished by then.
@pytest.mark.parametrize("name", [name for name in SAMPLERS if name != "tpe"])
def test_raising_the_trials_within_a_batch_gives_the_same_designs(name, whole, tmp_path):
    for trials in (14, TRIALS):
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
        (0.0, 1.0, 3.0, [0.0]),
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


@pytest.mark.parametrize("name", ["tpe", "random", "qmc"])
def test_stepped_values_are_on_their_steps(name, tmp_path):
    rows = small.run(searching(name, 12, STEPS), tmp_path).rows()
    spacings = {round(r["parameters.layout.spacing"], 9) for r in rows if r["kind"] == "trial"}
    assert spacings <= {0.2, 0.4, 0.6}


def test_optuna_is_told_the_ranges():
    found = distributions(searching("tpe"))
    assert {name: (d.low, d.high) for name, d in found.items()} == RANGES


def test_every_trial_has_a_sampler_of_its_own():
    spec = searching("tpe")
    first, second = (sampler.sampler_of(spec, number)._rng.rng.random() for number in (0, 1))
    assert first != second
