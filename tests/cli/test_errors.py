"""What users get wrong, in real processes: exit code 2, one message on stderr, nothing on stdout, no traceback."""

import errno
import subprocess
import sys

import pytest

from eiwa.cli import main
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
    assert (
        said.err
        == "optimun: neither a named design nor a trial of this study; did you mean 'optimum'? Known: optimum.\n"
    )


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


@pytest.mark.parametrize("threads", ["0", "two", "-1", "²"])
def test_a_number_of_threads_that_is_none(threads, tmp_path):
    path = small.write(tmp_path)
    code, out, err = small.eiwa("study", "check", str(path), folder=tmp_path, EIWA_THREADS=threads)
    assert (code, out) == (2, "")
    assert err == f"EIWA_THREADS = '{threads}': must be a whole number above 0. Unset it to use all processors.\n"


def test_a_place_that_cannot_be_written(monkeypatch, capsys):
    def refused():
        raise PermissionError(errno.EACCES, "Permission denied", "mine.py")

    monkeypatch.setattr("eiwa.cli.app", refused)
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert capsys.readouterr().err == "mine.py: Permission denied. Choose another place, or free this one.\n"


def test_a_terminal_without_unicode(tmp_path):
    path = small.write(tmp_path)
    said = {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    code, out, err = small.eiwa("evaluate", str(path), "--design", "optimum", folder=tmp_path, **said)
    assert code == 0, err
    assert " +- " in out
    assert "?" not in out


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({}, "mine.py provides the arm plugin 'broken' twice: remove one of them"),
        ({"def eiwa_arms": "def eiwa_arm"}, "eiwa_arm: there is no such hook; did you mean 'eiwa_arms'?"),
        ({"return [Plugin(": "return [("}, "eiwa_arms must return a list of Plugin records, not a tuple"),
        ({"class Broken(": "from nowhere import nothing\nclass Broken("}, "No module named 'nowhere' (line 9)"),
    ],
)
def test_a_plugin_file_that_is_none(changed, words, cli, path, tmp_path):
    text = small.BROKEN_ARM if changed else small.BROKEN_ARM.replace("Broken())]", "Broken())] * 2")
    for old, new in changed.items():
        text = text.replace(old, new)
    (tmp_path / "mine.py").write_text(text)
    said = cli("plugins", "check", "mine.py")
    assert (said.code, said.out) == (2, "")
    assert words in said.err


def test_a_plugin_file_that_is_named_twice(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    study = small.write(tmp_path, {small.TOP: f'plugins = ["mine.py", "mine.py"]\n{small.TOP}'}, mine=small.BROKEN_ARM)
    said = cli("study", "check", study.name)
    assert (said.code, said.err) == (2, "plugins.1 = 'mine.py': is named twice. Remove one of them.\n")


def test_a_folder_is_no_plugin(cli, path):
    said = cli("plugins", "check", ".")
    assert (said.code, said.err) == (2, ".: is a folder, not a plugin. Name one Python file, or an installed plugin.\n")


def test_masters_out_of_reach_are_told_where_they_are(cli, path):
    """The bases stand 1.6 m in front of the operator, as if somebody had added both lengths of a sketch."""
    away = ("--set", "layout.offset.1=1.6")
    for said in (cli("study", "check", path, *away), cli("evaluate", path, *away)):
        assert said.code == 0, said.err
        assert "F = 0: nothing dexterous lies where hands are comfortable." in said.out
        assert "right arm  x " in said.out
    assert "F = 0" in cli("study", "run", path, *away).err
