"""``eiwa plugins new``: what it writes works at once, and overwrites nothing."""

import os
import subprocess
import sys
import tomllib

import pytest

from eiwa.core.registry import KINDS
from eiwa.testing import samples

QUICK = ("--set", "sampling.samples=4096", "--set", "voxels.size=0.05")


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.setattr(samples, "SECONDS", 0.0)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_plugin_passes_the_check_and_runs_in_a_study(kind, cli, here):
    said = cli("plugins", "new", kind, "my_own", "--with-study")
    assert said.code == 0, said.err
    assert sorted(p.name for p in here.iterdir()) == ["my_own.py", "my_own.toml"]
    steps = [line.split()[1:] for line in said.out.splitlines() if line.startswith("  eiwa")]
    assert steps == [["plugins", "check", "my_own.py"], ["study", "run", "my_own.toml"]]
    checked = cli(*steps[0])
    assert checked.code == 0, checked.out
    assert f"{kind} my_own" in checked.out
    human = () if kind == "human" else ("--set", "human.samples=4096")
    ran = cli(*steps[1], *QUICK, *human, "--set", "study.trials=4")
    assert ran.code == 0, ran.err


def test_a_new_arm_has_at_most_forty_lines(cli, here):
    cli("plugins", "new", "arm", "mydevice")
    assert len((here / "mydevice.py").read_text().splitlines()) <= 40


@pytest.mark.parametrize("kind", KINDS)
def test_names_are_put_in(kind, cli, here):
    cli("plugins", "new", kind, "big_red_arm")
    text = (here / "big_red_arm.py").read_text()
    assert "class BigRedArmParameters(Parameters):" in text
    assert 'Plugin("big_red_arm"' in text
    assert "mydevice" not in text.lower()


def test_new_plugins_are_formatted(cli, here):
    """By the same rules as eiwa itself, but for the order of imports, in which eiwa is first-party here only."""
    pytest.importorskip("ruff")
    for kind in KINDS:
        cli("plugins", "new", kind, f"my_{kind}")
    pyproject = os.path.join(os.path.dirname(__file__), "..", "..", "pyproject.toml")
    for command in ("check --ignore I001", "format --check"):
        arguments = [sys.executable, "-m", "ruff", *command.split(), "--no-cache", "--config", pyproject, "."]
        done = subprocess.run(arguments, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("metric", "mine"), "metric: no such kind of plugin; did you mean 'metrics'"),
        (("arm", "dh"), "dh: the arm plugin of this name is eiwa.plugins.arms.dh's"),
        (("arm", "My-Arm"), "lower-case letters, digits and _"),
        (("arm", "class"), "class: is a word of Python's"),
        (("arm", "2arm"), "begins with a letter"),
        (("arm", "../arm"), "lower-case letters, digits and _"),
    ],
)
@pytest.mark.parametrize("option", [(), ("--package",)], ids=["file", "package"])
def test_what_is_refused(arguments, words, option, cli, here):
    said = cli("plugins", "new", *arguments, *option)
    assert (said.code, said.out) == (2, "")
    assert words in said.err
    assert list(here.iterdir()) == []


def test_the_same_name_of_another_kind_is_free(cli, here):
    assert cli("plugins", "new", "human", "dh").code == 0


@pytest.mark.parametrize(
    ("first", "second"),
    [((), ()), ((), ("--with-study",)), (("--package",), ("--package",)), (("--with-study",), ())],
    ids=" ".join,
)
def test_nothing_is_overwritten(first, second, cli, here):
    cli("plugins", "new", "arm", "mine", *first)
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    said = cli("plugins", "new", "arm", "mine", *second)
    assert said.code == 2
    assert "is not overwritten" in said.err
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


def test_a_package_is_found_when_it_is_installed_and_passes_its_own_tests(cli, here):
    said = cli("plugins", "new", "arm", "big_red", "--package", "--with-study")
    assert said.code == 0, said.err
    project = tomllib.loads((here / "big_red/pyproject.toml").read_text())["project"]
    assert project["name"] == "big-red"
    install(project, here / "big_red/src")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(["src", *sys.path])}

    def run(*command):
        arguments = [sys.executable, "-m", *command]
        return subprocess.run(arguments, cwd=here / "big_red", env=environment, capture_output=True, text=True)

    tested = run("pytest", "-q", "-p", "no:cacheprovider")
    assert tested.returncode == 0, tested.stdout
    assert "passed" in tested.stdout
    studied = run("eiwa", "study", "check", "big_red.toml", *QUICK, "--set", "human.samples=4096")
    assert studied.returncode == 0, studied.stderr


def install(project, source):
    """What an installer leaves beside the source, as far as importlib.metadata reads it."""
    folder = source / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    groups = project["entry-points"]
    lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in points.items()) for group, points in groups.items()]
    (folder / "entry_points.txt").write_text("\n".join(lines))
