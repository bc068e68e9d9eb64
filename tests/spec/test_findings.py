"""What a study file may get wrong: every finding starts with the TOML path and says what is allowed."""

import tomllib
from pathlib import Path

import pytest

from eiwa.core.errors import EiwaError, PluginError, SingularArm, SpecError
from eiwa.core.outcome import evaluate
from eiwa.core.spec import load
from eiwa.study.estimate import estimate
from tests.study import small

WAIST = '{ name = "waist", limits = [-120, 120] }'
LAYOUT = small.SMALL[small.SMALL.index("[layout]") : small.SMALL.index("[human]")]
STUDY = small.SMALL[small.SMALL.index("[study]") : small.SMALL.index("[arm]")]
REACH = "reach = { low = 0.20, high = 0.44 }"
SPLIT = '"reach * split"'
SPACING = "{ low = 0.20, high = 0.60 }"
OPTIMUM = '"arm.joints.upper.a" = 0.26\n'
PUBLISHED = "published = { F = 0.2732 }"
OBJECTIVE = small.OBJECTIVE


def table(text):
    """Writes more tables before [variables]."""
    return {"[variables]": f"{text}\n[variables]"}


def top(text):
    return {small.TOP: f"{text}\n{small.TOP}"}


def joints(count):
    return "joints = [" + ",".join(f'{{ name = "j{k}", limits = [-1, 1] }}' for k in range(count)) + "]\n"


def factors(text):
    """The dexterity as a product."""
    listed = f"factors = [{text}]" if text else ""
    return {'kind = "yoshikawa"\nK = 12270': f'kind = "product"\n{listed}'}


