"""Where Optuna keeps a study: a journal file in the study's folder, or a database by its URL, held by one process."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import BaseStorage, RDBStorage

from eiwa.core.errors import StoreError
from eiwa.core.spec import StudySpec
from eiwa.study import journal
from eiwa.study.store import Store, writing


@dataclass(frozen=True)
class Storage:
    """An open storage that nobody else runs this study on."""

    optuna: BaseStorage
    place: str
    """What messages call it; without a password."""
    shared: bool
    """Whether it can hold studies that do not belong to this folder."""
    transaction: Callable[[], AbstractContextManager[None]]
    """What is written inside is written at once where that can be; refusals become a StoreError."""


@contextmanager
def opened(spec: StudySpec, store: Store) -> Iterator[Storage]:
    """The storage of a study that runs.

    Raises
    ------
    StoreError
        It cannot be used, or another process runs the study there.
    """
    journal.quiet()
    if spec.execution.storage is None:
        with writing(store.journal):
            storage = journal.storage(store.journal)
        yield Storage(storage, str(store.journal), False, lambda: _journal_transaction(storage, store.journal))
        return
    with ExitStack() as stack:
        yield _database(spec.execution.storage, spec.study.name, stack)


@contextmanager
def _journal_transaction(storage: optuna.storages.JournalStorage, path: Path) -> Iterator[None]:
    backend: Any = storage._backend
    with writing(path), backend.transaction(storage):
        yield


def _database(address: str, study: str, stack: ExitStack) -> Storage:
    import sqlalchemy

    try:
        url = sqlalchemy.make_url(address)
    except sqlalchemy.exc.ArgumentError:
        raise StoreError("execution.storage: is not a URL such as postgresql://USER@HOST/DATABASE.") from None
    if url.drivername == "postgresql":
        url = url.set(drivername="postgresql+psycopg")
    place = f"execution.storage ({url.render_as_string(hide_password=True)})"
    full = url.render_as_string(hide_password=False)
    with refusals(place):
        hold = _held_file if url.get_backend_name() == "sqlite" else _held_on_server
        alive, turn = hold(url, study, place, stack)
        with turn:  # whose tables Optuna makes where there are none, and may be made once only
            storage = RDBStorage(full)
    stack.callback(storage.engine.dispose)
    stack.callback(storage.remove_session)

    @contextmanager
    def transaction() -> Iterator[None]:
        with refusals(place):
            alive()
            yield

    return Storage(storage, place, True, transaction)


@contextmanager
def refusals(place: str) -> Iterator[None]:
    """Turn what a database and its driver refuse into a StoreError."""
    import sqlalchemy

    try:
        yield
    except ImportError:
        raise StoreError(f"{place}: needs the driver psycopg: pip install 'eiwa[postgres]'.") from None
    except (sqlalchemy.exc.SQLAlchemyError, optuna.exceptions.StorageInternalError) as error:
        cause = error.__cause__ if isinstance(error, optuna.exceptions.StorageInternalError) else error
        reason = str(getattr(cause, "orig", None) or cause or error).strip().split("\n")[0]
        raise StoreError(
            f"{place}: cannot be used: {reason}. Check the address, the user and the password (PGPASSWORD), and that the "
            "server runs; finished trials are kept, run again to continue."
        ) from None


Held = tuple[Callable[[], None], AbstractContextManager[None]]
"""What refuses when the hold on a study is lost, and a turn among all who open the database."""


def _held_file(url: Any, study: str, place: str, stack: ExitStack) -> Held:
    """Hold a study of an SQLite file against other processes of this machine."""
    folder = Path(url.database).resolve()
    with writing(folder):
        lock = stack.enter_context(folder.with_name(f"{folder.name}.{study}.lock").open("a+"))
    if not journal.tried(lock):
        raise StoreError(_taken(study, place, "another process"))
    return lambda: None, journal.FileLock(folder.with_name(f"{folder.name}.lock")).held()


def _held_on_server(url: Any, study: str, place: str, stack: ExitStack) -> Held:
    """Hold a study of a PostgreSQL database by an advisory lock, which ends with its connection."""
    import sqlalchemy

    key, opening = _key(f"eiwa study {study}"), _key("eiwa")
    own = f"{platform.node()[:40]} in process {os.getpid()}"
    engine = sqlalchemy.create_engine(
        url,
        isolation_level="AUTOCOMMIT",
        poolclass=sqlalchemy.pool.NullPool,
        connect_args={"application_name": own, "connect_timeout": 10},
    )
    stack.callback(engine.dispose)
    connection = stack.enter_context(engine.connect())
    text = sqlalchemy.text
    if not connection.scalar(text("SELECT pg_try_advisory_lock(:key)"), {"key": key}):
        holder = connection.scalar(
            text(
                "SELECT application_name FROM pg_locks JOIN pg_stat_activity USING (pid) WHERE locktype = 'advisory' "
                "AND granted AND ((classid::bigint << 32) | objid::bigint) = :key"
            ),
            {"key": key},
        )
        raise StoreError(_taken(study, place, holder or "another process"))

    def alive() -> None:
        connection.execute(text("SELECT 1"))

    @contextmanager
    def turn() -> Iterator[None]:
        connection.execute(text("SELECT pg_advisory_lock(:key)"), {"key": opening})
        yield
        connection.execute(text("SELECT pg_advisory_unlock(:key)"), {"key": opening})

    return alive, turn()


def _key(name: str) -> int:
    """The number of an advisory lock."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big", signed=True)


def _taken(study: str, place: str, holder: str) -> str:
    return (
        f"{place}: the study {study!r} is running on {holder}. Wait for it, stop it, or use another name (study.name)."
    )
