"""Plugins: built in, installed, in a file; what is refused, and what is isolated."""

from types import SimpleNamespace

import pytest

from eiwa.core import registry
from eiwa.core.errors import PluginError, SpecError
from eiwa.core.hookspecs import Number, Parameters, Plugin, hookimpl
from eiwa.core.registry import KINDS, Registry, load

BUILT_IN = {
    "arm": {"dh"},
    "dexterity": {"yoshikawa"},
    "human": {"ehem", "ehem_comfort", "ehem_percentile", "free_arm", "points"},
    "voxels": {"dense"},
    "metrics": {
        "F", "F_volume", "mean_dexterity", "singletons", "reach", "total_link_length", "shared_volume",
        "dexterous_volume",
    },
}  # fmt: skip


class Nothing(Parameters):
    """Takes no parameters.

    And has a second paragraph.
    """


def provider(hook="eiwa_arms", answer=None, **more):
    """A plugin: an object with one hook."""
    if answer is None:
        answer = [Plugin("mine", Nothing, lambda parameters: None, **more)]

    def function():
        return answer

    function.__name__ = hook
    return SimpleNamespace(**{hook: hookimpl(function)})


def metric(name, *numbers):
    record = Plugin(name, Nothing, lambda parameters: None, tuple(Number(n, "", "") for n in numbers))
    return provider("eiwa_metrics", [record])


def refused(registry, module, name="mine.py"):
    with pytest.raises(PluginError) as error:
        registry.add(module, name, "1")
    return str(error.value)


@pytest.mark.parametrize("kind", KINDS)
def test_built_ins_are_there(kind):
    known = load()
    assert set(known.names(kind)) >= BUILT_IN[kind]
    assert all(known.find(kind, name, "x").name == name for name in BUILT_IN[kind])


@pytest.mark.parametrize("kind", KINDS)
def test_built_ins_come_from_eiwa(kind):
    entries = {e.plugin.name: e for e in load().of_kind(kind)}
    assert all(entries[name].provider.startswith("eiwa.plugins.") for name in BUILT_IN[kind])


def test_every_record_says_what_it_is():
    assert all(entry.plugin.summary for entry in load().entries.values())


def test_the_summary_is_the_first_line():
    assert Plugin("mine", Nothing, lambda parameters: None).summary == "Takes no parameters."


def test_a_plugin_of_ones_own():
    known = load()
    known.add(provider(), "mine.py", "7")
    assert known.find("arm", "mine", "arm.kind").parameters is Nothing
    assert known.versions()["mine.py"] == "7"


def test_one_record_needs_no_list():
    known = Registry()
    known.add(provider(answer=Plugin("mine", Nothing, lambda parameters: None)), "mine.py", "1")
    assert known.names("arm") == ["mine"]


def test_a_module_without_hooks_adds_nothing():
    known = Registry()
    known.add(SimpleNamespace(), "empty.py", "1")
    assert known.entries == {}


def test_a_duplicate_name_is_refused_and_both_providers_are_named():
    known = load()
    message = refused(known, provider(answer=[Plugin("dh", Nothing, lambda parameters: None)]))
    assert "mine.py" in message
    assert "eiwa.plugins.arms.dh" in message
    assert "'dh'" in message
    assert known.find("arm", "dh", "arm.kind").parameters is not Nothing


def test_the_same_name_of_another_kind_is_no_duplicate():
    known = load()
    known.add(provider("eiwa_humans", [Plugin("dh", Nothing, lambda parameters: None)]), "mine.py", "1")
    assert "dh" in known.names("human")


def test_a_number_that_another_metric_yields_is_refused():
    message = refused(load(), metric("mine", "F_se"))
    assert "'F_se'" in message
    assert "mine.py" in message
    assert "eiwa.plugins.metrics.interaction" in message


def test_two_records_of_one_plugin_must_differ():
    twice = [Plugin("mine", Nothing, lambda parameters: None)] * 2
    assert "'mine'" in refused(Registry(), provider(answer=twice))


