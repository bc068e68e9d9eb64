"""Measured hand positions: the counts by hand, the two formats, the hands, and files that cannot be."""

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import csv, parquet

from eiwa.core.errors import SpecError
from eiwa.core.interfaces import Operator
from eiwa.core.spec import load
from eiwa.core.workspace import Grid
from tests import humans
from tests.humans import field, own_grid
from tests.study import small

GRID = Grid(0.02, (-10, 0, 0), (20, 6, 6))
BOTH = {"x": [0.05, -0.05], "y": [0.05, 0.05], "z": [0.05, 0.05]}
"""The centres of cells (12, 2, 2) and (7, 2, 2)."""


@pytest.fixture
def points(tmp_path):
    """A model of columns, written to a file."""

    def build(columns, suffix=".csv", **parameters):
        table = pa.table(columns)
        (csv.write_csv if suffix == ".csv" else parquet.write_table)(table, tmp_path / f"hands{suffix}")
        return humans.human("points", tmp_path, file=f"hands{suffix}", **parameters)

    return build


# Counts.


def test_without_a_radius_a_point_counts_in_its_own_cell(points):
    E = field(points(BOTH, radius=0.0, comfort=1.0), GRID)
    assert (np.argwhere(E.right).tolist(), np.argwhere(E.left).tolist()) == ([[12, 2, 2]], [[7, 2, 2]])
    assert E.right.max() == E.left.max() == 1.0


def test_a_point_counts_less_with_the_distance_to_a_cell(points):
    """The next cells are 10 mm away, the ones across an edge 14 mm, across a corner 17 mm; those behind 30 mm."""
    E = field(points(BOTH, radius=0.02, comfort=1.0), GRID).right
    near = [E[12, 2, 2], E[13, 2, 2], E[13, 3, 2], E[13, 3, 3], E[14, 2, 2]]
    np.testing.assert_allclose(near, [1.0, 1 - 1 / 4, 1 - 2 / 4, 1 - 3 / 4, 0.0], atol=1e-9)


def test_a_cell_sums_the_weights(points):
    columns = {"x": [0.05, 0.05, 0.09, -0.05], "y": [0.05] * 4, "z": [0.05] * 4, "weight": [1.0, 2.0, 6.0, 1.5]}
    E = field(points(columns, radius=0.0, comfort=1.0), GRID)
    np.testing.assert_allclose(
        [E.right[12, 2, 2], E.right[14, 2, 2], E.left[7, 2, 2]], [3 / 6, 1.0, 1.5 / 6], atol=1e-15
    )


def test_points_without_weight_are_left_out(points):
    columns = {"x": [0.05, 0.15, -0.05], "y": [0.05] * 3, "z": [0.05] * 3, "weight": [1.0, 0.0, 1.0]}
    assert np.count_nonzero(field(points(columns, radius=0.0), GRID).right) == 1


@pytest.mark.parametrize(
    ("rule", "comfort", "expected"),
    [("max", 0.5, [0.125, 0.5]), ("mean", 0.4, [0.16, 0.64]), ("mean", 0.8, [0.32, 1.0]), ("reached", 0.5, [0.5, 0.5])],
)
def test_rules(points, rule, comfort, expected):
    """Weights 1 and 4 on the right, 2.5 on the left, so the mean is 2.5."""
    columns = {"x": [0.05, 0.09, -0.05], "y": [0.05] * 3, "z": [0.05] * 3, "weight": [1.0, 4.0, 2.5]}
    E = field(points(columns, radius=0.0, rule=rule, comfort=comfort), GRID).right
    np.testing.assert_allclose([E[12, 2, 2], E[14, 2, 2]], expected, atol=1e-15)


def test_a_uniform_cloud_gives_a_uniform_E(points):
    """2000 points a cell in a box of cells: inside, away from its sides, E is even to a few per cent."""
    x = np.random.default_rng(0).uniform([0.02, 0.02, 0.02], [0.12, 0.1, 0.1], (160_000, 3))
    columns = dict(zip("xyz", x.T, strict=True))
    E = field(points(columns, hands="mirrored", radius=0.015, comfort=1.0), GRID).right
    inside = E[12:15, 2:4, 2:4]
    assert inside.min() > 0.93 * inside.max()


# Hands.


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_both_formats_read_the_same(points, suffix):
    E = field(points(BOTH, suffix, radius=0.02), GRID)
    assert (E.right[12, 2, 2], E.left[7, 2, 2], np.count_nonzero(E.right)) == (0.5, 0.5, 27)


def test_the_column_hand_goes_before_the_sign_of_x(points):
    E = field(points({**BOTH, "hand": ["left", "right"]}, radius=0.0), GRID)
    assert (E.right[7, 2, 2], E.left[12, 2, 2]) == (0.5, 0.5)


def test_mirrored_hands_share_all_points(points):
    columns = {"x": [0.05, -0.09], "y": [0.05] * 2, "z": [0.05] * 2}
    E = field(points(columns, hands="mirrored", radius=0.0), GRID)
    assert np.argwhere(E.right).tolist() == [[12, 2, 2], [14, 2, 2]]
    np.testing.assert_array_equal(E.left, E.right[::-1])


