"""Elites against a slow version of the same rules in plain NumPy: the same random words, the same bits."""

import numpy as np
import pytest

from eiwa.core import elites
from eiwa.core.dexterity import Family, prepare
from eiwa.core.elites import refine
from eiwa.core.filling import Sampling
from eiwa.core.transforms import rotation_z, translation
from eiwa.core.workspace import Grid, Target, locate, packed
from eiwa.plugins.dexterity.yoshikawa import Yoshikawa
from tests import arms
from tests.core.rig import ALL_ROWS, ArrayIndex, stream

FIRST, BLOCK = 1 << 13, 256
GRID = Grid(0.05, (-4, 10, -2), (8, 5, 5))
TARGETS = [Target(GRID, translation(side * 0.1, 0.7, 0.05) @ rotation_z(-np.pi / 2)) for side in (1, -1)]
WEIGHTS = [np.zeros(GRID.shape), np.zeros(GRID.shape)]
WEIGHTS[0][:5], WEIGHTS[1][3:] = 1.0, 0.5  # two fields, which share two layers and leave none out


def words(key, numbers):
    """SplitMix64's so-manieth outputs."""
    z = np.uint64(key) + np.uint64(0x9E3779B97F4A7C15) * numbers
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    return z ^ (z >> np.uint64(31))


def units(bits):
    return ((bits >> np.uint64(12)).astype(float) + 0.5) / 2.0**52


def children(key, numbers, occupied, points):
    """Candidates: each joint of one of two members of a cell, the half of them moved."""
    members, dof = points.shape[1:]
    head, *bits = (words(key, numbers * np.uint64(dof + 1) + np.uint64(j)) for j in range(dof + 1))
    low, cells, bits = head & np.uint64(7), occupied[numbers.astype(int) % len(occupied)], np.stack(bits, axis=1)
    mother, father = ((((head >> np.uint64(k)) & np.uint64(0xFFFF)).astype(int) * members) >> 16 for k in (48, 32))
    of_mother = (head[:, None] >> np.arange(8, dof + 8, dtype=np.uint64)) & np.uint64(1)
    far = np.where(numbers < elites.EARLY, head & np.uint64(7 << 3), head & np.uint64(31 << 3)) == 0
    step = np.where(far, 1.0, 2.0 ** -(4.0 + low.astype(float)))[:, None]
    u = np.where(of_mother == 1, points[cells, mother], points[cells, father])
    u = np.abs(u + np.where(bits & np.uint64(1), step * (2 * units(bits) - 1), 0.0))
    return np.where(u > 1, 2 - u, u)


def slow(family, samples, dtype, key):
    dof, members, scales = family.arm.dof, len(family.members), family.scales(dtype)
    affines, layout = packed(TARGETS, dtype)
    layout[:, 3] = 0
    best = np.full((2 * GRID.cells, members), -1.0)
    points = np.full((*best.shape, dof), np.nan)
    occupied, in_order = [], 0
    for first in range(0, samples, FIRST):
        numbers = np.arange(first, min(first + FIRST, samples), dtype=np.uint64)
        of_joints = numbers[:, None] * np.uint64(dof + 1) + np.arange(1, dof + 1, dtype=np.uint64)
        u = children(key, numbers, np.array(occupied), points) if first else units(words(key, of_joints))
        u = u.astype(dtype)
        rows = family.kernel(dtype)(u, family.constants).T if family.traced else family.rows(u, dtype)
        rows = np.ascontiguousarray(rows)
        entries, room = [], np.empty((2, len(u)), np.int32)
        for t in range(2):
            found = locate(*rows[:4], len(u), affines[t], layout[t], *room)
            entries += [(i // BLOCK, t, i, t * GRID.cells + cell) for cell, i in room[:, :found].T]
        for _, _, i, row in sorted(entries):
            if best[row, 0] < 0:
                occupied.append(row)
            better = (values := rows[3:, i] * scales) > best[row]
            best[row, better], points[row, better] = values[better], u[i]
        if len(occupied) > in_order * 17 / 16:
            occupied.sort()
            in_order = len(occupied)
    return points.reshape(2, GRID.cells, members, dof)


def prepared(K, plain):
    made = prepare(arms.paper(0.26, 0.18, limits=(-2.0, 2.0)), Yoshikawa(K, None, ALL_ROWS), None, 0.0)
    index = ArrayIndex(lambda postures: made.index.values(postures, made.prepared))
    return prepare(made.arm, index, made.normaliser, 0.0) if plain else made


@pytest.mark.parametrize("plain", [False, True], ids=["traced", "NumPy"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_same_elites(plain, dtype, monkeypatch):
    monkeypatch.setattr(elites, "FIRST", FIRST)
    monkeypatch.setenv("EIWA_THREADS", "3")
    family, samples = Family(tuple(prepared(K, plain) for K in (4096.0, 200.0))), 3 * FIRST + 1000
    found = [r.elites for _, (r, _) in refine(family, TARGETS, WEIGHTS, stream(), Sampling(samples, dtype, 1e-12))]
    np.testing.assert_array_equal(np.stack(found, axis=2), slow(family, samples, dtype, stream().key))


@pytest.mark.parametrize(("dof", "members"), [(6, 1), (7, 3), (30, 5)])
def test_the_same_children(dof, members):
    """Also where one in 8 that moves anywhere becomes one in 32, and with more joints than there are bits for."""
    n, first, key = 3000, elites.EARLY - 1500, np.uint64(5)
    points = np.random.default_rng(0).random((40, members, dof))
    occupied, w = np.arange(39, 2, -1, dtype=np.int32), np.empty((dof + 1, n))
    elites.propose(w.ravel(), n, dof, n, first, key, occupied, points.reshape(-1, dof), members)
    expected = children(key, np.arange(first, first + n, dtype=np.uint64), occupied, points)
    np.testing.assert_array_equal(w[:dof].T, expected)
