"""Processes that are stopped, killed and started twice: what they leave is continued to what a whole run gives."""

import random
import time

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


def wait_for(process, condition, seconds=60):
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
    process = small.start("study", "run", path, folder=tmp_path)
    wait_for(process, lambda: len(search_of(tmp_path)) >= 3)
    process.send_signal(small.signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Stopped. Finished trials are kept; run the same command to continue." in err
    assert "Traceback" not in err
    assert out == ""
    assert 0 < len(Store(tmp_path / "runs/small").rows()) < TRIALS
    assert finish(tmp_path, path) == whole


@pytest.mark.slow
def test_kill_at_any_moment_is_continued(path, tmp_path, whole):
    """Eight times, at moments from before the first trial to the middle of a write."""
    moments, killed = random.Random(1), 0
    for _ in range(8):
        process = small.start("study", "run", path, folder=tmp_path)
        journal = tmp_path / "runs/small/journal.log"
        before = journal.stat().st_size if journal.exists() else -1
        while process.poll() is None and not (journal.exists() and journal.stat().st_size != before):
            time.sleep(0.01)
        time.sleep(moments.uniform(0.0, 0.6))
        killed += process.poll() is None
        process.kill()
        process.communicate()
    assert killed >= 5
    kept = Store(tmp_path / "runs/small").rows()
    assert any(r["kind"] == "trial" for r in kept)
    assert finish(tmp_path, path) == whole


@pytest.mark.slow
def test_a_second_process_is_refused_and_the_first_is_not_disturbed(path, tmp_path, whole):
    first = small.start("study", "run", path, folder=tmp_path)
    wait_for(first, lambda: len(search_of(tmp_path)) >= 2)
    first.send_signal(small.signal.SIGSTOP)
    said = [small.eiwa("study", "run", path, *option, folder=tmp_path) for option in ((), ("--fresh",))]
    first.send_signal(small.signal.SIGCONT)
    _, err = first.communicate(timeout=60)
    for code, out, message in said:
        assert (code, out) == (2, "")
        assert f"this study is running in process {first.pid}" in message
        assert "Traceback" not in message
    assert first.returncode == 0, err
    assert small.results(Store(tmp_path / "runs/small")) == whole
