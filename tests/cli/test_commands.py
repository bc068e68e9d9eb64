"""Every command: help, exit codes, JSON on stdout and nothing beside it, what is said the second time."""

import io
import json
import re
import shlex
from importlib.util import find_spec

import pytest
from rich.console import Console

import eiwa
from eiwa.cli.progress import StudyProgress
from eiwa.core.version import __version__
from eiwa.study.store import Store
from tests.study import small

COMMANDS = {
    (): ["study", "evaluate", "converge", "verify", "bench", "plugins", "schema", "--version"],
    ("study",): ["run", "check", "show", "compare", "pareto", "sensitivity", "tolerance"],
    ("study", "run"): ["STUDY.toml", "--fresh", "--runs", "--set", "--json"],
    ("study", "check"): ["STUDY.toml", "--set", "--json"],
    ("study", "show"): ["STUDY.toml", "--runs", "--set", "--json"],
    ("study", "compare"): ["STUDY.toml", "--replicates", "--runs", "--set", "--json"],
    ("study", "pareto"): ["STUDY.toml", "--objectives", "--with", "--csv", "--parquet", "--figure", "+NAME", "--json"],
    ("study", "sensitivity"): ["STUDY.toml", "--design", "--share", "--sobol", "--replicates", "--figure", "--json"],
    ("study", "tolerance"): ["catalogue", "STUDY.toml", "--design", "--draws", "--runs", "--set", "--json"],
    ("converge",): ["STUDY.toml", "--design", "--set", "--json"],
    ("verify",): ["--json"],
    ("bench",): ["compare|share|scaling", "--seconds", "--quick", "--out", "--json"],
    ("evaluate",): ["STUDY.toml", "--design", "--set", "--replicates", "--figure", "--json"],
    ("plugins",): ["list", "show", "check", "new"],
    ("plugins", "list"): ["--study", "--json"],
    ("plugins", "show"): ["NAME", "--kind", "--study", "--json"],
    ("plugins", "check"): ["FILE|NAME", "--kind", "--name", "--study", "--set", "--json"],
    ("plugins", "new"): ["KIND", "NAME", "--package", "--with-study"],
    ("schema",): ["--study", "--part"],
}


@pytest.fixture
def path(tmp_path, monkeypatch):
    """The small study, in the folder that commands run in."""
    monkeypatch.chdir(tmp_path)
    return small.write(tmp_path).name


@pytest.fixture
def ran(path, cli):
    """The small study after a run; what that said."""
    said = cli("study", "run", path)
    assert said.code == 0, said.err
    return said


def answer(said):
    """The one JSON object on stdout."""
    assert said.code == 0, said.err
    value, end = json.JSONDecoder().raw_decode(said.out)
    assert isinstance(value, dict)
    assert said.out[end:] == "\n"
    return value


# Help


@pytest.mark.parametrize("option", ["--help", "-h"])
@pytest.mark.parametrize(("command", "words"), COMMANDS.items(), ids=lambda part: " ".join(part) or "eiwa")
def test_help(command, words, option, cli):
    said = cli(*command, option)
    assert said.code == 0
    assert said.err == ""
    assert all(word in said.out for word in words)


@pytest.mark.parametrize("command", [(), ("study",), ("plugins",)], ids=lambda part: " ".join(part) or "eiwa")
def test_a_group_alone_shows_its_help(command, cli):
    said = cli(*command)
    assert "Usage:" in said.out + said.err
    assert said.code in (0, 2)


def test_version(cli):
    said = cli("--version")
    assert (said.code, said.out, said.err) == (0, f"eiwa {__version__}\n", "")


@pytest.mark.parametrize(
    "arguments",
    [
        ("studies",),
        ("study", "runn"),
        ("study", "run"),
        ("evaluate",),
        ("evaluate", "x.toml", "--replicates", "0"),
        ("evaluate", "x.toml", "--replicates", "many"),
        ("study", "run", "x.toml", "--frehs"),
        ("plugins", "list", "more"),
    ],
    ids=" ".join,
)
def test_a_command_that_is_not_one(arguments, cli):
    said = cli(*arguments)
    assert said.code == 2
    assert said.out == ""
    assert said.err


