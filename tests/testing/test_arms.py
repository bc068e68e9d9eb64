"""Every mistake that an arm's author makes is noticed by the contract that is about it, and explained."""

import pytest

from eiwa import testing
from tests.testing import wrong


def report(folder, change="", **parameters):
    """Results by contract."""
    results = testing.check(testing.subject(wrong.write(folder, change), parameters))
    return {result.contract.replace(" ", "_"): result for result in results}


def failures(results):
    return [name for name, result in results.items() if result.state == "failed"]


def test_the_right_arm_passes(tmp_path):
    results = report(tmp_path)
    assert failures(results) == []
    assert {r.state for r in results.values()} == {"passed", "not applicable"}


@pytest.mark.parametrize(("change", "words"), wrong.JACOBIANS.values(), ids=list(wrong.JACOBIANS))
def test_a_wrong_jacobian_is_explained(change, words, tmp_path):
    results = report(tmp_path, change)
    assert failures(results)[0] == "jacobian_is_the_derivative"
    said = results["jacobian_is_the_derivative"].said
    assert words in said.split("usual cause: ")[1]
    assert "at posture" in said
    assert "joint" in said.split("seen:")[0]


@pytest.mark.parametrize(("change", "contract", "words"), wrong.OTHERS.values(), ids=list(wrong.OTHERS))
def test_other_mistakes_are_explained(change, contract, words, tmp_path):
    results = report(tmp_path, change)
    assert failures(results)[0] == contract
    assert words in results[contract].said


def test_where_there_is_no_solution_anything_may_stand(tmp_path):
    nothing = (
        "bad = u[:, 0] > 0.7; valid = ~bad; q = q.copy(); q[bad], p[bad], J[bad], R = np.nan, np.nan, np.nan, R * 1.0"
    )
    assert failures(report(tmp_path, f"{nothing}; R[bad] = np.nan")) == []


def test_a_jacobian_beside_a_singularity_of_the_map_passes(tmp_path):
    """A linkage's tip moves as the root of the distance to a dead point: differences are rough there, and J is right."""
    rough = "s = np.sqrt(u[:, 0] + 2e-3); p = p + np.outer(s, [0, 0, 1]); J[:, 2, 0] += 0.5 / s / SPAN[0]"
    assert failures(report(tmp_path, rough)) == []


def test_after_a_basic_failure_the_rest_is_not_run(tmp_path):
    results = report(tmp_path, "J = J.swapaxes(1, 2)")
    assert [r.state for r in results.values()][3:] == ["not run"] * (len(results) - 3)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("lambda parameters: Elbow(parameters.scale)", "lambda parameters: None", "NoneType"),
        ("lambda parameters: Elbow(parameters.scale)", "lambda parameters: 1 / 0", "ZeroDivisionError"),
        ("dof, limited = 3", "dof, limited = 3.0", "dof = 3.0"),
        ("(True, True, True)", "(True, True)", "a tuple of 3 bools"),
        ("(True, True, True)", "[True, True, True]", "a tuple of 3 bools"),
        ("calls, last = 0, 0.0", "link_length = -1.0", "link_length = -1.0"),
    ],
)
def test_mistakes_beside_the_postures(old, new, words, tmp_path):
    path = tmp_path / "elbow.py"
    path.write_text(wrong.ARM.replace(old, new))
    results = testing.check(testing.subject(path))
    failed = next(r for r in results if r.state == "failed")
    assert failed.contract in ("builds", "declares its joints")
    assert words in failed.said


# Traced arms

TRACED = '''
import numpy as np
from dataclasses import dataclass
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import ArmColumns, TracedArm
from eiwa.core.symbols import sincos, where

class P(Parameters):
    """One joint."""
    length: float = quantity(0.3, description="Of the link.")
    offset: float = quantity(0.1, description="Along the axis.")

@dataclass(frozen=True)
class Crank(TracedArm):
    p: P
    dof, limited, structure = 1, (True,), "crank"

    @property
    def constants(self):
        return np.array([self.p.length, self.p.offset])

    def columns(self, u, p):
        q = 2.0 * u[0]
        s, c = sincos(q)
        L, z = p[0], p[1]
        # here
        R = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        J = [[-L * s], [L * c], [0], [0], [0], [1]]
        return ArmColumns(u, [q], [L * c, L * s, z], R, J, self.limited)

@hookimpl
def eiwa_arms():
    return [Plugin("crank", P, Crank)]
'''


def crank(folder, change=""):
    path = folder / "crank.py"
    path.write_text(TRACED.replace("# here", change))
    results = testing.check(testing.subject(path))
    return {r.contract: r for r in results}


def test_a_traced_arm_passes(tmp_path):
    results = crank(tmp_path)
    assert {r.contract for r in results.values() if r.state != "passed"} == {"reduced jacobian has the same volume"}
    assert "2 other designs share the kernel" in results["structure tells formulas apart"].said


def test_a_number_that_structure_does_not_know(tmp_path):
    """The kernel of one design would be used for another: the worst mistake that a traced arm can have."""
    results = crank(tmp_path, "z = self.p.offset")
    assert [r.contract for r in results.values() if r.state == "failed"] == ["structure tells formulas apart"]
    assert "offset is written into the formulas as a number" in results["structure tells formulas apart"].said


def test_a_wrong_reduced_jacobian():
    from dataclasses import replace

    from eiwa.testing.arms import reduced_jacobian_has_the_same_volume as contract
    from tests import arms

    class Subject:
        part = arms.paper()

    class Wrong(type(Subject.part)):
        def columns(self, u, p):
            found = super().columns(u, p)
            return replace(found, reduced=[[2 * e for e in found.reduced[0]], *found.reduced[1:]])

    assert contract(Subject).startswith(("exactly", "to "))
    Subject.part = Wrong(Subject.part.joints, Subject.part.T_last_tip, Subject.part.T_base_first)
    with pytest.raises(testing.Violation, match="the volume of the Jacobian at the tip"):
        contract(Subject)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("z = z if u[0] < 0.5 else -z", "a traced column has no truth value"),
        ("z = z + np.sin(q)", "TypeError"),
    ],
)
def test_what_cannot_be_traced(change, words, tmp_path):
    said = next(r.said for r in crank(tmp_path, change).values() if r.state == "failed")
    assert words in said
