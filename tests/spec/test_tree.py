"""Paths into a study file: table keys, list items by name, numbers by position."""

import copy
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eiwa.core.errors import SpecError
from eiwa.core.tree import did_you_mean, leaves, lookup, replaced
from tests.study import small

TREE = {
    "layout": {"spacing": 0.2, "offset": [0.0, 0.8, 0.1]},
    "arm": {"joints": [{"name": "upper", "a": 0.26}, {"name": "fore", "a": 0.18}]},
    "objectives": [{"metric": "F"}, {"metric": "reach"}],
}

PATHS = {
    "layout.spacing": 0.2,
    "layout.offset": [0.0, 0.8, 0.1],
    "layout.offset.1": 0.8,
    "arm.joints.upper.a": 0.26,
    "arm.joints.fore.a": 0.18,
    "objectives.1.metric": "reach",
}


@pytest.mark.parametrize(("path", "value"), PATHS.items())
def test_lookup(path, value):
    assert lookup(TREE, path) == value


def test_lookup_of_a_whole_item():
    assert lookup(TREE, "arm.joints.fore") == {"name": "fore", "a": 0.18}


@pytest.mark.parametrize("path", PATHS)
def test_replaced_puts_the_value_there(path):
    assert lookup(replaced(TREE, {path: 7}), path) == 7


@pytest.mark.parametrize("path", PATHS)
def test_replaced_does_not_touch_the_original(path):
    before = copy.deepcopy(TREE)
    replaced(TREE, {path: 7})
    assert before == TREE


def test_replaced_shares_nothing_with_what_it_was_given():
    value = [1.0, 2.0, 3.0]
    result = replaced(TREE, {"layout.offset": value})
    value[0] = 9.0
    result["arm"]["joints"][0]["a"] = 9.0
    assert result["layout"]["offset"] == [1.0, 2.0, 3.0]
    assert TREE["arm"]["joints"][0]["a"] == 0.26


def test_replaced_leaves_everything_else():
    result = replaced(TREE, {"arm.joints.fore.a": 0.3})
    assert dict(leaves(result)) == dict(leaves(TREE)) | {"arm.joints.fore.a": 0.3}


@pytest.mark.parametrize("path", ["layout.alpha", "arm.joints.fore.d"])
def test_replaced_adds_a_last_step(path):
    """A default need not be written in the study file to be changed."""
    assert lookup(replaced(TREE, {path: 1}), path) == 1


DEFAULTS = {"sampling": {"samples": 4}, "human": {"pitch": [-5.0, 30.0]}, "metrics": {"F": {"volume": "sum"}}}


@pytest.mark.parametrize("path", ["sampling.samples", "sampling.replicates", "human.pitch.1", "metrics.F.volume"])
def test_replaced_passes_through_defaults(path):
    """Nor need the table or list around it be written."""
    assert lookup(replaced(TREE, {path: 1}, DEFAULTS), path) == 1


def test_defaults_are_taken_along_as_lists_only():
    """A list cannot be written in part; the other keys of a table stay defaults."""
    assert replaced(TREE, {"human.pitch.1": 20.0}, DEFAULTS)["human"] == {"pitch": [-5.0, 20.0]}
    assert replaced(TREE, {"sampling.replicates": 2}, DEFAULTS)["sampling"] == {"replicates": 2}
    assert DEFAULTS["human"]["pitch"] == [-5.0, 30.0]


@pytest.mark.parametrize("path", ["voxel.size", "sampling.plan.size", "human.pitch.2", "metrics.G.volume"])
def test_replaced_refuses_what_neither_has(path):
    with pytest.raises(SpecError, match="has no"):
        replaced(TREE, {path: 1}, DEFAULTS)


def test_later_values_stand_on_earlier_ones():
    result = replaced(TREE, {"layout.offset": [1.0, 1.0, 1.0], "layout.offset.1": 5.0})
    assert result["layout"]["offset"] == [1.0, 5.0, 1.0]


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("layuot.spacing", "the study file has no 'layuot'; did you mean 'layout'?"),
        ("layout.spaceing", "layout has no 'spaceing'; did you mean 'spacing'?"),
        ("layout.spacing.x", "layout.spacing has no 'x'"),
        ("layout.offset.3", "layout.offset has no '3'"),
        ("layout.offset.-1", "layout.offset has no '-1'"),
        ("layout..spacing", "layout has no ''"),
        ("arm.joints.uper.a", "arm.joints has no 'uper'; did you mean 'upper'? Known: fore, upper."),
        ("arm.joints.0.a", "arm.joints has no '0'"),
        ("objectives.2.metric", "objectives has no '2'"),
    ],
)
def test_a_step_that_is_not_there(path, words):
    with pytest.raises(SpecError) as error:
        lookup(TREE, path)
    (line,) = error.value.findings
    assert line.startswith(f"{path}: {words}")


@pytest.mark.parametrize("path", ["arm.joints.uper.a", "layout.offset.3", "layout.spacing.x.y", "arm.joint.upper.a"])
def test_replaced_refuses_a_step_in_the_middle(path):
    with pytest.raises(SpecError, match="has no"):
        replaced(TREE, {path: 1})


def test_leaves_count_items_whose_name_is_empty():
    assert dict(leaves({"objectives": [{"name": None, "metric": "F"}]})) == {
        "objectives.0.name": None,
        "objectives.0.metric": "F",
    }


def test_leaves_name_every_value_once():
    assert dict(leaves(TREE)) == {
        "layout.spacing": 0.2,
        "layout.offset": [0.0, 0.8, 0.1],
        "arm.joints.upper.name": "upper",
        "arm.joints.upper.a": 0.26,
        "arm.joints.fore.name": "fore",
        "arm.joints.fore.a": 0.18,
        "objectives.0.metric": "F",
        "objectives.1.metric": "reach",
    }


def test_every_leaf_of_a_study_can_be_looked_up():
    tree = {k: v for k, v in small.tree().items() if k not in ("search", "designs")}
    for path, value in leaves(tree):
        assert lookup(tree, path) == value


def test_search_and_designs_are_keyed_by_whole_paths():
    tree = tomllib.loads(small.SMALL)
    assert tree["search"]["layout.spacing"] == {"low": 0.20, "high": 0.60}
    assert tree["designs"]["optimum"]["arm.joints.upper.a"] == 0.26


@given(st.dictionaries(st.sampled_from(sorted(PATHS)), st.floats(allow_nan=False), max_size=1))
def test_replacing_twice_is_replacing_once(values):
    once = replaced(TREE, values)
    assert replaced(once, values) == once


def test_nearest_word_first():
    assert did_you_mean("sped", ["speed", "size"]) == "; did you mean 'speed'? Known: size, speed."


def test_no_near_word():
    assert did_you_mean("xyz", ["speed"]) == ". Known: speed."


def test_no_word_at_all():
    assert did_you_mean("xyz", []) == "."
