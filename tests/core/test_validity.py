"""Arms with postures that are not valid: a gantry whose tip is its joint vector, and which may not pass a plane."""

from dataclasses import replace

import numpy as np
import pytest

from eiwa.core.chain import Coupling
from eiwa.core.dexterity import Family, prepare
from eiwa.core.elites import refine
from eiwa.core.errors import SpecError
from eiwa.core.evaluation import metrics
from eiwa.core.filling import Sampling, fill
from eiwa.core.finite import all_finite
from eiwa.core.reuse import samples
from eiwa.core.symbols import as_columns
from eiwa.core.workspace import Grid, Target
from eiwa.plugins.dexterity.yoshikawa import Yoshikawa
from eiwa.plugins.metrics.interaction import ValidShare, ValidShareParameters
from tests import arms
from tests.core import rig

R = 0.125
GRID = Grid(R, (-4, -4, -4), (8, 8, 8))
TARGET = Target(GRID, np.eye(4))
HALF = replace(arms.gantry(*[(-0.5, 0.5)] * 3), couplings=(Coupling({"x": 1.0, "y": 1.0}, -2.0, 0.0),))
"""x + y <= 0: half of the joint vectors."""
NEVER = replace(HALF, couplings=(Coupling({"x": 1.0}, 3.0, 4.0),))
SUMS = GRID.centres(0)[:, None, None] + GRID.centres(1)[:, None] + 0 * GRID.centres(2)
"""x + y at the cells' centres."""


class ArrayHalf(arms.ArrayArm):
    """In plain NumPy, with nonsense where there is no solution."""

    def postures(self, u):
        at = self.chain.postures(u)
        return replace(at, tips=np.where(at.valid[:, None], at.tips, np.nan))


ARMS = {"traced": HALF, "arrays": ArrayHalf(HALF)}


@pytest.fixture(params=ARMS.values(), ids=ARMS)
def arm(request):
    return request.param


def test_the_share_of_valid_postures(arm):
    assert prepare(arm, rig.One(), None, 0.0).valid_share == pytest.approx(0.5, abs=1e-3)


def test_every_posture_of_a_free_arm_is_valid():
    assert prepare(arms.gantry(*[(-0.5, 0.5)] * 3), rig.One(), None, 0.0).valid_share == 1.0


def test_the_share_is_a_number_of_every_evaluation(arm):
    design = rig.setup(arm, rig.One(), metrics={"valid_share": ValidShare(ValidShareParameters())})
    measurement = rig.measured(replace(design, sampling=Sampling(1 << 10)))
    assert metrics(measurement) == {"valid_share": measurement.dexterity.valid_share}


@pytest.mark.parametrize("index", [rig.One(), Yoshikawa(None, 3.0, (0, 1, 2))], ids=["one", "prepared"])
@pytest.mark.parametrize("never", [NEVER, ArrayHalf(NEVER)], ids=ARMS)
def test_an_arm_that_is_nowhere_valid_is_told(never, index):
    with pytest.raises(SpecError, match=r"arm: none of 16384 postures .* is valid\. Check coupled limits"):
        prepare(never, index, None, 0.0)


def test_an_index_is_prepared_with_valid_postures(arm):
    seen = []

    class Learning(rig.ArrayIndex):
        def prepare(self, arm, pilot):
            seen.append(pilot)
            return np.zeros(0)

    prepare(arm, Learning(lambda postures: np.ones(len(postures.u))), None, 0.0)
    assert len(seen[0].u) == pytest.approx(1 << 13, abs=16)
    assert (seen[0].tips[:, 0] + seen[0].tips[:, 1] <= 0).all()


def test_the_normaliser_is_the_largest_valid_value(arm):
    """2 + x + y is 3 at the corner, but 2 within x + y <= 0."""
    index = rig.ArrayIndex(lambda postures: 2 + postures.q[:, 0] + postures.q[:, 1])
    normaliser = prepare(arm, index, None, 0.0).normaliser
    assert 2 - 1e-3 < normaliser <= 2


def test_the_reach_is_that_of_valid_postures(arm):
    """(0.5, 0.5, 0.5) is out of bounds, (-0.5, -0.5, 0.5) is not; a plane through the origin leaves one octant's corner."""
    assert prepare(arm, rig.One(), None, 0.0).reach == pytest.approx(np.sqrt(0.75), abs=1e-4)
    quarter = replace(HALF, couplings=(Coupling({"x": 1.0, "y": 1.0}, 0.0, 0.0 + 1e-2),))
    assert prepare(quarter, rig.One(), None, 0.0).reach == pytest.approx(np.sqrt(0.75), abs=1e-2)


def test_invalid_samples_are_not_deposited(arm):
    dexterity, stream = prepare(arm, rig.One(), None, 0.0), rig.stream()
    filled = rig.fill_one(dexterity, [TARGET], rig.BACKENDS["max"], stream, Sampling(1 << 16))[0]
    values, hits = rig.filled_by_numpy(dexterity, TARGET, stream, 1 << 16)
    np.testing.assert_array_equal(filled.hits, hits)
    np.testing.assert_array_equal(filled.values, values)
    assert hits[SUMS > R].sum() == 0
    assert (hits[SUMS < R / 2] > 0).all()


def test_kept_samples_remember_what_was_valid():
    family = Family((prepare(HALF, rig.One(), None, 0.0),))
    before = samples.hits
    first, _, third = (
        fill(family, [TARGET], rig.BACKENDS["max"], rig.stream(key=77), Sampling(1 << 15))[0][0] for _ in range(3)
    )
    assert samples.hits == before + 1
    np.testing.assert_array_equal(first.hits, third.hits)


def test_elites_are_valid(arm):
    family = Family((prepare(arm, rig.One(), None, 0.0),))
    (((filled,), (refinement,)),) = refine(family, [TARGET], [np.ones(GRID.shape)], rig.stream(), Sampling(1 << 18))
    elites = refinement.elites[0]
    found = elites[~np.isnan(elites[:, 0])] - 0.5
    assert (found[:, 0] + found[:, 1] <= 1e-12).all()
    np.testing.assert_array_equal(filled.values, SUMS < R / 2)


def test_a_row_does_not_change_the_index():
    """Nearness to a coupled limit is not penalised."""
    index, u = Yoshikawa(None, 3.0, (0, 1, 2)), as_columns(np.array([[0.25, 0.6, 0.5], [0.1, 0.2, 0.3]]))
    with_row, without = (
        index.columns(arm.columns(u, list(arm.constants)), [3.0]) for arm in (HALF, replace(HALF, couplings=()))
    )
    np.testing.assert_array_equal(with_row, without)


@pytest.mark.parametrize("wrong", [np.nan, -np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("layout", [lambda a: a, lambda a: a.T, lambda a: a[:, ::2], lambda a: a.astype(np.float32)])
def test_one_entry_that_is_not_finite_is_found_anywhere(wrong, layout):
    values = np.random.default_rng(1).normal(size=(41, 6)) * 1e30
    assert all_finite(layout(values))
    for at in [(0, 0), (20, 2), (40, 4)]:
        spoilt = values.copy()
        spoilt[at] = wrong
        assert not all_finite(layout(spoilt))


def test_large_numbers_are_finite():
    assert all_finite(np.full(5, -np.finfo(float).max))
    assert all_finite(np.empty((0, 3)))
