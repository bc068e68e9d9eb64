"""Indices of singular values, joint-limit penalties, extended manipulability, products and the global index."""

from itertools import product as combinations
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eiwa.core.dexterity import Family, prepare
from eiwa.core.interfaces import ArmColumns, DexterityIndex, Postures, TracedIndex
from eiwa.core.registry import load
from eiwa.core.symbols import as_columns
from eiwa.core.transforms import roll_pitch_yaw, translation
from tests import arms
from tests.arms import postures, printed

REGISTRY = load()
ALL = np.arange(6)
SINGULAR_VALUES = ("condition", "smallest_singular_value", "isotropy")


def index(kind, **parameters):
    return REGISTRY.part("dexterity", {"kind": kind, **parameters}).build()


def on_arrays(chosen, at, prepared=None):
    """A traced index on NumPy columns: nothing is compiled."""
    prepared = chosen.prepare(Limited(at), at) if prepared is None else prepared
    J = [as_columns(row) for row in at.jacobians.transpose(1, 0, 2)]
    R = [as_columns(row) for row in at.rotations.transpose(1, 0, 2)]
    columns = ArmColumns(as_columns(at.u), as_columns(at.q), as_columns(at.tips), R, J, at.limited)
    return np.broadcast_to(chosen.columns(columns, list(prepared)), len(at.u))


class Limited:
    """What an index asks of an arm when it prepares."""

    def __init__(self, at):
        self.limited = at.limited


def value(kind, arm, q, **parameters):
    return on_arrays(index(kind, **parameters), postures(arm, np.atleast_2d(np.asarray(q, float))))


def sampled(arm, n=200, seed=0):
    return postures(arm, arm.lower + np.random.default_rng(seed).uniform(size=(n, arm.dof)) * (arm.upper - arm.lower))


def singular_values(at, length=1.0, rows=ALL):
    J = at.jacobians.copy()
    J[:, :3] /= length
    return np.linalg.svd(J[:, rows], compute_uv=False)


PANDA = (0, -0.3, 0, -2.2, 0, 2.0, np.pi / 4)
PUMA = np.deg2rad((0, 45, 180, 0, 45, 0))
TOUCH = (0, 0.875, 0.22, 6.375, 0.625, 0)


@pytest.mark.parametrize(
    ("kind", "arm", "q", "expected"),
    [
        ("condition", arms.panda(), PANDA, "0.1122211713"),
        ("smallest_singular_value", arms.panda(), PANDA, "0.2090134276"),
        ("condition", arms.touch(), TOUCH, "0.0373091555"),
        ("condition", arms.paper(), (0, 0, np.pi / 2, 0, np.pi / 2, 0), "0.06695467151789"),
        ("condition", arms.paper(), (0.1, 0.2, 0.7, 0.3, 0.9, 0.4), "0.030224782169583"),
        ("condition", arms.paper(), (0,) * 6, "0.0e-15"),
        ("isotropy", arms.planar(0.3, 0.3 * np.sqrt(0.5)), (0.4, 0.75 * np.pi), "1.000000"),
    ],
)
def test_published_and_closed_values(kind, arm, q, expected):
    rows = ["x", "y"] if arm.dof == 2 else "all"
    assert value(kind, arm, q, length=1.0, rows=rows)[0] == printed(expected)


def test_the_condition_number_of_the_puma():
    assert 1 / value("condition", arms.puma(), PUMA, length=1.0)[0] == printed("7.884032022")


def test_a_planar_arm_is_isotropic_where_salisbury_and_craig_say():
    """Links in the ratio sqrt(2) to 1 and an elbow of 135 degrees: both singular values are L2."""
    arm, q = arms.planar(0.3, 0.3 * np.sqrt(0.5)), (0.4, 0.75 * np.pi)
    assert value("condition", arm, q, rows=["x", "y"])[0] == pytest.approx(1.0, abs=1e-7)
    assert value("smallest_singular_value", arm, q, rows=["x", "y"])[0] == pytest.approx(0.3 * np.sqrt(0.5), rel=1e-7)


