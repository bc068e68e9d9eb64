"""Parts are gathered in one; whenever the process is killed, no row is lost or comes twice."""

import json
import subprocess
import sys

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from eiwa.core.errors import StoreError
from eiwa.study import store as module
from eiwa.study.rows import VERSION, schema
from eiwa.study.store import Store
from tests.study import small

COLUMNS = pa.schema(
    [
        *((name, pa.string()) for name in ("kind", "name")),
        ("number", pa.int64()),
        ("F", pa.float64()),
        ("started", pa.timestamp("us", tz="UTC")),
    ]
)


@pytest.fixture
def store(tmp_path):
    (tmp_path / "trials").mkdir()
    return Store(tmp_path)


def write(store, *numbers, columns=COLUMNS):
    for number in numbers:
        store.write([{"kind": "trial", "number": number, "F": number / 7}], columns)


def numbers(store):
    """Of the rows, each of which is in one part only."""
    found = [r["number"] for r in store.rows()]
    assert sorted(n for part in store.parts for n in pq.read_table(part)["number"].to_pylist()) == sorted(found)
    return found


def names(store):
    return sorted(p.name for p in (store.folder / "trials").iterdir())


def test_rows_and_their_order_stay(store):
    write(store, *range(5))
    before = store.rows()
    store.compact()
    assert store.rows() == before
    assert names(store) == ["part-000001-000005.parquet"]


def test_numbers_go_on_behind_what_was_gathered(store):
    write(store, *range(3))
    store.compact()
    write(store, 3)
    assert names(store) == ["part-000001-000003.parquet", "part-000004.parquet"]
    store.compact()
    assert names(store) == ["part-000001-000004.parquet"]
    assert numbers(store) == [0, 1, 2, 3]


def test_nothing_is_written_where_there_is_nothing_to_gather(store):
    store.compact()
    assert names(store) == []
    write(store, 0)
    store.compact()
    assert names(store) == ["part-000001.parquet"]


def test_loose_parts_are_gathered_during_a_run(store, monkeypatch):
    monkeypatch.setattr(module, "LOOSE", 4)
    write(store, *range(11))
    assert names(store) == [
        "part-000001-000004.parquet",
        "part-000005-000008.parquet",
        *(f"part-{k:06d}.parquet" for k in (9, 10, 11)),
    ]
    assert numbers(store) == list(range(11))


def test_a_part_that_lies_within_another_is_not_read_and_then_deleted(store):
    write(store, *range(4))
    kept = {p.name: p.read_bytes() for p in store.parts}
    store.compact()
    for name in ("part-000002.parquet", "part-000004.parquet"):
        (store.folder / "trials" / name).write_bytes(kept[name])
    assert numbers(store) == list(range(4))
    store.compact()
    assert names(store) == ["part-000001-000004.parquet"]


def test_a_column_that_comes_later(store):
    write(store, 0)
    write(store, 1, columns=COLUMNS.append(pa.field("more", pa.float64())))
    store.compact()
    assert store.table().column_names == [*COLUMNS.names, "more"]
    assert numbers(store) == [0, 1]


def test_a_part_that_is_gathered_while_it_is_read(store, monkeypatch):
    """A reader holds no lock: it looks again."""
    write(store, *range(3))
    read, moments = module._read, iter([True])

    def slow(part):
        if next(moments, False):
            store.compact()
        return read(part)

    monkeypatch.setattr(module, "_read", slow)
    assert numbers(store) == [0, 1, 2]


KILL = """
import os, signal, sys
from pathlib import Path
import pyarrow
pyarrow.set_cpu_count(1)
from eiwa.study import store as module
from eiwa.study.store import Store

def killed(folder, operation, when, moment):
    "A child that ends by SIGKILL before or after its n-th replace or unlink of a part."
    child = os.fork()
    if child:
        return os.WIFSIGNALED(os.waitpid(child, 0)[1])
    left, real = [moment], getattr(Path, operation)
    def counted(path, *arguments, **named):
        part = not path.name.endswith(".tmp") or operation == "replace"
        left[0] -= part
        if left[0] == 0 and part and when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        done = real(path, *arguments, **named)
        if left[0] == 0 and part:
            os.kill(os.getpid(), signal.SIGKILL)
        return done
    setattr(Path, operation, counted)
    Store(folder).compact()
    os._exit(0)

for case in Path(sys.argv[1]).iterdir():
    operation, when, moment = case.name.split("-")
    print(case.name, killed(case, operation, when, int(moment)))
"""


def test_killed_between_any_two_file_operations(tmp_path):
    """One file is put in place, four are deleted: before and after each."""
    cases = [f"replace-{when}-1" for when in ("before", "after")]
    cases += [f"unlink-{when}-{k}" for when in ("before", "after") for k in range(1, 5)]
    for case in cases:
        (tmp_path / case / "trials").mkdir(parents=True)
        write(Store(tmp_path / case), *range(4))
    said = subprocess.run([sys.executable, "-c", KILL, tmp_path], capture_output=True, text=True, check=True).stdout
    assert sorted(said.split("\n")[:-1]) == sorted(f"{case} True" for case in cases)
    for case in cases:
        store = Store(tmp_path / case)
        assert numbers(store) == list(range(4)), case
        write(store, 4)
        store.compact()
        assert numbers(store) == list(range(5)), case
        assert [name for name in names(store) if not name.startswith(".")] == ["part-000001-000005.parquet"], case


# What a part says about itself


def test_a_part_explains_itself(tmp_path, no_work):
    spec = small.spec()
    (part,) = small.run(spec, tmp_path).parts
    metadata = {k.decode(): v.decode() for k, v in pq.read_schema(part).metadata.items() if k.startswith(b"eiwa")}
    assert metadata["eiwa.schema"] == str(VERSION)
    assert metadata["eiwa.spec_hash"] == spec.hash
    assert json.loads(metadata["eiwa.study"])["voxels"]["size"] == 0.05
    assert json.loads(metadata["eiwa.file"]) == small.tree()


def test_rows_of_a_newer_version_are_refused(tmp_path, no_work):
    spec = small.spec()
    store = small.run(spec, tmp_path)
    (part,) = store.parts
    newer = {**pq.read_schema(part).metadata, b"eiwa.schema": str(VERSION + 1).encode()}
    pq.write_table(pq.read_table(part).replace_schema_metadata(newer), part)
    with pytest.raises(StoreError, match=r"was written by a newer eiwa \(store version 2; this one reads up to 1\)"):
        store.rows()


def test_rows_of_before_there_were_versions_are_read(tmp_path, no_work):
    store = small.run(small.spec(), tmp_path)
    (part,) = store.parts
    before = store.rows()
    pq.write_table(pq.read_table(part).replace_schema_metadata(None), part)
    assert store.rows() == before


def test_rows_tell_estimator_and_processor(tmp_path, no_work):
    changes = {small.DESIGN: small.DESIGN + '"sampling.estimator" = "sobol"\n'}
    rows = small.run(small.spec(changes), tmp_path).rows()
    assert {r["kind"]: r["estimator"] for r in rows} == {"design": "sobol", "trial": "plain", "leader": "plain"}
    assert all(r["cpu"] and r["cpu_features"] for r in rows)


def test_columns_of_the_schema_have_metadata_once():
    assert set(schema(small.spec()).metadata) == {
        b"eiwa.schema", b"eiwa.version", b"eiwa.spec_hash", b"eiwa.study", b"eiwa.file",
    }  # fmt: skip
