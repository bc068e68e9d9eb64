"""Files that parameters name: found beside the study, part of its hash, and refused when they cannot be read."""

import tomllib

import pytest

from eiwa.core.errors import SpecError
from eiwa.core.spec import check, load
from tests.study import small

PLUGIN = '''
from dataclasses import dataclass

from eiwa.core.hookspecs import FileParameter, Number, Parameters, Plugin, hookimpl
from eiwa.core.interfaces import Metric


class LinesParameters(Parameters):
    """Lines of a file."""

    file: FileParameter


@dataclass(frozen=True)
class Lines(Metric):
    parameters: LinesParameters

    def __call__(self, measurement):
        return {"lines": float(len(self.parameters.file.path.read_text().splitlines()))}


@hookimpl
def eiwa_metrics():
    return [Plugin("lines", LinesParameters, Lines, (Number("lines", "", "lines of a file"),))]
'''


@pytest.fixture
def study(tmp_path):
    """A study in a folder of its own, whose metric reads ``data/points.txt``."""
    (tmp_path / "lines.py").write_text(PLUGIN)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "points.txt").write_text("a\nb\n")
    text = small.SMALL.replace(small.TOP, f'plugins = ["lines.py"]\n{small.TOP}', 1)
    path = tmp_path / "study.toml"
    path.write_text(text + '\n[metrics.lines]\nfile = "data/points.txt"\n')
    return path


def test_a_file_is_found_beside_the_study(study, monkeypatch, tmp_path_factory):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    _, parameters = load(study).design({}).metrics["lines"]
    assert parameters.file.path.read_text() == "a\nb\n"


def test_its_content_is_part_of_the_hash(study):
    before = load(study).hash
    (study.parent / "data" / "points.txt").write_text("a\nc\n")
    assert load(study).hash != before


def test_a_resolved_study_is_a_study(study):
    spec = load(study)
    tree = tomllib.loads(study.read_text())
    tree["metrics"] = spec.resolved["metrics"]
    assert check(tree, study).hash == spec.hash


def test_a_resolved_study_knows_that_the_file_changed(study):
    written = load(study).resolved["metrics"]["lines"]["file"]
    (study.parent / "data" / "points.txt").write_text("a\nc\n")
    with pytest.raises(SpecError, match=r"metrics\.lines\.file = .*the file has changed"):
        load(study, {"metrics.lines.file": written})


@pytest.mark.parametrize(("value", "problem"), [("none.csv", "cannot be read"), (3, "must be the name of a file")])
def test_a_file_that_is_none_is_refused(study, value, problem):
    with pytest.raises(SpecError, match=rf"metrics\.lines\.file = .*{problem}"):
        load(study, {"metrics.lines.file": value})
