"""Filling voxels: against NumPy, in both flows, for any number of threads, and against known volumes."""

from dataclasses import replace

import numpy as np
import pytest

from eiwa.core.chain import SerialChain
from eiwa.core.dexterity import Dexterity, Family, prepare
from eiwa.core.errors import PluginError, SingularArm
from eiwa.core.filling import Sampling, Shelf, fill
from eiwa.core.interfaces import NOTHING, TracedIndex
from eiwa.core.sampling import ARRAY_BLOCK
from eiwa.core.transforms import roll_pitch_yaw, translation
from eiwa.core.workspace import Grid, Target
from eiwa.plugins.dexterity.yoshikawa import Yoshikawa
from eiwa.plugins.voxels.stores import Dense, Sparse
from tests import arms
from tests.arms import ArrayArm
from tests.core.rig import BACKENDS, PAPER_INDEX, ArrayIndex, One, fill_one, filled_by_numpy, stream

ARM = arms.paper(limits=(-2.0, 2.0))
POSE = translation(0.02, 0.3, -0.05) @ roll_pitch_yaw(0.3, 0.2, -1.0)
TARGETS = [
    Target(Grid(0.03, (-10, 0, -12), (22, 25, 20)), POSE),
    Target(Grid(0.05, (-9, -9, -9), (18, 18, 18)), np.eye(4)),
]
MANY = 200_001
"""Three chunks for each half, and a block that is not full."""


@pytest.fixture(scope="module")
def dexterity():
    return prepare(ARM, PAPER_INDEX, None, 0.2)


# The same bits for any number of threads.

WAYS = [
    ("max", "plain", np.float64),
    ("max", "sobol", np.float32),
    ("mean", "plain", np.float32),
    ("mean", "sobol", np.float64),
]
"""Every pair of aggregate, sequence and precision; each is a kernel of its own."""


@pytest.fixture(scope="module", params=WAYS, ids=lambda way: f"{way[0]}-{way[1]}-{way[2].__name__}")
def way(request, dexterity):
    """One way to fill, and what it gives on one thread."""
    aggregate, sequence, dtype = request.param

    def run(threads):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("EIWA_THREADS", str(threads))
            amount = Sampling(MANY, dtype)
            return fill_one(dexterity, TARGETS, BACKENDS[aggregate], stream(sequence), amount)

    return request.param, run, run(1)


@pytest.mark.parametrize("quantity", ["values", "half", "hits"])
@pytest.mark.parametrize("threads", [2, 3])
def test_same_bits_for_any_number_of_threads(way, threads, quantity):
    _, run, one = way
    for several, single in zip(run(threads), one, strict=True):
        np.testing.assert_array_equal(getattr(several, quantity), getattr(single, quantity))


@pytest.mark.parametrize("target", [0, 1])
def test_hits_equal_numpys(way, dexterity, target):
    (aggregate, sequence, dtype), _, filled = way
    _, hits = filled_by_numpy(dexterity, TARGETS[target], stream(sequence), MANY, aggregate)
    moved = np.abs(filled[target].hits - hits).sum()
    assert moved <= (0 if dtype is np.float64 else 1e-4 * MANY)


@pytest.mark.parametrize("target", [0, 1])
def test_values_equal_numpys(way, dexterity, target):
    """Singles: within 2e-6 but for the few cells that a rounded sample enters or leaves."""
    (aggregate, sequence, dtype), _, filled = way
    values, _ = filled_by_numpy(dexterity, TARGETS[target], stream(sequence), MANY, aggregate)
    error = np.abs(filled[target].values - values)
    worst, share = (2.0**-31, 1.0) if dtype is np.float64 else (2e-6, 0.999)
    assert (error <= worst).mean() >= share


def test_half_is_what_half_the_samples_give(dexterity):
    amount = Sampling(1 << 15)
    whole = fill_one(dexterity, TARGETS, BACKENDS["max"], stream(), amount)[0]
    first = fill_one(dexterity, TARGETS, BACKENDS["max"], stream(), Sampling(amount.half))[0]
    np.testing.assert_array_equal(whole.half, first.values)


@pytest.mark.parametrize(("samples", "half"), [(1, 1), (256, 256), (300, 256), (1000, 512), (1 << 20, 1 << 19)])
def test_half_is_rounded_up_to_whole_blocks(samples, half):
    assert Sampling(samples).half == half


@pytest.mark.parametrize("samples", [1, 255, 256, 257, 1000])
def test_every_sample_is_counted_once(dexterity, samples):
    everywhere = Target(Grid(0.5, (-1, -1, -1), (2, 2, 2)), np.eye(4))
    assert fill_one(dexterity, [everywhere], BACKENDS["max"], stream(), Sampling(samples))[0].hits.sum() == samples