CASES = {
    # types
    "a string for a number": ({"K = 12270": 'K = "many"'}, "dexterity.K = 'many'", "must be a valid number"),
    "a truth value for a number": ({"K = 12270": "K = true"}, "dexterity.K = True", "must be a valid number"),
    "a list for a number": ({"a = 0.26": "a = [1]"}, "arm.joints.upper.a = [1]", "must be a valid number"),
    "a date for a number": ({"spacing = 0.20": "spacing = 1979-05-27"}, "layout.spacing", "must be a valid number"),
    "a number for a list": ({"limits = [-120, 120]": "limits = 120"}, "arm.joints.waist.limits = 120", "list"),
    "a number for a table": ({LAYOUT: "", **top("layout = 3")}, "layout = 3", "write [layout]"),
    "a number for the study": ({STUDY: "study = 3\n"}, "study = 3", "[study]"),
    "a number for a kind": ({'kind = "dh"': "kind = 3"}, "arm.kind", "Known: delta, dh"),
    "a fraction for a count": ({"seed = 1": "seed = 1.5"}, "study.seed = 1.5", "must be a valid integer"),
    "too few numbers": ({"0.802, 0.10]": "0.802]"}, "layout.offset = [0.0, 0.802]", "at least 3"),
    "too many numbers": ({"[-120, 120]": "[1, 2, 3]"}, "arm.joints.waist.limits = [1, 2, 3]", "at most 2"),
    "a number for an item": ({small.JOINTS: "joints = [1]\n"}, "arm.joints.0 = 1", ""),
    "a table for a list": (
        {OBJECTIVE: OBJECTIVE.replace("[[objectives]]", "[objectives]")}, "objectives", "[[objectives]]"),
    "numbers for objectives": ({OBJECTIVE: "", **top("objectives = [3]")}, "objectives.0 = 3", ""),
    "a list for a design": (
        {small.DESIGN: "[designs]\noptimum = []\n"}, "designs.optimum = []", "write [designs.optimum]"),
    "a list for a metric": (table("[metrics]\nF = []"), "metrics", "write [metrics.F]"),
    "a string for plugins": (top('plugins = "x.py"'), "plugins = 'x.py'", "must be a list of file names"),
    "a number for an assumption": (table('[assumptions]\n"layout.spacing" = 3'), 'assumptions."layout.spacing"', ""),
    # tables within a plugin's table
    "a product of nothing": (factors(""), "dexterity.factors", "is required"),
    "a factor without a kind": (factors("{ K = 1 }"), "dexterity.factors.0.kind", "is required. Known: condition, "),
    "a factor of no kind": (
        factors('{ kind = "conditoin" }'), "dexterity.factors.0.kind = 'conditoin'", "mean 'condition'"),
    "a kind that is a number": (factors("{ kind = 3 }"), "dexterity.factors.0.kind", "name, not 3"),
    "a number for a factor": (factors("3"), "dexterity.factors.0 = 3", "must be a table with a kind"),
    "a factor's unknown key": (
        factors('{ kind = "condition" }, { kind = "yoshikawa", K = 1, row = "all" }'), "dexterity.factors.1.row",
        "did you mean 'rows'"),
    "a factor's wrong value": (
        factors('{ kind = "condition", length = -1 }'), "dexterity.factors.0.length = -1", "greater than 0"),
    "a factor's two choices": (
        factors('{ kind = "joint_limits", form = "mean", K = 1 }'), "dexterity.factors.0", "leave them out"),
    "a factor's factor": (
        factors('{ kind = "product", factors = [{ kind = "condition", rows = ["q"] }] }'),
        "dexterity.factors.0.factors.0.rows", "'rx'"),
    # values
    "not a number": ({"K = 12270": "K = nan"}, "dexterity.K = nan", "must be a finite number"),
    "infinity": ({"K = 12270": "K = inf"}, "dexterity.K = inf", "must be a finite number"),
    "infinity in a list": ({"[0.0, 0.802": "[0.0, -inf"}, "layout.offset.1 = -inf", "must be a finite number"),
    "infinite link": ({"a = 0.26": "a = inf"}, "arm.joints.upper.a = inf", "must be a finite number"),
    "not a number in limits": (
        {"[-120, 120]": "[nan, 120]"}, "arm.joints.waist.limits.0 = nan", "must be a finite number"),
    "not a number in a range": (
        {SPACING: "{ low = nan, high = 1 }"}, 'search."layout.spacing".low = nan', "must be a finite number"),
    "not a number in a bound": ({"max = 0.40": "max = nan"}, "constraints.0.max = nan", "must be a finite number"),
    "negative K": ({"K = 12270": "K = -1"}, "dexterity.K = -1", "must be greater than 0"),
    "negative spacing": (
        {"spacing = 0.20": "spacing = -0.2"}, "layout.spacing = -0.2", "must be greater than or equal to 0"),
    "negative seed": ({"seed = 1": "seed = -1"}, "study.seed = -1", "must be greater than or equal to 0"),
    "negative trials": ({"trials = 8": "trials = -8"}, "study.trials = -8", "must be greater than or equal to 0"),
    "empty batch": ({"batch = 4": "batch = 0"}, "study.batch = 0", "must be greater than or equal to 1"),
    "threshold above 1": (
        {"threshold = 0.3": "threshold = 2"}, "dexterity.threshold = 2", "must be less than or equal to 1"),
    "alpha above 1/2": (
        {"spacing = 0.20": "spacing = 0.2\nalpha = 0.9"}, "layout.alpha = 0.9", "must be less than or equal to 0.5"),
    "a name that is a path": ({'"small"': '"../small"'}, "study.name = '../small'", "Names the folder of results"),
    "no name": ({'name = "small"\n': ""}, "study.name", "is required"),
    "zero samples": (
        {"samples = 4096\nrep": "samples = 0\nrep"}, "sampling.samples = 0", "must be greater than or equal to 2"),
    "negative samples": (
        {"samples = 4096\nrep": "samples = -5\nrep"}, "sampling.samples = -5", "must be greater than or equal to 2"),
    "too many samples": (
        {"samples = 4096\nrep": "samples = 99999999999\nrep"}, "sampling.samples", "must be less than or equal to"),
    "zero voxels": ({"size = 0.05": "size = 0"}, "voxels.size = 0", "must be greater than or equal to 0.0001"),
    "negative voxels": (
        {"size = 0.05": "size = -0.05"}, "voxels.size = -0.05", "must be greater than or equal to 0.0001"),
    "vanishing voxels": (
        {"size = 0.05": "size = 1e-9"}, "voxels.size = 1e-09", "must be greater than or equal to 0.0001"),
    "reversed human range": (
        {'kind = "ehem"': 'kind = "ehem"\npitch = [30, -5]'}, "human", "pitch must be [low, high]"),
    # the arm
    "reversed limits": ({"[-120, 120]": "[120, -120]"}, "arm.joints.waist.limits = [120, -120]", "low < high"),
    "equal limits": ({"[-120, 120]": "[120, 120]"}, "arm.joints.waist.limits = [120, 120]", "kind = 'fixed'"),
    "no joints": ({small.JOINTS: "joints = []\n"}, "arm.joints = []", "at least 1"),
    "joints missing": ({small.JOINTS: ""}, "arm.joints", "is required"),
    "unlimited prismatic joint": (
        {WAIST: '{ name = "waist", kind = "prismatic" }'}, "arm.joints.waist", "needs limits = [low, high] in m"),
    "limited fixed joint": (
        {WAIST: '{ name = "waist", kind = "fixed", limits = [-1, 1] }'}, "arm.joints.waist", "a fixed joint has no limits"),
    "unknown kind of joint": (
        {WAIST: '{ name = "waist", kind = "ball" }'}, "arm.joints.waist.kind = 'ball'", "'revolute', 'prismatic' or 'fixed'"),
    "joint without a name": ({WAIST: "{ limits = [-1, 1] }"}, "arm.joints.0.name", "is required"),
    "joint name with a space": ({'"waist"': '"the waist"'}, "arm.joints.the waist.name", "Names the joint in paths"),
    "two joints of one name": ({'"waist"': '"fore"'}, "arm", "joints share the name fore"),
    "missing convention": (
        {'convention = "modified"\n': ""}, "arm.convention", "is required. How the rows are read: 'standard' or 'modified'"),
    "unknown convention": ({'"modified"': '"craig"'}, "arm.convention = 'craig'", "must be 'standard' or 'modified'"),
    # names
    "unknown arm": ({'"dh"': '"dhh"'}, "arm.kind = 'dhh'", "did you mean 'dh'? Known: delta, dh"),
    "unknown human": ({'"ehem"': '"eham"'}, "human.kind = 'eham'", "did you mean 'ehem'?"),
    "unknown index": ({'"yoshikawa"': '"yoshikava"'}, "dexterity.kind = 'yoshikava'", "did you mean 'yoshikawa'?"),
    "unknown voxels": ({'"dense"': '"octree"'}, "voxels.kind = 'octree'", "Known: auto, dense, sparse"),
    "unknown metric table": (table("[metrics.G]"), "metrics.G", "Known: F,"),
    "no kind": ({'kind = "ehem"\n': ""}, "human.kind", "is required. Known: ehem"),
    "unknown key": ({"spacing = 0.20": "spaceing = 0.20"}, "layout.spaceing", "unknown key; did you mean 'spacing'?"),
    "unknown key of a joint": (
        {"alpha = 90": "alhpa = 90"}, "arm.joints.shoulder.alhpa", "unknown key; did you mean 'alpha'?"),
    "unknown key of the arm": ({'"dh"': '"dh"\nangels = "deg"'}, "arm.angels", "unknown key; did you mean 'angles'?"),
    "unknown key beside a plugin's": (
        {"threshold = 0.3": "treshold = 0.3"}, "dexterity.treshold", "did you mean 'threshold'?"),
    "unknown key of a metric": (table('[metrics.F]\nvolum = "sum"'), "metrics.F.volum", "did you mean 'volume'?"),
    "unknown key of a range": (
        {SPACING: "{ low = 1, hihg = 2 }"}, 'search."layout.spacing".hihg', "did you mean 'high'?"),
    "unknown key of an objective": (
        {'metric = "F"': 'metric = "F"\nagregate = "min"'}, "objectives.0.agregate", "did you mean 'aggregate'?"),
    "unknown table": ({"[layout]": "[leyout]"}, "leyout", "unknown table; did you mean 'layout'?"),
    "unknown key above all tables": (top("trials = 3"), "trials", "unknown table"),
    # dexterity
    "both K": ({"K = 12270": "K = 12270\nK_scaled = 3"}, "dexterity", "give exactly one of K and K_scaled"),
    "neither K": ({"K = 12270\n": ""}, "dexterity", "give exactly one of K and K_scaled"),
    "unknown row": ({"K = 12270": 'K = 12270\nrows = ["q"]'}, "dexterity.rows", "'rx'"),
    "no rows": ({"K = 12270": "K = 12270\nrows = []"}, "dexterity", "at least one row"),
    "a row twice": ({"K = 12270": 'K = 12270\nrows = ["x", "x"]'}, "dexterity.rows", "each once"),
    "unknown normaliser": (
        {"K = 12270": 'K = 12270\nnormaliser = "mx"'}, "dexterity.normaliser = 'mx'", "must be 'max'"),
    # the search
    "a path that does not exist": (
        {'"layout.spacing" =': '"layout.spaceing" ='}, 'search."layout.spaceing"', "did you mean 'spacing'?"),
    "a joint that does not exist": (
        {'"arm.joints.upper.a" = "': '"arm.joints.uper.a" = "'}, 'search."arm.joints.uper.a"', "did you mean 'upper'?"),
    "a path to a list": ({'"layout.spacing" =': '"layout.offset" ='}, 'search."layout.offset"', "not a number"),
    "a path to a word": ({'"layout.spacing" =': '"layout.second" ='}, 'search."layout.second"', "not a number"),
    "a path outside the design": ({'"layout.spacing" =': '"study.seed" ='}, 'search."study.seed"', ""),
    "low above high": (
        {SPACING: "{ low = 0.6, high = 0.2 }"}, 'search."layout.spacing"', "low must be below high, not 0.6 and 0.2"),
    "low equal to high": ({SPACING: "{ low = 0.6, high = 0.6 }"}, 'search."layout.spacing"', "low must be below high"),
    "high missing": ({REACH: "reach = { low = 0.2 }"}, "variables.reach.high", "is required"),
    "logarithm of nothing": (
        {SPACING: "{ low = 0, high = 1, log = true }"}, 'search."layout.spacing"', "log needs low > 0"),
    "logarithmic steps": (
        {SPACING: "{ low = 0.1, high = 1, log = true, step = 0.1 }"}, 'search."layout.spacing"', "no step"),
    "no step at all": (
        {SPACING: "{ low = 0.1, high = 1, step = 0 }"}, 'search."layout.spacing".step = 0', "must be greater than 0"),
    "a corner that is no design": (
        {SPACING: "{ low = -0.2, high = 0.6 }"}, "search", "layout.spacing = -0.2: must be greater than or equal to 0"),
    "a variable nobody reads": ({REACH: f"{REACH}\nspare = {SPACING}"}, "variables.spare", "no expression reads it"),
    "a variable with a bad name": (
        {REACH: REACH.replace("reach", '"re-ach"')}, "variables.re-ach", "letters, digits and _ only"),
    "a variable that is a number": (
        {REACH: "reach = 0.3"}, "variables.reach = 0.3", "must be a range or an expression"),
    "a search without quotes": ({'"layout.spacing" =': "layout.spacing ="}, 'search."layout"', "quote the path"),
    "a call": ({SPLIT: '"max(reach, split)"'}, 'search."arm.joints.upper.a" = ', "a call is not allowed here"),
    "an attribute": ({SPLIT: '"reach.real"'}, 'search."arm.joints.upper.a" = ', "reach.real is not a variable"),
    "an unknown name": (
        {SPLIT: '"raech * split"'}, 'search."arm.joints.upper.a" = ', "raech is not a variable. Known: reach, split"),
    "half an expression": ({SPLIT: '"reach *"'}, 'search."arm.joints.upper.a" = ', "is not an expression"),
    "a division by zero": ({SPLIT: '"reach / (split - 0.3)"'}, 'search."arm.joints.upper.a" = ', "division by zero"),
    "a circle": ({REACH: 'reach = "arm_length + 1"\narm_length = "reach - 1"'}, "variables.", "in a circle: "),
    "a variable of itself": ({REACH: 'reach = "reach + 1"'}, "variables.reach", "in a circle: reach -> reach"),
    "a grid without steps": ({"batch = 4": 'batch = 4\nsampler = "grid"'}, "variables.reach", "needs a step"),
    "a grid without a step at a path": (
        {"batch = 4": 'batch = 4\nsampler = "grid"'}, 'search."layout.spacing"', "needs a step"),
    "unknown sampler": (
        {"batch = 4": 'batch = 4\nsampler = "tpee"'}, "study.sampler = 'tpee'", "must be 'auto', 'tpe', 'random',"),
    "unknown option of a sampler": (
        {"batch = 4": 'batch = 4\nsampler = { kind = "nsga2", populaton_size = 8 }'},
        "study.sampler.populaton_size", "did you mean 'population_size'?"),
    "an option of another sampler": (
        {"batch = 4": 'batch = 4\nsampler = { kind = "qmc", sigma = 0.1 }'}, "study.sampler.sigma", "unknown key"),
    "a sampler's option out of its bounds": (
        {"batch = 4": 'batch = 4\nsampler = { kind = "cmaes", sigma = 2.0 }'},
        "study.sampler.sigma = 2.0", "must be less than or equal to 1"),
    "a sampler without a kind": (
        {"batch = 4": "batch = 4\nsampler = { sigma = 0.1 }"}, "study.sampler", "or a table with such a kind"),
    "a sampler that is a number": ({"batch = 4": "batch = 4\nsampler = 3"}, "study.sampler = 3", "must be 'auto'"),
    "cmaes with two objectives": (
        {"batch = 4": 'batch = 4\nsampler = "cmaes"', OBJECTIVE: OBJECTIVE + OBJECTIVE.replace('"F"', '"reach"')},
        "study.sampler = 'cmaes'", "follows one objective, not 2"),
    "trials without a search": ({small.SEARCH: ""}, "study.trials = 8", "nothing to vary"),
    "trials without objectives": ({OBJECTIVE: ""}, "study.trials = 8", "[[objectives]]"),
    # objectives and constraints
    "unknown metric": ({'metric = "F"': 'metric = "F_volum"'}, "objectives.0.metric", "did you mean 'F_volume'?"),
    "unknown metric of a constraint": (
        {'metric = "reach"': 'metric = "raech"'}, "constraints.0.metric", "did you mean 'reach'?"),
    "unknown published metric": (
        {PUBLISHED: "published = { G = 1.0 }"}, "designs.optimum.published.G", "no metric yields 'G'"),
    "a published word": (
        {PUBLISHED: 'published = { F = "x" }'}, "designs.optimum.published.F = 'x'", "must be a valid number"),
    "unknown direction": (
        {'"maximize"': '"maximise"'}, "objectives.0.direction = 'maximise'", "must be 'maximize' or 'minimize'"),
    "no direction": ({'direction = "maximize"\n': ""}, "objectives.0.direction", "is required"),
    "no metric": ({'metric = "F"\n': ""}, "objectives.0", "give a metric or an expression"),
    "misfit with a metric": (
        {'"maximize"': '"minimize"\nover = "designs"\naggregate = "misfit"'}, "objectives.0", "misfit"),
    "misfit of one design": ({'metric = "F"': 'aggregate = "misfit"'}, "objectives.0", "go together"),
    "misfit without published values": (small.MISFIT | {PUBLISHED: ""}, "objectives", "published"),
    "misfit with a negative published value": (
        small.MISFIT | {PUBLISHED: "published = { F = -0.1 }"}, "designs.optimum", ""),
    "no bound": ({"max = 0.40\n": ""}, "constraints.0", "give min, max or both"),
    "min above max": (
        {"max = 0.40": "max = 0.4\nmin = 0.5"}, "constraints.0", "nothing can meet min = 0.5 above max = 0.4"),
    "a reach below zero": ({"max = 0.40": "max = -1"}, "constraints.0", "nothing can meet reach <= -1"),
    "an F of 3": ({'"reach"\nmax = 0.40': '"F"\nmin = 3'}, "constraints.0", "F lies between 0 and"),
    # designs and scenarios
    "a design at a path that does not exist": (
        {OPTIMUM: '"arm.joints.uper.a" = 0.26\n'}, 'designs.optimum."arm.joints.uper.a"', "did you mean 'upper'?"),
    "a design that is none": (
        {OPTIMUM: '"layout.spacing" = -1\n'}, "designs.optimum", "layout.spacing = -1: must be greater than or equal to 0"),
    "a design without quotes": ({OPTIMUM: "layout.spacing = 0.26\n"}, "designs.optimum.layout", '"layout.spacing" = '),
    "a longer design without quotes": (
        {OPTIMUM: "arm.joints.upper.a = 0.26\n"}, "designs.optimum.arm", '"arm.joints.upper.a" = '),
    "a design of infinity": ({OPTIMUM: '"layout.spacing" = inf\n'}, "designs.optimum", "must be a finite number"),
    "a scenario at a path that does not exist": (
        table('[scenarios]\n"dexterity.KK" = [1]'), 'scenarios."dexterity.KK"', "did you mean 'K'?"),
    "a scenario that is no list": (
        table('[scenarios]\n"dexterity.K" = 3'), 'scenarios."dexterity.K" = 3', "must be a list"),
    "an empty scenario": (table('[scenarios]\n"dexterity.K" = []'), 'scenarios."dexterity.K" = []', "must be a list"),
    "a scenario without quotes": (table("[scenarios]\ndexterity.K = [50]"), 'scenarios."dexterity"', "quote the path"),
    "a scenario that is no design": (
        table('[scenarios]\n"dexterity.K" = [1, -2]'), "scenarios", "dexterity.K = -2: must be greater than 0"),
    "too many scenarios": (table(f'[scenarios]\n"dexterity.K" = {list(range(1, 80))}'), "scenarios", "at most 64"),
    "an assumption about nothing": (
        table('[assumptions]\n"layout.spaceing" = "?"'), 'assumptions."layout.spaceing"', "no such path"),
}  # fmt: skip


