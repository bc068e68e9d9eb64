"""Tables fit into 80 columns, and those of the repository's own studies without cutting a word."""

import shutil
from pathlib import Path

import pytest
from rich.cells import cell_len

from tests.study import small

STUDIES = Path(__file__).parents[2] / "studies"

QUICK = {
    "1_048_576": "4096",
    "size = 0.02": "size = 0.05",
    'kind = "ehem"': 'kind = "ehem"\nsamples = 4096',
    "replicates = 4": "replicates = 2",
}


QUICKER = {
    "devices.toml": {"33_554_432": "4096"},
    "population.toml": {"percentile = 50\n\n": "percentile = 50\nsamples = 4096\n\n"},
}


def quick(name, folder):
    """A study of the repository, with so few samples that only its tables mean anything."""
    text = (STUDIES / name).read_text()
    for old, new in (QUICK | QUICKER.get(name, {})).items():
        assert old in text or QUICKER.get(name), old
        text = text.replace(old, new, 1)
    shutil.copytree(STUDIES / "devices", folder / "devices", dirs_exist_ok=True)
    path = folder / name
    path.write_text(text)
    return path.name


def check(out, whole=True):
    tables = out.split("Where to look next:")[0]
    wide = [line for line in tables.splitlines() if cell_len(line.rstrip()) > 80]
    assert wide == []
    assert not whole or "…" not in out


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", [p.name for p in sorted(STUDIES.glob("*.toml"))])
def test_a_study_of_the_repository(name, here, cli):
    trials = ["--set", "study.trials=8"] if "[search]" in (STUDIES / name).read_text() else []
    said = cli("study", "run", quick(name, here), *trials)
    assert said.code == 0, said.err
    check(said.out)


def test_designs_without_a_search_are_ranked(here, cli):
    """By the objective, whatever their order in the file; the best is what others are tied with."""
    lengths = {"short": 0.10, "long": 0.30, "middle": 0.20}
    designs = "".join(f'[designs.{name}]\n"arm.joints.upper.a" = {a}\n' for name, a in lengths.items())
    path = small.write(here, small.NO_SEARCH | {small.DESIGN: designs})
    said = cli("study", "run", path.name)
    assert said.code == 0, said.err
    rows = [line.split() for line in said.out.splitlines() if line.split()[:1] and line.split()[0] in lengths]
    found = [float(row[row.index("±") - 1]) for row in rows]
    assert len(found) == 3
    assert found == sorted(found, reverse=True)
    assert [row[0] for row in rows] != list(lengths)


@pytest.mark.parametrize(
    "arguments", [("study", "check"), ("evaluate",), ("evaluate", "--design", "optimum")], ids=" ".join
)
def test_other_tables_of_the_paper(arguments, here, cli):
    command, *more = [a for a in arguments if a != "study"]
    group = ("study",) if "study" in arguments else ()
    said = cli(*group, command, quick("paper.toml", here), *more)
    assert said.code == 0, said.err
    check(said.out)


def test_a_paper_says_everything(here, cli):
    said = cli("study", "run", quick("paper.toml", here), "--set", "study.trials=8")
    for words in (
        "original",
        "optimum",
        "0.0057",
        "0.2732",
        "trial ",
        "K=50",
        "K=12270",
        "arm.convention",
        "dexterity.K",
    ):
        assert words in said.out


def test_plugins_list(cli):
    check(cli("plugins", "list").out)


def objective(metric):
    return small.OBJECTIVE.replace('"F"', f'"{metric}"')


FOUR_PATHS = """[search]
"layout.offset.0" = { low = 0.0, high = 0.1 }
"layout.offset.1" = { low = 0.7, high = 0.9 }
"layout.offset.2" = { low = 0.0, high = 0.2 }
"dexterity.K" = { low = 1, high = 1e12, log = true }
"""

