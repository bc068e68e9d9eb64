"""Worker processes: the same rows as without them, and what happens when they, or their master, die."""

import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from eiwa.core.errors import ExecutionError
from eiwa.core.spec import load
from eiwa.study.parcel import packed
from eiwa.study.run import Silent
from eiwa.study.store import Store
from tests.study import small

ROOT = Path(__file__).parents[2]
TRIALS = 12

DEADLY = """
import os
from pathlib import Path
from eiwa.core.hookspecs import Number, Parameters, Plugin, hookimpl
from eiwa.core.interfaces import Metric

HERE = Path(__file__).parent

class DeadlyParameters(Parameters):
    "Kills the process that evaluates one design, as often as a file beside it says."

class Deadly(Metric):
    def __call__(self, measurement):
        deaths = HERE / "deaths"
        if deaths.exists():
            spacing, left = deaths.read_text().split()
            if measurement.setup.layout.spacing == float(spacing) and int(left):
                deaths.write_text(f"{spacing} {int(left) - 1}")
                os.kill(os.getpid(), 9)
        return {"deadly": 0.0}

@hookimpl
def eiwa_metrics():
    return [Plugin("deadly", DeadlyParameters, lambda parameters: Deadly(), (Number("deadly", "", "nothing"),))]
"""


class Said(Silent):
    """Keeps what it is told."""

    def __init__(self):
        self.messages = []

    def say(self, message):
        self.messages.append(message)


