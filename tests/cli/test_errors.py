"""What users get wrong, in real processes: exit code 2, one message on stderr, nothing on stdout, no traceback."""

import subprocess
import sys

import pytest

from tests.study import small

SINGULAR = {'"modified"': '"standard"'}

CASES = {
    "a wrong value": (("study", "check", "small.toml", "--set", "layout.spacing=-1"), {}, "layout.spacing = -1"),
    "a missing file": (("study", "run", "nowhere.toml"), {}, "nowhere.toml: cannot be read"),
    "a missing plugin": (("evaluate", "small.toml"), {small.TOP: f'plugins = ["x.py"]\n{small.TOP}'}, "plugins.0 = "),
    "a singular reading": (("evaluate", "small.toml"), SINGULAR, "convention = 'modified'"),
    "a file in place of runs": (("study", "run", "small.toml", "--runs", "small.toml"), {}, "cannot be written"),
    "an arm that raises": (("evaluate", "broken.toml"), {}, "the elbow is stuck"),
}


@pytest.mark.parametrize(("arguments", "changes", "words"), CASES.values(), ids=list(CASES))
def test_in_a_process(arguments, changes, words, tmp_path):
    small.broken_arm(tmp_path).rename(tmp_path / "broken.toml")
    small.write(tmp_path, changes)
    code, out, err = small.eiwa(*arguments, folder=tmp_path)
    assert words in err
    assert "Traceback" not in err
    assert code == 2
    assert out == ""


# The same in this process, where it is quick


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return small.write(tmp_path).name


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("layout.spacing", "--set layout.spacing: write PATH=VALUE"),
        ("=3", "--set =3: write PATH=VALUE"),
        ("layout.spacing=", "layout.spacing"),
        ("layout.spacing=wide", "layout.spacing = 'wide': must be a valid number"),
        ("layout.spaceing=0.2", "did you mean 'spacing'"),
        ("leyout.spacing=0.2", "did you mean 'layout'"),
        ("arm.joints.uper.a=0.2", "did you mean 'upper'"),
        ("layout.offset.3=0.2", "has no '3'"),
        ("dexterity.K=nan", "must be a finite number"),
        ("layout=3", "must be a table"),
    ],
)
@pytest.mark.parametrize("command", [("study", "run"), ("study", "check"), ("evaluate",)], ids=" ".join)
def test_settings(command, setting, words, cli, path):
    said = cli(*command, path, "--set", setting)
    assert said.code == 2
    assert said.out == ""
    assert words in said.err


def test_a_design_that_is_not_there(cli, path):
    said = cli("evaluate", path, "--design", "optimun")
    assert said.code == 2
    assert said.err == "--design optimun: the study has no such design; did you mean 'optimum'? Known: optimum.\n"


def test_all_findings_are_shown_each_on_its_line(cli, path, tmp_path):
    small.write(tmp_path, {"K = 12270": "K = -1", "spacing = 0.20": "spacing = -1"})
    said = cli("study", "run", path)
    assert said.code == 2
    assert [line.split(" = ")[0] for line in said.err.splitlines()] == ["layout.spacing", "dexterity.K"]


def test_brackets_in_messages_are_shown(cli, path, tmp_path):
    small.write(tmp_path, {"0.802, 0.10]": "0.802]"})
    assert "[0.0, 0.802]" in cli("study", "run", path).err


@pytest.mark.parametrize(
    "content",
    ["[study\n", "study = 3", "objectives = [3]", "[[study]]\nname = 'x'", "", "x", "\ufeff[study]\nname = 'x'"],
)
def test_files_that_are_no_study(content, cli, tmp_path):
    (tmp_path / "odd.toml").write_text(content)
    said = cli("study", "check", tmp_path / "odd.toml")
    assert said.code == 2
    assert said.err


@pytest.mark.parametrize("content", ['[assumptions]\n"layout.spacing" = 3\n', '[assumptions]\nlayout.spacing = "D"\n'])
def test_assumptions_that_are_no_text(content, cli, path, tmp_path):
    small.write(tmp_path, extra=content)
    said = cli("study", "run", path)
    assert said.code == 2
    assert "assumptions" in said.err


def test_a_closed_pipe_is_no_error(tmp_path):
    """As in ``eiwa plugins list | head -0``."""
    with subprocess.Popen(
        [sys.executable, "-m", "eiwa", "plugins", "list"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        process.stdout.close()
        err = process.stderr.read()
    assert "Traceback" not in err
    assert "Exception" not in err
