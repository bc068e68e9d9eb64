"""Visits in turn, what is summed up of them, and the table that they are kept in."""

import itertools
import os
from dataclasses import replace

import pytest

from eiwa.bench import measure
from eiwa.bench.measure import Contender, Record, cores, interleaved
from eiwa.core.kernel import thread_count

RECORD = Record("compare", "eiwa", "flow", "sample", 6, "f64", 1, 1024, 0.01)
OWN = ["what", "who", "part", "unit", "joints", "precision", "threads", "samples", "voxel", "visits"]
FOUND = ["seconds", "least", "lower", "upper", "ratio", "agrees", "tip_error", "dexterity_error", "flops", "others"]
MACHINE = ["started", "host", "cpu", "features", "versions"]


def silent(text):
    """Nobody listens."""


def contender(who, times, base=None, **changes):
    """Visits that give these times, again and again."""
    return Contender(replace(RECORD, who=who, **changes), itertools.cycle(times).__next__, base)


@pytest.fixture
def clock(monkeypatch):
    """Time passes by a second at every look."""
    monkeypatch.setattr(measure.time, "perf_counter", itertools.count().__next__)


def test_medians_quartiles_and_ratios_of_visits_in_turn(clock):
    order = []
    eiwa = contender("eiwa", [1.0, 2.0, 4.0, 8.0, 16.0])
    other = contender("other", [10.0, 10.0, 80.0, 8.0, 160.0], eiwa)
    first, second = interleaved([eiwa, other], 13, lambda text: order.append(text.split(": ")[1]))
    assert order == ["eiwa", "other"] * 5
    assert (first.visits, first.seconds, first.least, first.lower, first.upper, first.ratio) == (5, 4, 1, 2, 8, 1)
    assert (second.seconds, second.least, second.ratio) == (10, 8, 10)  # of 10, 5, 20, 1, 10


def test_everybody_is_visited_once_when_there_is_no_time():
    (record,) = interleaved([contender("eiwa", [3.0])], 0.0, silent)
    assert (record.visits, record.seconds) == (1, 3.0)


def test_who_is_wrong_is_reported_and_not_timed():
    wrong = Contender(replace(RECORD, who="wrong", agrees=False), lambda: pytest.fail("was visited"))
    records = interleaved([contender("eiwa", [3.0]), wrong], 0.0, silent)
    assert [(r.who, r.seconds) for r in records] == [("eiwa", 3.0), ("wrong", None)]


WARMED = [0.0, measure.WARM / 2, measure.WARM]


def test_a_visit_is_the_median_of_some_calls_after_others_that_warm_up(monkeypatch):
    calls = []
    times = iter([*WARMED, 1.0, 1.010, 2.0, 2.030, 3.0, 3.020, 4.0, 4.016, 5.0, 5.015])
    monkeypatch.setattr(measure.time, "perf_counter", times.__next__)
    assert measure.visit(calls.append, 160)() == pytest.approx(0.016 / 160)
    assert calls == [10, *[160] * 6]


def test_a_slow_visit_is_one_call(monkeypatch):
    calls = []
    monkeypatch.setattr(measure.time, "perf_counter", iter([0.0, measure.WARM, 1.0, 3.0]).__next__)
    assert measure.visit(calls.append, 16)() == 2.0 / 16
    assert calls == [1, 16]


@pytest.mark.parametrize("before", [None, "7"])
def test_cores_holds_threads_and_gives_them_back(before, monkeypatch):
    monkeypatch.delenv("EIWA_THREADS", raising=False)
    if before:
        monkeypatch.setenv("EIWA_THREADS", before)
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else {0}
    with cores(1):
        assert thread_count() == 1
        if hasattr(os, "sched_getaffinity"):
            assert os.sched_getaffinity(0) == {min(allowed)}
    assert os.environ.get("EIWA_THREADS") == before
    if hasattr(os, "sched_getaffinity"):
        assert os.sched_getaffinity(0) == allowed


def test_one_table_of_everything(tmp_path):
    import pyarrow.parquet as pq

    timed = replace(
        RECORD, visits=3, seconds=1e-8, least=1e-8, lower=1e-8, upper=2e-8, ratio=1.0, agrees=True, flops=416
    )
    records, where = [timed, replace(RECORD, who="wrong", agrees=False)], measure.machine()
    measure.write(records, where, tmp_path / "bench.parquet")
    assert pq.read_schema(tmp_path / "bench.parquet").names == OWN + FOUND + MACHINE
    assert measure.read(tmp_path / "bench.parquet") == (records, where)
    assert where["host"]
    assert '"numba"' in where["versions"]
