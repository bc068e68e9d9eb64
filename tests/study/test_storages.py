"""Studies whose search is kept in a database: a real PostgreSQL server, and SQLite."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import optuna
import pytest

from eiwa.core.errors import SpecError, StoreError
from eiwa.core.spec import load
from eiwa.study import storages
from eiwa.study.run import Silent
from eiwa.study.store import Store
from tests.study import server, small

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def postgres():
    with server.running() as found:
        yield found


@pytest.fixture
def database(postgres, request, monkeypatch):
    """The URL of a database of the test's own; the password comes from the environment."""
    monkeypatch.setenv("PGPASSWORD", server.PASSWORD)
    return postgres.url(request.node.name.replace("[", "-").strip("]")[-60:])


@pytest.fixture(params=["postgres", "sqlite"])
def storage(request, tmp_path):
    """Both kinds of databases."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'studies.db'}"
    return request.getfixturevalue("database")


def study(storage, changes=None, extra=""):
    return small.spec(changes, f'{extra}\n[execution]\nstorage = "{storage}"\n')


def refused(spec, folder):
    with pytest.raises(StoreError) as error:
        small.run(spec, folder)
    assert server.PASSWORD not in str(error.value)
    return str(error.value)


@contextmanager
def looking(storage):
    """Optuna's own view of a database."""
    storage = optuna.storages.RDBStorage(storage.replace("postgresql:", "postgresql+psycopg:"))
    yield storage
    storage.remove_session()
    storage.engine.dispose()


def trials(storage, name="small"):
    with looking(storage) as found:
        loaded = optuna.load_study(study_name=name, storage=found)
        return [(t.state.name, t.params, t.values, t.system_attrs.get("constraints")) for t in loaded.get_trials()]


@pytest.fixture
def clean(tmp_path, no_work):
    """The rows with a journal."""
    return small.results(small.run(small.spec(), tmp_path / "clean"))


def test_a_database_gives_the_same_rows_as_the_journal(storage, clean, tmp_path):
    store = small.run(study(storage), tmp_path / "runs")
    assert small.results(store) == clean
    assert not store.journal.exists()
    rows = [r for r in store.rows() if r["kind"] == "trial"]
    assert [values for _, _, values, _ in trials(storage)] == [[r["objectives.0"]] for r in rows]
    assert [violations for *_, violations in trials(storage)] == [[r["constraints.0"]] for r in rows]


def test_a_database_is_continued_with_more_trials(storage, clean, tmp_path):
    small.run(study(storage, {"trials = 8": "trials = 4"}), tmp_path / "runs")
    store = small.run(study(storage), tmp_path / "runs")
    assert [r for r in small.results(store) if r["kind"] == "trial"] == [r for r in clean if r["kind"] == "trial"]


def test_another_folder_evaluates_again_what_it_does_not_have(storage, clean, tmp_path):
    small.run(study(storage), tmp_path / "runs")
    assert small.results(small.run(study(storage), tmp_path / "elsewhere")) == clean
    assert len(trials(storage)) == 8


def test_a_lost_database_is_rebuilt_from_the_rows(storage, tmp_path, no_work):
    store = small.run(study(storage), tmp_path / "runs")
    before = trials(storage)
    rows = store.rows()
    with looking(storage) as found:
        optuna.delete_study(study_name="small", storage=found)
    assert small.run(study(storage), tmp_path / "runs").rows() == rows
    assert trials(storage) == before


def test_a_study_of_the_same_name_is_not_mixed_in(storage, tmp_path, no_work):
    small.run(study(storage), tmp_path / "runs")
    message = refused(study(storage, {"a = 0.26": "a = 0.27"}), tmp_path / "other")
    assert "holds a study 'small' that another study file made" in message
    assert "another name (study.name), or another storage (execution.storage)" in message
    small.run(study(storage, {"a = 0.26": "a = 0.27", '"small"': '"other"'}), tmp_path / "other")
    assert len(trials(storage, "other")) == len(trials(storage)) == 8


