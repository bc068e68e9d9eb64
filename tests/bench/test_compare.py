"""Everybody computes the same thing: who does not is found out before the clock starts."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from eiwa.bench import compare, native
from eiwa.bench.cases import PAPER, Missing, shipped
from eiwa.bench.comparators import COMPARATORS, Comparator, Foreign
from eiwa.bench.measure import Record

RECORD = Record("compare", "other", "flow", "sample", 6, "f64", 1, 1024, 0.01)
BUILT = {c.who: c for c in COMPARATORS if c.who != "Pinocchio, C++"}


@pytest.fixture(scope="module")
def family():
    return PAPER.family()


def verdict(family, evaluate, precision="f64"):
    """What is known of a comparator before it is timed."""
    error = compare.difference(family, Foreign(family.members, evaluate))
    return compare.checked(replace(RECORD, precision=precision), error)


@pytest.mark.parametrize(("who", "precision"), [(c.who, p) for c in BUILT.values() for p in c.precisions])
def test_a_comparator_agrees(who, precision, family):
    try:
        evaluate = BUILT[who].evaluate(PAPER, compare.PRECISIONS[precision])
    except Missing as error:
        pytest.skip(str(error))
    found = verdict(family, evaluate, precision)
    assert found.agrees, found


def right(u):
    """Tips and index of the paper's arm in NumPy."""
    return BUILT["NumPy, closed form"].evaluate(PAPER, np.float64)(u)


@pytest.mark.parametrize(
    ("wrong", "errors"),
    [
        (lambda tips, raw: (tips + [0, 0, 1e-3], raw), ("tip_error", 1e-3)),
        (lambda tips, raw: (tips, raw * 1.001), ("dexterity_error", 1e-3)),
        (lambda tips, raw: (tips, np.where(raw > np.median(raw), raw, 0.0)), ("dexterity_error", None)),
        (lambda tips, raw: (tips, np.where(raw == raw.max(), np.nan, raw)), ("dexterity_error", None)),
    ],
    ids=["tip", "scale", "zeros", "nan"],
)
def test_a_wrong_one_is_found_out(wrong, errors, family):
    found = verdict(family, lambda u: wrong(*right(u)))
    assert found.agrees is False
    name, value = errors
    if value is not None:
        assert getattr(found, name) == pytest.approx(value, rel=0.3)


def test_a_comparator_inside_the_flow_leaves_the_same_maxima(family):
    ours = compare.filled(family, PAPER, "f64", 1 << 16, 7)
    theirs = compare.filled(Foreign(family.members, right), PAPER, "f64", 1 << 16, 7)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(a.hits, b.hits)
        np.testing.assert_allclose(a.values, b.values, atol=1e-12)


def test_the_flow_asks_the_comparator(family):
    """Half of the index leaves half of every maximum."""
    ours = compare.filled(family, PAPER, "f64", 1 << 14, 7)
    halved = Foreign(family.members, lambda u: (right(u)[0], 0.5 * right(u)[1]))
    theirs = compare.filled(halved, PAPER, "f64", 1 << 14, 7)
    largest = [max(filled.values.max() for filled in each) for each in (ours, theirs)]
    assert largest[1] == pytest.approx(largest[0] / 2, abs=1e-9)


@pytest.mark.parametrize("parts", [{"arm": compare.NumpyArm(PAPER)}, {"index": compare.NumpyIndex(PAPER)}])
def test_parts_in_plain_numpy_agree(parts, family):
    error = compare.difference(family, PAPER.family(**parts))
    assert compare.checked(RECORD, error).agrees


def test_who_cannot_be_had_is_left_out(monkeypatch):
    def fail(case, dtype):
        raise AttributeError("renamed since")

    missing = Comparator("nobody", lambda case, dtype: right, module="no_such_module")
    monkeypatch.setattr(compare, "COMPARATORS", (missing, Comparator("newer", fail)))
    monkeypatch.setattr(native, "built", lambda source, flags: shipped("no_such_source.cpp"))
    contenders, left_out = compare.contenders((1,), lambda text: None, (6,), ("f64",))
    assert {c.record.who for c in contenders} == {"eiwa", "eiwa, NumPy arm", "eiwa, NumPy index"}
    assert left_out == [
        "roof: no_such_source.cpp did not come with eiwa",
        "nobody: no_such_module is not installed",
        "newer: AttributeError: renamed since",
    ]


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_the_roof_leaves_the_same_maxima(precision, monkeypatch):
    monkeypatch.setattr(compare, "COMPARATORS", ())
    contenders, _ = compare.contenders((1,), lambda text: None, (6,), (precision,))
    (roof,) = (c.record for c in contenders if c.record.who == "roof")
    assert roof.agrees, roof.dexterity_error
    assert roof.dexterity_error < {"f64": 1e-12, "f32": 1e-5}[precision]
    assert roof.flops > 300


def test_a_compiler_that_refuses(tmp_path, monkeypatch):
    (tmp_path / "wrong.cpp").write_text("int main() { return no_such_name; }\n")
    monkeypatch.setenv("EIWA_CACHE", str(tmp_path))
    monkeypatch.setattr(native, "shipped", lambda name: tmp_path / name)
    if shutil.which("g++") is None:
        monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(Missing, match=r"no C\+\+ compiler|fails: .*wrong.cpp"):
        native.built("wrong.cpp", ())