OTHERS = {
    "two scenarios": ({}, small.SCENARIOS),
    "six scenarios": ({}, '[scenarios]\n"dexterity.K" = [50, 12270, 1000000]\n"operator.armrest" = [0.01, 0.05]\n'),
    "misfit": (small.MISFIT, "[metrics.F_volume]\n[metrics.mean_dexterity]\n"),
    "a long name": ({"optimum": "a_design_with_a_rather_long_name_that_goes_on"}, ""),
    "three objectives": ({small.OBJECTIVE: small.OBJECTIVE + objective("mean_dexterity") + objective("F_volume")}, ""),
    "three published": ({"{ F = 0.2732 }": "{ F = 0.2732, reach = 0.44, F_volume = 0.1 }"}, ""),
    "over scenarios": ({'"maximize"': '"maximize"\nover = "scenarios"\naggregate = "min"'}, small.SCENARIOS),
    "four paths": ({small.SEARCH: FOUR_PATHS}, ""),
    "a long reason": ({}, '[assumptions]\n"arm.joints.shoulder.limits" = "' + "because " * 30 + '"\n'),
}


@pytest.mark.parametrize(("changes", "extra"), OTHERS.values(), ids=list(OTHERS))
def test_other_studies(changes, extra, here, cli):
    path = small.write(here, changes, extra).name
    for arguments in (("study", "run"), ("evaluate",)):
        said = cli(*arguments, path)
        assert said.code == 0, said.err
        check(said.out, whole=False)


@pytest.mark.parametrize("text", ["[bold]text[/bold]", "[/]", "[red]", "\\[x"])
def test_text_of_the_study_is_not_markup(text, here, cli):
    path = small.write(here, extra=f"[assumptions]\n'layout.spacing' = '{text}'\n").name
    said = cli("study", "run", path)
    assert said.code == 0, said.err
    assert text in said.out


@pytest.mark.parametrize("name", ["[bold]", "[/]"])
def test_names_of_designs_are_not_markup(name, here, cli):
    path = small.write(here, {"[designs.optimum]": f'[designs."{name}"]'}).name
    said = cli("study", "run", path)
    assert said.code == 0, said.err
    assert name in said.out
    said = cli("evaluate", path, "--design", name)
    assert said.code == 0, said.err
    assert name in said.out


def test_columns_that_find_no_room_follow_below(here, cli):
    """Several objectives, scenarios and searched values: no word is cut, none is lost."""
    objectives = "".join(
        f'[[objectives]]\n{lines}\ndirection = "maximize"\n\n'
        for lines in (
            'metric = "F"\nover = "scenarios"\naggregate = "cvar"',
            'metric = "singletons"',
            'expression = "F - 0.1 * reach"\nname = "balance"',
        )
    )
    scenarios = "[scenarios]\n" + '"dexterity.K" = [50, 12270]\n"operator.armrest" = [0.0, 0.05, 0.1]\n'
    path = small.write(here, {small.OBJECTIVE: objectives, "trials = 8": "trials = 0"}, scenarios)
    assert cli("study", "run", path.name).code == 0
    for arguments in (("study", "show", path.name), ("evaluate", path.name, "--replicates", "2")):
        said = cli(*arguments)
        assert said.code == 0, said.err
        check(said.out)
        assert said.out.count("K=50") >= 2
    assert all(word in cli("study", "show", path.name).out for word in ("published", "cvar F", "balance", "spacing"))


def test_trials_of_an_earlier_search_stand_below_ranked_designs(here, cli):
    path = small.write(here, {"trials = 8": "trials = 4"}, '[designs.short]\n"arm.joints.upper.a" = 0.1\n')
    assert cli("study", "run", path.name).code == 0
    said = cli("study", "show", path.name, "--set", "study.trials=0")
    assert said.code == 0, said.err
    first = [line.split()[0] for line in said.out.splitlines() if line.split()[:1]]
    assert first.index("short") < first.index("trial")
    assert "--design 'trial " in said.out


def test_the_mark_is_explained_only_where_it_stands(here, cli):
    path = small.write(here, small.NO_SEARCH | {small.DESIGN: '[designs.one]\n"arm.joints.upper.a" = 0.3\n'})
    assert "~" not in cli("study", "run", path.name).out
