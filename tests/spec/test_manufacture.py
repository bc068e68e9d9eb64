"""[tolerance] and [catalogue]: what they draw, what they refuse, and that they change no trial."""

import numpy as np
import pytest

from eiwa.core.errors import SpecError
from eiwa.core.manufacture import ToleranceSection
from tests.study import small

BOTH = """[tolerance]
"arm.joints.upper.a" = { normal = 0.0005 }
"arm.joints.upper.limits.1" = { uniform = 1.0 }
[catalogue]
"arm.joints.upper.a" = [0.20, 0.15, 1]
"""


@pytest.mark.parametrize(("tolerance", "deviation"), [({"normal": 0.2}, 0.2), ({"uniform": 0.6}, 0.6 / 3**0.5)])
def test_errors_have_the_deviation_that_is_said(tolerance, deviation):
    section = ToleranceSection(**tolerance)
    drawn = section.errors(np.random.default_rng(0), 200_000)
    assert section.deviation == pytest.approx(deviation)
    assert drawn.std() == pytest.approx(deviation, rel=0.01)
    assert abs(drawn.mean()) < 0.01 * deviation
    assert "uniform" not in tolerance or np.abs(drawn).max() <= 0.6


def test_the_tables_are_read():
    spec = small.spec(extra=BOTH)
    assert [t.deviation for t in spec.tolerance.values()] == pytest.approx([0.0005, 1 / 3**0.5])
    assert spec.catalogue == {"arm.joints.upper.a": [0.15, 0.20, 1.0]}


def test_they_change_no_trial():
    assert small.spec(extra=BOTH).hash == small.spec().hash


WRONG = {
    'tolerance."arm.joints.uper.a"': ('"arm.joints.uper.a" = { normal = 1.0 }', "did you mean 'upper'"),
    'tolerance."arm.convention"': ('"arm.convention" = { normal = 1.0 }', "holds 'modified', not a number"),
    'tolerance."study.seed"': ('"study.seed" = { normal = 1.0 }', "nothing of 'study' can change here. Known: arm"),
    'tolerance."layout.spacing".normal = -1': ('"layout.spacing" = { normal = -1 }', "greater than 0"),
    'tolerance."layout.spacing".gauss': ('"layout.spacing" = { gauss = 1.0 }', "unknown key"),
    'tolerance."layout.spacing":': ('"layout.spacing" = {}', "give normal (a standard deviation) or uniform"),
    'tolerance."layout.spacing": ': ('"layout.spacing" = { normal = 1.0, uniform = 1.0 }', "give normal"),
    'tolerance."layout.spacing" = 0.1': ('"layout.spacing" = 0.1', "Write { normal = 0.0005 }"),
    "tolerance.layout": ("layout.spacing = { normal = 1.0 }", 'Quote the whole path: "layout.spacing"'),
}


@pytest.mark.parametrize("where", WRONG)
def test_tolerances_that_cannot_be(where):
    line, said = WRONG[where]
    with pytest.raises(SpecError) as error:
        small.spec(extra=f"[tolerance]\n{line}\n")
    assert where in str(error.value)
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("line", "where", "said"),
    [
        ('"arm.joints.uper.a" = [0.1]', 'catalogue."arm.joints.uper.a"', "did you mean"),
        ('"layout.spacing" = []', 'catalogue."layout.spacing" = []', "list of different, finite numbers"),
        ('"layout.spacing" = 0.1', 'catalogue."layout.spacing" = 0.1', '"layout.spacing" = [0.15'),
        ('"layout.spacing" = [0.1, 0.1]', 'catalogue."layout.spacing"', "list of different, finite numbers"),
        ('"layout.spacing" = [0.1, true]', 'catalogue."layout.spacing"', "list of different, finite numbers"),
        ("layout.spacing = [0.1]", "catalogue.layout", "Quote the whole path"),
    ],
)
def test_catalogues_that_cannot_be(line, where, said):
    with pytest.raises(SpecError) as error:
        small.spec(extra=f"[catalogue]\n{line}\n")
    assert where in str(error.value)
    assert said in str(error.value)
