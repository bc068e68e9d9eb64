"""Where evaluations happen: in this process, in worker processes of this machine, or on a Dask cluster.

An executor takes tasks and gives their rows as they finish, in any order; which one it is changes no number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from eiwa.core.spec import StudySpec
from eiwa.study.rows import Row, Task, row

PATIENCE = 0.5
"""Seconds after which an executor that waits gives an empty answer, so that its caller can look after other things."""

Say = Callable[[str], None]


class Executor(Protocol):
    """Evaluates tasks."""

    def rows(self, tasks: Sequence[Task]) -> Iterator[list[Row]]:
        """Rows of all tasks as they finish, in any order; an empty list when there were none for a while.

        Raises
        ------
        ExecutionError
            There is nobody to evaluate them.
        """


class Here:
    """This process, one task after the other."""

    def __init__(self, spec: StudySpec) -> None:
        self._spec = spec

    def rows(self, tasks: Sequence[Task]) -> Iterator[list[Row]]:
        """A row at a time."""
        for task in tasks:
            yield [row(self._spec, task)]


def executor_of(spec: StudySpec, say: Say) -> AbstractContextManager[Executor]:
    """The executor that a study asks for, to be closed at its end; ``say`` tells its user what happened to workers."""
    if spec.execution.executor == "dask":
        from eiwa.study.cluster import cluster

        return cluster(spec, say)
    if spec.execution.workers > 1:
        from eiwa.study.pool import Pool

        return Pool(spec, say)
    return _here(spec)


@contextmanager
def _here(spec: StudySpec) -> Iterator[Executor]:
    with environment({} if spec.execution.threads is None else {"EIWA_THREADS": str(spec.execution.threads)}):
        yield Here(spec)


@contextmanager
def environment(values: dict[str, str]) -> Iterator[None]:
    """Environment variables for a while."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
