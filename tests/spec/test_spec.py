"""A study file as a whole: what it becomes, how other values are put into it, and which values make it another study."""

import tomllib
from pathlib import Path

import pytest

from eiwa.core.errors import SpecError
from eiwa.core.scenarios import REFERENCE
from eiwa.core.spec import check, differences, load
from eiwa.core.tree import replaced
from tests.study import small

STUDIES = Path(__file__).parents[2] / "studies"

DEFAULTS = {
    "study.batch": 8,
    "study.sampler.kind": "tpe",
    "arm.angles": "deg",
    "arm.tool": [0.0, 0.0, 0.0],
    "arm.joints.waist.kind": "revolute",
    "arm.joints.waist.alpha": 0.0,
    "layout.second": "translated",
    "layout.alpha": 0.5,
    "operator.armrest": 0.0,
    "human.comfort": 0.5,
    "dexterity.rows": "all",
    "dexterity.normaliser": "max",
    "voxels.aggregate": "max",
    "sampling.estimator": "plain",
    "sampling.precision": "f64",
    "metrics.F.volume": "sum",
    "metrics.singletons": {},
}


@pytest.mark.parametrize("path", sorted(STUDIES.glob("*.toml")), ids=lambda path: path.name)
def test_every_study_of_the_repository_loads(path):
    assert load(path).study.name


@pytest.fixture(scope="module")
def paper():
    return load(STUDIES / "paper.toml")


def test_the_paper(paper):
    assert (paper.study.name, paper.study.trials, paper.study.batch) == ("paper", 200, 8)
    assert list(paper.designs) == ["original", "optimum"]
    assert paper.designs["optimum"].published == {"F": 0.2732}
    assert [o.label for o in paper.objectives] == ["F"]
    assert [c.label for c in paper.constraints] == ["reach <= 0.44"]
    assert set(paper.ranges) == {"reach", "split", "layout.spacing"}


def test_the_papers_links_follow_from_reach_and_split(paper):
    values = paper.overrides({"reach": 0.4, "split": 0.6, "layout.spacing": 0.3})
    assert values == {
        "arm.joints.upper.a": 0.4 * 0.6,
        "arm.joints.fore.a": 0.4 * (1 - 0.6),
        "layout.spacing": 0.3,
    }


def test_the_papers_scenarios(paper):
    assert [s.label for s in paper.scenarios] == ["", "dexterity.K=50", "dexterity.K=100000"]
    assert [dict(s.overrides) for s in paper.scenarios] == [{}, {"dexterity.K": 50}, {"dexterity.K": 100_000}]


def test_every_assumption_of_the_paper_is_a_path_of_it(paper):
    assert len(paper.assumptions) >= 10
    assert all(isinstance(reason, str) and reason for reason in paper.assumptions.values())


# Overrides


@pytest.mark.parametrize(
    ("overrides", "changes"),
    [
        ({"layout.spacing": 0.33}, {"spacing = 0.20": "spacing = 0.33"}),
        ({"arm.joints.upper.a": 0.15}, {"a = 0.26": "a = 0.15"}),
        ({"layout.offset.1": 0.7}, {"0.802": "0.7"}),
        ({"layout.offset": [0.0, 0.7, 0.1]}, {"0.802": "0.7"}),
        ({"dexterity.K_scaled": 3.0, "dexterity.normaliser": 2.0, "dexterity.K": 7}, None),
        ({"arm.joints.fore.d": 0.01}, {"a = 0.18": "a = 0.18, d = 0.01"}),
        ({"sampling.estimator": "sobol"}, {"replicates = 2": 'replicates = 2\nestimator = "sobol"'}),
        ({"operator.armrest": 0.05}, {"[human]": "[operator]\narmrest = 0.05\n[human]"}),
        ({}, {}),
    ],
)
def test_overrides_are_as_if_they_were_written(overrides, changes):
    """Also in what they refuse."""
    if changes is None:
        with pytest.raises(SpecError, match="exactly one of K and K_scaled"):
            small.spec().design(overrides)
        return
    written, overridden = small.spec(changes).design({}), small.spec().design(overrides)
    assert tables(overridden) == tables(written)
    assert overridden.resolved() == written.resolved()


def tables(design):
    """All that a design consists of, but for the registry's records."""
    plugged = {**design.plugins, **design.metrics}
    return dict(design.tables), {key: (plugin.name, part) for key, (plugin, part) in plugged.items()}