def test_values_lie_between_0_and_1(dexterity):
    values = fill_one(dexterity, TARGETS, BACKENDS["max"], stream(), Sampling(1 << 15))[1].values
    assert 0.0 <= values.min() < values.max() <= 1.0


def test_nothing_between_0_and_the_threshold_survives(dexterity):
    values = fill_one(dexterity, TARGETS, BACKENDS["max"], stream(), Sampling(1 << 15))[1].values
    assert not ((values > 0) & (values < 0.2)).any()


def test_a_maximum_does_not_fall_with_more_samples(dexterity):
    filled = fill_one(dexterity, TARGETS, BACKENDS["max"], stream(), Sampling(1 << 15))[0]
    assert (filled.values >= filled.half).all()


def test_a_smaller_normaliser_caps_values_at_1():
    capped = prepare(ARM, PAPER_INDEX, 1e-6, 0.0)
    values = fill_one(capped, TARGETS, BACKENDS["max"], stream(), Sampling(1 << 14))[1].values
    assert values.max() == 1.0


# The flow of arrays, for arms and indices that cannot be traced.


def untraced_arm():
    return ArrayArm(ARM), PAPER_INDEX


def untraced_index():
    def values(postures):
        return PAPER_INDEX.values(postures, PAPER_INDEX.prepare(ARM, postures))

    return ARM, ArrayIndex(values)


def untraced_arm_and_index():
    return ArrayArm(ARM), untraced_index()[1]


@pytest.fixture(scope="module", params=[untraced_arm, untraced_index, untraced_arm_and_index])
def untraced(request):
    return prepare(*request.param(), None, 0.2)


def test_untraced_parts_have_the_same_normaliser(untraced, dexterity):
    assert untraced.normaliser == pytest.approx(dexterity.normaliser, rel=1e-12)


@pytest.mark.parametrize("aggregate", BACKENDS)
def test_untraced_parts_reach_the_same_cells(untraced, dexterity, aggregate):
    backend, amount = BACKENDS[aggregate], Sampling(70_000)
    array, fused = (fill_one(d, TARGETS, backend, stream(), amount)[0] for d in (untraced, dexterity))
    np.testing.assert_array_equal(array.hits, fused.hits)


@pytest.mark.parametrize("quantity", ["values", "half"])
@pytest.mark.parametrize("aggregate", BACKENDS)
def test_untraced_parts_leave_the_same_values(untraced, dexterity, aggregate, quantity):
    backend, amount = BACKENDS[aggregate], Sampling(70_000)
    array, fused = (fill_one(d, TARGETS, backend, stream(), amount)[0] for d in (untraced, dexterity))
    np.testing.assert_allclose(getattr(array, quantity), getattr(fused, quantity), rtol=0, atol=1e-12)


@pytest.mark.parametrize("threads", [2, 3])
def test_untraced_parts_give_the_same_bits_for_any_number_of_threads(untraced, threads, monkeypatch):
    amount = Sampling(MANY)
    monkeypatch.setenv("EIWA_THREADS", "1")
    one = fill_one(untraced, TARGETS, BACKENDS["mean"], stream(), amount)[0]
    monkeypatch.setenv("EIWA_THREADS", str(threads))
    several = fill_one(untraced, TARGETS, BACKENDS["mean"], stream(), amount)[0]
    np.testing.assert_array_equal(several.values, one.values)


def test_untraced_parts_in_single_precision(untraced, dexterity):
    amount = Sampling(10_000, np.float32)
    array, fused = (fill_one(d, TARGETS, BACKENDS["mean"], stream(), amount)[0] for d in (untraced, dexterity))
    assert np.abs(array.hits - fused.hits).sum() <= 4  # tips that rounding puts on the other side of a face
    same = array.hits == fused.hits
    np.testing.assert_allclose(array.values[same], fused.values[same], rtol=0, atol=1e-4)


@pytest.mark.parametrize("kind", [untraced_arm, untraced_index, untraced_arm_and_index])
def test_untraced_members_of_a_family_are_filled_side_by_side(kind):
    arm, index = kind()
    indices = (index, replace(index, K_scaled=40.0) if index is PAPER_INDEX else ArrayIndex(lambda p: p.u[:, 0]))
    members = tuple(prepare(arm, i, None, threshold) for i, threshold in zip(indices, (0.2, 0.0), strict=True))
    together = fill(Family(members), TARGETS, BACKENDS["max"], stream(), Sampling(20_000))
    for member, filled in zip(members, together, strict=True):
        for one, alone in zip(
            filled, fill_one(member, TARGETS, BACKENDS["max"], stream(), Sampling(20_000)), strict=True
        ):
            np.testing.assert_array_equal(one.values, alone.values)
            np.testing.assert_array_equal(one.hits, alone.hits)


