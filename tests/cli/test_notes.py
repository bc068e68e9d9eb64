"""Notes in Markdown: read back, they say what the tables say."""

import json

import pytest
from markdown_it import MarkdownIt
from markdown_it.tree import SyntaxTreeNode
from rich.table import Table
from rich.text import Text

from eiwa.cli import notes
from tests.study import small
from tests.study.conftest import no_work, unflushed  # noqa: F401 (fixtures)


def read(markdown):
    """The cells of every table of a text, line by line, as a reader of Markdown sees them."""
    tree = SyntaxTreeNode(MarkdownIt().enable("table").parse(markdown))
    return [
        [
            ["".join(t.content for t in cell.walk() if t.type in ("text", "code_inline")).strip() for cell in line]
            for line in part
        ]
        for table in tree.walk()
        if table.type == "table"
        for part in [[line.children for half in table for line in half]]
    ]


@pytest.mark.parametrize(
    "text", ["a | b", "2 * x_1 * y_2", "<script>", "`code` [link](x) ~gone~ ~~gone~~ # $ \\", "a\nb"]
)
def test_text_stays_what_it_is(text):
    table = Table(title="of [texts]".replace("[", "\\["))
    table.add_column("what")
    table.add_column(Text(text))
    table.add_row(Text(text), "b")
    written = notes.markdown(table)
    flat = text.replace("\n", " ")
    assert read(written) == [[["what", flat], [flat, "b"]]]
    assert written.startswith("**of \\[texts\\]**")


@pytest.fixture
def ran(tmp_path, no_work):  # noqa: F811
    spec = small.spec(extra=small.SCENARIOS)
    return spec, small.run(spec, tmp_path).rows()


def test_a_studys_note_has_its_tables(ran):
    spec, rows = ran
    searched, results, scenarios = read(notes.study_note(spec, rows, ["5 * 3 trials failed"]))
    assert ["arm.joints.upper.a", "reach * split"] in searched
    assert ["reach", "0.2 and 0.44"] in searched
    assert results[0][0] == "design" and results[1][0] == "optimum"
    assert [line[0] for line in scenarios[1:]] == ["K=12270 *", "K=50"]
    assert spec.hash in notes.study_note(spec, rows, [])


def test_a_trials_note_has_its_design_and_how_it_meets_the_constraints(ran):
    spec, rows = ran
    leader = next(r for r in rows if r["kind"] == "leader")
    note = notes.trial_note(spec, leader, "Number 1")
    design, metrics, constraints = read(note)
    assert {path: float(value) for path, value in design[1:]} == pytest.approx(
        json.loads(leader["overrides"]), rel=1e-5
    )
    assert metrics[0][0] == "metric" and metrics[1][0] == "F"
    assert constraints[1][0] == "reach <= 0.4"
    assert float(constraints[1][1]) == pytest.approx(-leader["constraints.0"], rel=1e-5)


def test_a_note_before_the_first_row():
    assert "Maximize **F** so that **reach \\<= 0.4**." in notes.study_note(small.spec(), [], [])
