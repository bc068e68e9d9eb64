"""The folder of a study: ``runs/<name>/`` with ``study.json``, ``journal.log``, ``lock`` and ``trials/part-*.parquet``.

A part is written to a temporary file, flushed to the disk and renamed, so a part is whole or not there. Parts
``part-000001`` to ``part-000064`` are gathered in ``part-000001-000064``, whose name says what it replaces: a part that lies
within another's numbers is not read, so a process may be killed before it has deleted them all.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from eiwa.core.errors import StoreError
from eiwa.core.spec import StudySpec, differences
from eiwa.study.rows import VERSION, VERSION_KEY, Row

LOOSE = 64
"""Loose parts that a run gathers in one."""


@dataclass(frozen=True)
class Store:
    """One study's folder."""

    folder: Path

    @property
    def journal(self) -> Path:
        """Optuna's journal."""
        return self.folder / "journal.log"

    @property
    def parts(self) -> list[Path]:
        """Parquet parts in the order they were written, without those that another has gathered."""
        return [path for path, gathered in self._found() if not gathered]

    def _found(self) -> list[tuple[Path, bool]]:
        """Every part, and whether its rows are in another one too; in the order of their numbers."""
        paths = (self.folder / "trials").glob("part-*.parquet")
        spans = sorted((*span, path) for path in paths if (span := numbers_of(path)))
        found, reached = [], 0
        for _, last, path in sorted(spans, key=lambda item: (item[0], -item[1])):
            found.append((path, last <= reached))
            reached = max(reached, last)
        return found

    def exists(self) -> bool:
        """Whether a study has been started here."""
        return (self.folder / "study.json").exists()

    def require(self, study: str = "STUDY.toml") -> None:
        """Refuse a folder without results of the study file.

        Raises
        ------
        StoreError
            With the command that makes some.
        """
        if not self.exists():
            raise StoreError(f"{self.folder}: has no results yet. Run: eiwa study run {shlex.quote(study)}")

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for one running process.

        Raises
        ------
        StoreError
            Another process holds it, or the folder cannot be written.
        """
        while not self._held(file := self._opened()):
            os.close(file)
        try:
            with writing(self.folder / "lock"):
                os.ftruncate(file, 0)
                os.pwrite(file, str(os.getpid()).encode(), 0)
            yield
        finally:
            os.close(file)

    def _opened(self) -> int:
        with writing(self.folder):
            (self.folder / "trials").mkdir(parents=True, exist_ok=True)
            return os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)

    def _held(self, file: int) -> bool:
        """Lock the open file; False where its folder was set aside meanwhile, so that it is the lock of another one."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(file, 32).decode().strip() or "unknown"
            os.close(file)
            raise StoreError(
                f"{self.folder}: this study is running in process {holder}. Wait for it, stop it, or use another name."
            ) from None
        try:
            return os.path.samestat(os.fstat(file), os.stat(self.folder / "lock"))
        except FileNotFoundError:
            return False

    def open(self, spec: StudySpec) -> None:
        """Make the folder this study's, or check that it is.

        Raises
        ------
        StoreError
            It holds results whose numbers another spec made.
        """
        if self.exists():
            changed = self.changes(spec)
            if not changed:
                return
            shown = "\n".join(f"  {line}" for line in changed[:8])
            raise StoreError(
                f"{self.folder}: holds results of another study file; their numbers would differ:\n{shown}\n"
                "Run with --fresh (the old results are kept aside), or give the study another name."
            )
        if any(row["spec_hash"] != spec.hash for row in self.rows()):
            raise StoreError(
                f"{self.folder}: holds rows that another study file made. Run with --fresh to keep them aside."
            )
        content = {"hash": spec.hash, "identity": spec.identity}
        write_atomically(self.folder / "study.json", json.dumps(content, indent=1, sort_keys=True).encode())

    def changes(self, spec: StudySpec) -> list[str]:
        """What differs between the study file that made the results and this one, where it changes numbers.

        Raises
        ------
        StoreError
            The folder's own record is damaged.
        """
        path = self.folder / "study.json"
        try:
            stored = json.loads(path.read_text())
            if stored["hash"] == spec.hash:
                return []
            changed = differences(stored["identity"], json.loads(json.dumps(spec.identity)))
        except (ValueError, KeyError, TypeError, AttributeError):
            raise StoreError(
                f"{path}: is damaged. Run with --fresh to keep the old results aside and begin anew."
            ) from None
        return changed or ["something that this version of eiwa does not know"]

    def set_aside(self) -> Path | None:
        """Move an existing folder to the next free ``<name>.old-N``."""
        if not self.folder.exists():
            return None
        with self.locked(), writing(self.folder):
            number = 1
            while (target := self.folder.with_name(f"{self.folder.name}.old-{number}")).exists():
                number += 1
            self.folder.rename(target)
        return target

    def write(self, rows: Sequence[Row], schema: pa.Schema) -> None:
        """Append rows as one part; many loose parts are gathered."""
        parts = self.parts
        number = 1 + max((numbers_of(p)[1] for p in parts), default=0)
        self._write(f"part-{number:06d}.parquet", pa.Table.from_pylist(list(rows), schema=schema))
        loose = [p for p in parts if len(set(numbers_of(p))) == 1]
        if len(loose) >= LOOSE:
            with suppress(StoreError):  # a disk without room for the copy holds the parts themselves
                self._gather(numbers_of(loose[0])[0], numbers_of(loose[-1])[1])

    def compact(self) -> None:
        """Gather all parts in one, and delete what was gathered before; killed at any moment, nothing is lost or doubled."""
        with writing(self.folder):
            for path, gathered in self._found():
                if gathered:
                    path.unlink()
        parts = self.parts
        if len(parts) > 1:
            self._gather(numbers_of(parts[0])[0], numbers_of(parts[-1])[1])

    def _gather(self, first: int, last: int) -> None:
        """Write one part in place of all that have these numbers."""
        parts = [p for p in self.parts if first <= numbers_of(p)[0] <= last]
        self._write(f"part-{first:06d}-{last:06d}.parquet", _joined([_read(part) for part in parts]))
        with writing(self.folder):
            for part in parts:
                part.unlink()

    def _write(self, name: str, table: pa.Table) -> None:
        sink = pa.BufferOutputStream()
        # Dictionaries and statistics of a hundred columns cost a part of a few rows more than its rows do.
        large = table.num_rows > LOOSE
        pq.write_table(table, sink, compression="zstd", use_dictionary=large, write_statistics=large)
        write_atomically(self.folder / "trials" / name, sink.getvalue().to_pybytes())

    def table(self) -> pa.Table:
        """All rows: designs, trials by number, leaders, else in the order they were written; the last part's metadata.

        Raises
        ------
        StoreError
            A part is damaged, or a newer eiwa wrote it.
        """
        while True:
            with suppress(FileNotFoundError):  # gathered by a running study since its name was read
                return _in_order(_once(_joined([_read(part) for part in self.parts])))

    def rows(self) -> list[Row]:
        """All rows as dictionaries."""
        rows: list[Row] = self.table().to_pylist()
        return rows