def test_nothing_is_kept_of_a_refused_plugin():
    known = load()
    before = dict(known.entries)
    records = [Plugin(name, Nothing, lambda parameters: None) for name in ("new", "dh")]
    refused(known, provider(answer=records))
    assert known.entries == before


def test_a_misspelt_hook_is_refused():
    message = refused(Registry(), provider("eiwa_arm"))
    assert "mine.py" in message
    assert "eiwa_arm" in message


def test_a_function_may_be_called_otherwise_than_its_hook():
    """As pluggy has it; a misspelt name is refused there too."""

    def function():
        return [Plugin("mine", Nothing, lambda parameters: None)]

    known = Registry()
    known.add(SimpleNamespace(mine=hookimpl(function, specname="eiwa_arms")), "mine.py", "1")
    assert ("arm", "mine") in known.entries
    wrong = SimpleNamespace(mine=hookimpl(function, specname="eiwa_arm"))
    assert "eiwa_arm: there is no such hook; did you mean 'eiwa_arms'?" in refused(Registry(), wrong)


def test_a_hook_with_arguments_of_its_own_is_refused():
    @hookimpl
    def eiwa_arms(where):
        return []

    message = refused(Registry(), SimpleNamespace(eiwa_arms=eiwa_arms))
    assert "mine.py" in message
    assert "where" in message


@pytest.mark.parametrize("answer", [["dh"], "dh", {"dh": 1}, [Nothing], 3, [None]])
def test_a_record_that_is_no_plugin_is_refused(answer):
    message = refused(Registry(), provider(answer=answer))
    assert message.startswith("plugin mine.py: eiwa_arms must return a list of Plugin records")


@pytest.mark.parametrize("parameters", [dict, None, Nothing()])
def test_parameters_must_be_a_model(parameters):
    record = Plugin("mine", parameters, lambda parameters: None)
    message = refused(Registry(), provider(answer=[record]))
    assert message == "plugin mine.py: parameters of 'mine' must be a subclass of Parameters"


def test_a_metric_declares_its_numbers():
    assert "declares no numbers" in refused(Registry(), metric("mine"))


# Installed plugins


class EntryPoint:
    """What importlib.metadata yields for an installed package."""

    def __init__(self, name, load):
        self.name, self.load, self.value = name, load, f"{name}_package"
        self.dist = SimpleNamespace(version="3.2")


@pytest.fixture
def installed(monkeypatch):
    """Pretends that packages with these entry points are installed."""

    def install(**loads):
        points = [EntryPoint(name, function) for name, function in loads.items()]
        monkeypatch.setattr(registry, "entry_points", lambda group: points if group == "eiwa" else [])

    return install


def raising(error):
    def load():
        raise error

    return load


def test_an_installed_plugin(installed):
    installed(nice=provider)
    known = load()
    assert "mine" in known.names("arm")
    assert known.versions()["nice (nice_package)"] == "3.2"


@pytest.mark.parametrize(
    ("load_it", "reason"),
    [
        (raising(ImportError("no module named gears")), "no module named gears"),
        (raising(RuntimeError("boom\non two lines")), "RuntimeError: boom on two lines"),
        (lambda: provider("eiwa_arm"), "eiwa_arm"),
        (lambda: provider(answer=["dh"]), "must return a list of Plugin records"),
        (lambda: provider(answer=[Plugin("dh", Nothing, lambda parameters: None)]), "both provide"),
    ],
)
def test_a_broken_entry_point_is_isolated_and_shown(installed, load_it, reason):
    installed(bad=load_it, nice=provider)
    known = load()
    assert "mine" in known.names("arm")
    assert set(known.names("human")) >= BUILT_IN["human"]
    (broken,) = known.broken
    assert broken.provider == "bad (bad_package)"
    assert reason in broken.reason
    assert "\n" not in broken.reason


