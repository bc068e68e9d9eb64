"""Optuna's journal file: our lock, whole transactions, mended tails."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from eiwa.core.errors import StoreError


class FileLock:
    """An advisory lock that the system releases when its holder dies; its holder may take it again."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[str] | None = None
        self._depth = 0

    def acquire(self) -> bool:
        """Wait for the lock."""
        if self._file is None:
            file = self._path.open("a")
            fcntl.flock(file, fcntl.LOCK_EX)
            self._file = file
        self._depth += 1
        return True

    def release(self) -> None:
        """Give it back."""
        self._depth -= 1
        if not self._depth and self._file is not None:
            self._file.close()
            self._file = None

    @contextmanager
    def held(self) -> Iterator[None]:
        """Have it for a while."""
        self.acquire()
        try:
            yield
        finally:
            self.release()


def tried(file: IO[str]) -> bool:
    """Take the lock of an open file unless another process has it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class Journal(JournalFileBackend):
    """A journal that can write several logs at once, and none when what made them is interrupted."""

    def __init__(self, path: Path) -> None:
        self._own = FileLock(path.with_name("journal.lock"))
        super().__init__(str(path), lock_obj=self._own)  # type: ignore[arg-type]
        self._pending: list[dict[str, Any]] | None = None
        self._read = 0
        """Logs of the file that were read."""

    def read_logs(self, log_number_from: int) -> Iterator[dict[str, Any]]:  # type: ignore[override]
        """Logs from a number on: those of the file, and within a transaction those that wait to be written."""
        if self._pending is not None:
            yield from self._pending[log_number_from - self._read :]
            return
        for number, log in enumerate(super().read_logs(log_number_from), log_number_from):
            self._read = number + 1
            yield log

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        """Write logs, or keep them for the end of the transaction."""
        if self._pending is None:
            super().append_logs(logs)
        else:
            self._pending += json.loads(json.dumps(logs))  # as they will be read

    @contextmanager
    def transaction(self, storage: JournalStorage) -> Iterator[None]:
        """Nobody else writes, and all that is written inside is written at once at the end."""
        with self._own.held():
            storage.get_all_studies()  # reads what others wrote
            self._pending = []
            try:
                yield
            finally:
                logs, self._pending = self._pending, None
            if logs:
                super().append_logs(logs)
                self._read += len(logs)


def storage(path: Path) -> JournalStorage:
    """The journal at an absolute path, checked and mended.

    Raises
    ------
    StoreError
        A line inside is damaged.
    """
    path = path.resolve()
    if path.exists():
        _mend_tail(path)
        _check(path)
    try:
        found = JournalStorage(Journal(path))
        found.get_all_studies()
    except OSError:
        raise
    # Replaying lines that are JSON but no log can raise anything.
    except Exception as error:
        raise _damaged(path, f"its log ({type(error).__name__})") from None
    return found


def _mend_tail(path: Path) -> None:
    """Cut a torn last line, to which the next line would otherwise be glued."""
    with path.open("r+b") as file:
        content = file.read()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            file.truncate(whole)


def _check(path: Path) -> None:
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            try:
                json.loads(line)
            except ValueError:
                raise _damaged(path, f"line {number}") from None


def _damaged(path: Path, where: str) -> StoreError:
    return StoreError(
        f"{path}: {where} is damaged. Finished trials are safe in {path.parent / 'trials'}: "
        "move the journal away and run again, it is rebuilt from them."
    )


def quiet() -> None:
    """Only errors from Optuna's own log: the command line has its own progress."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