# study run, show


def test_a_run_shows_the_best_and_where_to_look(ran):
    for words in (
        "Study small",
        "optimum",
        "trial ",
        "published",
        "0.2732",
        "runs/small/trials/*.parquet",
        "eiwa study dashboard small.toml",
        "eiwa evaluate small.toml",
    ):
        assert words in ran.out


def test_the_best_trial_is_one_command_away(ran, cli):
    command = next(line for line in ran.out.splitlines() if "the best design" in line)
    words = shlex.split(command.removeprefix("  the best design   eiwa "))
    shown = next(line.split() for line in ran.out.splitlines() if line.strip().startswith("trial "))
    assert words[words.index("--design") + 1] == " ".join(shown[:2])
    said = cli(*words[: words.index("--figure")], "--replicates", "1", "--json")
    assert said.code == 0, said.err
    assert f"{answer(said)['objectives']['F']:.4f}" in shown


def test_a_trial_of_another_version_of_the_study_is_told(ran, cli):
    """Its variables may mean something else by now."""
    command = next(line for line in ran.out.splitlines() if "the best design" in line)
    words = shlex.split(command.removeprefix("  the best design   eiwa "))
    changed = cli(*words[: words.index("--figure")], "--replicates", "1", "--set", "dexterity.K=50")
    assert "These results are of another version of the study file" in changed.err
    assert "dexterity.K" in changed.err


def test_a_search_that_goes_on_shows_the_best_so_far():
    """A trial that is worse than one of an earlier run is not the best."""
    spec = small.spec()
    console = Console(file=io.StringIO(), width=80)
    row = {"state": "COMPLETE", "feasible": True}
    with StudyProgress(spec, console) as progress:
        progress.begin("search", 2, 1, [row | {"objectives.0": 0.25}])
        progress("search", row | {"objectives.0": 0.125})
    assert "best F 0.2500" in console.file.getvalue()


def test_progress_goes_to_stderr(ran):
    for stage in ("designs", "search", "leaders"):
        assert stage in ran.err
    assert "8/8" in ran.err
    assert "8/8" not in ran.out


def test_the_second_run_says_that_the_study_is_complete(ran, cli, path):
    said = cli("study", "run", path)
    assert said.code == 0
    assert "Study small is complete (runs/small); nothing was left to do." in said.err
    assert said.out == ran.out


def test_show_shows_what_the_run_showed(ran, cli, path):
    said = cli("study", "show", path)
    assert (said.code, said.out, said.err) == (0, ran.out, "")


def test_show_before_any_run(cli, path):
    said = cli("study", "show", path)
    assert said.code == 2
    assert said.out == ""
    assert "has no results yet. Run: eiwa study run small.toml" in said.err


def test_show_quotes_a_path_with_a_space(cli, path, tmp_path):
    (tmp_path / path).rename(tmp_path / "my study.toml")
    said = cli("study", "show", "my study.toml")
    assert f"eiwa study run {shlex.quote('my study.toml')}" in said.err


def test_fresh_keeps_the_old_results_aside(ran, cli, path, tmp_path):
    before = Store(tmp_path / "runs/small").rows()
    said = cli("study", "run", path, "--fresh")
    assert said.code == 0
    assert "Old results are kept in runs/small.old-1." in said.err
    assert Store(tmp_path / "runs/small.old-1").rows() == before
    assert small.results(Store(tmp_path / "runs/small")) == small.stable(before)


def test_fresh_where_nothing_is(cli, path):
    said = cli("study", "run", path, "--fresh")
    assert said.code == 0
    assert "kept in" not in said.err


def test_a_changed_study_is_refused_until_it_is_fresh(ran, cli, path, tmp_path):
    small.write(tmp_path, {"a = 0.26": "a = 0.27"})
    said = cli("study", "run", path)
    assert said.code == 2
    assert said.out == ""
    assert "arm.joints.upper.a: 0.26 -> 0.27" in said.err
    assert "--fresh" in said.err
    assert cli("study", "run", path, "--fresh").code == 0