@pytest.mark.parametrize("rows", ["all", "translation", "rotation", ["x", "z", "ry"]])
@pytest.mark.parametrize("arm", [arms.paper(limits=(-2, 2)), arms.panda()], ids=["paper", "panda"])
def test_they_are_functions_of_lapacks_singular_values(arm, rows):
    at = sampled(arm)
    chosen = {"all": ALL, "translation": ALL[:3], "rotation": ALL[3:]}.get(str(rows), [0, 2, 4])
    s = singular_values(at, 0.2, chosen)
    expected = {
        "condition": s[:, -1] / s[:, 0],
        "smallest_singular_value": s[:, -1],
        "isotropy": np.prod(s, axis=1) ** (1 / s.shape[1]) / s.mean(axis=1),
    }
    for kind in SINGULAR_VALUES:
        found = on_arrays(index(kind, length=0.2, rows=rows), at)
        rtol = 1e-6 if kind == "isotropy" else 1e-9
        np.testing.assert_allclose(found, expected[kind], rtol=rtol, atol=1e-13, err_msg=kind)


@pytest.mark.parametrize("kind", SINGULAR_VALUES)
def test_an_arm_of_fewer_joints_than_rows_is_judged_by_the_motions_it_has(kind):
    at = sampled_planar()
    s = singular_values(at, 0.2)
    expected = {"condition": s[:, -1] / s[:, 0], "smallest_singular_value": s[:, -1]}
    expected["isotropy"] = np.sqrt(s[:, 0] * s[:, 1]) / s.mean(axis=1)
    np.testing.assert_allclose(on_arrays(index(kind, length=0.2), at), expected[kind], rtol=1e-12)


def sampled_planar():
    return postures(arms.planar(0.3, 0.2), np.random.default_rng(1).uniform(-3, 3, (100, 2)))


# The characteristic length.


def stretched(at, factor):
    """The same postures in another unit of length."""
    J = at.jacobians.copy()
    J[:, :3] *= factor
    return Postures(at.u, at.q, at.tips * factor, at.rotations, J, at.valid, at.limited)


@pytest.mark.parametrize("kind", SINGULAR_VALUES)
def test_with_the_automatic_length_the_unit_does_not_matter(kind):
    at = sampled(arms.panda())
    np.testing.assert_allclose(
        on_arrays(index(kind), stretched(at, 1000.0)), on_arrays(index(kind), at), rtol=1e-10, atol=1e-14
    )


def test_the_automatic_length_is_the_ratio_of_the_rms_entries():
    at = sampled(arms.mtm())
    (inverse,) = index("condition").prepare(Limited(at), at)
    linear, angular = (np.sqrt(np.mean(at.jacobians[:, rows] ** 2)) for rows in (slice(0, 3), slice(3, 6)))
    assert 1 / inverse == pytest.approx(linear / angular, rel=1e-12)


@pytest.mark.parametrize("rows", ["translation", "rotation"])
def test_rows_of_one_kind_have_the_length_1(rows):
    at = sampled(arms.mtm())
    assert index("condition", rows=rows).prepare(Limited(at), at) == [1.0]


def test_an_arm_that_does_not_turn_has_the_length_1():
    at = sampled(arms.gantry((0, 1), (0, 1), (0, 1)))
    assert index("condition").prepare(Limited(at), at) == [1.0]


# Invariances and bounds.


@pytest.mark.parametrize("kind", [*SINGULAR_VALUES])
def test_the_pose_of_the_base_does_not_matter(kind):
    plain, at = arms.paper(limits=(-2, 2)), sampled(arms.paper(limits=(-2, 2)))
    T = translation(0.3, -0.2, 0.5) @ roll_pitch_yaw(0.4, -0.8, 1.2)
    moved = type(plain)(plain.joints, plain.T_last_tip, T @ plain.T_base_first)
    np.testing.assert_allclose(
        on_arrays(index(kind), postures(moved, at.q)), on_arrays(index(kind), at), rtol=1e-9, atol=1e-13
    )


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_ratios_stay_within_0_and_1(q):
    for kind in ("condition", "isotropy"):
        assert 0.0 <= value(kind, arms.paper(), q, length=0.3)[0] <= 1.0 + 1e-15


@pytest.mark.parametrize("kind", [*SINGULAR_VALUES, "extended"])
@pytest.mark.parametrize("q", [(0,) * 6, (0, 0, 1, 0, 0, 0), (0, np.pi / 2, 1, 0, 1, 0)])
def test_they_vanish_at_singularities(kind, q):
    zero = 3e-3 if kind == "isotropy" else 3e-16  # the sixth root of rounding errors
    assert value(kind, arms.paper(limits=(-4, 4)), q, length=0.3)[0] == pytest.approx(0.0, abs=zero)