def test_one_hand_is_enough_when_it_is_mirrored(points):
    columns = {name: values[:1] for name, values in BOTH.items()}
    E = field(points(columns, hands="mirrored", radius=0.0), GRID)
    assert (E.right.sum(), E.left.sum()) == (0.5, 0.5)


def test_the_armrest_lifts_the_points_and_the_seat_does_not_matter(points):
    human = points(BOTH, radius=0.0)
    E = field(human, GRID, Operator(armrest=0.04, seat=0.1)).right
    assert np.argwhere(E).tolist() == [[12, 2, 4]]
    np.testing.assert_allclose(human.bounds(Operator(armrest=0.04)) - human.bounds(Operator()), [[0, 0, 0.04]] * 2)


@settings(max_examples=30)
@given(
    xyz=st.lists(st.tuples(*(st.floats(-0.5, 0.5) for _ in range(3))), min_size=1, max_size=6),
    radius=st.sampled_from([0.0, 0.013, 0.04]),
)
def test_E_lies_within_the_bounds_and_the_unit_interval(tmp_path_factory, xyz, radius):
    folder = tmp_path_factory.mktemp("points")
    parquet.write_table(pa.table(dict(zip("xyz", np.transpose(xyz), strict=True))), folder / "hands.parquet")
    human = humans.human("points", folder, file="hands.parquet", hands="mirrored", radius=radius)
    own = own_grid(human, 0.02)
    E, wide = field(human, own), field(human, humans.wider(own))
    assert (E.right.max(), E.right.min() >= 0) == (pytest.approx(0.5), True)
    assert np.count_nonzero(wide.right) == np.count_nonzero(E.right)


# In a study: every complaint names human.file.


@pytest.fixture
def study(tmp_path):
    """A small study whose operator is a file of points."""
    text = small.text({'kind = "ehem"\nsamples = 4096': 'kind = "points"\nfile = "hands.csv"'})
    (tmp_path / "study.toml").write_text(text)
    return tmp_path / "study.toml"


def test_a_study_reads_its_points(study):
    (study.parent / "hands.csv").write_text("x,y,z\n0.1,0.4,0.1\n-0.1,0.4,0.1\n")
    human = load(study).design({}).setup(1).human
    assert human.positions.right[0].tolist() == [[0.1, 0.4, 0.1]]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "cannot be read"),
        ("x,y\n0.1,0.2\n", "has no column z (it has x, y)"),
        ("x;y;z\n0.1;0.2;0.3\n", "has no column x, y, z (it has x;y;z)"),
        ("x,y,z\n", "no rows"),
        ("x,y,z\n0.1,0.2,0.3\n0.1,,0.3\n", "row 2 has y = nan"),
        ("x,y,z\n0.1,inf,0.3\n", "row 1 has y = inf"),
        ("x,y,z\n0.1,far,0.3\n", "column y must hold numbers, not string"),
        ("x,y,z,weight\n0.1,0.2,0.3,0\n-0.1,0.2,0.3,0\n", "all weights are zero"),
        ("x,y,z,weight\n0.1,0.2,0.3,-1\n", "row 1 has a negative weight"),
        ("x,y,z,weight\n0.1,0.2,0.3,nan\n", "row 1 has weight = nan"),
        ("x,y,z,hand\n0.1,0.2,0.3,right\n0.1,0.2,0.3,Left\n", "row 2 has hand = 'Left': must be 'right' or 'left'"),
        ("x,y,z\n0.1,0.2,0.3\n", "no point of the left hand"),
        ("x,y,z\n110,420,125\n", "row 1 has y = 420: write metres"),
        ("x,y,z\n0.1,0.2\n", "cannot be read as csv"),
    ],
)
def test_files_that_cannot_be_are_refused_by_their_path(study, content, problem):
    if content is not None:
        (study.parent / "hands.csv").write_text(content)
    with pytest.raises(SpecError) as refused:
        load(study)
    (line,) = refused.value.findings
    assert line.startswith("human.file = 'hands.csv': ") and problem in line


def test_a_file_of_another_kind_is_refused(study):
    (study.parent / "hands.txt").write_text("x,y,z\n")
    with pytest.raises(SpecError, match=r"human\.file = 'hands\.txt': must be a \.csv or a \.parquet file"):
        load(study, {"human.file": "hands.txt"})


def test_a_broken_parquet_file_is_refused(study):
    (study.parent / "hands.parquet").write_bytes(b"PAR1 no")
    with pytest.raises(SpecError, match=r"human\.file = 'hands\.parquet': the file cannot be read as parquet"):
        load(study, {"human.file": "hands.parquet"})


def test_a_new_file_is_read_anew(study):
    (study.parent / "hands.csv").write_text("x,y,z\n0.1,0.4,0.1\n-0.1,0.4,0.1\n")
    load(study)
    (study.parent / "hands.csv").write_text("x,y,z\n0.2,0.4,0.1\n-0.1,0.4,0.1\n")
    assert load(study).design({}).setup(1).human.positions.right[0][0, 0] == 0.2
