"""Objectives, constraints, scenarios and execution that cannot be are told of by path, value and remedy."""

import pytest

from eiwa.core.errors import SpecError
from tests.study import small

ADJUST = "[operator]\nadjust = { armrest = { low = 0.0, high = 0.1, step = 0.05 } }\n"
MAX = 'direction = "maximize"'


def said(changes=None, extra=""):
    with pytest.raises(SpecError) as error:
        small.spec(changes, extra)
    return str(error.value)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (f'expression = "3"\n{MAX}', "objectives.0.expression = '3': reads no metric"),
        (f'expression = ""\n{MAX}', "objectives.0.expression = '': is not an expression"),
        (f'expression = "F *"\n{MAX}', "objectives.0.expression = 'F *': is not an expression"),
        (f'metric = "F*2"\n{MAX}', "objectives.0.metric: no metric yields 'F*2'; did you mean 'F'"),
        (f'metric = "F"\nover = "scenarios"\n{MAX}', "objectives.0.over = 'scenarios': the study has no scenarios"),
        (f'metric = "F"\nover = "scenarios"\naggregate = "min"\ntail = 0.1\n{MAX}', "tail belongs to aggregate"),
        (f'metric = "F"\n{MAX}\n[[objectives]]\nmetric = "F"\n{MAX}', "objectives.1: is called 'F', as objectives.0"),
    ],
)
def test_objectives_that_cannot_be(lines, told):
    assert told in said({small.OBJECTIVE: f"[[objectives]]\n{lines}\n\n"})


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ('expression = "reach < 0.4"', "constraints.1.expression = 'reach < 0.4': is not an inequality"),
        ('expression = "lambda x: x <= 1"', "constraints.1.expression = 'lambda x: x <= 1': is not an inequality"),
        ('expression = "1 <= 2"', "constraints.1.expression = '1 <= 2': reads no variable"),
        ('expression = "F >= 0.1"', 'F is a metric, not a parameter: write metric = "F" with min or max'),
        ('expression = "arm.joints.uper.a <= 1"', "arm.joints has no 'uper'; did you mean 'upper'?"),
        ('expression = "layout.offset <= 1"', "layout.offset holds no number, but [0.0, 0.802, 0.1]"),
        ('expression = "9**9**9**9 <= reach"', "is too large"),
        (
            'metric = "F"\nmin = 1.5\nover = "scenarios"\naggregate = "share_above"\nlevel = 0.2\n'
            '[scenarios]\n"dexterity.K" = [50, 12270]',
            "constraints.1: nothing can meet 1.5 <= share F >= 0.2: a share lies between 0 and 1",
        ),
    ],
)
def test_constraints_that_cannot_be(lines, told):
    assert told in said(extra=f"[[constraints]]\n{lines}\n")


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ('[scenarios]\n"layout.spacing" = [0.2, 0.3]', 'scenarios."layout.spacing": the search chooses this value'),
        (f'[scenarios]\n"operator.armrest" = [0, 0.1]\n{ADJUST}', "the operator adjusts this value already"),
        (
            '[scenarios]\n"dexterity.K" = [1, 2]\n[scenarios.B]\n"dexterity.K" = 3',
            'scenarios.B."dexterity.K": [scenarios]',
        ),
        ('[scenarios]\n"study.seed" = [1, 2]', "nothing of 'study' can change here"),
        ("[scenarios.A]\nhuman = { percentile = 5 }", "human = { kind = ... }"),
        (
            "[scenarios]\n"
            + "".join(f'"layout.offset.{i}" = {{ low = 0, high = 1, step = 0.01 }}\n' for i in range(3)),
            "scenarios: 1030301 combinations",
        ),
    ],
)
def test_scenarios_that_cannot_be(lines, told):
    assert told in said(extra=f"{lines}\n")


def test_a_searched_value_is_not_the_operators_too():
    assert 'search."operator.armrest": the operator adjusts' in said(
        {"[search]": '[search]\n"operator.armrest" = { low = 0.0, high = 0.1 }'}, ADJUST
    )


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('scheduler = "localhost"', "execution.scheduler = 'localhost': is not of the form that is needed. Address of"),
        ('storage = "mysql://x"', "is not of the form that is needed. URL of Optuna's storage, as postgresql://"),
    ],
)
def test_addresses_of_another_form(line, told):
    assert told in said(extra=f"[execution]\n{line}\n")


def test_steps_beyond_the_range():
    assert "variables.reach: a step of 5 leads from 0.2 beyond 0.44" in said(
        {"high = 0.44 }": "high = 0.44, step = 5 }"}
    )


def test_catalogues_hold_finite_numbers():
    assert "finite numbers" in said(extra='[catalogue]\n"layout.spacing" = [nan]\n')


def test_listed_values_are_seen_from_the_named_table():
    """A named table that changes a listed path: the label says what differs from that table, not from the file."""
    table = 'dexterity = { kind = "yoshikawa", K = 50, threshold = 0.3 }'
    spec = small.spec(extra=f'[scenarios]\n"dexterity.K" = [50, 12270]\n[scenarios.A]\n{table}\n')
    K = {s.label: spec.design(s.overrides).resolved()["dexterity"]["K"] for s in spec.scenarios}
    assert K == {"": 12270, "dexterity.K=50": 50, "A": 50, "A dexterity.K=12270": 12270}
