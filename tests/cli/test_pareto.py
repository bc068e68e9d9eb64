"""``eiwa study pareto``: the table, its other forms, the picture, and what is refused."""

import csv
import io
import json
import sys

import pytest
from rich.cells import cell_len

from tests.study import small
from tests.study.test_pareto import BOTH

pytest.importorskip("moocore")

NAMED = {'name = "small"': 'name = "two"', "trials = 8": "trials = 16", **BOTH}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A study of two objectives and one of one, both run."""
    folder = tmp_path_factory.mktemp("pareto")
    for changes, extra in ((NAMED, ""), ({}, "[metrics.total_link_length]\n")):
        small.run(small.spec(changes, extra), folder / "runs")
    (folder / "two.toml").write_text(small.text(NAMED))
    (folder / "small.toml").write_text(small.text(extra="[metrics.total_link_length]\n"))
    return folder


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def test_every_line_fits(here, cli):
    said = cli("study", "pareto", "two.toml")
    assert all(cell_len(line.rstrip()) <= 80 for line in said.out.splitlines())
    assert "…" not in said.out


def test_the_table(here, cli):
    said = cli("study", "pareto", "two.toml")
    assert said.code == 0, said.err
    for words in (
        "Front of two",
        "total_link_length",
        "min [m]",
        "adds",
        "Hypervolume",
        "Reference point F = ",
        "quarter",
    ):
        assert words in said.out
    assert all(cell_len(line.rstrip()) <= 80 for line in said.out.split("Hypervolume")[0].splitlines())
    assert "…" not in said.out


def test_json_says_what_the_table_says(here, cli):
    found = json.loads(cli("study", "pareto", "two.toml", "--json").out)
    assert [o["column"] for o in found["objectives"]] == ["objectives.0", "objectives.1"]
    F = [member["F"] for member in found["front"]]
    lengths = [member["total_link_length"] for member in found["front"]]
    assert sorted(F, reverse=True) == F
    assert sorted(lengths, reverse=True) == lengths
    assert 0 < found["share"] < 1
    assert found["histories"]["runs/two"][-1] == pytest.approx(found["hypervolume"])
    leaders = [member for member in found["front"] if member["F_se"] is not None]
    assert any(member["F_se"] > 0 for member in leaders)
    assert all(member["total_link_length_se"] == 0 for member in leaders)


def test_csv_and_parquet_hold_the_front(here, cli, tmp_path):
    import pyarrow.parquet as pq

    said = cli("study", "pareto", "two.toml", "--csv", tmp_path / "front.csv", "--parquet", tmp_path / "front.parquet")
    assert said.code == 0, said.err
    rows = list(csv.DictReader(io.StringIO((tmp_path / "front.csv").read_text())))
    table = pq.read_table(tmp_path / "front.parquet").to_pylist()
    assert [float(row["F"]) for row in rows] == pytest.approx([row["F"] for row in table])
    assert {"run", "trial", "values.layout.spacing", "parameters.reach", "contribution", "knee"} <= rows[0].keys()


def test_csv_on_stdout_stands_alone(here, capfdbinary, monkeypatch):
    from eiwa.cli import main

    monkeypatch.setattr(sys, "argv", ["eiwa", "study", "pareto", "two.toml", "--csv", "-"])
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code
    out = capfdbinary.readouterr().out.decode()
    assert {row["run"] for row in csv.DictReader(io.StringIO(out))} == {"runs/two"}


def test_a_study_of_one_objective_with_numbers_of_its_rows(here, cli):
    said = cli("study", "pareto", "small.toml", "--objectives", "F,total_link_length", "--json")
    assert [(o["name"], o["maximised"]) for o in json.loads(said.out)["objectives"]] == [
        ("F", True),
        ("total_link_length", False),
    ]


def test_a_study_of_one_objective_alone(here, cli):
    said = cli("study", "pareto", "small.toml")
    assert said.code == 2
    assert "--objectives F,-total_link_length" in said.err


def test_with_another_run(here, cli):
    said = cli("study", "pareto", "small.toml", "--objectives", "F,total_link_length", "--with", "runs/two", "--json")
    found = json.loads(said.out)
    assert set(found["histories"]) == {"runs/small", "runs/two"}
    assert found["hypervolume"] >= max(volumes[-1] for volumes in found["histories"].values()) - 1e-12


def test_with_a_run_of_other_objectives(here, cli):
    said = cli("study", "pareto", "two.toml", "--with", "runs/small")
    assert said.code == 2
    assert "runs/small: its objectives are not those of two" in said.err
    assert "objectives.1" in said.err


def test_with_a_folder_that_holds_no_study(here, cli):
    said = cli("study", "pareto", "two.toml", "--with", "runs/nothing")
    assert (said.code, said.out) == (2, "")
    assert "runs/nothing: holds no study" in said.err


def test_before_any_run(here, cli):
    said = cli("study", "pareto", "two.toml", "--runs", "elsewhere")
    assert said.code == 2
    assert "has no results yet. Run: eiwa study run two.toml" in said.err


def test_a_file_that_cannot_be_written(here, cli):
    said = cli("study", "pareto", "two.toml", "--csv", "nowhere/front.csv")
    assert said.code == 2
    assert "nowhere/front.csv: cannot be written" in said.err


def test_a_picture(here, cli, tmp_path):
    pytest.importorskip("matplotlib")
    said = cli("study", "pareto", "two.toml", "--figure", tmp_path / "front.png", "--json")
    assert said.code == 0, said.err
    assert (tmp_path / "front.png").read_bytes().startswith(b"\x89PNG")
    json.loads(said.out)


def test_a_picture_of_three_objectives_and_two_runs(here, cli, tmp_path):
    pytest.importorskip("matplotlib")
    wanted = ("--objectives", "F,total_link_length,-singletons", "--with", "runs/two")
    said = cli("study", "pareto", "small.toml", *wanted, "--figure", tmp_path / "front.svg")
    assert said.code == 0, said.err
    assert (tmp_path / "front.svg").stat().st_size > 20_000