def paused(folder, trials=TRIALS):
    folder.mkdir(exist_ok=True)
    return small.paused(folder, trials)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return paused(tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def serial(path, tmp_path_factory):
    """The rows that this process gives."""
    return small.results(small.run(load(path), tmp_path_factory.mktemp("serial")))


def ended(pid):
    """Whether a process is gone, or dead and only not yet waited for."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] in "ZX"
    except FileNotFoundError:
        return True


def wait_until(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


# The same rows


@pytest.mark.slow
@pytest.mark.parametrize(("workers", "threads"), [(2, None), (3, 2)])
def test_workers_give_the_same_rows(path, serial, tmp_path, workers, threads):
    settings = {"execution.workers": workers} | ({"execution.threads": threads} if threads else {})
    store = small.run(load(path, settings), tmp_path)
    rows = store.rows()
    assert small.results(store) == serial
    assert len({r["pid"] for r in rows}) > 1
    assert os.getpid() not in {r["pid"] for r in rows}
    assert {r["threads"] for r in rows} == {threads or max(1, len(os.sched_getaffinity(0)) // workers)}


def test_threads_of_this_process(path, tmp_path, no_work):
    store = small.run(load(path, {"execution.threads": 3}), tmp_path)
    assert {r["threads"] for r in store.rows()} == {3}


def test_where_a_study_runs_does_not_change_its_hash(path):
    changed = {"execution.workers": 4, "execution.threads": 3, "execution.storage": "sqlite:///x.db"}
    assert load(path, changed).hash == load(path).hash


@pytest.mark.slow
def test_a_row_is_on_the_disk_when_it_is_heard_of(path, tmp_path):
    class Reader(Silent):
        heard = 0

        def __call__(self, stage, row):
            self.heard += 1
            assert (row["kind"], row["number"]) in {(r["kind"], r["number"]) for r in Store(tmp_path / "small").rows()}

    reader = Reader()
    small.run(load(path, {"execution.workers": 2}), tmp_path, reader)
    assert reader.heard == TRIALS + 4


# Another place


def test_a_parcel_is_read_where_the_studys_files_are_not(tmp_path):
    """Its plugin and its data file come with it, and its numbers are the same."""
    here = tmp_path / "here"
    here.mkdir()
    (here / "data").mkdir()
    (here / "data/hands.csv").write_bytes((Path(__file__).parents[1] / "data/hands.csv").read_bytes())
    human = {'kind = "ehem"\nsamples = 4096': 'kind = "points"\nfile = "data/hands.csv"'}
    pause = {small.TOP: f'plugins = ["pause.py"]\n{small.TOP}'}
    study = load(small.write(here, human | pause, "[metrics.pause]\n", pause=small.PAUSE))
    (tmp_path / "parcel").write_bytes(packed(study))
    before = small.stable([small_row(study)])
    shutil.rmtree(here)
    script = (
        "import pickle, sys; from eiwa.study.parcel import unpacked; from tests.study.test_workers import small_row; "
        "spec = unpacked(open(sys.argv[1], 'rb').read()); "
        "sys.stdout.buffer.write(pickle.dumps((spec.hash, small_row(spec))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "parcel")],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, check=True,
    )  # fmt: skip
    found, row = pickle.loads(done.stdout)
    assert found == study.hash
    assert small.stable([row]) == before


def small_row(spec):
    from eiwa.study.rows import Task, row

    found = row(spec, Task("trial", {"layout.spacing": 0.3}, 1, number=0))
    assert found["state"] == "COMPLETE", found["message"]
    return found


@pytest.mark.slow
def test_a_plugin_that_changes_meanwhile_is_told(tmp_path):
    path = paused(tmp_path / "study", 4)
    spec = load(path, {"execution.workers": 2})
    (path.parent / "pause.py").write_text(small.PAUSE + "# changed\n")
    with pytest.raises(ExecutionError, match=r"reads another study .* a file that the study names was changed"):
        small.run(spec, tmp_path / "runs")


@pytest.mark.slow
def test_a_script_without_a_main_guard_is_told(path, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        f"import eiwa\nsettings = {{'execution.workers': 2, 'execution.retries': 0}}\n"
        f"eiwa.run(eiwa.load({str(path)!r}, settings), {str(tmp_path)!r})\n"
    )
    done = subprocess.run(
        [sys.executable, script],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 1
    assert 'needs the line: if __name__ == "__main__":' in done.stderr.splitlines()[-1]


# Deaths


@pytest.fixture
def deadly(tmp_path):
    changes = {small.TOP: f'plugins = ["deadly.py"]\n{small.TOP}'}
    return load(
        small.write(tmp_path, changes, "[metrics.deadly]\n", deadly=DEADLY),
        {"execution.workers": 2, "execution.retries": 1},
    )


def deaths(folder, serial, left):
    """One design of the search is to kill its worker so many times; its spacing.

    A range of spacings would not do: two workers could each evaluate another of its designs at the same time.
    """
    spacing = next(r["values.layout.spacing"] for r in serial if r["kind"] == "trial" and r["number"] == 5)
    (folder / "deaths").write_text(f"{spacing!r} {left}")
    return spacing


@pytest.mark.slow
def test_a_worker_that_dies_once_is_replaced_and_its_trial_tried_again(deadly, serial, tmp_path):
    said = Said()
    deaths(tmp_path, serial, 1)
    found = small.results(small.run(deadly, tmp_path / "died", said))
    assert len(said.messages) == 1
    assert said.messages[0].endswith("its worker died (signal 9); it is tried again (1 of 1).")
    assert found == small.results(small.run(deadly, tmp_path / "lived"))


@pytest.mark.slow
def test_a_design_that_kills_every_worker_fails_and_says_so(deadly, serial, tmp_path):
    """The others of its batch are not blamed."""
    said = Said()
    spacing = deaths(tmp_path, serial, 2)
    trials = [r for r in small.run(deadly, tmp_path / "died", said).rows() if r["kind"] == "trial"]
    failed = [r for r in trials if r["state"] == "FAIL"]
    assert [r["values.layout.spacing"] for r in failed] == [spacing]
    assert failed[0]["message"] == "its worker died (signal 9) at each of 2 attempts (execution.retries = 1)"
    assert said.messages[-1] == f"trial {failed[0]['number']}: {failed[0]['message']}; it has failed."


@pytest.mark.slow
def test_workers_that_are_killed_again_and_again(path, serial, tmp_path):
    """From outside, at whatever they are doing."""

    class Killer(Said):
        killed = 0

        def __call__(self, stage, row):
            if stage == "search" and row["number"] in (2, 7) and not ended(row["pid"]):
                os.kill(row["pid"], signal.SIGKILL)
                self.killed += 1

    killer = Killer()
    store = small.run(load(path, {"execution.workers": 2, "execution.retries": 5}), tmp_path, killer)
    assert killer.killed
    assert small.results(store) == serial


def search_rows(folder):
    return [r for r in Store(folder / "runs/small").rows() if r["kind"] == "trial"]


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_workers_end_with_their_master(tmp_path, end):
    """Ctrl-C reaches all processes of a terminal, and only the master answers; a killed one answers nothing."""
    path = paused(tmp_path / "study", 200)
    small.hold(path.parent, 8)
    process = small.start("study", "run", path, "--workers", "2", folder=tmp_path, start_new_session=True)
    wait_until(lambda: len(search_rows(tmp_path)) >= 4)
    workers = {r["pid"] for r in search_rows(tmp_path)}
    assert process.pid not in workers
    if end is signal.SIGINT:
        os.killpg(process.pid, end)
    else:
        process.send_signal(end)
    out, err = process.communicate(timeout=120)
    assert process.returncode == (130 if end is signal.SIGINT else -9)
    assert out == ""
    assert "Traceback" not in err
    wait_until(lambda: all(map(ended, workers)))
    assert len(search_rows(tmp_path)) < 200
