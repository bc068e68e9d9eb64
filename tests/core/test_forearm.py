"""The forearm on an armrest: how far an elbow slides, and the search for the best rotations."""

from dataclasses import replace

import numpy as np
import pytest

from eiwa.core.evaluation import field_stream
from eiwa.core.forearm import Forearm, slides, to_ends
from eiwa.core.sampling import Stream
from eiwa.core.workspace import Grid

DEG = np.pi / 180
RANGES = np.array(
    [[-0.06, 0.1], [0.0, 0.14], *(np.array([[-5, 30], [-20, 20], [0, 0], [-50, 50], [-10, 10], [-30, 30]]) * DEG)]
)
ARM = Forearm(0.22, 0.045, 15 * DEG, 0.27, 0.11, RANGES)
TARGET = np.array([10.0, 5.0, 0.0, -20.0, 4.0, 12.0]) * DEG


def nearness(q):
    """Largest, 0, for one posture alone."""
    return -((q[:, 2:] - TARGET) ** 2).sum(axis=1)


def best(samples=1 << 18, r=0.02, armrest=0.0, key=1):
    return ARM.best(r, armrest, field_stream(key, 0), samples, nearness)


@pytest.mark.parametrize(("upper_arm", "expected"), [(0.3, [[-0.15, 0.15], [0.0, 0.3]])])
def test_slides_are_sines_and_no_longer_than_the_arm(upper_arm, expected):
    np.testing.assert_allclose(slides(upper_arm, (-30, 30), (0, 120)), expected, atol=1e-15)


def test_angles_and_tips_belong_to_the_same_posture():
    """At both ends of all ranges and in the middle."""
    u = np.array([[0.0] * 6, [0.5] * 6, [1.0] * 6])
    np.testing.assert_allclose(
        ARM.angles(u)[:, 2:], [RANGES[2:, 0], RANGES[2:].mean(axis=1), RANGES[2:, 1]], atol=1e-15
    )


def test_to_ends_keeps_the_cube_and_its_ends():
    u = np.linspace(0, 1, 11)[:, None]
    ends = to_ends(u)[:, 0]
    assert ends.min() == 0.0 and ends.max() <= 1.0
    assert (ends[5], ends[10]) == (pytest.approx(0.5), pytest.approx(1.0, abs=1e-15))
    assert (np.diff(ends) > 0).all()
    np.testing.assert_allclose(ends, np.sin(np.pi / 2 * u[:, 0]) ** 2, atol=1e-15)


@pytest.mark.parametrize("armrest", [0.04, 0.05, -0.02])
def test_a_raised_armrest_takes_the_cells_along(armrest):
    """Found anew by the same forearm's twin, on a grid that is larger than need be."""
    twin, stream = replace(ARM), Stream("sobol", 3)
    grid = Grid.covering(ARM.bounds(armrest) + [[-0.1], [0.1]], 0.02)
    ARM.reached(grid, 0.0, stream, 1 << 12)
    np.testing.assert_array_equal(
        ARM.reached(grid, armrest, stream, 1 << 12), twin._sampled(grid, armrest, stream, 1 << 12)
    )


def test_cells_on_a_part_of_the_grid():
    stream = Stream("sobol", 3)
    whole = Grid.covering(ARM.bounds(0.0), 0.02)
    part = Grid(0.02, tuple(o + 2 for o in whole.origin), tuple(n - 1 for n in whole.shape))
    cells = ARM.reached(whole, 0.0, stream, 1 << 12)
    np.testing.assert_array_equal(ARM.reached(part, 0.0, stream, 1 << 12)[:-1, :-1, :-1], cells[2:, 2:, 2:])


def test_the_best_rotations_lie_in_their_ranges():
    q = best().q
    assert (q[:, 2:] >= RANGES[2:, 0] - 1e-12).all() and (q[:, 2:] <= RANGES[2:, 1] + 1e-12).all()


def test_tips_and_promise_are_those_of_the_rotations():
    found = best(armrest=0.1)
    u = (found.q[:, [3, 4, 2, 5, 6, 7]] - ARM.chain.lower) / np.maximum(ARM.chain.upper - ARM.chain.lower, 1e-9)
    np.testing.assert_allclose(found.tips, ARM.tips(u) + [0, 0, 0.1], atol=1e-12)
    np.testing.assert_allclose(found.promise, nearness(found.q), atol=1e-12)


def test_the_most_promising_come_first():
    assert (np.diff(best().promise) <= 0).all()


def test_the_search_finds_the_best_posture():
    """Within 0.045 rad over five joints, the distance from one bin to the next."""
    assert best().promise[0] == pytest.approx(0.0, abs=2e-3)


def test_more_samples_promise_more():
    """Averaged over the layers of voxels that both know."""
    few, many = best(1 << 17), best(1 << 20)
    layers = [np.floor(found.tips[:, 2] / 0.02).astype(int) for found in (few, many)]
    best_of = [
        {k: found.promise[layer == k].max() for k in layer} for found, layer in zip((few, many), layers, strict=True)
    ]
    gains = [best_of[1][k] - best_of[0][k] for k in best_of[0]]
    assert np.mean(gains) > 0


def test_the_tips_fill_every_layer_of_voxels():
    layers = np.unique(np.floor(best().tips[:, 2] / 0.02).astype(int))
    low, high = np.floor(ARM.tip_box[:, 2] / 0.02).astype(int)
    assert set(range(low + 1, high)) <= set(layers)


def test_the_same_stream_gives_the_same_rotations():
    one, other = best(), best()
    np.testing.assert_array_equal(one.q, other.q)


def test_another_stream_gives_others():
    assert best().q.shape != best(key=2).q.shape or (best().q != best(key=2).q).any()
