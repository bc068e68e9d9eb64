"""The folder of a study: whole parts, one process at a time, another spec refused, full and unwritable disks told."""

import errno
import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from eiwa.core.errors import StoreError
from eiwa.study.rows import schema
from eiwa.study.store import Store, write_atomically, writing
from tests.study import small


@pytest.fixture
def finished(tmp_path, no_work):
    """A study that has run."""
    return small.run(small.spec(), tmp_path)


def refused(call, *arguments):
    with pytest.raises(StoreError) as error:
        call(*arguments)
    return str(error.value)


def files(folder):
    return sorted(str(p.relative_to(folder)) for p in Path(folder).rglob("*") if p.is_file())


# Writing


@pytest.mark.usefixtures("loose")
def test_what_lies_in_the_folder_of_a_running_study(finished):
    parts = [f"trials/part-{k:06d}.parquet" for k in range(1, 5)]
    assert files(finished.folder) == ["journal.lock", "journal.log", "lock", "study.json", *parts]


def test_what_lies_in_the_folder_of_a_finished_study(finished):
    part = "trials/part-000001-000004.parquet"
    assert files(finished.folder) == ["journal.lock", "journal.log", "lock", "study.json", part]


def test_parts_are_numbered_in_the_order_they_were_written(finished):
    kinds = [r["kind"] for r in finished.rows()]
    assert kinds == ["design"] + ["trial"] * 8 + ["leader"] * 3


@pytest.mark.usefixtures("loose")
def test_a_part_is_never_written_over(finished):
    spec = small.spec()
    (finished.folder / "trials/part-000002.parquet").unlink()
    finished.write(finished.rows()[:1], schema(spec))
    assert finished.parts[-1].name == "part-000005.parquet"


def test_an_atomic_write(tmp_path):
    path = tmp_path / "file"
    write_atomically(path, b"first")
    write_atomically(path, b"second")
    assert path.read_bytes() == b"second"
    assert files(tmp_path) == ["file"]


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_an_atomic_write_that_fails_leaves_what_was_there(tmp_path, monkeypatch, step):
    path = tmp_path / "file"
    write_atomically(path, b"first")

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(*((os, "fsync", full) if step == "fsync" else (Path, "replace", full)))
    message = refused(write_atomically, path, b"second")
    assert "No space left on device. Free some space, or " in message
    assert "finished trials are kept, run again to continue." in message
    assert path.read_bytes() == b"first"
    assert files(tmp_path) == ["file"]


def test_an_interrupted_write_leaves_no_temporary_file(tmp_path, monkeypatch):
    def interrupt(descriptor):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "file", b"text")
    assert files(tmp_path) == []


def test_what_a_killed_process_left_is_not_read(finished):
    before = finished.rows()
    (finished.folder / "trials/.part-000005.parquet.tmp").write_bytes(b"half a par")
    assert finished.rows() == before


def test_rows_have_every_column_of_the_schema(finished):
    spec = small.spec()
    assert finished.table().column_names == schema(spec).names


# Reading


@pytest.mark.usefixtures("loose")
@pytest.mark.parametrize("content", [b"", b"PAR1", b"nonsense" * 100])
def test_a_damaged_part_is_named(finished, content):
    part = finished.parts[2]
    part.write_bytes(content)
    message = refused(finished.rows)
    assert message.startswith(f"{part}: is damaged")
    assert "Move it away and run the study again" in message


@pytest.mark.usefixtures("loose")
def test_a_part_that_was_cut_is_named(finished):
    part = finished.parts[1]
    part.write_bytes(part.read_bytes()[:-20])
    assert refused(finished.rows).startswith(f"{part}: is damaged")


@pytest.mark.usefixtures("loose")
def test_the_remedy_for_a_damaged_part_works(finished, tmp_path):
    whole = small.results(finished)
    part = finished.parts[2]
    part.write_bytes(b"nonsense")
    refused(small.run, small.spec(), tmp_path)
    part.rename(tmp_path / "away.parquet")
    assert small.results(small.run(small.spec(), tmp_path)) == whole


def test_a_study_that_has_not_run(tmp_path):
    store = Store(tmp_path / "small")
    assert not store.exists()
    assert store.parts == []
    assert store.table().num_rows == 0


# Another spec


def test_another_spec_is_refused_with_what_changed(finished):
    message = refused(finished.open, small.spec({"a = 0.26": "a = 0.27", "K = 12270": "K = 50"}))
    assert message.startswith(f"{finished.folder}: holds results of another study file")
    assert "arm.joints.upper.a: 0.26 -> 0.27" in message
    assert "dexterity.K: 12270.0 -> 50.0" in message
    assert "--fresh" in message


