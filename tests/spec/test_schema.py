"""The JSON Schema takes every study that eiwa takes, and refuses the mistakes that an editor should show."""

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from eiwa.core import spec
from eiwa.core.registry import load
from eiwa.core.schema import schema
from tests.study import small
from tests.testing import wrong

ROOT = Path(__file__).parents[2]
STUDIES = sorted([*ROOT.glob("studies/**/*.toml"), *ROOT.glob("docs/examples/**/*.toml")])


@pytest.fixture(scope="module")
def installed():
    return schema(load())


def problems(tree, schema):
    """Messages with their paths."""
    found = jsonschema.Draft202012Validator(schema).iter_errors(tree)
    return [f"{'.'.join(map(str, error.absolute_path))}: {error.message}" for error in found]


def test_it_is_a_schema(installed):
    jsonschema.Draft202012Validator.check_schema(installed)
    assert installed["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    json.dumps(installed, allow_nan=False)


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.name)
def test_studies_of_the_repository(path):
    tree = spec.read(path)
    assert problems(tree, schema(spec.registry_of(tree, path), part="study" not in tree)) == []


@pytest.mark.parametrize(
    "extra",
    [
        small.SCENARIOS,
        "[metrics.F]\nvolume = 'union'\n[metrics.reach]\n",
        "[assumptions]\n'layout.spacing' = 'D'\n",
        "[operator]\narmrest = 0.1\n",
        "[designs.wide]\n'layout.offset' = [0.0, 0.7, 0.1]\n'layout.second' = 'mirrored'\n",
        "[designs.other]\nfrom = 'devices/panda.toml'\n[designs.other.dexterity]\nkind = 'yoshikawa'\nK = 5\n",
    ],
)
def test_a_study_with_more_tables(extra, installed):
    assert problems(small.tree(extra=extra), installed) == []


def test_defaults_may_be_left_out(installed):
    tree = small.tree({"[sampling]\nsamples = 4096\nreplicates = 2\n": "", 'kind = "dense"\nsize': "size"})
    assert problems(tree, installed) == []


MISTAKES = {
    "an unknown table": ({"[layout]": "[lay_out]"}, "", "'lay_out' was unexpected"),
    "a table that is missing": ({"[human]\nkind = \"ehem\"\nsamples = 4096\n": ""}, "", "'human' is a required property"),
    "an unknown key": ({"spacing = 0.20": "spaceing = 0.20"}, "", "layout: "),
    "an unknown key of a plugin": ({"K = 12270": "k = 12270"}, "", "dexterity: "),
    "an unknown key of a joint": ({"a = 0.26": "A = 0.26"}, "", "arm.joints.2: "),
    "eiwa's own key in the wrong table": ({"threshold = 0.3": "size = 0.3"}, "", "dexterity: "),
    "an unknown kind": ({'kind = "dh"': 'kind = "hd"'}, "", "arm.kind: 'hd' is not one of"),
    "another kind's key": ({"samples = 4096": "K = 3"}, "", "human: "),
    "no kind": ({'kind = "dh"\n': ""}, "", "arm: 'kind' is a required property"),
    "a missing key": ({'convention = "modified"\n': ""}, "", "arm: 'convention' is a required property"),
    "a word for a number": ({"spacing = 0.20": 'spacing = "0.20"'}, "", "layout.spacing: "),
    "a number for a word": ({'"modified"': "3"}, "", "arm.convention: "),
    "a word that is none of the choice": ({'"modified"': '"craig"'}, "", "arm.convention: "),
    "a fraction of a sample": ({"replicates = 2": "replicates = 2.5"}, "", "sampling.replicates: "),
    "out of range": ({"threshold = 0.3": "threshold = 3"}, "", "dexterity.threshold: "),
    "not positive": ({"size = 0.05": "size = 0.0"}, "", "voxels.size: "),
    "two of three numbers": ({"0.802, 0.10]": "0.802]"}, "", "layout.offset: "),
    "one limit": ({"limits = [-120, 120] },\n  { name = \"shoulder\"": "limits = [-120] },\n  { name = \"shoulder\""}, "",
                  "arm.joints.0.limits: "),
    "an unknown metric": ({'metric = "F"': 'metric = "f"'}, "", "objectives.0.metric: "),
    "an unknown table of a metric": ({}, "[metrics.G]\n", "metrics: "),
    "an unknown published number": ({"{ F = 0.2732 }": "{ G = 0.2732 }"}, "", "designs.optimum.published: "),
    "an unknown key of a design's table": ({}, "[designs.a.dexterity]\nkind = 'yoshikawa'\nk = 5\n", "designs.a.dexterity: "),
    "a design's table without its kind": ({}, "[designs.a.arm]\nconvention = 'modified'\n", "designs.a.arm: 'kind'"),
    "a design's path without quotes": ({}, "[designs.a]\nlayout.spacing = 0.3\n", "designs.a: "),
    "a range without an end": ({"high = 0.44 }": "hihg = 0.44 }"}, "", "variables.reach: "),
    "a path without quotes": ({'"layout.spacing" = { low': "layout.spacing = { low"}, "", "search: "),
    "a path to nowhere": ({'"layout.spacing" = { low': '"lay_out.spacing" = { low'}, "", "search: "),
    "one value for a scenario": ({}, '[scenarios]\n"dexterity.K" = 50\n', "scenarios.dexterity.K: "),
    "no values for a scenario": ({}, '[scenarios]\n"dexterity.K" = []\n', "scenarios.dexterity.K: "),
    "a number for a reason": ({}, '[assumptions]\n"dexterity.K" = 50\n', "assumptions.dexterity.K: "),
    "a direction that is none": ({'"maximize"': '"max"'}, "", "objectives.0.direction: "),
    "a table for a list": ({"[[constraints]]": "[constraints]"}, "", "constraints: "),
    "one plugin file": ({small.TOP: f'plugins = "mine.py"\n{small.TOP}'}, "", "plugins: "),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "extra", "words"), MISTAKES.values(), ids=list(MISTAKES))