class Scaled(TracedIndex):
    """A sum of coordinates, weighed by as many numbers as it is given."""

    structure = "scaled"

    def __init__(self, *weights):
        self.weights = weights

    def prepare(self, arm, pilot):
        return np.array(self.weights)

    def columns(self, arm, p):
        return sum((weight * u for weight, u in zip(p, arm.u, strict=False)), 0.0)


@pytest.mark.parametrize("arm", [ARM, ArrayArm(ARM)], ids=["fused", "array"])
def test_members_may_prepare_different_numbers_of_numbers(arm):
    for weights in ([(0.3,), (0.1, 0.2, 0.05)], [(0.3, 0.1), (0.2, 0.05)]):
        members = tuple(prepare(arm, Scaled(*w), 1.0, 0.0) for w in weights)
        together = fill(Family(members), TARGETS, BACKENDS["mean"], stream(), Sampling(5_000))
        for member, filled in zip(members, together, strict=True):
            alone = fill_one(member, TARGETS, BACKENDS["mean"], stream(), Sampling(5_000))
            np.testing.assert_array_equal(filled[0].values, alone[0].values)


def test_indices_may_answer_in_the_same_memory():
    room = np.empty(1 << 14)

    def answer(factor):
        return ArrayIndex(lambda at: np.multiply(at.u[:, 0], factor, out=room[: len(at.u)]))

    members = tuple(prepare(ARM, answer(factor), 4.0, 0.0) for factor in (1.0, 2.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EIWA_THREADS", "1")
        one, two = fill(Family(members), TARGETS, BACKENDS["max"], stream(), Sampling(20_000))
    np.testing.assert_array_equal(2 * one[0].values, two[0].values)


class PlainMax(type(BACKENDS["max"])):
    """A backend whose deposit is not compiled."""

    @staticmethod
    def deposit(store, cells, values, count):
        np.maximum.at(store[:, 0], cells[:count], values[:count])
        np.add.at(store[:, 1], cells[:count], 1)


def test_a_backend_in_plain_numpy_gives_the_same_cells(dexterity):
    amount = Sampling(10_000)
    plain, compiled = (fill_one(dexterity, TARGETS, b, stream(), amount)[0] for b in (PlainMax("max"), BACKENDS["max"]))
    np.testing.assert_allclose(plain.values, compiled.values, atol=1e-12)


@pytest.mark.parametrize("quantity", ["values", "half", "hits"])
@pytest.mark.parametrize("aggregate", BACKENDS)
@pytest.mark.parametrize("kind", ["fused", "array"])
def test_dense_and_sparse_agree_to_the_last_bit(dexterity, kind, aggregate, quantity, monkeypatch):
    """Two threads, several chunks, both arms."""
    monkeypatch.setenv("EIWA_THREADS", "2")
    used = dexterity if kind == "fused" else prepare(*untraced_arm_and_index(), None, 0.2)
    dense, sparse = (fill_one(used, TARGETS, b(aggregate), stream(), Sampling(MANY)) for b in (Dense, Sparse))
    for one, other in zip(dense, sparse, strict=True):
        np.testing.assert_array_equal(getattr(one, quantity), getattr(other, quantity))


# Stores of several threads.


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 1, 2, 0], [2, 3, 0, 1]])
def test_who_leaves_the_last_store_gets_all_of_them(order):
    shelf, sizes = Shelf(BACKENDS["max"], 10), [1, 2, 3, 4]
    stores = [np.array([[float(k == c), k] for c in range(4)]) for k in range(4)]
    got = [shelf.add(stores[k], sizes[k]) for k in order]
    assert [whole is None for whole in got] == [True, True, True, False]
    np.testing.assert_array_equal(got[-1], [[1.0, 6.0]] * 4)


def test_a_thread_that_came_too_late_leaves_nothing():
    shelf = Shelf(BACKENDS["max"], 1)
    assert shelf.add(None, 0) is None
    assert shelf.add("all", 1) == "all"


# Samples without a solution.


class HalfSolved(SerialChain):
    """A planar arm of which only joint vectors with u_1 < 1/2 have a solution."""

    def columns(self, u, p):
        return replace(super().columns(u, p), valid=u[0] < 0.5)


def half_solved():
    planar = arms.planar(0.3, 0.2)
    return HalfSolved(planar.joints, planar.T_last_tip, planar.T_base_first)


