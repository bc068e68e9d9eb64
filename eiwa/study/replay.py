"""A stored row evaluated once more, and what differs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from eiwa.core.errors import EiwaError, StoreError
from eiwa.core.spec import StudySpec, check
from eiwa.core.tree import did_you_mean
from eiwa.study.rows import VOLATILE, Row, Task, row, schema
from eiwa.study.run import parameters
from eiwa.study.store import Store

PROVENANCE = ("spec_hash", "versions", "cpu", "cpu_features", "threads", "host")
"""What may explain a difference."""


@dataclass(frozen=True)
class Replay:
    """The row as it is stored and as it comes out now; ``source`` says which study it was evaluated with."""

    stored: Row
    again: Row
    source: str

    @property
    def differing(self) -> dict[str, tuple[Any, Any]]:
        """Columns that equal results share, with both values where they differ."""
        return self._both(c for c in {**self.stored, **self.again} if c not in VOLATILE)

    @property
    def provenance(self) -> dict[str, tuple[Any, Any]]:
        """What differs in how the rows were made; versions one by one."""
        found = self._both(c for c in PROVENANCE if c != "versions")
        old, new = (json.loads(r["versions"]) for r in (self.stored, self.again))
        names = sorted({**old, **new})
        return found | {name: (old.get(name), new.get(name)) for name in names if old.get(name) != new.get(name)}

    def _both(self, columns: Any) -> dict[str, tuple[Any, Any]]:
        pairs = {c: (self.stored.get(c), self.again.get(c)) for c in columns}
        # NaN differs from itself; its text does not.
        return {c: (a, b) for c, (a, b) in pairs.items() if a != b and repr(a) != repr(b)}


def find(rows: Sequence[Row], name: str) -> Row:
    """The row of ``N`` or ``trial N``, ``leader N``, or a named design's latest.

    Raises
    ------
    StoreError
        There is none.
    """
    names = {_name(r): r for r in rows}
    wanted = f"trial {name}" if name.isdigit() else name
    if wanted not in names:
        raise StoreError(f"{name}: no row of this study{did_you_mean(wanted, list(names)[:6])}")
    return names[wanted]


def _name(r: Row) -> str:
    return str(r["name"]) if r["kind"] == "design" else f"{r['kind']} {r['number']}"


def replay(spec: StudySpec, store: Store, name: str) -> Replay:
    """Evaluate a stored row again, from its own overrides.

    A study file that has changed since is replaced by the copy of it in the row's part.

    Raises
    ------
    EiwaError
        There is no such row, or no study that it can be evaluated with.
    """
    table = store.table()
    stored = find(table.to_pylist(), name)
    source = "file"
    if stored["spec_hash"] != spec.hash:
        spec, source = _kept(spec, table.schema.metadata or {}), "stored"
        if stored["spec_hash"] != spec.hash:
            source = "changed"
    task = Task(
        stored["kind"],
        json.loads(stored["overrides"]),
        stored["replicates"],
        name=stored["name"],
        number=stored["number"],
        parameters=parameters(stored),
    )
    again = pa.Table.from_pylist([row(spec, task)], schema=schema(spec)).to_pylist()[0]
    return Replay(stored, again, source)


def _kept(spec: StudySpec, metadata: dict[bytes, bytes]) -> StudySpec:
    """The study as it is stored with the rows; files that it names are those of now."""
    if b"eiwa.file" not in metadata:
        raise StoreError("The study file has changed since this row, and the row's part does not hold a copy of it.")
    try:
        return check(json.loads(metadata[b"eiwa.file"]), spec.path)
    except EiwaError as error:
        raise StoreError(
            f"The study file has changed since this row, and its stored copy does not hold:\n{error}"
        ) from None