def findings(changes):
    with pytest.raises(SpecError) as error:
        small.spec(changes)
    return error.value.findings


@pytest.mark.parametrize(("changes", "path", "words"), CASES.values(), ids=list(CASES))
def test_finding(changes, path, words):
    lines = findings(changes)
    assert any(line.startswith(path) and words in line for line in lines), lines


@pytest.mark.parametrize(("changes", "path", "words"), CASES.values(), ids=list(CASES))
def test_findings_are_lines_in_the_users_words(changes, path, words):
    """No line is given twice, and none shows what the checks are made of."""
    lines = findings(changes)
    assert len(set(lines)) == len(lines)
    for line in lines:
        assert "\n" not in line
        for word in ("instance of", "after validation", "pydantic"):
            assert word not in line


def test_all_findings_are_told_at_once():
    lines = findings({"K = 12270": "K = -1", "spacing = 0.20": "spacing = -1", '"ehem"': '"eham"'})
    assert {line.split(" = ")[0] for line in lines} == {"layout.spacing", "dexterity.K", "human.kind"}


def test_findings_of_design_and_search_are_told_at_once():
    lines = findings({"K = 12270": "K = -1", SPACING: "{ low = 0.6, high = 0.2 }"})
    assert {line.split(" ")[0].rstrip(":") for line in lines} == {"dexterity.K", 'search."layout.spacing"'}


