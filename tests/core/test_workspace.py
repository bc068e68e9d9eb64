"""Grids, the way from a tip to a cell, and the layout of Eq. (3)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eiwa.core.dexterity import Family, prepare
from eiwa.core.evaluation import Layout, fill_pairs, joint_stream
from eiwa.core.transforms import roll_pitch_yaw, translation
from eiwa.core.workspace import Grid, Target, locate, normalise, packed
from tests.core import rig

SIZES = st.sampled_from([0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 1 / 3])
BOUND = st.floats(-2, 2, allow_subnormal=False)


@st.composite
def boxes(draw):
    ends = np.sort(np.array([[draw(BOUND) for _ in range(3)] for _ in range(2)]), axis=0)
    return ends


@given(boxes(), SIZES)
def test_faces_lie_at_integer_multiples_of_the_size(box, r):
    faces = Grid.covering(box, r).faces(0)
    np.testing.assert_allclose(faces / r, np.round(faces / r), rtol=0, atol=1e-9)


@given(boxes(), SIZES)
def test_a_grid_covers_its_box(box, r):
    grid = Grid.covering(box, r)
    low, high = (np.array([grid.faces(k)[end] for k in range(3)]) for end in (0, -1))
    assert (low <= box[0] + 1e-8 * r).all()
    assert (high >= box[1] - 1e-8 * r).all()


@given(boxes(), SIZES)
def test_a_grid_is_the_smallest_one(box, r):
    grid = Grid.covering(box, r)
    spare = [grid.faces(k)[[1, -2]] for k in range(3) if grid.shape[k] > 1]
    ends = [box[:, k] for k in range(3) if grid.shape[k] > 1]
    assert all(first > low and last < high for (first, last), (low, high) in zip(spare, ends, strict=True))


@given(st.integers(-50, 50), st.integers(1, 50), SIZES)
def test_a_bound_that_is_a_face_up_to_rounding_opens_no_layer(first, count, r):
    box = np.array([[first * r] * 3, [(first + count) * r] * 3])
    assert Grid.covering(box, r) == Grid(r, (first,) * 3, (count,) * 3)


def test_a_point_is_covered_by_one_cell():
    assert Grid.covering(np.full((2, 3), 0.015), 0.01).shape == (1, 1, 1)


def test_centres_lie_between_faces():
    grid = Grid(0.5, (-1, 2, 0), (3, 1, 1))
    assert grid.centres(0).tolist() == [-0.25, 0.25, 0.75]


def test_cells_counts_the_cells():
    assert Grid(0.5, (0, 0, 0), (3, 4, 5)).cells == 60


@pytest.mark.parametrize(
    ("first", "count", "symmetric"), [(-3, 6, True), (-3, 5, False), (-2, 6, False), (0, 1, False)]
)
def test_a_grid_is_symmetric_when_mirroring_maps_it_onto_itself(first, count, symmetric):
    assert Grid(0.1, (first, 0, 0), (count, 1, 1)).symmetric is symmetric


# locate() against NumPy.

POSE = translation(0.3, -0.2, 0.1) @ roll_pitch_yaw(0.4, -0.3, 0.9)
GRID = Grid(0.05, (-3, -7, 2), (8, 9, 5))
NUMBERS = np.random.default_rng(0)
TIPS = NUMBERS.uniform(-0.6, 0.6, (4000, 3))
RAW = NUMBERS.uniform(-0.5, 3.0, 4000)
SCALE, THRESHOLD = 0.5, 0.25
ONE_TARGET = (Target(GRID, POSE),)


def located(tips, raw, targets=ONE_TARGET, which=0, dtype=np.float64):
    affines, layout = packed(targets, dtype)
    n = len(tips)
    cells, picks, values = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, dtype)
    x, y, z = np.ascontiguousarray(tips.T, dtype)
    raw = raw.astype(dtype)
    count = locate(x, y, z, raw, n, affines[which], layout[which], cells, picks)
    normalise(raw, picks, count, dtype(SCALE), dtype(THRESHOLD), values)
    return cells[:count], values[:count]


def kept(tips, raw):
    """Cell indices in the grid and the mask of the samples that are in it and have a solution."""
    cells = np.floor((tips @ POSE[:3, :3].T + POSE[:3, 3]) / GRID.r).astype(int) - GRID.origin
    return cells, ((cells >= 0) & (cells < GRID.shape)).all(axis=1) & (raw >= 0)


def test_locate_finds_numpys_cells():
    cells, mask = kept(TIPS, RAW)
    np.testing.assert_array_equal(located(TIPS, RAW)[0], np.ravel_multi_index(tuple(cells[mask].T), GRID.shape))


def test_normalise_scales_caps_and_marks_what_is_below_the_threshold():
    _, mask = kept(TIPS, RAW)
    scaled = np.minimum(RAW[mask] * SCALE, 1.0)
    np.testing.assert_array_equal(located(TIPS, RAW)[1], np.where(scaled >= THRESHOLD, scaled, -1.0))


def test_locate_drops_samples_without_a_solution():
    assert len(located(TIPS, np.full(len(TIPS), -1.0))[0]) == 0


@pytest.mark.parametrize("place", [1e6, -1e6, 1e12, -1e12])
def test_locate_drops_samples_far_away(place):
    assert len(located(np.full((5, 3), place), np.ones(5))[0]) == 0


def test_a_lower_face_belongs_to_its_cell():
    targets = (Target(Grid(0.25, (0, 0, 0), (2, 1, 1)), np.eye(4)),)
    tips = np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.0], [0.5, 0.0, 0.0]])
    assert located(tips, np.ones(3), targets)[0].tolist() == [0, 1]


def test_the_second_target_stands_behind_the_first_in_the_store():
    first = located(TIPS, RAW)[0]
    second = located(TIPS, RAW, ONE_TARGET * 2, which=1)[0]
    np.testing.assert_array_equal(second, first + GRID.cells)


def test_locate_in_single_precision_moves_samples_near_faces_only():
    single, double = (
        np.bincount(located(TIPS, RAW, dtype=dtype)[0], minlength=GRID.cells) for dtype in (np.float32, np.float64)
    )
    assert np.abs(single - double).sum() <= 4


@pytest.mark.parametrize("aggregate", rig.BACKENDS)
def test_the_order_of_the_samples_is_immaterial(aggregate):
    backend = rig.BACKENDS[aggregate]
    orders = [np.arange(len(TIPS)), np.random.default_rng(3).permutation(len(TIPS))]
    results = []
    for order in orders:
        cells, values = located(TIPS[order], RAW[order])
        store = backend.open(GRID.cells)
        backend.deposit(store, cells, values, len(cells))
        results.append(backend.values(store))
    np.testing.assert_array_equal(*results)


# Eq. (3): V_dual(i', j', k') = alpha (V(i - r_x, j - r_y, k - r_z) + V(i + D - r_x, j - r_y, k - r_z)).

R_CELLS, D_CELLS = np.array([1, 14, -3]), 6


@pytest.fixture(scope="module")
def index_shift():
    """V on the base grid, and V of both sides on W's grid, with R and D whole multiples of r."""
    r = 0.03125
    layout = Layout(D_CELLS * r, tuple(float(x) for x in R_CELLS * r), (0.0, 0.0, 0.0))
    setup = rig.setup(layout=layout, r=r)
    dexterity = prepare(setup.arm, setup.index, None, 0.0)
    base = Grid(r, (-15, -15, -15), (30, 30, 30))
    world = Grid(r, (-24, -8, -24), (48, 40, 48))
    V = rig.fill_one(dexterity, [Target(base, np.eye(4))], setup.backend, joint_stream(setup, 0), setup.sampling)[0]
    return base, V, world, fill_pairs(setup, Family((dexterity,)), world, 0, setup.sampling)[0]


