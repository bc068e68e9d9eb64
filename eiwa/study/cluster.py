"""Evaluations on a Dask cluster: its workers need eiwa and its plugins installed, but none of the study's files."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from typing import Any

from eiwa.core.errors import EiwaError, ExecutionError, finding
from eiwa.core.spec import StudySpec
from eiwa.study.executors import PATIENCE, Executor, Say, environment
from eiwa.study.parcel import packed, unpacked
from eiwa.study.rows import Row, Task, failed, row

REACH = 10.0
"""Seconds in which the scheduler must answer."""
LONELY = 10.0
"""Seconds after which the user hears that it has no workers."""


@contextmanager
def cluster(spec: StudySpec, say: Say) -> Iterator[Executor]:
    """The cluster of the study's scheduler.

    Raises
    ------
    ExecutionError
        Dask is not installed, or the scheduler does not answer.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ExecutionError("execution.executor = 'dask' needs Dask: pip install 'eiwa[dask]'.") from None
    address = spec.execution.scheduler
    try:
        client = Client(address, timeout=REACH, set_as_default=False, name="eiwa")
    except (OSError, ValueError) as error:
        problem = f"no Dask scheduler answers there ({str(error).splitlines()[0][:120]})."
        remedy = "Start one (dask scheduler), or correct the address."
        raise ExecutionError(finding("execution.scheduler", problem, value=address, remedy=remedy)) from None
    with client:
        yield Cluster(spec, say, client)


class Cluster:
    """Hands tasks to a Dask client; what dead workers had, Dask gives to others."""

    def __init__(self, spec: StudySpec, say: Say, client: Any) -> None:
        self._spec = spec
        self._say = say
        self._client = client
        self._parcel = b""
        self._workers: set[str] = set()
        self._alone_since: float | None = None

    def rows(self, tasks: Sequence[Task]) -> Iterator[list[Row]]:
        """Rows as the cluster finishes them."""
        self._parcel = self._parcel or packed(self._spec)
        run, threads = uuid.uuid4().hex[:8], self._spec.execution.threads
        waiting: dict[Any, Task] = {}
        try:
            with self._reached():
                for task in tasks:
                    key = f"eiwa-{task.label}-{run}"
                    future = self._client.submit(evaluated, self._parcel, task, threads, key=key, pure=False)
                    waiting[future] = task
            while waiting:
                with self._reached():
                    finished = [self._row(waiting.pop(future), future) for future in self._done(list(waiting))]
                    self._watch()
                yield finished
        finally:
            with suppress(CancelledError, OSError):
                self._client.cancel(list(waiting))

    @contextmanager
    def _reached(self) -> Iterator[None]:
        """Turn what is lost with the scheduler into an ExecutionError."""
        try:
            yield
        except (CancelledError, OSError):  # the client gives up all futures when its connection is lost
            raise ExecutionError(
                f"execution.scheduler = {self._spec.execution.scheduler!r}: the scheduler went away. Start it again; "
                "finished trials are kept, run again to continue."
            ) from None

    def _done(self, futures: Sequence[Any]) -> Sequence[Any]:
        from distributed import wait

        try:
            with self._client.as_current():
                wait(futures, timeout=PATIENCE, return_when="FIRST_COMPLETED")
        except TimeoutError:
            return []
        return [future for future in futures if future.done()]

    def _row(self, task: Task, future: Any) -> Row:
        from distributed import KilledWorker

        try:
            result: Row = future.result()
            return result
        except KilledWorker as error:
            message = f"its worker died at every attempt; the last was {error.last_worker.address}"
            self._say(f"{task.label}: {message}; it has failed.")
            return failed(self._spec, task, message)
        except (EiwaError, CancelledError):
            raise
        # Whatever else a cluster raises is not about the design, which row() would have told.
        except Exception as error:
            raise ExecutionError(
                f"A Dask worker cannot evaluate ({type(error).__name__}: {error}). Install the same eiwa for all workers."
            ) from error

    def _watch(self) -> None:
        """Tell of workers that left, and when there are none."""
        known = self._client.scheduler_info(n_workers=-1)
        if "workers" not in known:
            raise ConnectionError
        workers = set(known["workers"])
        for address in sorted(self._workers - workers):
            self._say(f"The Dask worker {address} is gone; what it had is tried again by others.")
        self._workers = workers
        if workers:
            self._alone_since = None
            return
        now = time.monotonic()
        if self._alone_since is None:
            self._alone_since = now
        elif now - self._alone_since > LONELY:
            self._say(f"{self._spec.execution.scheduler} has no workers; the study waits for some (dask worker).")
            self._alone_since = float("inf")


_one = threading.Lock()


def evaluated(parcel: bytes, task: Task, threads: int | None) -> Row:
    """A task's row, on a worker; one at a time in each of its processes, on as many threads as Dask gave it."""
    from distributed import get_worker

    with _one, environment({"EIWA_THREADS": str(threads or get_worker().state.nthreads)}):
        return row(unpacked(parcel), task)
