"""Pages do what they say, and lack nothing: commands are run, examples checked, references complete."""

import importlib.util
import json
import re
import runpy
import tomllib
from pathlib import Path

import duckdb
import jsonschema
import pytest

from eiwa.core.registry import KINDS, load
from eiwa.testing import samples
from tests.cli.conftest import cli  # noqa: F401 (a fixture)
from tests.docs import runner
from tests.study import small
from tests.study.conftest import no_work  # noqa: F401 (a fixture)

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = {"arm": "gantry", "dexterity": "drive", "human": "elbow_rest", "voxels": "worst", "metrics": "reliable"}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.setattr(samples, "SECONDS", 0.0)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def generate():
    """docs/generate.py as a module."""
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# Commands


@pytest.mark.parametrize("page", ["tutorials/your-own-device.md", "how-to/plugin.md"])
def test_a_page_runs(page, cli, here):  # noqa: F811
    assert runner.run(DOCS / page, cli) == []


def test_the_tutorials_device_has_at_most_forty_lines_and_passes(cli, here):  # noqa: F811
    page = DOCS / "tutorials/your-own-device.md"
    quick = lambda *arguments: cli(*arguments) if arguments[:2] != ("study", "run") else cli("--version")  # noqa: E731
    runner.run(page, quick)
    assert len((here / "mydevice.py").read_text().splitlines()) <= 40
    assert cli("plugins", "check", "mydevice.py").code == 0


def test_the_editors_page_runs(cli, here):  # noqa: F811
    """Its schema takes the study, and refuses it when it is wrong."""
    (here / "my_study.toml").write_text(small.text())
    page = DOCS / "how-to/editor.md"
    assert runner.run(page, cli) == []
    (code,) = [block.body for block in runner.blocks(page) if block.head == "python"]
    exec(code, {})
    (here / "my_study.toml").write_text(small.text({"spacing = 0.20": 'spacing = "0.20"'}))
    with pytest.raises(jsonschema.ValidationError, match="is not of type 'number'"):
        exec(code, {})


@pytest.fixture
def paper(here, no_work):  # noqa: F811
    """A small study that is called as the pages call theirs."""
    scenarios = '[scenarios]\n"dexterity.K" = [50, 12270]\n'
    return small.run(small.spec({'name = "small"': 'name = "paper"'}, scenarios), here / "runs")


def test_results_are_read_as_the_page_says(paper, capsys):
    """In pandas, polars, DuckDB and pyarrow: each example of the page sees every trial."""
    shown = {b.head: [] for b in runner.blocks(DOCS / "how-to/read-results.md")}
    for block in runner.blocks(DOCS / "how-to/read-results.md"):
        shown[block.head].append(block.body)
    best = max(r["metrics.F"] for r in paper.rows() if r["kind"] == "trial")
    for example in shown["python"]:
        names = {}
        exec(example, names)
        assert f"{best:.6f}"[:6] in capsys.readouterr().out or names["table"].num_rows == len(paper.rows())
    for query in shown["sql"]:
        assert len(duckdb.sql(query).fetchall()) == sum(r["kind"] != "trial" for r in paper.rows())


# Examples


def test_every_kind_has_an_example():
    assert EXAMPLES.keys() == KINDS.keys()


@pytest.mark.parametrize("kind", KINDS)
def test_an_example_is_on_its_page_and_passes_the_check(kind, cli, here):  # noqa: F811
    page = (DOCS / f"reference/plugins/{kind}.md").read_text()
    assert f"{{literalinclude}} ../../examples/{EXAMPLES[kind]}.py" in page
    said = cli("plugins", "check", DOCS / f"examples/{EXAMPLES[kind]}.py", "--json")
    assert said.code == 0, said.out
    assert {(p["kind"], p["name"]) for p in json.loads(said.out)["plugins"]} == {(kind, EXAMPLES[kind])}


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "arm"])
def test_an_example_runs_in_a_study_as_its_page_says(kind, cli, here):  # noqa: F811
    (written,) = [b.body for b in runner.blocks(DOCS / f"reference/plugins/{kind}.md") if b.head == "toml"]
    (here / f"{EXAMPLES[kind]}.py").write_text((DOCS / f"examples/{EXAMPLES[kind]}.py").read_text())
    tables = tomllib.loads(written)
    text = small.text({small.TOP: f'plugins = ["{EXAMPLES[kind]}.py"]\n{small.TOP}', "size = 0.05": "size = 0.04"})
    for table in tables:
        text = re.sub(rf"^\[\[?{table}\]\]?\n(.*\n)*?(?=\n|\Z)", "", text, flags=re.MULTILINE)
    Path("study.toml").write_text(f"{text}\n{written}\n")
    said = cli("evaluate", "study.toml", "--set", "voxels.size=0.04")
    assert said.code == 0, said.err
    assert kind != "metrics" or "reliable" in said.out


def test_the_gantrys_study_runs(cli, here):  # noqa: F811
    quick = ("--set", "sampling.samples=4096", "--set", "human.samples=4096", "--set", "voxels.size=0.05")
    said = cli("study", "run", DOCS / "examples/gantry.toml", *quick, "--set", "study.trials=4")
    assert said.code == 0, said.err


def test_the_gantrys_own_test_passes():
    module = runpy.run_path(str(DOCS / "examples/test_gantry.py"))
    contracts = module["testing"].contracts("arm")
    assert module["test_contract"].pytestmark[0].args == ("contract", contracts)
    for contract in contracts:
        module["test_contract"](contract)


# References


def test_every_hook_and_column_has_its_place(generate):
    assert generate.missing(DOCS / "reference") == []


def test_a_hook_without_a_page_is_told(generate, monkeypatch):
    monkeypatch.setitem(generate.KINDS, "gripper", "eiwa_arms")
    assert "docs/reference/plugins.md does not mention plugins/gripper.md" in generate.missing(DOCS / "reference")


def test_every_built_in_has_its_reference(generate, tmp_path):
    generate.write(tmp_path)
    for (kind, name), entry in load().entries.items():
        page = (tmp_path / f"reference/built-in/{kind}-{name}.md").read_text()
        assert page.startswith(f"# {name} ({kind})\n")
        for word in (*entry.plugin.parameters.model_fields, *(n.name for n in entry.plugin.numbers)):
            assert f"| `{word}` |" in page, word
        index = (tmp_path / f"reference/_generated/built-in-{kind}.md").read_text()
        assert f"(/reference/built-in/{kind}-{name}.md)" in index


def test_references_of_what_is_gone_go(generate, tmp_path):
    old = tmp_path / "reference/built-in/arm-old.md"
    old.parent.mkdir(parents=True)
    old.write_text("# old (arm)\n")
    generate.write(tmp_path)
    assert not old.exists()


def test_tables_to_begin_with_are_valid(generate):
    for kind in KINDS:
        for entry in generate.built_in(kind):
            lines = generate.beginning(entry)
            table = tomllib.loads("\n".join(lines))
            table.pop("kind", None)
            assert lines == [] or entry.plugin.parameters.model_validate(table, context=load().context)
