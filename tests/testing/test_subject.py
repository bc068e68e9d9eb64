"""What an outsider's test suite uses: subjects from files, modules and names; contracts; results."""

import importlib.util
import subprocess
import sys

import pytest

from eiwa import testing
from eiwa.core.errors import PluginError, SpecError
from eiwa.core.registry import KINDS
from tests.testing import wrong


def module(path):
    """A plugin file imported as anyone imports a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    found = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = found
    spec.loader.exec_module(found)
    return found


def test_what_the_module_exports():
    names = ["Contract", "NotApplicable", "Result", "Subject", "Violation", "check", "contracts", "name_of", "subject"]
    assert testing.__all__ == names
    assert all(hasattr(testing, name) for name in names)


def test_nothing_needs_pytest():
    code = "import sys, eiwa.testing; sys.exit('pytest' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_file_a_module_and_a_name_give_the_same(tmp_path):
    path = wrong.write(tmp_path, name="elbow_of_a_module")
    by_file, by_module = testing.subject(path, {"scale": 2.0}), testing.subject(module(path), {"scale": 2.0})
    assert str(by_file) == str(by_module) == "arm elbow"
    assert by_file.part.scale == by_module.part.scale == 2.0
    assert str(testing.subject("yoshikawa")) == "dexterity yoshikawa"


def test_defaults_then_examples_fill_what_is_not_given():
    subject = testing.subject("dh")
    assert subject.parameters.convention == "modified"
    assert subject.part.dof == 6
    assert testing.subject("dh", {"convention": "standard"}).parameters.convention == "standard"
    assert testing.subject("yoshikawa").parameters.K == 12270
    assert testing.subject("yoshikawa", {"K_scaled": 3.0}).parameters.K is None
    assert testing.subject("yoshikawa", {"rows": "rotation"}).parameters.K == 12270


def test_a_subject_is_built_once_and_anew(tmp_path):
    subject = testing.subject(wrong.write(tmp_path))
    assert subject.part is subject.part
    assert subject.build() is not subject.part


def test_one_of_several_is_chosen(tmp_path):
    path = wrong.write(tmp_path)
    path.write_text(
        path.read_text().replace("return [Plugin", "return [Plugin('knee', ElbowParameters, Elbow), Plugin")
    )
    with pytest.raises(SpecError, match=r"holds arm knee, arm elbow\. Choose one by kind and name"):
        testing.subject(path)
    assert str(testing.subject(path, name="knee")) == "arm knee"


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        (("nowhere.py",), SpecError, "there is no such plugin file"),
        (("elbwo",), SpecError, "no plugin has this name"),
        (("dh", {"conventoin": "standard"}), SpecError, "did you mean 'convention'"),
        (("dh", {"joints": []}), SpecError, "arm.joints"),
    ],
)
def test_what_is_refused(arguments, error, words):
    with pytest.raises(error, match=words):
        testing.subject(*arguments)


def test_a_kind_that_is_none():
    with pytest.raises(SpecError, match="no such kind of plugin; did you mean 'arm'"):
        testing.subject("dh", kind="arms")


def test_a_file_without_hooks(tmp_path):
    (tmp_path / "empty.py").write_text("x = 1\n")
    with pytest.raises(PluginError, match="has no hooks"):
        testing.subject(tmp_path / "empty.py")


@pytest.mark.parametrize("kind", KINDS)
def test_contracts_are_functions_with_promises(kind):
    contracts = testing.contracts(kind)
    assert len({contract.__name__ for contract in contracts}) == len(contracts)
    assert all(contract.__doc__ and contract.__doc__.split("\n")[0].endswith(".") for contract in contracts)


def test_a_contract_raises_in_a_test_and_reports_in_a_check(tmp_path):
    subject = testing.subject(wrong.write(tmp_path, "R = 2 * R"))
    contract = next(c for c in testing.contracts("arm") if c.__name__ == "turns_by_rotations")
    with pytest.raises(AssertionError) as raised:
        contract(subject)
    violation = raised.value
    assert (violation.expected, violation.cause.split(",")[0]) == ("R Rt = 1", "a sign or an entry in the wrong place")
    (result,) = [r for r in testing.check(subject) if r.contract == testing.name_of(contract)]
    assert result.state == "failed"
    assert result.said == str(violation)
    assert result.promise == "Rotation matrices are orthonormal and right-handed."
