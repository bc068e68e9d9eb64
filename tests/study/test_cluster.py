"""Studies on a Dask cluster of real processes: the same rows, dead workers, refusals."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from distributed import Client

from eiwa.core.errors import ExecutionError, SpecError
from eiwa.core.spec import load
from eiwa.study.run import Silent
from eiwa.study.store import Store
from tests.study import small
from tests.study.test_workers import ROOT, Said, paused

TRIALS = 12
ELSEWHERE = "import eiwa.core.version as v; v.__version__ = '0.0.1'; "
MAIN = "import sys; from dask.__main__ import main; sys.argv[0] = 'dask'; main()"


def begun(folder, name, *arguments, code=MAIN):
    """A process of a cluster, in a folder where the study's files are not."""
    place = folder / name
    place.mkdir(parents=True, exist_ok=True)
    with (place / "log").open("w") as log:
        return subprocess.Popen(
            [sys.executable, "-c", code, *arguments, "--no-dashboard"],
            cwd=place, env=os.environ | {"PYTHONPATH": str(ROOT)}, stdout=log, stderr=log,
        )  # fmt: skip


def worker(folder, name, address, code=MAIN, threads=1):
    options = ["--nthreads", str(threads), "--no-nanny", "--name", name, "--local-directory", str(folder / name)]
    return begun(folder, name, "worker", address, *options, code=code)


def end(process):
    process.kill()
    process.wait()


def scheduling(folder):
    """A scheduler without workers: its process and its address."""
    file = folder / "address.json"
    process = begun(
        folder, "scheduler", "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file)
    )
    until = time.monotonic() + 120
    while not file.exists() or not file.read_text().endswith("}"):
        assert process.poll() is None, (folder / "scheduler/log").read_text()
        assert time.monotonic() < until
        time.sleep(0.05)
    return process, json.loads(file.read_text())["address"]


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """The address of a scheduler without workers."""
    process, address = scheduling(tmp_path_factory.mktemp("scheduler"))
    yield address
    end(process)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return paused(tmp_path_factory.mktemp("study"), TRIALS)


@pytest.fixture(scope="module")
def serial(path, tmp_path_factory):
    return small.results(small.run(load(path), tmp_path_factory.mktemp("serial")))


def settings(address):
    return {"execution.executor": "dask", "execution.scheduler": address}


@pytest.mark.slow
def test_a_cluster_gives_the_same_rows_though_a_worker_is_killed(path, serial, scheduler, tmp_path):
    workers = [worker(tmp_path, name, scheduler) for name in ("one", "two")]
    pids = {w.pid for w in workers}

    class Killer(Said):
        killed = None

        def __call__(self, stage, row):
            assert row["pid"] in pids
            if self.killed is None and stage == "search" and row["number"] >= 3:
                self.killed = row["pid"]
                os.kill(row["pid"], signal.SIGKILL)

    killer = Killer()
    try:
        store = small.run(load(path, settings(scheduler)), tmp_path / "runs", killer)
    finally:
        for process in workers:
            end(process)
    assert killer.killed
    assert any("is gone; what it had is tried again by others." in message for message in killer.messages)
    assert small.results(store) == serial
    assert {r["pid"] for r in store.rows()} <= pids


@pytest.mark.slow
def test_a_scheduler_that_dies_is_told_and_the_study_goes_on(path, serial, tmp_path):
    process, address = scheduling(tmp_path)
    helper = worker(tmp_path, "helper", address)

    class Killer(Silent):
        def __call__(self, stage, row):
            if stage == "search":
                end(process)

    try:
        with pytest.raises(ExecutionError, match=rf"'{address}': the scheduler went away. Start it again"):
            small.run(load(path, settings(address)), tmp_path / "runs", Killer())
    finally:
        end(helper)
    before = len(Store(tmp_path / "runs/small").rows())
    assert 0 < before < len(serial)
    assert small.results(small.run(load(path), tmp_path / "runs")) == serial


@pytest.mark.slow
@pytest.mark.parametrize(("threads", "wanted"), [(3, None), (1, 2)])
def test_threads_of_a_worker(path, serial, scheduler, tmp_path, threads, wanted):
    """As many as Dask was told, or as the study says; never two evaluations at a time."""
    process = worker(tmp_path, "worker", scheduler, threads=threads)
    more = {"execution.threads": wanted} if wanted else {}
    try:
        store = small.run(load(path, settings(scheduler) | more), tmp_path / "runs")
    finally:
        end(process)
    assert {r["threads"] for r in store.rows()} == {wanted or threads}
    assert small.results(store) == serial


@pytest.mark.slow
def test_a_worker_of_another_version_is_refused(path, scheduler, tmp_path):
    process = worker(tmp_path, "old", scheduler, code=ELSEWHERE + MAIN)
    try:
        with pytest.raises(
            ExecutionError, match=r"has eiwa 0\.0\.1, the process that runs the study has .* Install the same"
        ):
            small.run(load(path, settings(scheduler)), tmp_path / "runs")
    finally:
        end(process)


def wait_until_alone(address):
    """Until the scheduler has noticed the deaths of earlier tests' workers."""
    with Client(address, timeout=120, set_as_default=False) as client:
        until = time.monotonic() + 120
        while client.scheduler_info(n_workers=-1)["workers"]:
            assert time.monotonic() < until
            time.sleep(0.05)


@pytest.mark.slow
def test_a_cluster_without_workers_is_waited_for(path, serial, scheduler, tmp_path, monkeypatch):
    """Its user is told, and the study begins when one comes."""
    wait_until_alone(scheduler)
    monkeypatch.setattr("eiwa.study.cluster.LONELY", 0.2)
    started = []

    class Starter(Silent):
        def say(self, message):
            assert message == f"{scheduler} has no workers; the study waits for some (dask worker)."
            started.append(worker(tmp_path, "late", scheduler))

    try:
        store = small.run(load(path, settings(scheduler)), tmp_path / "runs", Starter())
    finally:
        for process in started:
            end(process)
    assert len(started) == 1
    assert small.results(store) == serial


def test_a_scheduler_that_does_not_answer(path, tmp_path, monkeypatch):
    monkeypatch.setattr("eiwa.study.cluster.REACH", 1.0)
    with pytest.raises(ExecutionError) as error:
        small.run(load(path, settings("tcp://127.0.0.1:1")), tmp_path)
    assert str(error.value).startswith("execution.scheduler = 'tcp://127.0.0.1:1': no Dask scheduler answers there")


def test_dask_that_is_not_installed(path, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ExecutionError, match=r"needs Dask: pip install 'eiwa\[dask\]'"):
        small.run(load(path, settings("tcp://127.0.0.1:1")), tmp_path)


@pytest.mark.parametrize(
    ("said", "problem"),
    [
        ('executor = "dask"', "executor = 'dask' needs scheduler"),
        ('scheduler = "tcp://h:1"', "scheduler needs executor = 'dask'"),
        ('executor = "dask"\nscheduler = "tcp://h:1"\nworkers = 2', "leave workers out"),
        ('executor = "dask"\nscheduler = "h:1"', "execution.scheduler = 'h:1'"),
        ("workers = -1", "execution.workers = -1"),
        ('executor = "ray"', "execution.executor = 'ray'"),
        ('storage = "mysql://h/d"', "execution.storage = 'mysql://h/d'"),
    ],
)
def test_what_cannot_be_executed_is_refused(said, problem):
    with pytest.raises(SpecError) as error:
        small.spec(extra=f"[execution]\n{said}\n")
    assert problem in str(error.value)