def numbers_of(part: Path) -> tuple[int, int]:
    """First and last number of a part, or nothing where the name is no part's."""
    found = re.fullmatch(r"part-(\d+)(?:-(\d+))?", part.stem)
    return (int(found[1]), int(found[2] or found[1])) if found else ()  # type: ignore[return-value]


def _read(part: Path) -> pa.Table:
    try:
        table = pq.ParquetFile(part).read(use_threads=False)
        version = int((table.schema.metadata or {}).get(VERSION_KEY, 0))
    except FileNotFoundError:
        raise
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StoreError(
            f"{part}: is damaged ({str(error).splitlines()[0]}). Move it away and run the study again: "
            "its rows are evaluated again, to the same numbers."
        ) from None
    if version > VERSION:
        raise StoreError(
            f"{part}: was written by a newer eiwa (store version {version}; this one reads up to {VERSION}). Update eiwa."
        )
    return table


def _joined(tables: Sequence[pa.Table]) -> pa.Table:
    if not tables:
        return pa.table({})
    whole = pa.concat_tables(tables, promote_options="default")
    return whole.replace_schema_metadata(tables[-1].schema.metadata)


def _once(table: pa.Table) -> pa.Table:
    """Each row once, though its part was copied, or put back after its trials had been evaluated again."""
    if not table.num_rows:
        return table
    trial = pc.equal(table["kind"], "trial")
    started = pc.if_else(trial, pa.scalar(None, table["started"].type), table["started"])
    keys = {"kind": table["kind"], "name": table["name"], "number": table["number"], "started": started}
    rows = pa.table({**keys, "row": pa.array(range(table.num_rows))})
    first = rows.group_by(list(keys), use_threads=False).aggregate([("row", "min")])["row_min"]
    return table if len(first) == table.num_rows else table.take(first.sort())


def _in_order(table: pa.Table) -> pa.Table:
    """Rows are written as evaluations finish, in any order."""
    if not table.num_rows:
        return table
    trial = pc.equal(table["kind"], "trial")
    ranks = [pc.equal(table["kind"], "leader"), trial, pc.if_else(trial, table["number"], None)]
    order = pa.table(dict(zip("abc", ranks, strict=True)))
    return table.take(pc.sort_indices(order, sort_keys=[(key, "ascending") for key in "abc"]))


RUN_AGAIN = "choose another --runs folder; finished trials are kept, run again to continue."


def write_atomically(path: Path, content: bytes, otherwise: str = RUN_AGAIN) -> None:
    """Write a file so that it is whole or not there, even after a power loss."""
    temporary = path.with_name(f".{path.name}.tmp")
    with writing(path, otherwise):
        try:
            with temporary.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def writing(path: Path, otherwise: str = RUN_AGAIN) -> Iterator[None]:
    """Turn an operating system's refusal to write into a StoreError, with what else the user may do."""
    try:
        yield
    except OSError as error:
        if isinstance(error, BlockingIOError):
            raise
        remedy = "Free some space" if error.errno == errno.ENOSPC else "Make it writable"
        raise StoreError(f"{path}: cannot be written: {error.strerror}. {remedy}, or {otherwise}") from error