def test_a_mistake_is_shown_where_it_is(changes, extra, words, installed):
    found = problems(small.tree(changes, extra), installed)
    assert any(words in problem for problem in found), found
    assert len(found) <= 2


def test_a_local_plugin_is_known_with_its_study(tmp_path, installed):
    wrong.write(tmp_path)
    text = small.text({small.TOP: f'plugins = ["elbow.py"]\n{small.TOP}'})
    tree = tomllib.loads(text)
    tree["arm"] = {"kind": "elbow", "scale": 2.0}
    known = schema(spec.registry_of(tree, tmp_path / "small.toml"))
    assert problems(tree, known) == []
    assert (
        problems(tree, installed) == ["arm.kind: 'elbow' is not one of ['dh']"] or "dh" in problems(tree, installed)[0]
    )
    tree["arm"]["scale"] = -1
    assert problems(tree, known) == ["arm.scale: -1 is less than or equal to the minimum of 0"]


def test_descriptions_units_and_sources_are_shown(installed):
    forearm = installed["$defs"]["human-ehem"]["properties"]["forearm"]
    assert forearm["description"].startswith("L_fw: fulcrum to wrist. [m] Source: ANSUR II")
    assert forearm["default"] == 0.273
    assert "Scaling factor" in installed["properties"]["dexterity"]["properties"]["K"]["description"]


def test_toml_has_no_null(installed):
    assert '"null"' not in json.dumps(installed)


def test_every_plugin_is_in_it(installed):
    for (kind, name), entry in load().entries.items():
        where = installed["properties"]["metrics"]["properties"] if kind == "metrics" else installed["$defs"]
        table = where[name if kind == "metrics" else f"{kind}-{name}"]
        assert table["properties"].keys() >= entry.plugin.parameters.model_fields.keys()


def test_every_table_of_a_study_is_in_it(installed):
    assert set(installed["properties"]) == set(spec.TABLES)


@pytest.mark.parametrize(
    ("sampler", "right"),
    [
        ('"nsga2"', True),
        ('{ kind = "nsga2", population_size = 8 }', True),
        ('"tpee"', False),
        ('{ kind = "nsga2", sigma = 0.1 }', False),
        ('{ kind = "cmaes", sigma = 3.0 }', False),
    ],
)
def test_samplers(sampler, right, installed):
    tree = small.tree({"batch = 4": f"batch = 4\nsampler = {sampler}"})
    assert (problems(tree, installed) == []) == right