def test_a_changed_study_does_not_show_the_old_results_as_its_own(ran, cli, path, tmp_path):
    """The numbers belong to another arm."""
    small.write(tmp_path, {"a = 0.18": "a = 0.10"})
    assert "arm.joints.fore.a: 0.18 -> 0.1" in cli("study", "show", path).err


def test_runs_chooses_the_folder(cli, path, tmp_path):
    assert "elsewhere/small/trials" in cli("study", "run", path, "--runs", "elsewhere").out
    assert (tmp_path / "elsewhere/small/study.json").exists()
    assert not (tmp_path / "runs").exists()
    assert cli("study", "show", path, "--runs", "elsewhere").code == 0


def test_set_changes_the_study(cli, path):
    said = cli("study", "run", path, "--set", "study.trials=4", "--set", "study.name=other")
    assert said.code == 0
    assert "runs/other" in said.out
    assert "4/4" in said.err


def test_run_as_json(cli, path):
    said = cli("study", "run", path, "--json")
    found = answer(said)
    assert (found["study"], found["trials"], found["target"], found["failed"]) == ("small", 8, 8, 0)
    assert [r["name"] for r in found["designs"]] == ["optimum"]
    assert [r["number"] for r in found["best"]] == [r["number"] for r in found["leaders"]]
    assert all(r["feasible"] for r in found["best"])
    assert found["hash"] == small.spec().hash
    assert "search" in said.err


def test_show_as_json_is_what_run_said(cli, path):
    assert answer(cli("study", "run", path, "--json")) == answer(cli("study", "show", path, "--json"))


def test_a_complete_run_as_json(ran, cli, path):
    said = cli("study", "run", path, "--json")
    assert answer(said)["trials"] == 8
    assert "is complete" in said.err


def test_an_incomplete_study_says_so(ran, cli, path):
    said = cli("study", "show", path, "--set", "study.trials=20")
    assert "8 trials of 20 so far." in said.out


def test_a_study_where_nothing_is_feasible_says_so(cli, path):
    said = cli("study", "run", path, "--set", "constraints.0.max=0.1")
    assert said.code == 0
    assert "No trial meets the constraints (reach <= 0.1): widen them, or the search." in said.out


