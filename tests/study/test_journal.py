"""Optuna's journal: torn tails, damaged lines, and its rebuilding from rows, whenever a run was cut off."""

import json
import shutil
import warnings

import optuna
import pyarrow.parquet as pq
import pytest
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from eiwa.core.errors import StoreError
from eiwa.study import journal
from eiwa.study.store import Store
from tests.study import small
from tests.study.test_sampler import INSTALLED, study_of

TRIALS = 16


def study(sampler="tpe", trials=TRIALS):
    return study_of(sampler, trials)


@pytest.fixture(autouse=True)
def _no_work(no_work):
    pass


def optunas(store):
    """What Optuna has: state, parameters, values and constraints by number."""
    path = store.journal
    loaded = optuna.load_study(study_name="small", storage=journal.storage(path))
    return {t.number: (t.state, t.params, t.values, t.system_attrs.get("constraints")) for t in loaded.get_trials()}


def consistent(store):
    """Whether Optuna was told what the rows say."""
    rows = {r["number"]: r for r in store.rows() if r["kind"] == "trial"}
    told = optunas(store)
    assert told.keys() == rows.keys()
    for number, (state, params, values, violations) in told.items():
        row = rows[number]
        assert state is TrialState.COMPLETE
        assert params == {name: row[f"parameters.{name}"] for name in params}
        assert values == [row["objectives.0"]]
        assert violations == [row["constraints.0"]]


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """An uninterrupted run of each sampler, kept."""
    runs = {}

    def clean_run(sampler, trials=TRIALS):
        if (sampler, trials) not in runs:
            runs[sampler, trials] = small.run(study(sampler, trials), tmp_path_factory.mktemp(sampler))
        return runs[sampler, trials]

    return clean_run


@pytest.fixture(autouse=True)
def _loose(loose):
    """Single parts can be lost."""


@pytest.fixture
def finished(clean, tmp_path):
    """A copy of a run of TPE to change."""
    shutil.copytree(clean("tpe").folder, tmp_path / "small")
    return Store(tmp_path / "small")


def continued(tmp_path, sampler="tpe", trials=TRIALS):
    """Run again: the store is consistent."""
    store = small.run(study(sampler, trials), tmp_path)
    consistent(store)
    return store


def lines(store):
    return store.journal.read_bytes().splitlines(keepends=True)


# Tails and lines


@pytest.mark.parametrize("cut", [1, 7, 30])
def test_a_torn_tail_is_mended(finished, clean, tmp_path, cut):
    finished.journal.write_bytes(finished.journal.read_bytes()[:-cut])
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


def test_a_tail_of_nonsense_is_cut(finished, clean, tmp_path):
    with finished.journal.open("ab") as file:
        file.write(b'{"op_code": 4, "worker')
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))
    assert all(json.loads(line) for line in lines(finished))


def test_an_empty_journal_is_filled_again(finished, clean, tmp_path):
    finished.journal.write_bytes(b"")
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


@pytest.mark.parametrize("damage", [b"nonsense\n", b"\n", b"\xff\xfe\n", b"\0" * 30 + b"\n", b'{"op_code": 4\n'])
def test_a_damaged_line_is_refused_with_what_to_do(finished, tmp_path, damage):
    whole = lines(finished)
    finished.journal.write_bytes(b"".join([*whole[:20], damage, *whole[21:]]))
    with pytest.raises(StoreError) as error:
        small.run(study(), tmp_path)
    message = str(error.value)
    assert message.startswith(f"{finished.journal}: ")
    assert "line 21" in message
    assert "damaged" in message
    assert f"Finished trials are safe in {finished.folder / 'trials'}" in message
    assert "move the journal away and run again, it is rebuilt from them" in message


@pytest.mark.parametrize("damage", [b"3\n", b"{}\n", b'{"op_code": 99}\n', b"[]\n"])
def test_a_line_that_is_json_but_no_log_is_refused_too(finished, tmp_path, damage):
    whole = lines(finished)
    finished.journal.write_bytes(b"".join([*whole[:20], damage, *whole[21:]]))
    with pytest.raises(StoreError):
        small.run(study(), tmp_path)


def test_the_remedy_works(finished, clean, tmp_path):
    finished.journal.write_bytes(b"nonsense\n" + finished.journal.read_bytes())
    with pytest.raises(StoreError):
        small.run(study(), tmp_path)
    finished.journal.rename(tmp_path / "away.log")
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


# Rebuilding


def lose(store, *parts, journal=True):
    if journal:
        store.journal.unlink()
    for number in parts:
        store.parts[number].unlink()


@pytest.mark.parametrize("sampler", INSTALLED)
def test_a_lost_journal_is_rebuilt_and_the_study_goes_on(clean, tmp_path, sampler):
    half, whole = clean(sampler, 8), clean(sampler)
    shutil.copytree(half.folder, tmp_path / "small")
    lose(Store(tmp_path / "small"))
    assert small.results(continued(tmp_path, sampler), "trial") == small.results(whole, "trial")


def test_a_lost_journal_of_a_finished_study(finished, clean, tmp_path):
    before = optunas(finished)
    lose(finished)
    store = continued(tmp_path)
    assert store.rows() == clean("tpe").rows()
    assert optunas(store) == before


def test_a_rebuilt_journal_keeps_failed_trials(tmp_path, monkeypatch):
    from eiwa.study import rows
    from tests.study.conftest import instead

    def some_fail(spec, overrides, replicates=1, *, parameters=None, named=False):
        if overrides.get("layout.spacing", 0) > 0.5:
            raise RuntimeError("too wide")
        return instead(spec, overrides, replicates, named=named)

    monkeypatch.setattr(rows, "evaluate", some_fail)
    store = small.run(study(), tmp_path)
    before = optunas(store)
    states = [state for state, *_ in before.values()]
    assert 0 < states.count(TrialState.FAIL) < TRIALS
    lose(store)
    assert optunas(small.run(study(), tmp_path)) == before


