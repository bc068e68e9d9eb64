"""Processes that are stopped, killed and started twice: what they leave is continued to what a whole run gives."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from eiwa.core.spec import load
from eiwa.study.store import Store
from tests.study import small

TRIALS = 24


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The rows of a run that nobody interrupts."""
    folder = tmp_path_factory.mktemp("whole")
    return small.results(small.run(load(small.paused(folder, TRIALS)), folder / "runs"))


def search_of(folder):
    return sorted((folder / "runs/small/trials").glob("part-*.parquet"))


def wait_for(process, condition, seconds=240):
    """Until something is there; fails when the process ends before."""
    end = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)


def finish(folder, path):
    code, _, err = small.eiwa("study", "run", path, folder=folder)
    assert code == 0, err
    return small.results(Store(folder / "runs/small"))


@pytest.fixture
def path(tmp_path):
    return small.paused(tmp_path, TRIALS)


@pytest.mark.slow
def test_ctrl_c_ends_with_130_and_is_continued(path, tmp_path, whole):
    held = small.hold(tmp_path, TRIALS // 2)
    process = small.start("study", "run", path, folder=tmp_path)
    wait_for(process, lambda: len(search_of(tmp_path)) >= 3)
    process.send_signal(small.signal.SIGINT)
    out, err = process.communicate(timeout=240)
    held.unlink()
    assert process.returncode == 130
    assert "Stopped. Finished trials are kept; run the same command to continue." in err
    assert "Traceback" not in err
    assert out == ""
    assert 0 < len(Store(tmp_path / "runs/small").rows()) < TRIALS
    assert finish(tmp_path, path) == whole


KILLS, OF_POOLS = 48, 6
CHEAP = {
    "samples = 4096\nreplicates": "samples = 256\nreplicates",
    "size = 0.05": "size = 0.1",
}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_fifty_kills_are_continued(tmp_path):
    """Masters and workers of one study die by SIGKILL, at random times and in the middle of writes.

    Nothing that was heard of is lost or made twice, and in the end the table is that of a run that nobody interrupts.
    """
    moments, runs = random.Random(3), tmp_path / "runs"
    path = small.paused(tmp_path, 320, 0.0, CHEAP)
    environment = {"EIWA_THREADS": "1", "PYTHONPATH": str(Path(__file__).parents[2])}
    killed = Counter()
    held = small.hold(tmp_path, 6)
    while sum(killed.values()) < OF_POOLS:
        kill_in_a_pool(path, tmp_path, moments, killed)
    held.unlink()
    command = [sys.executable, "-m", "tests.study.killing", str(path), str(runs), str(KILLS), "1"]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    killed += Counter(json.loads(done.stdout))
    assert sum(killed.values()) >= 50
    kinds = ("master", "worker", "at a random time", "before a flush", "after a flush", "before a rename")
    assert {*kinds, "half a journal write"} <= killed.keys(), killed

    heard = [json.loads(line) for line in (runs / "heard.jsonl").read_text().splitlines()]
    before = Store(runs / "small").rows()
    assert finish(tmp_path, path) == small.results(small.run(load(path), tmp_path / "clean"))
    rows = Store(runs / "small").rows()
    stored = [r for part in Store(runs / "small").parts for r in pq.read_table(part).to_pylist()]
    made = Counter((r["kind"], r["name"], r["number"]) for r in stored)
    assert set(made.values()) == {1}
    by = {(r["kind"], r["name"], r["number"]): r["pid"] for r in rows}
    assert len(heard) > 20
    assert all(by[note["kind"], note["name"], note["number"]] == note["pid"] for note in heard)
    assert [r for r in rows if r in before] == before


def rows_of(store):
    return store.table().num_rows


def kill_in_a_pool(path, folder, moments, killed):
    """Run with two workers, and kill the master or the process that made the newest row."""
    store = Store(folder / "runs/small")
    before = rows_of(store)
    process = small.start("study", "run", path, "--workers", "2", folder=folder, EIWA_THREADS="2")
    wait_for(process, lambda: rows_of(store) > before)
    time.sleep(moments.uniform(0.0, 0.3))
    newest = max(store.rows(), key=lambda r: r["started"])
    if moments.random() < 0.5:
        os.kill(newest["pid"], signal.SIGKILL)
        killed["worker"] += 1
        before = rows_of(store)
        wait_for(process, lambda: rows_of(store) > before)
    process.kill()
    process.communicate()
    killed["master"] += 1


@pytest.mark.slow
def test_a_second_process_is_refused_and_the_first_is_not_disturbed(path, tmp_path, whole):
    held = small.hold(tmp_path, TRIALS // 2)
    first = small.start("study", "run", path, folder=tmp_path)
    wait_for(first, lambda: len(search_of(tmp_path)) >= 2)
    first.send_signal(small.signal.SIGSTOP)
    said = [small.eiwa("study", "run", path, *option, folder=tmp_path) for option in ((), ("--fresh",))]
    held.unlink()
    first.send_signal(small.signal.SIGCONT)
    _, err = first.communicate(timeout=240)
    for code, out, message in said:
        assert (code, out) == (2, "")
        assert f"this study is running in process {first.pid}" in message
        assert "Traceback" not in message
    assert first.returncode == 0, err
    assert small.results(Store(tmp_path / "runs/small")) == whole