def test_a_metric_more_is_refused_with_its_name(finished):
    assert "mean_dexterity" in refused(finished.open, small.spec(extra="[metrics.mean_dexterity]\n"))


def test_many_changes_are_cut(finished):
    changes = {f'"{name}"': f'"{name}_"' for name in ("waist", "shoulder", "upper", "fore", "pitch", "roll")}
    changes |= {small.SEARCH: '[search]\n"layout.spacing" = { low = 0.1, high = 0.2 }\n', small.DESIGN: ""}
    message = refused(finished.open, small.spec(changes))
    assert len(message.splitlines()) <= 12


def test_the_same_numbers_are_accepted(finished):
    finished.open(small.spec({"trials = 8": "trials = 100", small.DESIGN: "", "a = 0.26": "a = 0.260"}))


@pytest.mark.parametrize("content", ["", "{", "{}", "[]", "3", '{"hash": "x"}', "\0" * 40])
def test_a_damaged_study_file_is_told(finished, content):
    path = finished.folder / "study.json"
    path.write_text(content)
    message = refused(finished.open, small.spec())
    assert message.startswith(f"{path}: is damaged")
    assert "--fresh" in message


def test_what_is_stored_is_the_identity(finished):
    stored = json.loads((finished.folder / "study.json").read_text())
    assert stored == {"hash": small.spec().hash, "identity": small.spec().identity}


# Setting aside


def test_old_results_are_set_aside_under_numbers(finished, tmp_path):
    asides = []
    for _ in range(3):
        finished.folder.mkdir(exist_ok=True)
        asides.append(finished.set_aside().name)
    assert asides == ["small.old-1", "small.old-2", "small.old-3"]
    assert not finished.folder.exists()
    assert (tmp_path / "small.old-1/study.json").exists()


def test_there_may_be_nothing_to_set_aside(tmp_path):
    assert Store(tmp_path / "small").set_aside() is None


def test_a_part_that_was_copied_counts_once(finished):
    before = finished.rows()
    for part, number in ((finished.parts[0], 90), (finished.parts[-1], 91)):
        shutil.copy(part, part.with_name(f"part-{number:06d}.parquet"))
    assert finished.rows() == before


def test_a_part_that_is_put_back_counts_once(finished, tmp_path, no_work, loose):
    """Its trials were evaluated again meanwhile."""
    folder = small.run(small.spec(), tmp_path / "loose").folder
    store = Store(folder)
    before = small.results(store)
    part = next(p for p in store.parts if "trial" in pq.read_table(p)["kind"].to_pylist())
    part.rename(tmp_path / part.name)
    small.run(small.spec(), tmp_path / "loose")
    (tmp_path / part.name).rename(part)
    assert small.results(store) == before


# One process at a time