@pytest.mark.parametrize(
    ("path", "value", "changes"),
    [
        ("metrics.F.volume", "union", {"[variables]": '[metrics.F]\nvolume = "union"\n[variables]'}),
        ("metrics.F_volume.isovalue", 0.5, {"[variables]": "[metrics.F_volume]\nisovalue = 0.5\n[variables]"}),
        ("human.pitch.1", 20.0, {'kind = "ehem"': 'kind = "ehem"\npitch = [-5.0, 20.0]'}),
        ("arm.tool.2", 0.05, {'"modified"': '"modified"\ntool = [0.0, 0.0, 0.05]'}),
    ],
)
def test_what_is_not_written_out_can_be_overridden_too(path, value, changes):
    """A value of the spec has its path whether or not the study file spells the default around it."""
    written, overridden = small.spec(changes).design({}), small.spec().design({path: value})
    assert overridden.resolved() == written.resolved()


def test_what_is_not_written_out_can_be_searched_too():
    spec = small.spec({'"layout.spacing" = {': '"human.pitch.1" = { low = 20.0, high = 30.0 }\n"layout.spacing" = {'})
    assert "human.pitch.1" in spec.searched


def test_overrides_leave_the_spec_alone():
    spec = small.spec()
    before = spec.design({})
    spec.design({"layout.spacing": 0.5, "layout.offset.0": 0.1})
    assert spec.design({}) == before


def test_settings_are_as_if_they_were_written(tmp_path):
    settings = {"layout.spacing": 0.33, "study.trials": 20, "dexterity.rows": ["x", "y"]}
    changes = {
        "spacing = 0.20": "spacing = 0.33",
        "trials = 8": "trials = 20",
        "K = 12270": 'K = 12270\nrows = ["x", "y"]',
    }
    (tmp_path / "written").mkdir()
    written = load(small.write(tmp_path / "written", changes))
    assert load(small.write(tmp_path), settings).resolved == written.resolved


def test_variables_may_read_each_other():
    spec = small.spec({"reach = { low = 0.20, high = 0.44 }": 'reach = "half * 2"\nhalf = { low = 0.1, high = 0.22 }'})
    values = spec.overrides({"half": 0.2, "split": 0.5, "layout.spacing": 0.3})
    assert values["arm.joints.upper.a"] == 0.2
    assert spec.searched.keys() == values.keys()


# Scenarios


def scenarios(extra):
    return small.spec(extra=extra).scenarios


def test_a_study_without_scenarios_has_the_reference():
    assert scenarios("") == [REFERENCE]


def test_the_reference_comes_first_and_is_not_repeated():
    assert [s.label for s in scenarios(small.SCENARIOS)] == ["", "dexterity.K=50"]


def test_scenarios_are_all_combinations():
    found = scenarios('[scenarios]\n"dexterity.K" = [12270, 50, 7]\n"operator.seat" = [0.0, 0.25]\n')
    assert [dict(s.overrides) for s in found] == [
        {},
        {"operator.seat": 0.25},
        {"dexterity.K": 50},
        {"dexterity.K": 50, "operator.seat": 0.25},
        {"dexterity.K": 7},
        {"dexterity.K": 7, "operator.seat": 0.25},
    ]


def test_a_scenario_at_a_default():
    """Scenarios may change what the study file does not write out."""
    labels = [s.label for s in scenarios('[scenarios]\n"operator.armrest" = [0.05, 0.1]\n')]
    assert labels == ["", "operator.armrest=0.05", "operator.armrest=0.1"]


def test_a_scenario_that_equals_a_default_is_the_reference():
    assert scenarios('[scenarios]\n"operator.armrest" = [0.0, 0.1]\n') == scenarios(
        '[operator]\narmrest = 0.0\n[scenarios]\n"operator.armrest" = [0.0, 0.1]\n'
    )


# Identity


def hash_of(changes=None, extra=""):
    return small.spec(changes, extra).hash


@pytest.mark.parametrize(
    ("changes", "extra"),
    [
        ({"trials = 8": "trials = 800"}, ""),
        ({'name = "small"': 'name = "other"'}, ""),
        ({small.DESIGN: ""}, ""),
        ({"published = { F = 0.2732 }": "published = { F = 0.1, reach = 1.0 }"}, ""),
        ({}, "[designs.original]\n'layout.spacing' = 0.5\n"),
        ({}, '[assumptions]\n"layout.spacing" = "as in the paper"\n'),
        ({"spacing = 0.20": "spacing = 0.2 # D"}, ""),
        ({"orientation = [0, 0, -90]": "orientation = [0.0, 0.0, -90.0]"}, ""),
        ({"[layout]": "[metrics.F]\n[metrics.singletons]\n[layout]"}, ""),
    ],
)
def test_what_does_not_change_a_trials_numbers_does_not_change_the_hash(changes, extra):
    assert hash_of(changes, extra) == hash_of()


