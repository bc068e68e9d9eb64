"""``eiwa bench``: everything visited once, written, drawn, and a wrong comparator not called fast."""

import json

import numpy as np
import pytest

from eiwa.bench import compare, measure, native, scaling
from eiwa.bench.cases import Missing
from eiwa.bench.comparators import COMPARATORS, Comparator
from eiwa.cli.bench import views

NUMPY = next(c for c in COMPARATORS if c.who == "NumPy, closed form")


@pytest.fixture
def few(monkeypatch):
    """NumPy alone, no compiler, and few samples."""

    def refuse(source, flags):
        raise Missing("no C++ compiler; install g++ or set CXX")

    monkeypatch.setattr(native, "built", refuse)
    monkeypatch.setattr(compare, "COMPARATORS", (NUMPY,))
    monkeypatch.setattr(compare, "SAMPLES", 1 << 14)
    monkeypatch.setattr(scaling, "SAMPLES", 1 << 14)
    monkeypatch.setattr(scaling, "COUNTS", (1 << 12, 1 << 13, 1 << 14, 1 << 15))
    monkeypatch.setenv("EIWA_THREADS", "1")


def test_compare(few, cli):
    said = cli("bench", "compare", "--quick", "--json")
    assert said.code == 0, said.err
    answer = json.loads(said.out)
    assert answer["left_out"] == ["roof: no C++ compiler; install g++ or set CXX"]
    assert answer["machine"]["features"]
    found = {(r["who"], r["part"]): r for r in answer["records"]}
    others = [("eiwa, NumPy arm", "flow"), ("eiwa, NumPy arm", "rest"), ("eiwa, NumPy index", "flow")]
    assert list(found) == [("eiwa", "flow"), (NUMPY.who, "flow"), *others, ("eiwa, NumPy index", "rest")]
    assert all(r["seconds"] > 0 and r["visits"] == 1 for r in found.values())
    eiwa, numpy = found["eiwa", "flow"], found[NUMPY.who, "flow"]
    assert numpy["ratio"] == pytest.approx(numpy["seconds"] / eiwa["seconds"])
    assert numpy["agrees"] and numpy["tip_error"] < 1e-12


def test_scaling_is_written_and_drawn(few, cli, tmp_path):
    said = cli("bench", "scaling", "--seconds", "0.01", "--quick", "--out", tmp_path / "new")
    assert said.code == 0, said.err
    assert max(map(len, said.out.splitlines())) <= 80
    for words in ("Scaling with samples", "Scaling with joints", "voxel [mm]", "Scaling with threads"):
        assert words in said.out
    records, _ = measure.read(tmp_path / "new/bench.parquet")
    assert {r.part for r in records} == {"base", "samples", "joints", "voxel", "threads"}
    assert (tmp_path / "new/scaling.png").read_bytes()[:4] == b"\x89PNG"
    assert not (tmp_path / "new/compare.png").exists()


def test_a_wrong_comparator_is_called_wrong(few, cli, monkeypatch):
    def build(case, dtype):
        evaluate = NUMPY.build(case, dtype)
        return lambda u: (evaluate(u)[0] + 1e-3, evaluate(u)[1])

    monkeypatch.setattr(compare, "COMPARATORS", (Comparator("shifted", build, precisions=("f64",)),))
    said = cli("bench", "compare", "--quick")
    assert said.code == 1
    assert "shifted, 6 joints, f64: differs from eiwa, so it is not timed." in said.err
    (line,) = (line for line in said.out.splitlines() if line.split()[:1] == ["shifted"])
    assert line.split() == ["shifted", "wrong"]


@pytest.mark.parametrize("arguments", [("everything",), ("--seconds", "-1")], ids=" ".join)
def test_what_cannot_be_measured(arguments, cli):
    said = cli("bench", *arguments)
    assert (said.code, said.out) == (2, "")


def test_views_stay_within_80_columns_and_know_the_goals():
    """A whole comparison with times that are known: 20 ns for eiwa, half of it for the roof."""
    from dataclasses import replace

    base = measure.Record("compare", "eiwa", "flow", "sample", 7, "f64", 1, 1 << 20, 0.01)

    def timed(who, ns, ratio, **changes):
        times = dict.fromkeys(("seconds", "least", "lower", "upper"), 1e-9 * ns)
        return replace(base, who=who, visits=3, ratio=ratio, **times, **changes)

    records = [
        record
        for t in (1, 64)
        for record in (
            timed("eiwa", 20.0, 1.0, threads=t),
            timed("roof", 10.0, 0.5, threads=t, agrees=True),
            timed("matrix product", 6.0, 0.3, threads=t, part="product", flops=420),
            timed("robotics-toolbox", 123456.0, 6172.8, threads=t),
            timed("eiwa, NumPy index", 500.0, 25.0, threads=t),
            timed("eiwa, NumPy index", 30.0, 1.5, threads=t, part="rest"),
        )
    ]
    *_, roofs, forms, goals = views(records)
    assert list(roofs.rows[0]) == ["7", "f64", "1", "420", "70", "60%", "2.00"]
    assert list(forms.rows[0]) == ["eiwa, NumPy index", "7", "1", "500", "30.0", "3.00"]
    assert [list(row) for row in goals.rows] == [
        ["robotics-toolbox / eiwa", "at least 1000", "6,173", "6,173"],
        ["eiwa / roof", "at most 1.5", "2.00", "2.00"],
        ["rest of the array form / roof", "at most 4", "3.00", "3.00"],
        ["matrix product / roof", "at least 0.45", "0.60", "0.60"],
    ]
    for view in views(records):
        wide = np.max(
            [[len(cell) for cell in row] for row in (*view.rows, [c.split("\n")[-1] for c in view.columns])], axis=0
        )
        assert wide.sum() + 2 * len(wide) <= 80