HOLDER = """
import sys
from pathlib import Path
from eiwa.study.store import Store
with Store(Path(sys.argv[1])).locked():
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the study's folder until its stdin closes."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "small")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process


def test_a_second_process_is_refused_with_the_firsts_number(holder, tmp_path):
    message = refused(small.run, small.spec(), tmp_path)
    assert message.startswith(f"{tmp_path / 'small'}: this study is running in process {holder.pid}.")
    assert files(tmp_path / "small") == ["lock"]


def test_being_refused_does_not_disturb_the_first(holder, tmp_path):
    for _ in range(2):
        assert str(holder.pid) in refused(small.run, small.spec(), tmp_path)


def test_the_lock_of_a_folder_that_was_set_aside_is_not_taken_for_the_new_folders(tmp_path, monkeypatch):
    """Two processes with --fresh at once: the second opens the lock, and then the first moves its folder away."""
    store, flock = Store(tmp_path / "small"), fcntl.flock

    def late(file, operation):
        monkeypatch.setattr(fcntl, "flock", flock)
        store.folder.rename(tmp_path / "small.old-1")
        flock(file, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with store.locked():
        assert (store.folder / "lock").read_text() == str(os.getpid())
        with pytest.raises(StoreError, match="is running in process"), Store(store.folder).locked():
            pass


@pytest.mark.parametrize("end", ["stdin", "kill"])
def test_the_lock_ends_with_its_holder(holder, tmp_path, no_work, end):
    holder.stdin.close() if end == "stdin" else holder.kill()
    holder.wait()
    assert len(small.run(small.spec(), tmp_path).rows()) == 12


def test_a_running_study_cannot_be_set_aside(holder, tmp_path):
    """Its process would go on writing into the folder that was moved."""
    refused(Store(tmp_path / "small").set_aside)
    assert (tmp_path / "small").exists()


def test_reading_needs_no_lock(finished):
    with finished.locked():
        assert len(Store(finished.folder).rows()) == 12


# Folders that cannot be used


def test_a_file_in_place_of_the_folder(tmp_path):
    (tmp_path / "small").write_text("mine")
    message = refused(small.run, small.spec(), tmp_path)
    assert message.startswith(f"{tmp_path / 'small'}: cannot be written: ")
    assert "--runs" in message
    assert (tmp_path / "small").read_text() == "mine"


def test_a_file_in_place_of_the_folder_of_runs(tmp_path):
    (tmp_path / "runs").write_text("mine")
    assert "cannot be written" in refused(small.run, small.spec(), tmp_path / "runs")


def test_a_folder_in_place_of_the_journal(tmp_path, no_work):
    (tmp_path / "small/journal.log").mkdir(parents=True)
    assert "journal.log" in refused(small.run, small.spec(), tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="permissions do not bind root")
def test_a_folder_without_permission(tmp_path):
    (tmp_path / "runs").mkdir(mode=0o500)
    message = refused(small.run, small.spec(), tmp_path / "runs")
    assert "Permission denied. Make it writable, or choose another --runs folder" in message


def test_other_refusals_of_the_system_are_told(tmp_path):
    def read_only():
        with writing(tmp_path):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    assert re.search("cannot be written: Read-only file system. Make it writable", refused(read_only))


# A full disk


def mounted(folder, *options):
    command = ["mount", "-t", "tmpfs", "-o", ",".join(options), "eiwa-tests", str(folder)]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.fixture
def disk(tmp_path):
    """A disk of 1 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if not mounted(folder, "size=1m"):
        pytest.skip("a disk can be mounted by root only")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(disk, left):
    """Fill a disk but for so many pages."""
    status = os.statvfs(disk)
    with (disk / "filler").open("wb") as file:
        file.write(bytes(max(0, status.f_bavail - left) * status.f_frsize))


class FillAfter(small.Silent):
    """A listener that fills the disk after so many trials."""

    def __init__(self, disk, trials, left):
        self.disk, self.trials, self.left = disk, trials, left

    def __call__(self, stage, row):
        self.trials -= stage == "search"
        if self.trials == 0:
            fill(self.disk, self.left)


@pytest.mark.parametrize("left", [0, 1, 3, 6])
@pytest.mark.parametrize("trials", [2, 6])
def test_a_disk_that_fills_up(disk, tmp_path, no_work, trials, left):
    """The run stops with what to do; with space again it completes to what a clean run gives."""
    spec = small.spec({"trials = 8": "trials = 16"})
    message = refused(small.run, spec, disk, FillAfter(disk, trials, left))
    assert "No space left on device. Free some space, or " in message
    assert "finished trials are kept, run again to continue." in message
    (disk / "filler").unlink()
    assert small.results(small.run(spec, disk)) == small.results(small.run(spec, tmp_path / "clean"))


def test_a_larger_disk_is_enough(disk, tmp_path, no_work):
    spec = small.spec()
    refused(small.run, spec, disk, FillAfter(disk, 2, 0))
    assert mounted(disk, "remount", "size=4m")
    assert small.results(small.run(spec, disk)) == small.results(small.run(spec, tmp_path / "clean"))


@pytest.mark.parametrize("trials", [0, 4])
def test_a_disk_that_has_become_read_only(disk, tmp_path, no_work, trials):
    """Before a study or in its midst; writable again, the study completes to what a clean run gives."""
    if trials:
        small.run(small.spec({"trials = 8": f"trials = {trials}"}), disk)
    assert mounted(disk, "remount", "ro")
    message = refused(small.run, small.spec(), disk)
    assert "Read-only file system. Make it writable, or choose another --runs folder" in message
    assert mounted(disk, "remount", "rw")
    found, clean = (small.run(small.spec(), folder) for folder in (disk, tmp_path / "clean"))
    assert small.results(found, "design", "trial") == small.results(clean, "design", "trial")


@pytest.mark.parametrize("left", [0, 1, 2])
def test_a_disk_that_is_full_from_the_start(disk, no_work, left):
    fill(disk, left)
    assert "No space left on device" in refused(small.run, small.spec(), disk)
    (disk / "filler").unlink()
    assert len(small.run(small.spec(), disk).rows()) == 12


def test_a_finished_study_needs_no_space(disk, no_work):
    """Looking at it only reads."""
    spec = small.spec()
    whole = small.run(spec, disk).rows()
    fill(disk, 0)
    assert Store(disk / "small").rows() == whole
