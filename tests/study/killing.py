"""Runs a study in one process after the other, and kills each with SIGKILL: python -m tests.study.killing STUDY RUNS KILLS SEED

The processes are forks of this one, so that a start costs milliseconds. Each ends itself at a random event (before or after
a flush to the disk, before a rename, or with half of a write in the journal), and half of them are killed at a random time
before that.
Every row that was heard of is noted, with the process that made it. Prints the number of kills of each kind.
"""

import builtins
import json
import os
import random
import signal
import sys
import time
from collections import Counter
from pathlib import Path

from optuna.storages.journal import _file

from eiwa.core.outcome import evaluate
from eiwa.core.spec import load
from eiwa.study.run import Run, Silent
from eiwa.study.store import Store

HEARD = "heard.jsonl"


class Noting(Silent):
    """Notes rows that are said to be on the disk."""

    def __init__(self, folder):
        self._file = os.open(folder / HEARD, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def __call__(self, stage, row):
        note = {"kind": row["kind"], "name": row["name"], "number": row["number"], "pid": row["pid"]}
        os.write(self._file, (json.dumps(note) + "\n").encode())


def die():
    os.kill(os.getpid(), signal.SIGKILL)


class Torn:
    """A file whose process ends in the middle of a write."""

    def __init__(self, file, due):
        self._file, self._due = file, due

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._file.close()

    def __getattr__(self, name):
        return getattr(self._file, name)

    def write(self, content):
        if self._due("half a journal write"):
            self._file.write(content[: len(content) // 2])
            self._file.flush()
            die()
        return self._file.write(content)


def end_at(moment, report):
    """End this process at its n-th event, and say at which."""
    left = moment
    fsync, replace, opened = os.fsync, Path.replace, builtins.open

    def due(event):
        nonlocal left
        left -= 1
        if left == 0:
            os.write(report, event.encode())
        return left == 0

    def flush(descriptor):
        if due("before a flush"):
            die()
        fsync(descriptor)
        if due("after a flush"):
            die()

    def rename(self, target):
        if due("before a rename"):
            die()
        return replace(self, target)

    def appended(path, mode="r", **options):
        file = opened(path, mode, **options)
        return Torn(file, due) if "a" in mode else file

    os.fsync, Path.replace, _file.open = flush, rename, appended


def child(spec, runs, moment, report):
    """What one of the processes does; it does not return."""
    end_at(moment, report)
    code = 1
    try:
        Run(spec, Store(runs / spec.study.name), Noting(runs)).execute()
        code = 0
    finally:
        os._exit(code)


def main():
    study, runs, kills, seed = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    choice, done = random.Random(seed), Counter()
    spec = load(study)
    evaluate(spec, {})  # compiles, for all of them
    runs.mkdir(exist_ok=True)
    while sum(done.values()) < kills:
        moment, timed = choice.randrange(1, 20), choice.random() < 0.5
        reading, report = os.pipe()
        pid = os.fork()
        if pid == 0:
            child(spec, runs, moment, report)
        os.close(report)
        if timed:
            time.sleep(0.2 * choice.random() ** 3)  # most of them before the event, on any machine
            os.kill(pid, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
        if os.WIFSIGNALED(status):
            done[os.read(reading, 100).decode() or "at a random time"] += 1
        elif os.WEXITSTATUS(status):
            sys.exit("a process failed")
        else:
            sys.exit(f"the study was complete after {dict(done)}")
        os.close(reading)
    print(json.dumps(done))


if __name__ == "__main__":
    main()
