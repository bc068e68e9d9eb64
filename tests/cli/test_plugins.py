"""``eiwa plugins``: shown, checked, begun; and what a broken plugin is told, by the check and by a study."""

import json

import pytest
from rich.cells import cell_len

from eiwa.core.registry import KINDS, load
from eiwa.testing import samples
from tests.cli.test_tables import STUDIES
from tests.study import small
from tests.testing import wrong


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Commands run in an empty folder; speeds are not what is tested."""
    monkeypatch.setattr(samples, "SECONDS", 0.0)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def answer(said, code=0):
    assert said.code == code, said.err
    return json.loads(said.out)


def narrow(said):
    return [line for line in said.out.splitlines() if cell_len(line.rstrip()) > 80] == []


# show


@pytest.mark.parametrize(("kind", "name"), load().entries)
def test_show_names_every_parameter(kind, name, cli):
    said = cli("plugins", "show", name, "--kind", kind)
    assert said.code == 0, said.err
    plugin = load().entries[kind, name].plugin
    for word in (
        kind,
        plugin.summary.split()[0].strip("`"),
        *plugin.parameters.model_fields,
        *(n.name for n in plugin.numbers),
    ):
        assert word in said.out
    assert narrow(said)


def test_show_says_type_range_default_unit_and_source(cli):
    said = cli("plugins", "show", "ehem")
    for word in ("number > 0, ≤ 1", "0.273", "deg", "ANSUR", "integer ≥ 1024", "list of 2 numbers"):
        assert word in said.out


def test_show_describes_nested_tables(cli):
    said = cli("plugins", "show", "dh")
    assert "Each DhJoint" in said.out
    assert "limits" in said.out


def test_show_as_json(cli):
    (found,) = answer(cli("plugins", "show", "F", "--json"))["plugins"]
    assert (found["kind"], found["name"]) == ("metrics", "F")
    assert found["parameters"]["properties"]["volume"]["default"] == "sum"
    assert {n["name"] for n in found["numbers"]} >= {"F", "F_se"}
    assert next(n for n in found["numbers"] if n["name"] == "F_se")["high"] is None


def test_show_a_plugin_file(cli, here):
    said = cli("plugins", "show", wrong.write(here))
    assert "arm elbow" in said.out
    assert "Of all lengths." in said.out


def test_a_name_in_two_kinds_is_shown_twice(cli, here):
    path = wrong.write(here)
    both = '\n\n@hookimpl\ndef eiwa_humans():\n    return [Plugin("elbow", ElbowParameters, Elbow)]\n'
    path.write_text(path.read_text() + both)
    assert [p["kind"] for p in answer(cli("plugins", "show", path, "--json"))["plugins"]] == ["arm", "human"]
    (one,) = answer(cli("plugins", "show", path, "--kind", "human", "--json"))["plugins"]
    assert one["kind"] == "human"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("show", "yoshkawa"), "did you mean 'yoshikawa'"),
        (("show", "dh", "--kind", "arms"), "arms: no such kind of plugin; did you mean 'arm'"),
        (("show", "dh", "--kind", "human"), "there is no human of this name, but: arm"),
        (("show", "nowhere.py"), "there is no such plugin file"),
        (("list", "--study", "nowhere.toml"), "nowhere.toml: cannot be read"),
        (("check", "dh", "--study", str(STUDIES / "nowhere.toml")), "cannot be read"),
        (("check", "dh", "--set", "joints"), "write PATH=VALUE"),
        (("check", "dh", "--set", "conventoin=standard"), "arm.conventoin: unknown key; did you mean 'convention'"),
        (("check", "dh", "--set", "joints.uper.a=0.2"), "did you mean 'upper'"),
        (("check", "dh", "--set", "joints.upper.a=wide"), "arm.joints.upper.a = 'wide'"),
        (("check", "F", "--study", "small.toml"), "small.toml: has no [metrics.F]"),
        (("check", "elbow.py", "--study", "small.toml"), 'small.toml: has no [arm] with kind = "elbow"'),
        (("check", "elbow.py", "--name", "knee"), "elbow.py: holds arm elbow. Choose one by --kind and --name."),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, tuple) else "",
)
def test_bad_input(arguments, words, cli, here):
    small.write(here)
    wrong.write(here)
    said = cli("plugins", *arguments)
    assert said.code == 2
    assert said.out == ""
    assert words in said.err


# list


def test_list_with_a_studys_own_files(cli, here):
    wrong.write(here)
    path = small.write(here, {small.TOP: f'plugins = ["elbow.py"]\n{small.TOP}'})
    assert "elbow" in cli("plugins", "list", "--study", path).out
    assert "elbow" not in cli("plugins", "list").out


# check


@pytest.mark.parametrize("name", ["dh", "yoshikawa", "dense"])
def test_check_a_built_in_by_name(name, cli):
    said = cli("plugins", "check", name)
    assert said.code == 0, said.out
    assert "passed" in said.out
    assert "FAILED" not in said.out
    assert narrow(said)


def test_check_takes_a_studys_table(cli, here):
    path = small.write(here, {"a = 0.26": "a = 0.31"})
    (checked,) = answer(cli("plugins", "check", "dh", "--study", path, "--json"))["plugins"]
    assert checked["parameters"]["joints"][2]["a"] == 0.31
    (checked,) = answer(cli("plugins", "check", "yoshikawa", "--study", path, "--json"))["plugins"]
    assert checked["parameters"]["K"] == 12270


def test_check_takes_a_studys_plugin_files(cli, here):
    wrong.write(here)
    path = here / "part.toml"
    path.write_text('plugins = ["elbow.py"]\n[arm]\nkind = "elbow"\nscale = 2.0\n')
    for target in ("elbow", "elbow.py"):
        (checked,) = answer(cli("plugins", "check", target, "--study", path, "--json"))["plugins"]
        assert checked["parameters"] == {"scale": 2.0}


def test_check_with_values_on_top(cli, here):
    (checked,) = answer(cli("plugins", "check", "dh", "--set", "joints.upper.a=0.3", "--json"))["plugins"]
    assert checked["parameters"]["joints"][2]["a"] == 0.3
    assert checked["parameters"]["convention"] == "modified"


def test_check_as_json(cli, here):
    found = answer(cli("plugins", "check", wrong.write(here, "J = -J"), "--json"), code=1)
    assert found["passed"] is False
    (checked,) = found["plugins"]
    assert (checked["kind"], checked["name"], checked["provider"]) == ("arm", "elbow", str(here / "elbow.py"))
    failed = [r for r in checked["results"] if r["state"] == "failed"]
    assert [r["contract"] for r in failed] == ["jacobian is the derivative"]
    assert failed[0].keys() == {"contract", "promise", "state", "said"}


def test_check_of_a_file_with_several_plugins(cli, here):
    path = wrong.write(here)
    path.write_text(
        path.read_text().replace("return [Plugin", "return [Plugin('knee', ElbowParameters, Elbow), Plugin")
    )
    assert [p["name"] for p in answer(cli("plugins", "check", path, "--json"), code=1)["plugins"]] == ["knee", "elbow"]
    assert answer(cli("plugins", "check", path, "--name", "elbow", "--set", "scale=2", "--json"))["passed"]
    said = cli("plugins", "check", path, "--set", "scale=2")
    assert said.code == 2
    assert "holds arm knee, arm elbow. Choose one" in said.err


def test_parameters_that_are_missing_are_asked_for(cli, here):
    path = wrong.write(here)
    path.write_text(path.read_text().replace("quantity(1.0, gt=0", "quantity(gt=0"))
    said = cli("plugins", "check", path)
    assert said.code == 2
    assert "arm.scale: is required. Of all lengths." in said.err
    assert "--set KEY=VALUE" in said.err
    assert cli("plugins", "check", path, "--set", "scale=1.5").code == 0
    path.write_text(path.read_text().replace("quantity(gt=0", "quantity(examples=[1.5], gt=0"))
    assert cli("plugins", "check", path).code == 0


def test_an_installed_plugins_own_file_is_not_a_duplicate(cli):
    path = next(e for e in load().of_kind("arm") if e.plugin.name == "dh").provider.replace(".", "/") + ".py"
    assert cli("plugins", "check", STUDIES.parent / path).code == 0


# What a broken plugin is told: by the check (1: a contract failed, 2: it cannot be loaded), and by a study

BROKEN = {
    "a wrong Jacobian": ("J = J[:, [3, 4, 5, 0, 1, 2]]", "with the angular rows above the linear ones",
                         "Elbow (elbow.py): the Jacobian is not the derivative of the tip: column"),
    "a wrong shape": ("J = J.swapaxes(1, 2)", "jacobians must have shape (256, 6, 3)",
                      "Elbow (elbow.py) raised ValueError: jacobians must have shape"),
    "NaN": ("p[u[:, 0] > 0.9] = np.nan", "tips of posture", "Elbow (elbow.py): tips that are not finite"),
    "an exception": ("raise RuntimeError('stuck')", "RuntimeError: stuck (line 53)",
                     "Elbow (elbow.py) raised RuntimeError: stuck (line 53)"),
    "hidden state": ("self.calls += 1; p = p + 1e-3 * self.calls", "a call leaves behind",
                     "Elbow (elbow.py): the same joint vectors, evaluated again, gave other values"),
}  # fmt: skip


def study(folder, change="", name="elbow"):
    """A study of the elbow."""
    path = wrong.write(folder, change)
    path.write_text(path.read_text().replace('"elbow"', f'"{name}"'))
    changes = {
        small.TOP: f'plugins = ["elbow.py"]\n{small.TOP}',
        'kind = "dh"\nconvention = "modified"\n' + small.JOINTS: f'kind = "{name}"\n',
        small.SEARCH: '[search]\n"arm.scale" = { low = 0.8, high = 1.2 }\n',
        small.DESIGN: '[designs.half]\n"arm.scale" = 0.5\n',
        "K = 12270": 'K_scaled = 3\nrows = "translation"',
    }
    return small.write(folder, changes)


@pytest.mark.parametrize(("change", "words", "_"), BROKEN.values(), ids=list(BROKEN))
def test_the_check_tells_a_broken_plugin(change, words, _, cli, here):
    said = cli("plugins", "check", wrong.write(here, change))
    assert said.code == 1
    assert "FAILED" in said.out
    assert words in " ".join(said.out.split())
    assert narrow(said)


@pytest.mark.parametrize(("change", "_", "words"), BROKEN.values(), ids=list(BROKEN))
@pytest.mark.parametrize("command", [("evaluate",), ("study", "run")], ids=" ".join)
def test_a_study_tells_a_broken_plugin(command, change, _, words, cli, here):
    said = cli(*command, study(here, change))
    assert said.code == 2
    assert said.out == ""
    assert words in said.err
    assert "Traceback" not in said.err


def test_the_same_study_runs_with_the_right_arm(cli, here):
    assert cli("study", "run", study(here)).code == 0


@pytest.mark.parametrize(
    "command",
    [("plugins", "check", "elbow.py"), ("evaluate", "small.toml"), ("study", "run", "small.toml")],
    ids=" ".join,
)
def test_a_name_that_is_taken_is_told(command, cli, here):
    study(here, name="dh")
    said = cli(*command)
    assert said.code == 2
    assert said.out == ""
    assert "elbow.py and eiwa.plugins.arms.dh both provide the arm plugin 'dh': rename one of them" in said.err


# What parts of the other kinds are told by a study

PARTS = {
    "an index that branches": ("dexterity", "if self.parameters.penalty else", "if arm.u[0] > 0.5 else",
                               "Mydevice (mydevice.py) raised TypeError: a traced column has no truth value"),
    "a field of another shape": ("human", "        return ErgonomicField(",
        "        return ErgonomicField(right[1:], left)\n        ErgonomicField(",
        "Mydevice (mydevice.py): E of the right hand must have the grid's shape"),
    "a field beyond 1": ("human", "np.maximum(0.0, 1 - d", "np.maximum(0.0, 2 - d", "must lie in [0, 1], not 0 to"),
    "a field of NaN": ("human", "np.maximum(0.0, 1 - d", "np.sqrt(0.1 - d", "must lie in [0, 1], not nan to nan"),
    "bounds upside down": ("human", "[[-abs(x) - r, y - r, z - r], [abs(x) + r, y + r, z + r]]",
                           "[[abs(x) + r, y - r, z - r], [-abs(x) - r, y + r, z + r]]", "bounds must be [[low x, y, z]"),
    "another number": ("metrics", '        return {"mydevice"', '        return {"my_device"', "my_device"),
    "a number out of bounds": ("metrics", "0.0, 1.0)", "0.0, 0.4)", "it declares a number between 0 and 0.4"),
    "a number that is none": ("metrics", "right / (right + left) if", "float('nan') if", "returned mydevice = nan"),
}  # fmt: skip
TABLES = {
    "dexterity": ('kind = "yoshikawa"\nK = 12270', 'kind = "mydevice"'),
    "human": ('kind = "ehem"\nsamples = 4096', 'kind = "mydevice"'),
    "metrics": ("[human]", "[metrics.mydevice]\n\n[human]"),
}


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize(("kind", "old", "new", "words"), PARTS.values(), ids=list(PARTS))
def test_a_study_tells_broken_parts(kind, old, new, words, cli, here):
    from tests.testing.test_kinds import TEMPLATES

    text = (TEMPLATES / f"{kind}.py").read_text()
    assert old in text
    (here / "mydevice.py").write_text(text.replace(old, new, 1))
    path = small.write(here, dict([TABLES[kind], (small.TOP, f'plugins = ["mydevice.py"]\n{small.TOP}')]))
    said = cli("evaluate", path)
    assert said.code == 2
    assert words in said.err


def test_every_kind_has_contracts():
    from eiwa import testing

    assert all(testing.contracts(kind) for kind in KINDS)