IN_PLANE = Yoshikawa(K=None, K_scaled=3.0, rows=(0, 1))
EVERYWHERE = [Target(Grid(0.05, (-10, -10, -1), (20, 20, 2)), np.eye(4))]


@pytest.fixture(scope="module", params=["fused", "array"])
def partly_solved(request):
    arm = half_solved()
    return prepare(arm if request.param == "fused" else ArrayArm(arm), IN_PLANE, None, 0.0)


def test_samples_without_a_solution_are_not_deposited(partly_solved):
    hits = fill_one(partly_solved, EVERYWHERE, BACKENDS["max"], stream(), Sampling(20_000))[0].hits
    assert hits.sum() == (stream().points(0, 20_000, 2)[:, 0] < 0.5).sum()


def test_samples_without_a_solution_leave_no_values(partly_solved):
    values = fill_one(partly_solved, EVERYWHERE, BACKENDS["max"], stream(), Sampling(20_000))[0].values
    expected, _ = filled_by_numpy(partly_solved, EVERYWHERE[0], stream(), 20_000)
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12)


def test_samples_without_a_solution_are_marked_minus_one(partly_solved):
    u = np.array([[0.4, 0.4], [0.6, 0.4]])
    assert list(partly_solved.raw(u)[1] >= 0) == [True, False]


def test_postures_carry_the_mask():
    u = np.array([[0.4, 0.4], [0.6, 0.4]])
    assert half_solved().postures(u).valid.tolist() == [True, False]


# Voxel counting is biased (facts-kinematics): occupied voxels of the paper's arm, full range, against its
# exact reachable volume 8 pi L1^2 L2, and the share of samples that are alone in their voxel.

EXACT = 8 * np.pi * 0.26**2 * 0.18
COUNTED = {
    (0.05, 10**5): 0.34,
    (0.05, 10**6): 0.38,
    (0.02, 10**5): -0.13,
    (0.02, 10**6): 0.13,
    (0.01, 10**5): -0.76,
    (0.01, 10**6): -0.10,
}
COUNTED_8E6 = {(0.05, 8 * 10**6): 0.40, (0.02, 8 * 10**6): 0.15, (0.01, 8 * 10**6): 0.07}
ALONE = {10**5: 0.58, 10**6: 0.078}


def paper_hits(r, samples):
    """Hits of the paper's arm, full range, on a grid that holds it."""
    unlimited = prepare(arms.paper(), PAPER_INDEX, 1.0, 0.0)
    grid = Grid.covering(np.array([[-0.44] * 3, [0.44] * 3]), r)
    return fill_one(unlimited, [Target(grid, np.eye(4))], BACKENDS["max"], stream(), Sampling(samples))[0].hits


@pytest.mark.parametrize(
    ("case", "bias"),
    [*COUNTED.items(), *(pytest.param(*item, marks=pytest.mark.slow) for item in COUNTED_8E6.items())],
)
def test_counted_volume_has_the_known_bias(case, bias):
    r, samples = case
    volume = np.count_nonzero(paper_hits(r, samples)) * r**3
    assert volume / EXACT - 1 == pytest.approx(bias, abs=0.01)


@pytest.mark.parametrize(("samples", "share"), ALONE.items())
def test_share_of_samples_alone_in_their_voxel(samples, share):
    assert np.count_nonzero(paper_hits(0.01, samples) == 1) / samples == pytest.approx(share, abs=0.005)


@pytest.mark.slow
def test_share_of_8e6_samples_alone_in_their_voxel():
    alone = np.count_nonzero(paper_hits(0.01, 8 * 10**6) == 1) / (8 * 10**6)
    assert alone == pytest.approx(0.0002, abs=0.0001)


# prepare().


def test_the_normaliser_is_the_largest_manipulability():
    w = ArrayIndex(lambda postures: arms.manipulability(postures.jacobians))
    assert prepare(arms.paper(), w, None, 0.0).normaliser == pytest.approx(0.014256078741, abs=1e-12)


def test_a_given_normaliser_is_kept():
    assert prepare(ARM, PAPER_INDEX, 0.125, 0.0).normaliser == 0.125


def test_the_reach_is_the_largest_distance(dexterity):
    assert dexterity.reach == pytest.approx(0.44, abs=1e-9)


def test_an_arm_that_is_singular_everywhere_is_refused():
    with pytest.raises(SingularArm, match="zero at every posture"):
        prepare(ArrayArm(arms.planar(0.3, 0.2)), Yoshikawa(K=None, K_scaled=3.0, rows=(2,)), None, 0.0)