# What shows only when the arm is built


def unsearched(changes):
    return small.spec(small.NO_SEARCH | {small.DESIGN: ""} | changes)


BUILDING = {
    "all joints fixed": (
        {small.JOINTS: 'joints = [{ name = "one", kind = "fixed" }]\n'}, "arm.joints", "every joint is fixed"),
    "13 joints": ({small.JOINTS: joints(13)}, "arm.joints", "13 movable joints; a chain has 1 to 12"),
    "small voxels": ({"size = 0.05": "size = 0.0001"}, "voxels.size = 0.0001", "GiB"),
    "singular reading": ({'"modified"': '"standard"'}, "arm.convention = 'standard'", "convention = 'modified'"),
}  # fmt: skip


@pytest.mark.parametrize("when", [lambda spec: evaluate(spec, {}), estimate], ids=["evaluate", "check"])
@pytest.mark.parametrize(("changes", "path", "words"), BUILDING.values(), ids=list(BUILDING))
def test_finding_when_built(changes, path, words, when):
    spec = unsearched(changes)
    with pytest.raises(EiwaError) as error:
        when(spec)
    assert str(error.value).startswith(path)
    assert words in str(error.value)


def test_the_other_reading_is_named_with_both_ranks():
    with pytest.raises(SingularArm) as error:
        evaluate(unsearched({'"modified"': '"standard"'}), {})
    assert "rank 5 at every posture" in str(error.value)
    assert "Read as convention = 'modified' the same table has rank 6" in str(error.value)


