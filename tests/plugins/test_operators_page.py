"""docs/explanation/operators.md: its table is what its example prints, its study and its points can be read."""

import importlib.util
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from eiwa.core.spec import check
from eiwa.plugins.humans.ehem_comfort import RANGES as FOREARM
from eiwa.plugins.humans.free_arm import RANGES as ARM
from tests import humans
from tests.study import small

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "explanation" / "operators.md").read_text()


def example():
    spec = importlib.util.spec_from_file_location("operators_example", DOCS / "examples" / "operators.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


EXAMPLE = example()


def cells(name):
    """The cells of the last table's row that has this first cell."""
    *_, row = re.findall(rf"^\| {re.escape(name)} \| (.*) \|$", PAGE, re.MULTILINE)
    return [cell.strip() for cell in row.split("|")]


def fenced(language):
    return re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL).group(1)


@pytest.mark.parametrize("name", EXAMPLE.OPERATORS)
def test_the_table_is_what_the_example_prints(name):
    """At 20 mm, to a hundredth: the last digits depend on how a processor rounds."""
    at_20_mm, _, total, mean, *extent = cells(name)
    human = EXAMPLE.build(*EXAMPLE.OPERATORS[name])
    stated = [float(at_20_mm), float(total), float(mean)]
    np.testing.assert_allclose(EXAMPLE.one_hand(human, 0.02), stated, rtol=0.01, atol=0.05)
    assert EXAMPLE.extent(human) == " | ".join(extent)


def test_the_table_has_every_kind_but_the_points():
    kinds = {kind for kind, _ in EXAMPLE.OPERATORS.values()}
    assert kinds | {"points"} == set(humans.registry().names("human"))


def degrees(cell):
    """Both ends of a cell such as '-10° to 45°', '±20°' or '30°, 10°' (two directions)."""
    numbers = [float(number) for number in re.findall(r"-?\d+", cell)]
    return (-numbers[0], numbers[-1]) if cell.startswith("±") or "," in cell else tuple(numbers)


@pytest.mark.parametrize(
    ("row", "joint"),
    [
        ("abduction (slide along the edge)", "abduction"), ("shoulder flexion (slide forward)", "shoulder"),
        ("pitch", "pitch"), ("pronation, supination", "pronation"), ("wrist: ulnar, radial", "deviation"),
        ("wrist: extension, flexion", "flexion"),
    ],
)  # fmt: skip
def test_the_ranges_of_ehem_comfort_are_those_in_force(row, joint):
    stated = dict(zip(("functional", "maximal", "comfort"), map(degrees, cells(row)), strict=True))
    assert stated == {name: FOREARM[name][joint] for name in stated}


@pytest.mark.parametrize(
    ("joint", "row"),
    list(enumerate(
        ["q₁ shoulder flexion", "q₂ abduction", "q₃ medial rotation", "q₄ elbow flexion", "q₅ pronation",
         "q₆ wrist flexion", "q₇ radial deviation"]
    )),
)  # fmt: skip
def test_the_ranges_of_free_arm_are_those_in_force(joint, row):
    assert [degrees(cell) for cell in cells(row)] == [ranges[joint] for ranges in ARM.values()]


def test_the_study_of_several_people_can_be_read(tmp_path):
    tree = {**small.tree(), **tomllib.loads(fenced("toml"))}
    spec = check(tree, tmp_path / "study.toml")
    assert {label for label in (s.label for s in spec.scenarios) if "human" in label} >= {"human.percentile=95"}


def test_the_points_can_be_read(tmp_path):
    (tmp_path / "hands.csv").write_text(fenced("text"))
    human = humans.human("points", tmp_path, file="hands.csv")
    assert [len(points) for points, _ in (human.positions.right, human.positions.left)] == [1, 1]
