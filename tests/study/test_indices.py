"""Every index in a small study, from the file to the rows."""

import pytest

from eiwa.core.outcome import evaluate
from tests.study import small

LENGTH = "dexterity.factors.0.length"
OBJECTIVE = 'direction = "maximize"\n'
YOSHIKAWA = 'kind = "yoshikawa"\nK = 12270'
QUICK = {"replicates = 2": "replicates = 1"}
FACTORS = """kind = "product"
factors = [{ kind = "condition", rows = "translation" }, { kind = "joint_limits", K_scaled = 3.0 }]
"""
KINDS = {
    "condition": 'kind = "condition"\nrows = "translation"',
    "smallest_singular_value": 'kind = "smallest_singular_value"\nrows = "rotation"',
    "isotropy": 'kind = "isotropy"\nrows = "translation"',
    "joint_limits": 'kind = "joint_limits"\nform = "mean"',
    "extended": 'kind = "extended"\nrows = "translation"',
}


@pytest.mark.parametrize("kind", KINDS)
def test_an_index_evaluates_in_a_study(kind):
    numbers = evaluate(small.spec({YOSHIKAWA: KINDS[kind], **QUICK}), {}).scenarios[""]
    assert 0 < numbers["F"] < 1


def test_a_product_takes_scenarios_and_searched_parameters(tmp_path):
    """Rows of one kind are divided by any length alike, which leaves 1 / cond; K is the second factor's."""
    changes = {
        YOSHIKAWA: FACTORS,
        "trials = 8": "trials = 4",
        small.SEARCH: '[search]\n"dexterity.factors.1.K_scaled" = { low = 1.0, high = 9.0 }\n\n',
        small.DESIGN: "",
        OBJECTIVE: OBJECTIVE + 'over = "scenarios"\naggregate = "mean"\n',
        **QUICK,
    }
    extra = '\n[scenarios]\n"dexterity.factors.0.length" = [0.1, 1.0]\n[metrics.gci]\nrows = "translation"\n'
    rows = small.run(small.spec(changes, extra), tmp_path).rows()
    trials = [row for row in rows if row["kind"] == "trial"]
    assert len({row["parameters.dexterity.factors.1.K_scaled"] for row in trials}) == 4
    assert len({row[f"metrics.F@{LENGTH}=0.1"] for row in trials}) == 4
    for row in trials:
        assert row[f"metrics.F@{LENGTH}=0.1"] == pytest.approx(row[f"metrics.F@{LENGTH}=1.0"], rel=1e-9)
        assert row[f"metrics.gci@{LENGTH}=0.1"] == trials[0][f"metrics.gci@{LENGTH}=1.0"]