@pytest.mark.parametrize(("side", "sign"), [("right", 1), ("left", -1)])
@pytest.mark.parametrize("quantity", ["values", "hits"])
def test_equation_3_shifts_by_whole_cells(index_shift, side, sign, quantity):
    base, V, world, pair = index_shift
    shifted = np.zeros(world.shape)
    start = np.array(base.origin) + R_CELLS + [sign * D_CELLS // 2, 0, 0] - world.origin
    shifted[tuple(slice(s, s + n) for s, n in zip(start, base.shape, strict=True))] = getattr(V, quantity)
    np.testing.assert_array_equal(getattr(getattr(pair, side), quantity), shifted)


def test_the_shifted_array_holds_every_sample(index_shift):
    _, V, _, pair = index_shift
    assert pair.left.hits.sum() == V.hits.sum() == 1 << 16


# The left arm as the mirror image of the right one.


@pytest.fixture(scope="module")
def mirrored():
    layout = Layout(0.21, (0.03, 0.4, 0.05), (0.1, -0.2, -1.0), second="mirrored")
    setup = rig.setup(layout=layout)
    dexterity = prepare(setup.arm, setup.index, None, 0.0)
    grid = Grid(0.03125, (-20, -4, -16), (40, 32, 32))
    return setup, dexterity, grid, fill_pairs(setup, Family((dexterity,)), grid, 0, setup.sampling)[0]


@pytest.mark.parametrize("quantity", ["values", "half", "hits"])
def test_a_mirrored_left_arm_is_the_flipped_right_one(mirrored, quantity):
    pair = mirrored[-1]
    np.testing.assert_array_equal(getattr(pair.left, quantity), getattr(pair.right, quantity)[::-1])


def test_a_mirrored_left_arm_holds_the_mirrored_samples(mirrored):
    setup, dexterity, grid, pair = mirrored
    tips, _ = dexterity.raw(joint_stream(setup, 0).points(0, setup.sampling.samples, 6))
    T = setup.layout.T_world_base(+1)
    mirror = (tips @ T[:3, :3].T + T[:3, 3]) * [-1, 1, 1]
    edges = [grid.faces(k) for k in range(3)]
    np.testing.assert_array_equal(np.histogramdd(mirror, edges)[0], pair.left.hits)


def test_bases_stand_a_spacing_apart_along_x():
    layout = Layout(0.3, (0.1, 0.8, 0.2), (0.0, 0.0, -np.pi / 2))
    apart = layout.T_world_base(+1)[:3, 3] - layout.T_world_base(-1)[:3, 3]
    np.testing.assert_allclose(apart, [0.3, 0, 0], atol=1e-15)


def test_the_offset_is_the_midpoint_of_the_bases():
    layout = Layout(0.3, (0.1, 0.8, 0.2), (0.0, 0.0, -np.pi / 2))
    middle = (layout.T_world_base(+1) + layout.T_world_base(-1))[:3, 3] / 2
    np.testing.assert_allclose(middle, layout.offset, atol=1e-15)
