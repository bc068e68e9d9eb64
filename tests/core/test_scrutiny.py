"""Arms and indices that contradict themselves are refused before any number is computed from them."""

import numpy as np
import pytest

from eiwa.core import scrutiny
from eiwa.core.dexterity import prepare
from eiwa.core.errors import PluginError
from eiwa.core.interfaces import Postures
from tests import arms
from tests.core.rig import PAPER_INDEX, ArrayIndex


class Odd(arms.ArrayArm):
    """The paper's arm whose answers are changed on the way out."""

    def __init__(self, change):
        super().__init__(arms.paper(limits=(-2.0, 2.0)))
        self.change, self.calls = change, 0

    def postures(self, u):
        p = super().postures(u)
        self.calls += 1
        fields = {
            "u": u,
            "q": p.q,
            "tips": p.tips,
            "rotations": p.rotations,
            "jacobians": p.jacobians,
            "valid": p.valid,
        }
        return Postures(**{**fields, **self.change(self, p)}, limited=self.limited)


CHANGES = {
    "a wrong jacobian": (lambda s, p: {"jacobians": -p.jacobians}, "the Jacobian is not the derivative of the tip"),
    "one wrong column": (lambda s, p: {"jacobians": p.jacobians * [1, 1, 1, 1.2, 1, 1]}, "column 3"),
    "a counter": (lambda s, p: {"tips": p.tips + 1e-3 * s.calls}, "evaluated again, gave other values"),
    "a counted jacobian": (lambda s, p: {"jacobians": p.jacobians * (1 + 1e-4 * s.calls)}, "evaluated again"),
    "random numbers": (
        lambda s, p: {"tips": p.tips + 1e-3 * np.random.default_rng().random(3)},
        "evaluated again, gave other values",
    ),
    "a mean over the block": (lambda s, p: {"tips": p.tips - 1e-3 * p.tips.mean(axis=0)}, "evaluated again"),
    "a transposed jacobian": (
        lambda s, p: {"jacobians": p.jacobians[:, :5]},
        "raised ValueError: jacobians must have shape (32, 6, 6) for 32 postures of 6 joints, not (32, 5, 6)",
    ),
    "nan": (lambda s, p: {"tips": p.tips * np.nan}, "tips that are not finite"),
    "an infinite jacobian": (
        lambda s, p: {"jacobians": p.jacobians + np.inf},
        "Jacobians that are not finite at 32 of 32",
    ),
}


@pytest.mark.parametrize(("change", "words"), CHANGES.values(), ids=list(CHANGES))
def test_an_odd_arm_is_refused_by_name(change, words):
    with pytest.raises(PluginError) as error:
        prepare(Odd(change), PAPER_INDEX, None, 0.0)
    assert words in str(error.value).replace("(16384,", "(32,").replace("16384 ", "32 ")
    assert str(error.value).startswith("Odd (")


def test_the_arm_itself_is_not_refused():
    assert prepare(Odd(lambda s, p: {}), PAPER_INDEX, None, 0.0).normaliser > 0


def volume(postures):
    return np.abs(np.linalg.det(postures.jacobians))


INDICES = {
    "another shape": (lambda p: volume(p)[:, None], "values must have shape (16384,), one per posture, not (16384, 1)"),
    "a number": (lambda p: volume(p).max(), "one per posture, not ()"),
    "random numbers": (lambda p: volume(p) * np.random.default_rng().random(), "evaluated again, gave other values"),
    "best of the block": (lambda p: volume(p) / volume(p).max(), "evaluated again, gave other values"),
}


@pytest.mark.parametrize(("function", "words"), INDICES.values(), ids=list(INDICES))
def test_an_odd_index_is_refused_by_name(function, words):
    with pytest.raises(PluginError) as error:
        prepare(arms.paper(limits=(-2.0, 2.0)), ArrayIndex(function), None, 0.0)
    assert words in str(error.value)
    assert str(error.value).startswith("ArrayIndex (")


def test_postures_without_a_solution_may_hold_anything():
    """A delta's unreachable joint vectors are not compared."""

    def change(arm, p):
        valid = p.u[:, 0] < 0.7
        noise = np.random.default_rng().random((len(valid), 1))
        return {"valid": valid, "tips": np.where(valid[:, None], p.tips, noise)}

    assert prepare(Odd(change), PAPER_INDEX, None, 0.0).normaliser > 0


def test_a_traced_structure_is_examined_once(monkeypatch):
    calls, original = [], scrutiny.differentiate
    monkeypatch.setattr(scrutiny, "_seen", set())
    monkeypatch.setattr(scrutiny, "differentiate", lambda arm, u: calls.append(arm) or original(arm, u))
    for length in (0.26, 0.3):
        scrutiny.refuse_wrong_jacobian(arms.paper(length), np.random.default_rng(0).random((64, 6)))
    assert len(calls) == 1