@pytest.mark.parametrize("kind", SINGULAR_VALUES)
@pytest.mark.parametrize("joints", [4, 5, 6])
def test_an_arm_that_is_singular_everywhere_has_none(kind, joints):
    """More than three parallel axes: three of all directions, so that it is refused, not normalised."""
    arm = arms.planar(*(0.1,) * joints)
    q = np.random.default_rng(2).uniform(-3, 3, (50, joints))
    np.testing.assert_array_equal(on_arrays(index(kind), postures(arm, q)), 0.0)


# Joint limits.


def test_the_product_form_is_the_factor_of_yoshikawas_index():
    at = sampled(arms.panda())
    w = on_arrays(index("yoshikawa", K=500.0), at)
    expected = w / np.prod(singular_values(at), axis=1)
    np.testing.assert_allclose(on_arrays(index("joint_limits", K=500.0), at), expected, rtol=1e-8)


def test_the_mean_form_is_reachs_bounded_mean():
    at = sampled(arms.panda())
    expected = np.mean(4 * at.u * (1 - at.u), axis=1)
    np.testing.assert_allclose(on_arrays(index("joint_limits", form="mean"), at), expected, rtol=1e-12)


@pytest.mark.parametrize("place", [0.0, 1.0, -0.1, 1.3])
def test_a_joint_at_or_beyond_a_limit_adds_nothing_to_the_mean(place):
    arm = arms.paper(limits=(-1.0, 1.0))
    q = [2 * place - 1, 0, 0, 0, 0, 0]
    assert value("joint_limits", arm, q, form="mean")[0] == pytest.approx(5 / 6, rel=1e-12)


def test_an_arm_without_limits_is_not_penalised():
    assert value("joint_limits", arms.planar(0.3, 0.2), (0.4, 0.7), form="mean")[0] == 1.0


# Extended manipulability.


def vahrenkamp(at, arm, length):
    """By its definition, orthant by orthant, in NumPy."""
    low, high, q = arm.lower, arm.upper, at.q
    w = np.abs((high - low) ** 2 * (2 * q - high - low) / (4 * (high - q) ** 2 * (q - low) ** 2))
    near_high = np.abs(q - low) > np.abs(q - high)
    pen = 1 / np.sqrt(1 + w)
    up, down = np.where(near_high, pen, 1.0), np.where(near_high, 1.0, pen)
    J = at.jacobians.copy()
    J[:, :3] /= length
    volumes = []
    for signs in combinations((1, -1), repeat=6):
        forward = J * np.array(signs)[None, :, None] >= 0
        volumes.append(np.prod(np.linalg.svd(J * np.where(forward, up[:, None], down[:, None]), compute_uv=False), 1))
    return np.min(volumes, axis=0)


@pytest.mark.parametrize("arm", [arms.paper(limits=(-2.0, 1.0)), arms.panda()], ids=["paper", "panda"])
def test_extended_manipulability_is_that_of_its_definition(arm):
    at = sampled(arm, 40)
    np.testing.assert_allclose(
        on_arrays(index("extended", length=0.3), at), vahrenkamp(at, arm, 0.3), rtol=1e-8, atol=1e-12
    )


def test_it_is_plain_manipulability_at_mid_range_or_without_limits():
    middle = postures(arms.panda(), np.tile((arms.panda().lower + arms.panda().upper) / 2, (2, 1)))
    for at, rows in ((middle, ALL), (sampled_planar(), ALL[:2])):
        names = [("x", "y", "z", "rx", "ry", "rz")[k] for k in rows]
        expected = np.prod(singular_values(at, 1.0, rows), axis=1)
        two = Postures(*(np.concatenate([a, a]) for a in (at.u, at.q, at.tips, at.rotations, at.jacobians, at.valid)),
                       at.limited)  # fmt: skip
        prepared = np.array([1.0, *np.full(at.q.shape[1], 2.0)])
        np.testing.assert_allclose(on_arrays(index("extended", rows=names), two, prepared)[: len(expected)], expected)


