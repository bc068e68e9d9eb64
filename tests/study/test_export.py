"""Rows in one file, as CSV, and as a study that Optuna loads with the same best trials."""

import csv
import errno
import json
import os
import warnings

import optuna
import pyarrow.parquet as pq
import pytest

from eiwa.core.errors import StoreError
from eiwa.study import journal, rows
from eiwa.study.export import export
from eiwa.study.run import leaders
from tests.cli.conftest import cli  # noqa: F401 (a fixture)
from tests.study import small
from tests.study.conftest import instead
from tests.study.test_sampler import TWO

SKIP = '[[constraints]]\nexpression = "reach <= 0.38"\n'


@pytest.fixture(autouse=True)
def _no_work(no_work):
    pass


@pytest.fixture(params=[{}, TWO], ids=["one objective", "two objectives"])
def study(request, tmp_path, monkeypatch):
    """A study with failed, skipped, infeasible and good trials, and its store."""

    def sometimes(spec, overrides, replicates=1, *, parameters=None, named=False):
        if not named and int(1e6 * overrides["layout.spacing"]) % 7 == 0:
            raise RuntimeError("no such arm")
        return instead(spec, overrides, replicates, parameters=parameters, named=named)

    monkeypatch.setattr(rows, "evaluate", sometimes)
    spec = small.spec({"trials = 8": "trials = 40", **request.param}, SKIP)
    store = small.run(spec, tmp_path / "runs")
    assert {r["state"] for r in store.rows()} == {"COMPLETE", "FAIL", "SKIPPED"}
    return spec, store


def front(spec, trials):
    """Numbers of the feasible trials that no feasible trial dominates."""
    signs = [-1.0 if o.direction == "maximize" else 1.0 for o in spec.objectives]
    values = {
        r["number"]: tuple(s * r[f"objectives.{i}"] for i, s in enumerate(signs))
        for r in trials
        if r["state"] == "COMPLETE" and r["feasible"]
    }
    below = lambda a, b: a != b and all(x <= y for x, y in zip(a, b, strict=True))  # noqa: E731
    return {n for n, v in values.items() if not any(below(w, v) for w in values.values())}


def loaded(storage):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return optuna.load_study(study_name="small", storage=storage)


@pytest.mark.parametrize("target", ["sqlite:///{}/study.db", "{}/study.log"])
def test_optuna_has_the_same_study(study, target, tmp_path):
    spec, store = study
    place = target.format(tmp_path)
    trials = [r for r in store.rows() if r["kind"] == "trial"]
    assert export(spec, store, place) == len(trials) == 40
    told = loaded(place if "://" in place else journal.storage(tmp_path / "study.log"))
    assert told.metric_names == [o.label for o in spec.objectives]
    assert [d.name.lower() for d in told.directions] == [o.direction for o in spec.objectives]
    assert told.user_attrs["constraints"] == [c.label for c in spec.constraints]
    assert told.user_attrs["study"]["voxels"]["size"] == 0.05
    if len(spec.objectives) > 1:
        assert {t.number for t in told.best_trials} == front(spec, trials)
    else:
        assert told.best_trial.number == leaders(spec, trials)[0]["number"]
    for r, t in zip(sorted(trials, key=lambda r: r["number"]), told.trials, strict=True):
        assert t.params == {name: r[f"parameters.{name}"] for name in spec.ranges}
        assert t.state.name == {"SKIPPED": "PRUNED"}.get(r["state"], r["state"])
        if r["state"] == "COMPLETE":
            assert t.values == [r[f"objectives.{i}"] for i in range(len(spec.objectives))]
            assert t.user_attrs["metrics.F"] == r["metrics.F"]
            assert all(v <= 0 for v in t.constraints.values()) == r["feasible"]
        else:
            assert t.user_attrs["message"] == r["message"]


def test_one_parquet_file(study, tmp_path):
    spec, store = study
    export(spec, store, str(tmp_path / "all.parquet"))
    assert pq.read_table(tmp_path / "all.parquet").to_pylist() == store.rows()
    assert b"eiwa.study" in pq.read_schema(tmp_path / "all.parquet").metadata