@pytest.mark.parametrize("part", [1, 2, 4])
def test_a_lost_part_is_evaluated_again(finished, clean, tmp_path, part):
    lose(finished, part, journal=False)
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


def test_all_parts_lost(finished, clean, tmp_path):
    lose(finished, *reversed(range(len(finished.parts))), journal=False)
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


@pytest.mark.parametrize("part", [1, 2, 4])
def test_a_lost_part_and_a_lost_journal(finished, clean, tmp_path, part):
    lose(finished, part)
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


def test_a_lost_part_of_the_designs(finished, clean, tmp_path):
    lose(finished, 0, journal=False)
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


def test_a_lost_part_of_the_leaders(finished, clean, tmp_path):
    lose(finished, -1, journal=False)
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


# Every moment of a run


class Cut(BaseException):
    """The process ends here."""


@pytest.fixture
def cut_at(monkeypatch):
    """Ends the run just before (or in the middle of) its n-th write; returns what counts them."""
    append, write = JournalFileBackend.append_logs, Store.write

    def cut(moment, torn=False, sevenths=None):
        counter = {"writes": 0}

        def due():
            counter["writes"] += 1
            return counter["writes"] == moment

        def append_logs(self, logs):
            if due():
                if torn:
                    text = "".join(json.dumps(log) + "\n" for log in logs).encode()
                    with open(self._file_path, "ab") as file:
                        file.write(text[: len(text) * (moment % 7 if sevenths is None else sevenths) // 7 + 1])
                raise Cut
            append(self, logs)

        def write_rows(self, rows, schema):
            if due():
                raise Cut
            write(self, rows, schema)

        monkeypatch.setattr(JournalFileBackend, "append_logs", append_logs)
        monkeypatch.setattr(Store, "write", write_rows)
        return counter

    return cut


def writes(sampler, trials, cut_at, tmp_path):
    counter = cut_at(0)
    small.run(study(sampler, trials), tmp_path / "counted")
    return counter["writes"]


@pytest.mark.parametrize(
    ("sampler", "trials", "stride", "torn"),
    [
        ("tpe", TRIALS, 1, False),
        ("tpe", TRIALS, 2, True),
        ("random", 8, 1, True),
        ("qmc", 8, 2, False),
        ("grid", 8, 3, False),
        ("nsga2", 16, 3, False),
        ("nsga3", 16, 4, False),
        ("cmaes", 16, 5, False),
    ],
)
def test_a_run_that_ends_at_any_write_is_continued(sampler, trials, stride, torn, cut_at, clean, tmp_path):
    """Between any two writes, or within one: a batch asks once a trial, writes its rows, and tells once."""
    expected = small.results(clean(sampler, trials))
    wrong = []
    for moment in range(1, writes(sampler, trials, cut_at, tmp_path) + 1, stride):
        folder = tmp_path / str(moment)
        cut_at(moment, torn)
        with pytest.raises(Cut):
            small.run(study(sampler, trials), folder)
        cut_at(0)
        store = small.run(study(sampler, trials), folder)
        consistent(store)
        if small.results(store) != expected:
            wrong.append(moment)
    assert wrong == []


@pytest.mark.parametrize("share", [0, 1, 2, 3, 5, 6])
def test_a_rebuilding_that_is_torn_anywhere_is_continued(share, cut_at, finished, clean, tmp_path):
    """It is one write: all but a part of it is lost."""
    lose(finished)
    cut_at(1, torn=True, sevenths=share)
    with pytest.raises(Cut):
        small.run(study(), tmp_path)
    cut_at(0)
    assert small.results(continued(tmp_path)) == small.results(clean("tpe"))


@pytest.mark.parametrize("moment", [1, 2, 3, 4, 5])
def test_optuna_knows_the_names_whenever_the_first_run_ended(moment, cut_at, tmp_path):
    """The dashboard shows them."""
    cut_at(moment)
    with pytest.raises(Cut):
        small.run(study(), tmp_path)
    cut_at(0)
    store = continued(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        loaded = optuna.load_study(study_name="small", storage=journal.storage(store.journal))
        assert loaded.metric_names == ["F"]
    assert loaded.user_attrs["constraints"] == ["reach <= 0.4"]


# Rows that were written one by one


@pytest.fixture
def one_by_one(monkeypatch):
    """Every row is a part, as with evaluations that take their time."""
    monkeypatch.setattr("eiwa.study.run.PATIENCE", -1.0)


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
@pytest.mark.parametrize("journal", ["kept", "lost"])
def test_a_batch_of_which_only_some_have_rows_is_continued(sampler, journal, cut_at, one_by_one, clean, tmp_path):
    """Also where these are not the first of it, as with workers, and the journal is gone."""
    for moment, missing in ((8, 0), (9, 1), (10, 0), (15, 1)):
        folder = tmp_path / str(moment)
        cut_at(moment)
        with pytest.raises(Cut):
            small.run(study(sampler), folder)
        cut_at(0)
        store = Store(folder / "small")
        trials = [part for part in store.parts if "trial" in {r["kind"] for r in pq.read_table(part).to_pylist()}]
        if missing and trials:
            trials[-1 - missing].unlink()
        if journal == "lost":
            store.journal.unlink()
        assert small.results(small.run(study(sampler), folder)) == small.results(clean(sampler)), moment
        consistent(store)