def test_table_1_read_as_standard_names_the_other_convention():
    with pytest.raises(SingularArm, match=r"arm\.convention = 'standard'.*convention = 'modified'"):
        prepare(arms.paper(convention="standard"), PAPER_INDEX, None, 0.0)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_index_that_is_not_finite_is_refused(value):
    broken = ArrayIndex(lambda postures: np.where(postures.u[:, 0] < 0.1, value, 1.0))
    with pytest.raises(PluginError, match="ArrayIndex"):
        prepare(ARM, broken, None, 0.0)


def test_an_arm_with_tips_that_are_not_finite_is_refused():
    class Broken(ArrayArm):
        def postures(self, u):
            at = super().postures(u)
            return replace(at, tips=np.where(u[:, :1] < 0.1, np.nan, at.tips))

    with pytest.raises(PluginError, match="Broken"):
        prepare(Broken(ARM), PAPER_INDEX, None, 0.0)


FAR = 1 - 2.0**-15
"""Some of 2^18 samples have a coordinate above it, no posture of the pilot that is looked at before."""


class SpoiltArm(ArrayArm):
    """Something is not finite at a few postures."""

    def __init__(self, chain, name):
        super().__init__(chain)
        self.name = name

    def postures(self, u):
        at = super().postures(u)
        spoilt = np.array(getattr(at, self.name))
        spoilt[u[:, 0] > FAR] = np.nan
        return replace(at, **{self.name: spoilt})


LATE = {
    "tips": (lambda: (SpoiltArm(ARM, "tips"), PAPER_INDEX), "SpoiltArm .* tips"),
    "Jacobians": (lambda: (SpoiltArm(ARM, "jacobians"), PAPER_INDEX), "SpoiltArm .* Jacobians"),
    "Jacobians that the index does not read": (lambda: (SpoiltArm(ARM, "jacobians"), One()), "SpoiltArm .* Jacobians"),
    "values": (lambda: (ARM, ArrayIndex(lambda at: np.where(at.u[:, 0] > FAR, np.inf, 1.0))), "ArrayIndex .* values"),
    "values of arrays": (
        lambda: (ArrayArm(ARM), ArrayIndex(lambda at: np.where(at.u[:, 0] > FAR, np.nan, 1.0))),
        "ArrayIndex .* values",
    ),
}


class Forgetful(ArrayArm):
    """Some postures are lost, or there are too many."""

    change = staticmethod(lambda u: u)

    def postures(self, u):
        return super().postures(self.change(u))


@pytest.mark.parametrize("change", [lambda u: u[:-1], lambda u: np.vstack([u, u])], ids=["fewer", "more"])
@pytest.mark.parametrize("index", [PAPER_INDEX, untraced_index()[1]], ids=["traced", "array"])
def test_another_number_of_postures_is_refused(index, change):
    arm = Forgetful(ARM)
    dexterity = prepare(arm, index, 1.0, 0.0)
    arm.change = change
    with pytest.raises(PluginError, match=r"Forgetful .*: \d+ postures for 4096 points"):
        fill_one(dexterity, TARGETS, BACKENDS["max"], stream(), Sampling(8192))


def test_who_fails_stops_the_others(monkeypatch):
    """Two threads, 32 blocks of the first half and as many of the second; the third block fails."""
    monkeypatch.setenv("EIWA_THREADS", "2")
    calls = []

    def answer(at):
        if len(at.u) == ARRAY_BLOCK:
            calls.append(1)
            if len(calls) == 3:
                raise ArithmeticError
        return at.u[:, 0]

    dexterity = prepare(ARM, ArrayIndex(answer), 1.0, 0.0)
    calls.clear()
    with pytest.raises(PluginError, match="ArithmeticError"):
        fill_one(dexterity, TARGETS, BACKENDS["max"], stream(), Sampling(64 * ARRAY_BLOCK))
    assert len(calls) <= 16


@pytest.mark.parametrize(("parts", "message"), LATE.values(), ids=LATE)
def test_what_is_not_finite_at_a_sample_is_refused(parts, message):
    dexterity = prepare(*parts(), 1.0, 0.0)
    with pytest.raises(PluginError, match=message + " that are not finite at 1 of"):
        fill_one(dexterity, TARGETS, BACKENDS["max"], stream(), Sampling(1 << 18))


def test_negative_values_of_an_index_count_as_zero():
    negative = ArrayIndex(lambda postures: np.full(len(postures.u), -3.0))
    _, raw = Dexterity(ARM, negative, NOTHING, 1.0, 0.0).raw(np.full((1, 6), 0.5))
    assert raw == [0.0]