def test_a_study_without_a_search(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = cli(
        "study", "run", small.write(tmp_path, small.NO_SEARCH).name, "--runs", "else where", "--set", "study.seed=2"
    )
    assert said.code == 0
    assert "optimum" in said.out
    assert "eiwa study dashboard small.toml --runs 'else where' --set study.seed=2\n" in said.out


def test_a_study_of_nothing(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = small.write(tmp_path, small.NO_SEARCH | {small.DESIGN: ""}).name
    assert cli("study", "run", path).code == 0
    assert answer(cli("study", "show", path, "--json"))["designs"] == []


def test_failing_designs_end_with_code_2(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = small.broken_arm(tmp_path).name
    said = cli("study", "run", path)
    assert said.code == 2
    assert said.out == ""
    assert "trials failed, so the study stops" in said.err
    assert "RuntimeError: the elbow is stuck" in said.err
    shown = cli("study", "show", path)
    assert shown.code == 0
    assert "8 of 8 trials failed; the last said: Broken (broken_arm.py) raised RuntimeError: the elbow" in " ".join(
        shown.out.split()
    )


def test_a_damaged_part_is_told_by_show(ran, cli, path, tmp_path):
    part = next((tmp_path / "runs/small/trials").glob("part-*"))  # how many there are depends on the time they took
    part.write_bytes(b"nonsense")
    said = cli("study", "show", path)
    assert said.code == 2
    assert f"{part.name}: is damaged" in said.err


# study compare


def test_compare(ran, cli, path):
    said = cli("study", "compare", path, "optimum", "trial 1")
    assert said.code == 0
    assert said.out.startswith("optimum: F = ")
    assert "F(optimum) - F(trial 1) = +" in said.out


def test_compare_as_json(ran, cli, path):
    found = answer(cli("study", "compare", path, "optimum", "1", "--replicates", "4", "--json"))
    assert found["replicates"] == 4
    assert found["mean"] > 0
    assert found["designs"].keys() == {"optimum", "1"}


def test_a_design_is_no_better_than_itself(ran, cli, path):
    found = answer(cli("study", "compare", path, "optimum", "optimum", "--json"))
    assert (found["mean"], found["real"]) == (0.0, False)


def test_compare_with_what_is_not_there(ran, cli, path):
    said = cli("study", "compare", path, "optimum", "trial 99")
    assert said.code == 2
    assert "trial 99: neither a named design nor a trial of this study" in said.err


# study check


def test_check(cli, path, tmp_path):
    said = cli("study", "check", path)
    assert said.code == 0
    assert "small.toml is valid." in said.out
    for words in ("cells of E's grid", "memory", "scenarios", "reach, split, layout.spacing", "time per trial"):
        assert words in said.out
    assert [p.name for p in tmp_path.iterdir()] == ["small.toml"]


def test_check_says_when_the_samples_are_few(cli, path):
    said = cli("study", "check", path, "--set", "voxels.size=0.02")
    assert "4,096 samples are few for voxels of 20 mm" in said.out
    assert 'estimator = "elites" comes within 5%' in " ".join(said.out.split())


def test_run_says_so_before_it_starts(cli, path):
    said = cli("study", "run", path, "--set", "voxels.size=0.02", "--set", "study.trials=0")
    assert "samples are few" in said.err.split("designs")[0]


def test_check_as_json(cli, path):
    found = answer(cli("study", "check", path, "--json"))
    assert found["study"] == "small"
    assert found["hash"] == small.spec().hash
    assert found["trials"] == 8
    assert found["cells"] > 0
    assert found["memory"] > found["cells"]
    assert found["seconds"] == pytest.approx(8 * found["seconds_per_trial"])


AUTO = ("--set", "study.sampler=auto")
CHOSEN = "Sampler: auto is tpe, for 8 trials are fewer than 1000."


def test_check_says_which_sampler_auto_is(cli, path):
    assert CHOSEN in cli("study", "check", path, *AUTO).out
    assert answer(cli("study", "check", path, *AUTO, "--json"))["sampler"] == "tpe"
    assert "Sampler" not in cli("study", "check", path).out


def test_run_says_which_sampler_auto_is_on_stderr(cli, path):
    said = cli("study", "run", path, *AUTO)
    assert said.code == 0
    assert said.err.count(CHOSEN) == 1
    assert "Sampler" not in said.out


def test_auto_that_becomes_another_sampler_is_another_study(cli, path):
    assert cli("study", "run", path, *AUTO).code == 0
    said = cli("study", "run", path, *AUTO, "--set", "study.trials=1000")
    assert said.code == 2
    assert "study.sampler.kind: tpe -> nsga2" in said.err


def test_check_of_a_study_that_leaves_the_sampling_to_its_defaults(cli, path, tmp_path):
    small.write(tmp_path, {"[sampling]\nsamples = 4096\nreplicates = 2\n": ""})
    said = cli("study", "check", path)
    assert said.code == 0, said.err
    assert "1,048,576" in said.out


def test_check_of_a_study_that_is_wrong(cli, path):
    said = cli("study", "check", path, "--set", "layout.spacing=-1", "--set", "dexterity.K=nan")
    assert said.code == 2
    assert said.out == ""
    assert "layout.spacing = -1" in said.err
    assert "dexterity.K = nan" in said.err


# evaluate


def test_evaluate(cli, path):
    said = cli("evaluate", path)
    assert said.code == 0
    for words in (
        "Design as written in small.toml",
        "F ",
        "±",
        "reach [m]",
        "0.4400",
        "constraint reach <= 0.4: not met (by 0.04)",
    ):
        assert words in said.out


def test_evaluate_a_named_design(cli, path):
    found = answer(cli("evaluate", path, "--design", "optimum", "--json"))
    assert found["design"] == "optimum"
    assert found["overrides"] == {"arm.joints.upper.a": 0.26}
    assert found["replicates"] == 2
    assert found["metrics"] == eiwa.evaluate(small.spec(), {"arm.joints.upper.a": 0.26}, 2).scenarios[""]


def test_evaluate_as_json(cli, path):
    found = answer(cli("evaluate", path, "--json"))
    assert found.keys() == {
        "study",
        "design",
        "settings",
        "overrides",
        "replicates",
        "metrics",
        "scenarios",
        "operators",
        "objectives",
        "violations",
        "feasible",
    }
    assert found["objectives"] == {"F": found["metrics"]["F"]}
    assert found["violations"]["reach <= 0.4"] == pytest.approx(0.04)
    assert found["feasible"] is False


def test_evaluate_with_values_on_top(cli, path):
    found = answer(
        cli(
            "evaluate",
            path,
            "--design",
            "optimum",
            "--set",
            "arm.joints.upper.a=0.2",
            "--set",
            "layout.spacing=0.3",
            "--json",
        )
    )
    assert found["metrics"]["reach"] == pytest.approx(0.38)
    values = {"arm.joints.upper.a": 0.2, "layout.spacing": 0.3}
    assert found["metrics"] == eiwa.evaluate(small.spec(), values, 2).scenarios[""]


def test_a_rows_overrides_as_settings_give_the_row(ran, cli, path, tmp_path):
    """The command line alone can replay a trial."""
    row = next(r for r in Store(tmp_path / "runs/small").rows() if r["kind"] == "leader")
    settings = [part for p, v in json.loads(row["overrides"]).items() for part in ("--set", f"{p}={v!r}")]
    found = answer(cli("evaluate", path, *settings, "--json"))
    assert found["metrics"] == {name: row[f"metrics.{name}"] for name in found["metrics"]}


def test_evaluate_with_replicates(cli, path):
    one, three = (answer(cli("evaluate", path, "--replicates", k, "--json")) for k in (1, 3))
    assert one["metrics"]["F_se"] is None
    assert three["metrics"]["F_se"] > 0
    assert one["metrics"]["F"] == three["metrics"]["F"]


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("dexterity.rows=translation", "translation"),
        ('dexterity.rows="translation"', "translation"),
        ('dexterity.rows=["x", "y"]', ["x", "y"]),
        ("dexterity.K=50", 50),
        ("dexterity.K=5e1", 50.0),
        ("layout.offset=[0.0, 0.7, 0.1]", [0.0, 0.7, 0.1]),
    ],
)
def test_settings_are_read_as_toml_or_as_words(setting, value, cli, path):
    said = answer(cli("evaluate", path, "--set", setting, "--json"))
    put = eiwa.load(path, {setting.split("=")[0]: value})
    assert said["metrics"] == eiwa.evaluate(put, {}, 2).scenarios[""]


def test_evaluate_under_scenarios(cli, tmp_path):
    path = small.write(tmp_path, extra=small.SCENARIOS)
    found = answer(cli("evaluate", path, "--json"))
    assert found["scenarios"].keys() == {"dexterity.K=50"}
    said = cli("evaluate", path)
    assert "K=12270" in said.out
    assert "K=50" in said.out


def test_a_setting_at_a_scenarios_path_is_what_the_table_says(cli, tmp_path):
    """The reference column then holds K = 777, not the study file's 12270."""
    path = small.write(tmp_path, extra=small.SCENARIOS)
    said = cli("evaluate", path, "--set", "dexterity.K=777")
    assert "K=777 *" in said.out


@pytest.mark.parametrize(
    "setting",
    ["study.seed=7", "voxel.size=0.1", "metrics.F.volume=union", "operator.armrest=0.05", "human.pitch.1=9.0"],
)
def test_a_setting_has_an_effect_or_is_refused(setting, cli, path):
    plain, said = answer(cli("evaluate", path, "--json")), cli("evaluate", path, "--set", setting, "--json")
    if said.code == 0:
        assert answer(said)["metrics"] != plain["metrics"]
    else:
        assert setting.split(".")[0] in said.err
        assert "has no 'F'" not in said.err


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_a_figure(ending, cli, path, tmp_path):
    pytest.importorskip("matplotlib")
    said = cli("evaluate", path, "--design", "optimum", "--figure", f"workspace.{ending}")
    assert said.code == 0, said.err
    assert f"Drew workspace.{ending}." in said.err
    starts = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    content = (tmp_path / f"workspace.{ending}").read_bytes()
    assert content.startswith(starts[ending])
    assert len(content) > 10_000


def test_a_figure_beside_json(cli, path):
    pytest.importorskip("matplotlib")
    said = cli("evaluate", path, "--figure", "workspace.png", "--json")
    assert answer(said)["metrics"]["F"] > 0
    assert "Drew workspace.png." in said.err


@pytest.mark.parametrize("name", ["workspace.xyz", "nowhere/workspace.png"])
def test_a_figure_that_cannot_be_drawn(name, cli, path):
    pytest.importorskip("matplotlib")
    said = cli("evaluate", path, "--figure", name)
    assert said.code == 2
    assert f"{name}: cannot be drawn" in said.err


def test_figures_need_matplotlib(cli, path, monkeypatch):
    import sys

    for name in ("matplotlib", "matplotlib.figure", "matplotlib.backends.backend_agg"):
        monkeypatch.setitem(sys.modules, name, None)
    said = cli("evaluate", path, "--figure", "workspace.png")
    assert said.code == 2
    assert "pip install 'eiwa[figures]'" in said.err


# plugins list


def test_plugins_list(cli):
    said = cli("plugins", "list")
    assert said.code == 0
    assert said.err == ""
    for name in ("dh", "yoshikawa", "ehem", "dense", "F_volume", "singletons"):
        assert name in said.out


def test_plugins_list_as_json(cli):
    found = answer(cli("plugins", "list", "--json"))
    assert found["broken"] == []
    kinds = {(p["kind"], p["name"]) for p in found["plugins"]}
    assert {
        ("arm", "dh"),
        ("dexterity", "yoshikawa"),
        ("human", "ehem"),
        ("voxels", "dense"),
        ("metrics", "F"),
    } <= kinds
    assert all(p["summary"] and p["provider"] and p["version"] for p in found["plugins"])


def test_a_broken_plugin_is_listed(cli, monkeypatch):
    from eiwa.core import registry

    class Broken:
        name, value, dist = "gearbox", "gearbox.plugin", None

        def load(self):
            raise ImportError("no module named gears")

    monkeypatch.setattr(registry, "entry_points", lambda group: [Broken()])
    said = cli("plugins", "list")
    assert said.code == 0
    assert "not loaded: gearbox (gearbox.plugin): ImportError: no module named gears" in said.out.replace("\n", " ")
    (broken,) = answer(cli("plugins", "list", "--json"))["broken"]
    assert broken["provider"] == "gearbox (gearbox.plugin)"


def test_the_dashboard_is_named_with_how_to_get_it(ran):
    assert ("pip install 'eiwa[dashboard]'" in ran.out) is (find_spec("optuna_dashboard") is None)


# schema


def test_schema(cli, path):
    found = answer(cli("schema"))
    assert found["$schema"].endswith("2020-12/schema")
    assert "arm-dh" in found["$defs"]


def test_schema_with_a_studys_plugins(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = small.broken_arm(tmp_path).name
    assert "arm-broken" in answer(cli("schema", "--study", path))["$defs"]
    assert "arm-broken" not in answer(cli("schema"))["$defs"]


def test_schema_of_a_part(cli):
    assert "study" in answer(cli("schema"))["required"]
    assert answer(cli("schema", "--part"))["required"] == []


def test_schema_of_a_file_that_is_not_there(cli):
    said = cli("schema", "--study", "nowhere.toml")
    assert (said.code, said.out) == (2, "")
    assert "nowhere.toml: cannot be read" in said.err


def test_no_help_has_words_in_square_brackets():
    """The screen takes them for markup and leaves them out."""
    import typer

    from eiwa.cli import app

    def walk(command):
        yield command
        for child in getattr(command, "commands", {}).values():
            yield from walk(child)

    for command in walk(typer.main.get_command(app)):
        texts = [command.help or "", *(getattr(p, "help", None) or "" for p in command.params)]
        assert not [text for text in texts if re.search(r"(?<!\\)\[[a-z.]+\]", text)], command.name