@pytest.mark.parametrize("path", [p for p in DEFAULTS if p != "study.batch"])
def test_a_default_written_out_does_not_change_the_hash(path):
    if path == "study.sampler.kind":
        path, written = "study.sampler", {"kind": "tpe", "startup_trials": 10}
    else:
        written = DEFAULTS[path]
    tree = replaced(small.tree(), {path: written}, small.spec().defaults)
    assert check(tree, Path("x")).hash == hash_of()


def test_the_default_batch_written_out_does_not_change_the_hash():
    assert hash_of({"batch = 4": "batch = 8"}) == hash_of({"batch = 4": ""})


@pytest.mark.parametrize(
    "changes",
    [
        {"a = 0.26": "a = 0.27"},
        {"K = 12270": "K = 12271"},
        {"seed = 1": "seed = 2"},
        {"batch = 4": "batch = 8"},
        {"batch = 4": 'batch = 4\nsampler = "random"'},
        {"samples = 4096\n\n[dexterity]": "samples = 8192\n\n[dexterity]"},
        {"samples = 4096\nreplicates": "samples = 8192\nreplicates"},
        {"size = 0.05": "size = 0.04"},
        {"threshold = 0.3": "threshold = 0.2"},
        {"high = 0.44": "high = 0.45"},
        {'"reach * split"': '"split * reach"'},
        {"max = 0.40": "max = 0.41"},
        {'"maximize"': '"minimize"'},
        {'name = "waist"': 'name = "hip"'},
        {"[layout]": "[metrics.F_volume]\n[layout]"},
        {"[variables]": f"{small.SCENARIOS}[variables]"},
    ],
)
def test_what_changes_a_trials_numbers_changes_the_hash(changes):
    assert hash_of(changes) != hash_of()


def test_a_plugin_files_bytes_are_part_of_the_hash(tmp_path):
    path = small.paused(tmp_path, trials=8)
    before = load(path).hash
    assert load(path).hash == before
    (tmp_path / "pause.py").write_text(small.PAUSE + "\n")
    assert load(path).hash != before
    (tmp_path / "pause.py").write_text(small.PAUSE)
    assert load(path).hash == before


@pytest.mark.parametrize(
    "changes",
    [
        {"published = { F = 0.2732 }": "published = { F = 0.2733 }"},
        {'"arm.joints.upper.a" = 0.26\n': '"arm.joints.upper.a" = 0.25\n'},
        {"[designs.optimum]": "[designs.other]\npublished = { F = 0.1 }\n[designs.optimum]"},
    ],
)
def test_designs_are_part_of_the_hash_where_an_objective_is_over_them(changes):
    assert hash_of(small.MISFIT | changes) != hash_of(small.MISFIT)
    assert hash_of(changes) == hash_of()


def test_differences_name_paths_with_both_values():
    old, new = small.spec().identity, small.spec({"a = 0.26": "a = 0.27", "K = 12270": "K = 5"}).identity
    assert sorted(differences(old, new)) == [
        "arm.joints.upper.a: 0.26 -> 0.27",
        "dexterity.K: 12270.0 -> 5.0",
    ]


def test_differences_name_what_is_absent():
    lines = differences(small.spec().identity, small.spec(extra="[metrics.F_volume]\n").identity)
    assert lines == ["metrics.F_volume.isovalue: absent -> 0.3"]


@pytest.mark.parametrize(
    ("changes", "extra"),
    [
        ({}, "[metrics.mean_dexterity]\n"),
        ({"max = 0.40": "max = 0.40\n[[constraints]]\nmetric = 'reach'\nmin = 0.1"}, ""),
        ({}, small.SCENARIOS),
    ],
)
def test_specs_of_different_hash_have_differences(changes, extra):
    old, new = small.spec(), small.spec(changes, extra)
    assert old.hash != new.hash
    assert differences(old.identity, new.identity)


def test_everything_is_plain(paper):
    """What is stored as JSON is read back equal."""
    import json

    assert json.loads(json.dumps(paper.identity)) == paper.identity


def test_the_hash_does_not_depend_on_the_order_of_tables():
    tree = tomllib.loads(small.SMALL)
    turned = {key: tree[key] for key in reversed(tree)}
    assert check(turned, Path("x")).hash == hash_of()