def test_the_memory_is_told_with_a_size_that_fits():
    """Nothing of that size is allocated: this machine could not."""
    with pytest.raises(SpecError) as error:
        evaluate(unsearched({}), {"voxels.size": 1e-4})
    line = str(error.value)
    assert "this machine has" in line
    smallest = float(line.split("Use at least ")[1].split(" m")[0])
    assert 1e-4 < smallest < 0.05


@pytest.mark.parametrize("metric", ["shared_volume", "dexterous_volume"])
def test_the_memory_of_a_whole_workspace_is_told_too(metric):
    """A long arm's workspace holds far more cells than the hands' grid."""
    spec = unsearched({"[layout]": f'[metrics.{metric}]\ncounting = "cells"\n[layout]'})
    with pytest.raises(SpecError, match=r"voxels\.size"):
        evaluate(spec, {"voxels.size": 2e-3, "arm.joints.upper.a": 15.0})


def test_an_index_that_vanishes_is_not_blamed_on_the_arm():
    """K = 1e-300 makes Eq. (1) zero; the arm has full rank."""
    with pytest.raises(EiwaError) as error:
        evaluate(unsearched({"K = 12270": "K = 1e-300"}), {})
    assert "rank 6" not in str(error.value)


# Overrides


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("voxel.size", "did you mean 'voxels'"),
        ("leyout.spacing", "did you mean 'layout'"),
        (".layout", ""),
        ("layout.spaceing", "did you mean 'spacing'"),
        ("arm.joints.uper.a", "did you mean 'upper'"),
        ("arm.joints.upper.aa", "did you mean 'a'"),
        ("layout.offset.3", "has no '3'"),
        ("layout.spacing.x", "has no 'x'"),
    ],
)
def test_an_override_that_changes_nothing_is_refused(path, words):
    """Whoever misspells a table must not take the number for an answer."""
    with pytest.raises(SpecError) as error:
        evaluate(small.spec(), {path: 1})
    assert words in str(error.value)


