"""The paper's study: its two published F, and a search that finds its optimum whatever the seed."""

import copy
import tomllib
from pathlib import Path

import pytest

from eiwa.core.outcome import evaluate
from eiwa.core.spec import check
from tests.study import small

PAPER = Path(__file__).parents[2] / "studies/paper.toml"
SEARCHED = ("F", "reach")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "published", "tolerance"), [("original", 0.0057, 0.0006), ("optimum", 0.2732, 0.014)]
)
def test_the_published_F(design, published, tolerance, tmp_path):
    """Tolerances: 10 % of the small one, 5 % of the large one."""
    found = small.answer("evaluate", PAPER, "--design", design, folder=tmp_path)
    assert found["metrics"]["F"] == pytest.approx(published, abs=tolerance, rel=0)
    assert found["metrics"]["F_se"] < tolerance
    assert found["replicates"] == 4


def reduced(seed):
    """The study without scenarios and volumes; sampling unchanged."""
    tree = copy.deepcopy(tomllib.loads(PAPER.read_text()))
    del tree["scenarios"]
    tree["metrics"] = {name: table for name, table in tree["metrics"].items() if name in SEARCHED}
    tree["study"]["seed"] = seed
    return check(tree, PAPER)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_the_search_finds_the_optimum(seed, tmp_path):
    """Within 2 % of the published design's F in 200 trials, at designs that reach no farther."""
    spec = reduced(seed)
    assert spec.study.trials == 200
    rows = small.run(spec, tmp_path).rows()
    optimum = evaluate(spec, spec.designs["optimum"].overrides).scenarios[""]["F"]
    trials = [r for r in rows if r["kind"] == "trial"]
    assert [r["number"] for r in trials] == list(range(200))
    assert max(r["metrics.F"] for r in trials if r["feasible"]) >= 0.98 * optimum
    assert all(r["metrics.reach"] <= 0.44 + 1e-6 for r in trials)
