"""Worker processes of this machine. Each has one task at a time, so that a death is known to belong to a task."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from eiwa.core.errors import EiwaError, ExecutionError
from eiwa.core.kernel import thread_count
from eiwa.core.spec import StudySpec
from eiwa.study.executors import PATIENCE, Say, environment
from eiwa.study.parcel import packed, unpacked
from eiwa.study.rows import Row, Task, failed, row

THREADS = ("EIWA_THREADS", "NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Worker:
    """A process that evaluates one task at a time."""

    def __init__(self, parcel: bytes, threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs, parcel), name="eiwa worker", daemon=True)
        with _spawning(threads):
            self.process.start()
        theirs.close()
        self.ready = False
        self.task: Task | None = None

    def take(self, task: Task) -> bool:
        """Begin a task; False when the process is gone."""
        try:
            self.connection.send(task)
        except OSError:
            return False
        self.task = task
        return True

    def stop(self) -> str:
        """End the process and tell how it ended."""
        self.process.kill()
        self.process.join()
        self.connection.close()
        code = self.process.exitcode or 0
        return f"signal {-code}" if code < 0 else f"exit code {code}"


class Pool:
    """As many workers as the study asks for, started when there is something to do."""

    def __init__(self, spec: StudySpec, say: Say) -> None:
        self._spec = spec
        self._say = say
        self._size = spec.execution.workers
        self._threads = spec.execution.threads or max(1, thread_count() // self._size)
        self._workers: list[Worker] = []
        self._parcel = b""
        self._stillborn = 0

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._workers:
            worker.stop()

    def rows(self, tasks: Sequence[Task]) -> Iterator[list[Row]]:
        """Rows as the workers finish them; the task of a worker that died is tried again."""
        waiting, deaths = deque(tasks), Counter[str]()
        left = len(waiting)
        while left:
            self._hand_out(waiting)
            answers = wait([w.connection for w in self._workers], PATIENCE)
            finished = []
            for worker in [w for w in self._workers if w.connection in answers]:
                try:
                    finished += self._heard(worker, worker.connection.recv())
                except (EOFError, OSError):
                    finished += self._bury(worker, deaths, waiting)
            left -= len(finished)
            self._hand_out(waiting)
            yield finished

    def _hand_out(self, waiting: deque[Task]) -> None:
        """Give every idle worker a task; start those that are missing."""
        self._parcel = self._parcel or packed(self._spec)
        while len(self._workers) < self._size and len(waiting) > sum(w.task is None for w in self._workers):
            self._workers.append(Worker(self._parcel, self._threads))
        for worker in list(self._workers):
            if waiting and worker.task is None:
                if worker.take(waiting[0]):
                    waiting.popleft()
                else:
                    self._bury(worker, Counter(), waiting)

    def _heard(self, worker: Worker, answer: Row | EiwaError | None) -> list[Row]:
        if isinstance(answer, EiwaError):
            raise answer
        if answer is None:
            worker.ready, self._stillborn = True, 0
            return []
        worker.task = None
        return [answer]

    def _bury(self, worker: Worker, deaths: Counter[str], waiting: deque[Task]) -> list[Row]:
        """Part from a dead worker; its task waits again, or has failed when too many died of it."""
        self._workers.remove(worker)
        end, task, retries = worker.stop(), worker.task, self._spec.execution.retries
        if not worker.ready:
            self._stillborn += 1
            if self._stillborn > retries + self._size:
                raise ExecutionError(
                    f"execution.workers: worker processes end before they begin ({end}). A script that runs a study "
                    'with workers needs the line: if __name__ == "__main__":'
                )
            if task is not None:
                waiting.appendleft(task)
            return []
        if task is None:
            return []
        deaths[task.label] += 1
        died = f"its worker died ({end})"
        if deaths[task.label] > retries:
            message = f"{died} at each of {deaths[task.label]} attempts (execution.retries = {retries})"
            self._say(f"{task.label}: {message}; it has failed.")
            return [failed(self._spec, task, message)]
        self._say(f"{task.label}: {died}; it is tried again ({deaths[task.label]} of {retries}).")
        waiting.appendleft(task)
        return []


def serve(connection: Connection, parcel: bytes) -> None:
    """What a worker does: answer that it is ready (or why not), then a row for every task, until its master is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_master, daemon=True).start()
    with suppress(EOFError, OSError):
        try:
            spec = unpacked(parcel)
        except EiwaError as error:
            connection.send(error)
            return
        connection.send(None)
        while True:
            connection.send(row(spec, connection.recv()))


def _end_with_the_master() -> None:
    master: Any = multiprocessing.parent_process()
    wait([master.sentinel])
    os._exit(1)


@contextmanager
def _spawning(threads: int) -> Iterator[None]:
    """The child is born with its budget of threads, and deaf to Ctrl-C, which its master hears."""
    resource_tracker.ensure_running()  # else it would be started, and SIGINT unblocked, in between
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with environment(dict.fromkeys(THREADS, str(threads))):
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