def test_it_is_zero_at_a_limit_where_plain_manipulability_is_not():
    """The second joint of a planar arm at its end: one orthant needs it to go further."""
    arm = arms.gantry((0.0, 1.0), (0.0, 1.0), (0.0, 1.0))
    at = postures(arm, np.array([[0.5, 0.5, 0.5], [0.5, 1.0, 0.5]]))
    prepared = np.array([1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(on_arrays(index("extended", rows="translation"), at, prepared), [1.0, 0.0])


def test_ranges_are_read_off_the_pilot():
    arm = arms.panda()
    at = sampled(arm)
    np.testing.assert_allclose(index("extended").prepare(arm, at)[1:], arm.upper - arm.lower, rtol=1e-12)


# Products.

FACTORS = [
    {"kind": "condition", "rows": "translation"},
    {"kind": "joint_limits", "K_scaled": 3.0},
    {"kind": "yoshikawa", "K": 100.0, "rows": "rotation"},
]


def test_a_product_is_the_product_of_its_parts():
    at = sampled(arms.panda())
    parts = [on_arrays(REGISTRY.part("dexterity", factor).build(), at) for factor in FACTORS]
    np.testing.assert_allclose(on_arrays(index("product", factors=FACTORS), at), np.prod(parts, axis=0), rtol=1e-13)


class OnArrays(DexterityIndex):
    """An index that nobody can trace."""

    def prepare(self, arm, pilot):
        return np.array([2.0, 3.0])

    def values(self, postures, prepared):
        return postures.u[:, 0] * prepared[1]


def test_a_product_with_an_index_on_arrays_is_on_arrays():
    build = REGISTRY.find("dexterity", "product", "").build
    part = type("Part", (), {"build": staticmethod(OnArrays)})
    other = REGISTRY.part("dexterity", {"kind": "joint_limits", "form": "mean"})
    chosen = build(type("P", (), {"factors": [part, part]}))
    at = sampled(arms.paper(limits=(-1, 1)))
    assert not isinstance(build(type("P", (), {"factors": [part, other]})), TracedIndex)
    np.testing.assert_allclose(chosen.values(at, chosen.prepare(None, at)), 9.0 * at.u[:, 0] ** 2)


def test_products_of_the_same_kinds_share_a_structure_and_others_do_not():
    def with_K(K, kind="condition"):
        return index("product", factors=[{"kind": kind}, {"kind": "joint_limits", "K": K}])

    assert with_K(1.0).structure == with_K(2.0).structure
    assert with_K(1.0).structure != with_K(1.0, "isotropy").structure


# The global conditioning index.


def gci(arm, **parameters):
    plugin = REGISTRY.find("metrics", "gci", "")
    measurement = SimpleNamespace(setup=SimpleNamespace(arm=arm))
    return plugin.build(plugin.parameters(**parameters))(measurement)["gci"]


def test_the_global_index_is_the_mean_over_joint_space():
    """Within five standard errors of plain samples."""
    arm = arms.paper(limits=(-2.0, 2.0))
    s = singular_values(sampled(arm, 40000), 0.3)
    each = s[:, -1] / s[:, 0]
    assert gci(arm, length=0.3) == pytest.approx(each.mean(), abs=5 * each.std() / np.sqrt(len(each)))


def test_an_arm_that_is_isotropic_everywhere_has_the_global_index_1():
    assert gci(arms.gantry((0, 1), (0, 1), (0, 1)), rows="translation") == 1.0


# Compiled: a family, and what is kept of its samples.


def test_compiled_products_make_a_family_that_is_told_from_others():
    arm = arms.paper(limits=(-2.0, 2.0))
    members = [
        prepare(arm, index("product", factors=[FACTORS[0], {"kind": "joint_limits", "K_scaled": K}]), 1.0, 0.0)
        for K in (3.0, 5.0)
    ]
    family = Family(tuple(members))
    at = sampled(arm)
    _, raw = family.evaluate(at.u)
    for member, values in zip(members, raw.T, strict=True):
        np.testing.assert_allclose(values, on_arrays(member.index, at, member.prepared), rtol=1e-9, atol=1e-13)
    assert family.traced
    assert family.identity is not None
    assert family.identity == Family(tuple(members)).identity != Family(tuple(members[::-1])).identity
