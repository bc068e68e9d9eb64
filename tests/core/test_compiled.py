"""Compiled code is kept on the disk, for several processes; without it, or with what a power loss left of it, all works."""

import errno
import fcntl
import importlib.util
import os
import subprocess
import sys
import threading

import numba.core.caching
import pytest

TEXT = "from eiwa.core.compiled import compiled\n\n@compiled\ndef twice(x):\n    return 2 * x\n"


@pytest.fixture
def fresh(tmp_path):
    """The same function as a new process has it, which has yet to compile it or to read what was kept."""
    path = tmp_path / "source.py"
    path.write_text(TEXT)

    def load():
        spec = importlib.util.spec_from_file_location("source", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.twice

    return load


def hits(function):
    return sum(function.stats.cache_hits.values())


def kept(folder, suffix):
    return list((folder / "__pycache__").glob(f"*.{suffix}"))


def test_what_was_compiled_is_read(fresh):
    assert (fresh()(1.5), hits(again := fresh()), again(1.5), hits(again)) == (3.0, 0, 3.0, 1)


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("left", [0, 40, -7])
def test_what_a_power_loss_left_is_compiled_again_and_kept(suffix, left, fresh, tmp_path):
    fresh()(1.5)
    (path,) = kept(tmp_path, suffix)
    path.write_bytes(path.read_bytes()[:left])
    assert (fresh()(1.5), hits(again := fresh()), again(1.5), hits(again)) == (3.0, 0, 3.0, 1)


def test_a_full_disk_is_no_hindrance(fresh, tmp_path, monkeypatch):
    def full(cache, path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(numba.core.caching.IndexDataCacheFile, "_open_for_write", full)
    assert fresh()(1.5) == 3.0
    assert kept(tmp_path, "nbi") == []


def test_another_process_has_its_turn(fresh, tmp_path):
    (tmp_path / "__pycache__").mkdir()
    found = []
    with (tmp_path / "__pycache__/lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        ours = threading.Thread(target=lambda: found.append(fresh()(1.5)))
        ours.start()
        ours.join(1.0)
        assert found == []
        assert kept(tmp_path, "nbi") == []
    ours.join()
    assert found == [3.0]


INTERRUPTED = """
import os, signal
from numba.core.codegen import CPUCodeLibrary

real, presses = CPUCodeLibrary._object_compiled_hook.__func__, [signal.SIGINT]

def hook(cls, *arguments):
    while presses:
        os.kill(os.getpid(), presses.pop())
    real(cls, *arguments)

CPUCodeLibrary._object_compiled_hook = classmethod(hook)
import source
try:
    source.twice(1.5)
except KeyboardInterrupt:
    print("heard,", len(source.twice.overloads), "compiled")
print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)
"""


def test_ctrl_c_during_compilation_is_heard_when_it_is_over(fresh, tmp_path):
    """It comes in a callback of numba's, where it would be lost and make numba raise a RuntimeError."""
    path = {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    command = [sys.executable, "-c", INTERRUPTED]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ | path)
    assert (done.stdout, done.stderr) == ("heard, 1 compiled\nTrue\n", "")


FORKS = """
import fcntl, os, sys
from eiwa.core.compiled import _turn

with _turn(sys.argv[1]):
    reading, writing = os.pipe()
    if not os.fork():
        os.close(writing)
        os.read(reading, 1)  # until the parent has ended
        os._exit(0)
    os.close(reading)
with open(os.path.join(sys.argv[1], "lock")) as other:
    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
"""


def test_a_turn_is_over_though_a_child_was_forked_meanwhile(tmp_path):
    command = [sys.executable, "-W", "ignore", "-c", FORKS, str(tmp_path)]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
