"""The streams against an independent SplitMix64, scipy's Sobol sequence, and what a stream promises."""

import numpy as np
import pytest
from scipy.stats import qmc

from eiwa.core.errors import EiwaError
from eiwa.core.sampling import FILLS, MAX_DIMENSIONS, Stream, direction_numbers

SEQUENCES = ["plain", "sobol"]


class SplitMix64:
    """Steele, Lea and Flood (2014), as its authors write it."""

    MASK = (1 << 64) - 1

    def __init__(self, seed):
        self.state = seed

    def __call__(self):
        self.state = (self.state + 0x9E3779B97F4A7C15) & self.MASK
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & self.MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & self.MASK
        return z ^ (z >> 31)


# Widely published first outputs for seed 1234567.
KNOWN = (
    6457827717110365317,
    3203168211198807973,
    9817491932198370423,
    4593380528125082431,
    16408922859458223821,
)


def test_the_reference_gives_the_known_outputs():
    generator = SplitMix64(1234567)
    assert tuple(generator() for _ in KNOWN) == KNOWN


def test_plain_points_are_the_top_52_bits_of_the_known_outputs():
    u = Stream("plain", 1234567).points(0, 1, 5)[0]
    assert [int(x * 2**52) for x in u] == [z >> 12 for z in KNOWN]


def test_plain_points_lie_in_the_middle_of_their_cells():
    u = Stream("plain", 1234567).points(0, 1, 5)[0]
    assert list(u) == [((z >> 12) + 0.5) / 2**52 for z in KNOWN]


@pytest.mark.parametrize("key", [0, 1, 2**63, 2**64 - 1])
def test_plain_reads_splitmix_in_sample_major_order(key):
    generator = SplitMix64(key)
    expected = [[((generator() >> 12) + 0.5) / 2**52 for _ in range(7)] for _ in range(600)]
    np.testing.assert_array_equal(Stream("plain", key).points(0, 600, 7), expected)


def shifts(dimensions, key):
    """The 32-bit digital shift: the first point of Sobol's sequence is zero before it."""
    return np.floor(Stream("sobol", key).points(0, 1, dimensions)[0] * 2.0**32).astype(np.uint64)


@pytest.mark.parametrize("power", [0, 1, 5, 8, 9, 13])
def test_sobol_without_its_shift_is_scipys_as_a_set(power):
    n, d, key = 1 << power, MAX_DIMENSIONS, 42
    shifted = np.floor(Stream("sobol", key).points(0, n, d) * 2.0**32).astype(np.uint64)
    points = {tuple(row) for row in (shifted ^ shifts(d, key)).tolist()}
    reference = qmc.Sobol(d, scramble=False, bits=32).random_base2(power) * 2.0**32
    assert points == {tuple(row) for row in reference.astype(np.uint64).tolist()}


def test_sobol_points_lie_in_the_middle_of_their_cells():
    fraction = Stream("sobol", 7).points(0, 300, 3) * 2.0**32 % 1.0
    np.testing.assert_array_equal(fraction, 0.5)


def test_every_aligned_stretch_of_sobol_is_stratified():
    """2^k points starting at a multiple of 2^k: one in each of the 2^k intervals of every axis."""
    u = Stream("sobol", 3).points(3 << 10, 1 << 10, MAX_DIMENSIONS)
    cells = np.sort(np.floor(u * 1024).astype(int), axis=0)
    np.testing.assert_array_equal(cells, np.broadcast_to(np.arange(1024)[:, None], cells.shape))


def test_first_direction_numbers_of_the_second_dimension():
    assert [v >> 27 for v in direction_numbers(1)[:5]] == [0b10000, 0b11000, 0b10100, 0b11110, 0b10001]


def test_more_than_twelve_sobol_dimensions_are_refused():
    with pytest.raises(EiwaError, match="at most 12 dimensions, not 13"):
        Stream("sobol", 0).points(0, 1, 13)


def test_thirteen_plain_dimensions_are_allowed():
    assert Stream("plain", 0).points(0, 4, 13).shape == (4, 13)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_a_prefix_is_a_prefix(sequence):
    stream = Stream(sequence, 11)
    np.testing.assert_array_equal(stream.points(0, 300, 6), stream.points(0, 5000, 6)[:300])


@pytest.mark.parametrize("first", [1, 255, 256, 257, 1000, 65_536])
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_points_are_addressed_by_number(sequence, first):
    stream = Stream(sequence, 11)
    np.testing.assert_array_equal(stream.points(first, 300, 6), stream.points(0, first + 300, 6)[first:])


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_far_points_exist(sequence):
    stream = Stream(sequence, 11)
    far = 10**10
    np.testing.assert_array_equal(stream.points(far, 4, 6)[1:], stream.points(far + 1, 3, 6))


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_no_points(sequence):
    assert Stream(sequence, 0).points(0, 0, 6).shape == (0, 6)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_points_lie_inside_the_open_unit_cube(sequence):
    u = Stream(sequence, 5).points(0, 1 << 16, 6)
    assert 0.0 < u.min() < u.max() < 1.0


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_different_keys_give_different_points(sequence):
    assert not (Stream(sequence, 1).points(0, 100, 6) == Stream(sequence, 2).points(0, 100, 6)).any()


@pytest.mark.parametrize("entropy", [(1, 0, 1), (1, 1, 0), (2, 0, 0), (0, 0, 0)])
def test_seed_replicate_and_purpose_each_change_the_key(entropy):
    assert Stream.of("plain", *entropy) != Stream.of("plain", 1, 0, 0)


def test_the_same_path_gives_the_same_stream():
    assert Stream.of("sobol", 1, 2, 3) == Stream.of("sobol", 1, 2, 3)


def test_a_sobol_table_is_read_only():
    with pytest.raises(ValueError, match="read-only"):
        Stream("sobol", 0).table(3)[0, 0] = 1


N = 1 << 17


@pytest.fixture(scope="module", params=SEQUENCES)
def many(request):
    return Stream(request.param, 99).points(0, N, 6)


def test_mean_is_a_half_within_five_standard_errors(many):
    assert np.abs(many.mean(axis=0) - 0.5).max() < 5 * np.sqrt(1 / 12 / N)


def test_variance_is_a_twelfth_within_five_standard_errors(many):
    assert np.abs(many.var(axis=0) - 1 / 12).max() < 5 * np.sqrt(1 / 180 / N)


def test_dimensions_are_uncorrelated(many):
    correlation = np.corrcoef(many.T) - np.eye(6)
    assert np.abs(correlation).max() < 5 / np.sqrt(N)


def test_neighbours_are_uncorrelated_in_the_plain_sequence():
    u = Stream("plain", 99).points(0, N, 1)[:, 0]
    assert abs(np.corrcoef(u[:-1], u[1:])[0, 1]) < 5 / np.sqrt(N)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_single_precision_points_are_the_doubles_top_23_bits(sequence):
    stream, rows = Stream(sequence, 5), np.empty(3 * 256, np.float32)
    FILLS[sequence](rows, 256, 3, np.uint64(512), np.uint64(stream.key), stream.table(3))
    double = stream.points(512, 256, 3)
    np.testing.assert_array_equal(rows.reshape(3, 256).T, (np.floor(double * 2**23) + 0.5) / 2**23)
