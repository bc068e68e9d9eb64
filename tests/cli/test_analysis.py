"""``eiwa study sensitivity`` and ``eiwa study tolerance`` on a study that was run."""

import json
from pathlib import Path

import pytest
from rich.cells import cell_len

from tests.study import small

STUDY = Path(__file__).parents[2] / "studies" / "tolerance.toml"
TABLES = """
[tolerance]
"arm.joints.upper.a" = { normal = 0.001 }
"arm.joints.upper.limits.1" = { uniform = 2.0 }
"layout.offset.1" = { uniform = 0.01 }

[catalogue]
"arm.joints.upper.a" = [0.20, 0.25, 0.30]
"arm.joints.fore.a" = [0.08, 0.10, 0.20]
"""
LENGTH = '[[objectives]]\nmetric = "total_link_length"\ndirection = "minimize"\n\n'
MORE = {"trials = 8": "trials = 24", small.OBJECTIVE: small.OBJECTIVE + LENGTH}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The small study with both tables, and its run."""
    folder = tmp_path_factory.mktemp("analysis")
    small.run(small.spec(MORE, TABLES), folder / "runs")
    (folder / "small.toml").write_text(small.text(MORE, TABLES))
    (folder / "bare.toml").write_text(small.text(MORE))
    return folder


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def fits(out):
    tables = [line for line in out.splitlines() if not line.startswith(("~", "First", "Best", "±"))]
    assert "…" not in out
    assert all(cell_len(line.rstrip()) <= 80 for line in tables)


def test_sensitivity(here, cli):
    said = cli("study", "sensitivity", "small.toml", "--sobol", "4")
    assert said.code == 0, said.err
    fits(said.out)
    for words in ("F: one variable at a time, around trial ", "total_link_length: shares", "reach", "split", "spacing"):
        assert words in said.out
    assert "22 designs with 2 replicates, 20 with one for the Sobol indices: about " in said.err


def test_sensitivity_as_json(here, cli):
    """The length of the links is the reach variable itself: its slope, its indices and importance are known."""
    said = cli("study", "sensitivity", "small.toml", "--sobol", "16", "--design", "optimum", "--json")
    assert said.code == 0, said.err
    found = json.loads(said.out)
    assert found["variables"] == pytest.approx({"reach": 0.44, "split": 0.26 / 0.44, "layout.spacing": 0.2}, abs=1e-6)
    length = found["objectives"][1]
    effects = {e["variable"]: e for e in length["effects"]}
    assert effects["reach"]["slope"]["mean"] == pytest.approx(1)
    assert effects["reach"]["levels"] == pytest.approx([0.2, 0.26, 0.32, 0.38, 0.44])
    assert [c["mean"] for c in effects["reach"]["changes"]] == pytest.approx([-0.24, -0.18, -0.12, -0.06, 0], abs=1e-6)
    assert effects["split"]["slope"]["mean"] == pytest.approx(0, abs=1e-9)
    assert effects["reach"]["feasible"] == [True, True, True, True, False]
    assert length["sobol"]["total"]["split"]["value"] == pytest.approx(0, abs=1e-9)
    assert length["importance"]["reach"] == max(length["importance"].values())


def test_sensitivity_without_sobol_indices_and_with_a_picture(here, cli, tmp_path):
    pytest.importorskip("matplotlib")
    said = cli("study", "sensitivity", "small.toml", "--sobol", "0", "--share", "0.1", "--figure", tmp_path / "t.png")
    assert said.code == 0, said.err
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
    assert "Sobol" not in said.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--sobol", "48"], "--sobol 48: must be a power of two, such as 32 or 64"),
        (["--design", "optimun"], "did you mean 'optimum'"),
        (["--design", "trial 99"], "trial 99: neither a named design nor a trial"),
        (["--set", "search={}", "--set", "variables={}", "--set", "study.trials=0"], "search: nothing varies"),
    ],
)
def test_sensitivities_that_cannot_be(arguments, said, here, cli):
    found = cli("study", "sensitivity", "small.toml", *arguments)
    assert (found.code, found.out) == (2, "")
    assert said in found.err


def test_tolerance(here, cli):
    said = cli("study", "tolerance", "small.toml", "--draws", "16", "--design", "optimum")
    assert said.code == 0, said.err
    fits(said.out)
    for words in ("made 16 times", "which error matters", "of 16 devices break a constraint", "choice 1", "limits 1"):
        assert words in said.out
    assert "16 draws and 4 designs of the catalogue with 2 replicates: about " in said.err


def test_tolerance_as_json(here, cli):
    """A link's length is wrong by its own error, and the offset does not change it."""
    said = cli("study", "tolerance", "small.toml", "--draws", "64", "--design", "optimum", "--json")
    assert said.code == 0, said.err
    found = json.loads(said.out)
    length = found["made"]["spreads"]["total_link_length"]
    assert length["nominal"] == pytest.approx(0.44)
    assert length["deviation"]["value"] == pytest.approx(0.001, abs=3 * length["deviation"]["error"])
    assert {e["path"]: round(e["per_deviation"]["value"], 9) for e in length["effects"]} == {
        "arm.joints.upper.a": 0.001,
        "arm.joints.upper.limits.1": 0,
        "layout.offset.1": 0,
    }
    assert found["made"]["any_broken"] == 64
    assert [c["feasible"] for c in found["catalogue"]] == sorted(
        (c["feasible"] for c in found["catalogue"]), reverse=True
    )
    assert {tuple(c["values"].values()) for c in found["catalogue"]} == {
        (a, b) for a in (0.25, 0.3) for b in (0.1, 0.2)
    }


def test_the_same_draws_twice(here, cli):
    once, again = (cli("study", "tolerance", "small.toml", "--draws", "8", "--json").out for _ in range(2))
    assert once == again


def test_tolerance_without_its_tables(here, cli):
    said = cli("study", "tolerance", "bare.toml")
    assert (said.code, said.out) == (2, "")
    assert '"arm.joints.upper.a" = { normal = 0.0005 }' in said.err
    assert "[catalogue]" in said.err


def test_the_repositorys_study(tmp_path, monkeypatch, cli):
    """With few samples, so that only its tables mean anything."""
    monkeypatch.chdir(tmp_path)
    quick = [f"--set={setting}" for setting in ("sampling.samples=4096", "human.samples=4096", "voxels.size=0.05")]
    said = cli("study", "tolerance", STUDY, *quick, "--draws", "16")
    assert said.code == 0, said.err
    fits(said.out)
    assert "the design as written, made 16 times" in said.out


def test_the_tables_may_be_added_after_the_run(here, cli):
    """The results are of the study without them."""
    assert cli("study", "run", "bare.toml").err.startswith("Study small is complete")
