"""The folder of a study: ``runs/<name>/`` with ``study.json``, ``journal.log``, ``lock`` and ``trials/part-*.parquet``.

A part is written to a temporary file, flushed to the disk and renamed, so a part is whole or not there.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from eiwa.core.errors import StoreError
from eiwa.core.spec import StudySpec, differences
from eiwa.study.rows import Row


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
        """Parquet parts in the order they were written."""
        found = (self.folder / "trials").glob("part-*.parquet")
        return sorted(path for path in found if path.stem.removeprefix("part-").isdigit())

    def exists(self) -> bool:
        """Whether a study has been started here."""
        return (self.folder / "study.json").exists()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for one running process.

        Raises
        ------
        StoreError
            Another process holds it, or the folder cannot be written.
        """
        with writing(self.folder):
            (self.folder / "trials").mkdir(parents=True, exist_ok=True)
            file = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                holder = os.read(file, 32).decode().strip() or "unknown"
                raise StoreError(
                    f"{self.folder}: this study is running in process {holder}. Wait for it, stop it, or use another name."
                ) from None
            with writing(self.folder / "lock"):
                os.ftruncate(file, 0)
                os.pwrite(file, str(os.getpid()).encode(), 0)
            yield
        finally:
            os.close(file)

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
        number = 1
        while (target := self.folder.with_name(f"{self.folder.name}.old-{number}")).exists():
            number += 1
        with self.locked(), writing(self.folder):
            self.folder.rename(target)
        return target

    def write(self, rows: Sequence[Row], schema: pa.Schema) -> None:
        """Append rows as one part."""
        number = 1 + max((int(p.stem.split("-")[1]) for p in self.parts), default=0)
        sink = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist(list(rows), schema=schema), sink, compression="zstd")
        write_atomically(self.folder / "trials" / f"part-{number:06d}.parquet", sink.getvalue().to_pybytes())

    def table(self) -> pa.Table:
        """All rows: designs, trials by number, leaders; otherwise in the order they were written.

        Raises
        ------
        StoreError
            A part is damaged.
        """
        tables = []
        for part in self.parts:
            try:
                tables.append(pq.read_table(part))
            except (OSError, pa.ArrowException) as error:
                raise StoreError(
                    f"{part}: is damaged ({str(error).splitlines()[0]}). Move it away and run the study again: "
                    "its rows are evaluated again, to the same numbers."
                ) from None
        if not tables:
            return pa.table({})
        table = pa.concat_tables(tables, promote_options="default")
        # Rows are written as evaluations finish, in any order.
        trial = pc.equal(table["kind"], "trial")
        ranks = [pc.equal(table["kind"], "leader"), trial, pc.if_else(trial, table["number"], None)]
        order = pa.table(dict(zip("abc", ranks, strict=True)))
        return table.take(pc.sort_indices(order, sort_keys=[(key, "ascending") for key in "abc"]))

    def rows(self) -> list[Row]:
        """All rows as dictionaries."""
        rows: list[Row] = self.table().to_pylist()
        return rows


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that it is whole or not there, even after a power loss."""
    temporary = path.with_name(f".{path.name}.tmp")
    with writing(path):
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
def writing(path: Path) -> Iterator[None]:
    """Turn an operating system's refusal to write into a StoreError."""
    try:
        yield
    except OSError as error:
        if isinstance(error, BlockingIOError):
            raise
        remedy = (
            "Free some space" if error.errno == errno.ENOSPC else "Make it writable, or choose another --runs folder"
        )
        raise StoreError(
            f"{path}: cannot be written: {error.strerror}. {remedy}; finished trials are kept, run again to continue."
        ) from error
