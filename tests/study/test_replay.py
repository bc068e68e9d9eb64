"""A stored row comes out again, bit for bit; what differs is shown with what may explain it."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.cli.conftest import cli  # noqa: F401 (a fixture)
from tests.study import small
from tests.study.test_export import SKIP


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A study that was really evaluated, with a skipped trial among its rows."""
    folder = tmp_path_factory.mktemp("replayed")
    path = small.write(folder, extra=SKIP)
    code, _, err = small.eiwa("study", "run", path, folder=folder)
    assert code == 0, err
    return path


@pytest.fixture
def here(ran, tmp_path, monkeypatch):
    """A copy of it to change."""
    import shutil

    shutil.copytree(ran.parent, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return tmp_path / "copy"


def stored(here):
    (part,) = (here / "runs/small/trials").glob("*.parquet")
    return part


def change(here, **columns):
    """Put other values into the rows."""
    table = pq.read_table(stored(here))
    for name, value in columns.items():
        name = name.replace("__", ".")
        at = table.column_names.index(name)
        table = table.set_column(at, name, pa.array([value] * table.num_rows, table.schema.field(name).type))
    pq.write_table(table, stored(here))


@pytest.mark.parametrize("name", ["0", "trial 3", "optimum", "leader"])
def test_a_row_is_identical(name, here, cli):  # noqa: F811
    if name == "leader":
        leaders = [r for r in pq.read_table(stored(here)).to_pylist() if r["kind"] == "leader"]
        name = f"leader {leaders[0]['number']}"
    said = cli("study", "replay", "small.toml", name)
    assert (said.code, said.out) == (0, "identical\n")


def test_a_skipped_row_is_identical(here, cli):  # noqa: F811
    skipped = [r["number"] for r in pq.read_table(stored(here)).to_pylist() if r["state"] == "SKIPPED"]
    assert cli("study", "replay", "small.toml", skipped[0]).out == "identical\n"


def test_a_difference_is_shown_with_what_may_explain_it(here, cli):  # noqa: F811
    change(here, metrics__F=0.5, cpu="anothercpu", versions=json.dumps({"numpy": "1.0"}))
    said = cli("study", "replay", "small.toml", "optimum")
    assert said.code == 1
    assert "differs: metrics.F: 0.5 stored, 0." in said.out
    assert "made differently: cpu: anothercpu stored" in said.out
    assert "made differently: numpy: 1.0 stored, 2." in said.out
    found = json.loads(cli("study", "replay", "small.toml", "optimum", "--json").out)
    assert (found["identical"], found["source"]) == (False, "file")
    assert found["differing"].keys() == {"metrics.F", "versions"}
    assert found["differing"]["metrics.F"]["stored"] == 0.5
    assert found["provenance"]["numpy"]["stored"] == "1.0"


def test_a_volatile_column_makes_no_difference(here, cli):  # noqa: F811
    change(here, seconds=1e6, host="elsewhere")
    assert cli("study", "replay", "small.toml", "optimum").out == "identical\n"


def test_a_changed_study_file_is_replaced_by_the_stored_one(here, cli):  # noqa: F811
    path = here / "small.toml"
    path.write_text(path.read_text().replace("size = 0.05", "size = 0.04"))
    said = cli("study", "replay", "small.toml", "optimum")
    assert (said.code, said.out.splitlines()[-1]) == (0, "identical")
    assert "replayed with the study that is stored with the row" in " ".join(said.out.split())
    assert json.loads(cli("study", "replay", "small.toml", "optimum", "--json").out)["source"] == "stored"


def test_without_a_stored_study_a_changed_file_is_refused(here, cli):  # noqa: F811
    pq.write_table(pq.read_table(stored(here)).replace_schema_metadata(None), stored(here))
    path = here / "small.toml"
    path.write_text(path.read_text().replace("size = 0.05", "size = 0.04"))
    said = cli("study", "replay", "small.toml", "optimum")
    assert (said.code, said.out) == (2, "")
    assert "does not hold a copy of it" in said.err


@pytest.mark.parametrize("name", ["99", "optimun", "leader 99"])
def test_a_row_that_does_not_exist(name, here, cli):  # noqa: F811
    said = cli("study", "replay", "small.toml", name)
    assert said.code == 2
    assert f"{name}: no row of this study" in said.err