# Files


def refused(path, settings=None):
    with pytest.raises(EiwaError) as error:
        load(path, settings)
    return error.value


def test_a_missing_file(tmp_path):
    line = str(refused(tmp_path / "nowhere.toml"))
    assert line.startswith(f"{tmp_path / 'nowhere.toml'}: cannot be read: No such file")


def test_a_folder(tmp_path):
    assert "cannot be read" in str(refused(tmp_path))


def test_what_is_not_toml(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text("[study\nname = 1")
    error = str(refused(path))
    assert error.startswith(f"{path}: is not TOML: ")
    assert "line 1" in error


def test_what_is_not_text(tmp_path):
    path = tmp_path / "study.toml"
    path.write_bytes(b"name = '\xff\xfe'")
    assert str(refused(path)).startswith(f"{path}: is not TOML: ")


def test_an_empty_file(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text("")
    assert refused(path).findings


def test_a_key_written_twice(tmp_path):
    assert "is not TOML" in str(refused(small.write(tmp_path, {"seed = 1": "seed = 1\nseed = 2"})))


def test_a_missing_plugin_file(tmp_path):
    path = small.write(tmp_path, top('plugins = ["my_arm.py"]'))
    line = str(refused(path))
    assert line.startswith("plugins.0 = ")
    assert "my_arm.py" in line


def test_a_plugin_file_that_raises(tmp_path):
    path = small.write(tmp_path, top('plugins = ["my_arm.py"]'), my_arm="raise RuntimeError('out of gears')")
    error = refused(path)
    assert isinstance(error, PluginError)
    assert "my_arm.py raises on import: RuntimeError: out of gears" in str(error)


def test_a_plugin_file_that_takes_a_built_in_name(tmp_path):
    path = small.write(tmp_path, top('plugins = ["my_arm.py"]'), my_arm=small.BROKEN_ARM.replace('"broken"', '"dh"'))
    error = str(refused(path))
    assert "my_arm.py" in error
    assert "eiwa.plugins.arms.dh" in error


def test_settings_are_checked_too(tmp_path):
    path = small.write(tmp_path)
    assert "did you mean 'layout'" in str(refused(path, {"leyout.spacing": 1}))
    assert "did you mean 'spacing'" in str(refused(path, {"layout.spaceing": 1}))


def test_the_small_study_itself_is_right():
    assert tomllib.loads(small.SMALL)["study"]["name"] == small.spec().study.name


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"layout.spacing": 200.0}, "layout.spacing = 200.0: must be less than or equal to 20. "
         "D: distance of the bases along x. Unit: m."),
        ({"layout.offset.1": 802.0}, "layout.offset.1 = 802.0: must be less than or equal to 20. "
         "R: operator origin to the midpoint of the bases. Unit: m."),
        ({"operator.armrest": 50.0}, "operator.armrest = 50.0: must be less than or equal to 20. "
         "Armrest above the reference plane: moves E in z. Unit: m."),
    ],
)  # fmt: skip
def test_a_layout_in_millimetres(settings, line):
    with pytest.raises(SpecError) as error:
        unsearched({}).design(settings)
    assert str(error.value) == line


