"""Optuna's journal file: our lock, mended tails, and its rebuilding from Parquet rows."""

from __future__ import annotations

import fcntl
import json
from pathlib import Path
from typing import IO

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from eiwa.core.errors import StoreError


class FileLock:
    """An advisory lock that the system releases when its holder dies."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[str] | None = None

    def acquire(self) -> bool:
        """Wait for the lock."""
        self._file = self._path.open("a")
        fcntl.flock(self._file, fcntl.LOCK_EX)
        return True

    def release(self) -> None:
        """Give it back."""
        if self._file is not None:
            self._file.close()
            self._file = None


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
    lock = FileLock(path.with_name("journal.lock"))
    try:
        found = JournalStorage(JournalFileBackend(str(path), lock_obj=lock))  # type: ignore[arg-type]
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
