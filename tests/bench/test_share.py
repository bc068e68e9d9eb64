"""The clock at the doors of a trial's stages, and the shares that come out."""

import pytest

from eiwa.bench import share
from eiwa.bench.share import PARTS, STAGES, Clock, SearchOver


@pytest.fixture
def now(monkeypatch):
    """A time that the test sets."""
    time = {"now": 0.0}
    monkeypatch.setattr(share.time, "perf_counter", lambda: time["now"])
    return time


def test_a_stage_is_charged_without_what_it_asks_of_another(now):
    clock = Clock()

    def spend(seconds, then=lambda: None):
        now["now"] += seconds
        then()
        now["now"] += seconds

    inner = clock.at("inner", lambda: spend(1.0))
    outer = clock.at("outer", lambda: spend(2.0, inner))
    outer()  # nobody searches yet
    clock.begin("search", 1, 0)
    now["now"] += 0.5
    outer()
    inner()
    with pytest.raises(SearchOver):
        clock.begin("leaders", 1, 0)
    outer()
    assert dict(clock.seconds) == {"rest": 0.5, "outer": 4.0, "inner": 4.0}


def test_a_stage_that_fails_is_left(now):
    clock = Clock()
    clock.begin("search", 1, 0)

    def fail():
        now["now"] += 1.0
        raise ValueError

    with pytest.raises(ValueError):
        clock.at("stage", fail)()
    now["now"] += 2.0
    clock.begin("designs", 1, 0)
    assert dict(clock.seconds) == {"stage": 1.0, "rest": 2.0}


@pytest.fixture
def paper(tmp_path, monkeypatch):
    """The paper's study with few samples."""
    text = share.shipped("paper.toml").read_text()
    assert "1_048_576" in text
    (tmp_path / "paper.toml").write_text(text.replace("1_048_576", "65_536"))
    monkeypatch.setattr(share, "shipped", lambda name: tmp_path / name)


def test_shares_of_the_paper_study(paper, monkeypatch):
    monkeypatch.setattr(share, "FEWEST", 2)
    records = share.records((1,), 0.0, lambda text: None, quick=True)
    seconds = {r.part: r.seconds for r in records}
    assert list(seconds) == [*PARTS, *(s for s in STAGES if s != "fill"), "rest", "trial"]
    assert sum(seconds[part] for part in seconds if part != "trial") == pytest.approx(seconds["trial"])
    assert sum(r.ratio for r in records if r.part != "trial") == pytest.approx(1.0)
    # Every door was passed: a function that moved away from its door would take no time.
    assert all(seconds[stage] > 0 for stage in STAGES if stage not in ("fill", "elites"))
    assert sum(seconds[part] for part in PARTS) > 0
    assert seconds["elites"] == 0  # which it does not use