def test_an_arm_in_millimetres():
    with pytest.raises(SpecError, match=r"arm: its tip is up to .* m from its base; .* not in millimetres"):
        evaluate(unsearched({}), {"arm.joints.upper.a": 260.0})


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"arm.angles": "rad"}, r'waist has limits = .* rad, 19.1 turns, .*: angles = "deg" reads them as degrees'),
        (
            {"arm.joints.upper.limits": [0, 1801]},
            "upper has limits = .* deg, 5.003 turns, at most 5 .*: without limits",
        ),
    ],
)
def test_joints_of_many_turns(settings, words):
    with pytest.raises(SpecError, match=f"arm: joint {words}"):
        unsearched({}).design(settings)


def test_joints_of_five_turns():
    assert unsearched({}).design({"arm.joints.upper.limits": [-1800, 1800]})


@pytest.mark.parametrize("name", ["17", "trial 17", "leader 3"])
def test_a_design_may_not_be_called_like_a_trial(name):
    with pytest.raises(
        SpecError, match=f"designs.{name}: commands call a trial of the search so. Choose another name."
    ):
        unsearched({"[layout]": f'[designs."{name}"]\n"layout.spacing" = 0.3\n[layout]'})


def test_a_name_in_capitals_is_near():
    with pytest.raises(SpecError, match=r"arm.kind = 'DH': .*did you mean 'dh'"):
        unsearched({}).design({"arm.kind": "DH"})


def test_a_byte_order_mark_is_no_statement(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text("\ufeff" + (Path(__file__).parents[2] / "studies" / "paper.toml").read_text())
    assert load(path).study.name == "paper"


def test_an_objective_without_a_name():
    with pytest.raises(SpecError, match=r"objectives.0.metric = '': must have at least 1 character"):
        unsearched({"[layout]": '[[objectives]]\nmetric = ""\ndirection = "maximize"\n[layout]'})