def test_two_who_open_an_empty_database_at_once_make_its_tables_once(storage, monkeypatch):
    inside, together, real = [], threading.Barrier(2), storages.RDBStorage

    def slow(url):
        inside.append(1)
        time.sleep(0.1)
        assert len(inside) == 1
        found = real(url)
        inside.pop()
        return found

    def opens(name):
        together.wait(60)
        with ExitStack() as stack:
            storages._database(storage, name, stack)
        return name

    monkeypatch.setattr(storages, "RDBStorage", slow)
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(opens, ["one", "other"])) == ["one", "other"]


def test_a_password_in_the_url_is_never_shown_or_stored(postgres, database, tmp_path, no_work, monkeypatch):
    monkeypatch.delenv("PGPASSWORD")
    url = postgres.url(database.rsplit("/", 1)[1], password=True)
    store = small.run(study(url), tmp_path)
    for path in store.folder.rglob("*"):
        assert path.is_dir() or server.PASSWORD.encode() not in path.read_bytes()
    assert server.PASSWORD not in store.table().to_pandas().to_csv()
    message = refused(study(url, {"a = 0.26": "a = 0.27"}), tmp_path / "other")
    assert f"postgresql+psycopg://eiwa:***@127.0.0.1:{postgres.port}" in message
    with pytest.raises(SpecError) as error:
        study(url.replace("postgresql", "mysql"))
    assert "mysql://eiwa:***@" in str(error.value)
    assert server.PASSWORD not in str(error.value)


def test_a_wrong_password_is_told(database, tmp_path, monkeypatch):
    monkeypatch.setenv("PGPASSWORD", "wrong")
    message = refused(study(database), tmp_path)
    assert "password authentication failed" in message
    assert "PGPASSWORD" in message


def test_no_server_is_told(tmp_path):
    assert "cannot be used: " in refused(study("postgresql://eiwa@127.0.0.1:1/none"), tmp_path)


def test_a_missing_driver_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "psycopg", None)
    message = refused(study("postgresql://eiwa@127.0.0.1:1/none"), tmp_path)
    assert message.endswith("needs the driver psycopg: pip install 'eiwa[postgres]'.")


def test_a_server_that_crashes_is_told_and_the_study_goes_on(postgres, database, clean, tmp_path):
    class Crash(Silent):
        def __call__(self, stage, row):
            if stage == "search" and row["number"] == 5:
                postgres.stop()

    with pytest.raises(StoreError, match="finished trials are kept, run again to continue"):
        small.run(study(database), tmp_path / "runs", Crash())
    postgres.start()
    assert small.results(small.run(study(database), tmp_path / "runs")) == clean


@pytest.mark.slow
def test_two_masters_of_one_study(storage, tmp_path):
    """In folders of their own, as on two machines: the second is refused while the first lives."""
    spec = small.paused(tmp_path, 40)
    settings = ["--set", f"execution.storage={storage}"]
    held = small.hold(tmp_path, 20)
    first = small.start("study", "run", spec, "--runs", "first", *settings, folder=tmp_path)
    rows = Store(tmp_path / "first/small")
    until = time.monotonic() + 120
    while len(rows.parts) < 3:
        assert first.poll() is None, first.communicate()
        assert time.monotonic() < until
        time.sleep(0.02)
    code, out, err = small.eiwa("study", "run", spec, "--runs", "second", *settings, folder=tmp_path)
    assert (code, out) == (2, "")
    assert "the study 'small' is running on " in err
    if storage.startswith("postgresql"):
        assert f"in process {first.pid}" in err
    assert "Traceback" not in err
    first.kill()
    first.communicate(timeout=120)
    held.unlink()
    code, _, err = small.eiwa("study", "run", spec, "--runs", "first", *settings, folder=tmp_path)
    assert code == 0, err
    assert small.results(rows) == small.results(small.run(load(spec), tmp_path / "clean"))