def test_a_broken_entry_point_is_mentioned_where_a_name_is_not_found(installed):
    installed(bad=raising(ImportError("no module named gears")))
    with pytest.raises(SpecError) as error:
        load().find("arm", "gearbox", "arm.kind")
    assert "bad (bad_package): ImportError: no module named gears" in str(error.value)


def test_the_order_of_installation_does_not_matter(installed):
    first = provider(answer=[Plugin("twin", Nothing, lambda parameters: None)])
    second = provider(answer=[Plugin("twin", Nothing, lambda parameters: None)])
    kept = []
    for order in ({"a": lambda: first, "b": lambda: second}, {"b": lambda: second, "a": lambda: first}):
        installed(**order)
        kept.append(load().entries["arm", "twin"].provider)
    assert kept == ["a (a_package)"] * 2


# Local files

FILE = """
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl

class P(Parameters):
    "Mine."

@hookimpl
def eiwa_arms():
    return [Plugin("mine", P, lambda parameters: None)]
"""


def load_file(path):
    return load([(path.name, "plugins.0")], path.parent)


def test_a_local_file(tmp_path):
    path = tmp_path / "my_arm.py"
    path.write_text(FILE)
    known = load_file(path)
    entry = known.entries["arm", "mine"]
    assert entry.provider == "my_arm.py"
    assert entry.version == f"sha256:{known.digests['my_arm.py']}"


def test_a_local_file_may_have_classes_that_need_their_module(tmp_path):
    """Dataclasses look their module up by name while they are made."""
    path = tmp_path / "my_dataclass.py"
    header = "from __future__ import annotations\nfrom dataclasses import dataclass\n"
    path.write_text(header + FILE + "\n@dataclass\nclass D:\n    x: int = 1\n")
    assert "mine" in load_file(path).names("arm")


def test_a_changed_local_file_is_read_again(tmp_path):
    path = tmp_path / "my_arm.py"
    path.write_text(FILE)
    first = load_file(path)
    path.write_text(FILE.replace('"mine"', '"other"'))
    second = load_file(path)
    assert "other" in second.names("arm")
    assert "mine" not in second.names("arm")
    assert first.digests != second.digests


def test_a_local_file_that_is_not_there(tmp_path):
    with pytest.raises(SpecError) as error:
        load_file(tmp_path / "nowhere.py")
    assert str(error.value).startswith("plugins.0 = ")
    assert "nowhere.py" in str(error.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("raise RuntimeError('out of gears')", "RuntimeError: out of gears"),
        ("import gears_that_nobody_made", "gears_that_nobody_made"),
        ("def broken(:\n", "SyntaxError"),
        ("raise KeyError", "KeyError"),
    ],
)
def test_a_local_file_that_raises_on_import(tmp_path, content, words):
    path = tmp_path / "my_arm.py"
    path.write_text(content)
    with pytest.raises(PluginError) as error:
        load_file(path)
    assert f"plugin file {path} raises on import" in str(error.value)
    assert words in str(error.value)


def test_a_local_file_that_is_not_python(tmp_path):
    path = tmp_path / "my_arm.txt"
    path.write_text("A letter about arms.")
    with pytest.raises(PluginError, match="is not a Python file"):
        load_file(path)


def test_a_file_that_raised_can_be_mended(tmp_path):
    path = tmp_path / "my_arm.py"
    path.write_text("raise RuntimeError")
    with pytest.raises(PluginError):
        load_file(path)
    path.write_text(FILE)
    assert "mine" in load_file(path).names("arm")


def test_two_files_of_one_name_are_both_told_apart(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "my_arm.py").write_text(FILE.replace('"mine"', f'"{folder}"'))
    known = load([(name, f"plugins.{i}") for i, name in enumerate(("a/my_arm.py", "b/my_arm.py"))], tmp_path)
    assert {"a", "b"} <= set(known.names("arm"))
    assert len(known.digests) == 2