def test_csv(study, tmp_path):
    spec, store = study
    export(spec, store, str(tmp_path / "all.csv"))
    with (tmp_path / "all.csv").open() as file:
        written = list(csv.DictReader(file))
    for r, line in zip(store.rows(), written, strict=True):
        assert line["kind"] == r["kind"]
        assert float(line["metrics.F"] or "nan") == pytest.approx(r["metrics.F"] or float("nan"), nan_ok=True)
        if r["kind"] == "design":
            assert json.loads(line["replicated.metrics.F"]) == r["replicated.metrics.F"]


def test_a_trial_whose_worker_died_is_optunas_too(study, tmp_path):
    spec, store = study
    task = rows.Task("trial", {}, 1, number=40, parameters={name: r.low for name, r in spec.ranges.items()})
    store.write([rows.failed(spec, task, "its worker died")], rows.schema(spec))
    assert export(spec, store, str(tmp_path / "study.log")) == 41
    assert loaded(journal.storage(tmp_path / "study.log")).trials[40].state.name == "FAIL"


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_a_journal_is_written_with_nothing_beside_it(study, tmp_path):
    before = names(tmp_path)
    export(*study, str(tmp_path / "study.log"))
    assert names(tmp_path) == before | {"study.log"}


@pytest.mark.parametrize("suffix", ["parquet", "csv", "log"])
def test_a_file_that_cannot_be_written_is_not_there(study, suffix, tmp_path, monkeypatch):
    def full(path, target):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = names(tmp_path)
    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(StoreError, match=r"No space left on device. Free some space, or choose another name\.$"):
        export(*study, str(tmp_path / f"all.{suffix}"))
    assert names(tmp_path) == before


# Refusals


def test_a_file_that_exists_is_not_written_over(study, tmp_path):
    spec, store = study
    (tmp_path / "all.csv").write_text("mine")
    with pytest.raises(StoreError, match="exists already"):
        export(spec, store, str(tmp_path / "all.csv"))
    assert (tmp_path / "all.csv").read_text() == "mine"


def test_a_study_that_exists_is_not_written_over(study, tmp_path):
    spec, store = study
    url = f"sqlite:///{tmp_path}/study.db"
    export(spec, store, url)
    with pytest.raises(StoreError, match="has a study small already"):
        export(spec, store, url)


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("all.xlsx", "ends in .parquet, .csv or .log"),
        ("nosuchdatabase://x", "cannot be opened"),
        ("sqlite:////no/such/folder/x.db", "cannot be opened"),
        ("postgresql://me:hunter2@127.0.0.1:1/x", r"^postgresql://me:\*\*\*@127.0.0.1:1/x: cannot be opened"),
        ("no/all.csv", "there is no folder no"),
        ("no/study.log", "there is no folder no"),
    ],
)
def test_a_target_that_cannot_be(study, target, said, tmp_path):
    with pytest.raises(StoreError, match=said):
        export(*study, target)


def test_trials_of_another_study_file_are_not_optunas(study, tmp_path):
    _, store = study
    other = small.spec({"trials = 8": "trials = 40", "size = 0.05": "size = 0.04"})
    with pytest.raises(StoreError, match="has changed since its trials were run"):
        export(other, store, str(tmp_path / "study.log"))


def test_the_command(cli, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.chdir(tmp_path)
    path = small.write(tmp_path)
    assert "has no results yet" in cli("study", "export", path, "--to", "x.csv").err
    assert cli("study", "run", path).code == 0
    assert "12 rows in x.csv" in cli("study", "export", path, "--to", "x.csv").out
    said = json.loads(cli("study", "export", path, "--to", "sqlite:///x.db", "--json").out)
    assert said == {"study": "small", "to": "sqlite:///x.db", "count": 8}


def test_trials_behind_an_unfinished_one_are_left_out(study, tmp_path):
    spec, store = study
    (part,) = store.parts
    table = pq.read_table(part)
    pq.write_table(table.filter([n != 37 for n in table["number"].to_pylist()]), part)
    assert export(spec, store, str(tmp_path / "study.log")) == 37
