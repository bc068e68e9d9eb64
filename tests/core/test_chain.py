"""The chain against closed forms, published numbers, Pinocchio and finite differences."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from eiwa.core.chain import Coupling, Joint, Mimic, SerialChain
from eiwa.core.errors import SpecError
from eiwa.core.linear import volume
from eiwa.core.optimum import maximum, pilot_points
from eiwa.core.sampling import Stream
from eiwa.core.symbols import Tape, as_columns
from eiwa.core.transforms import inverse, roll_pitch_yaw, rotation_x, translation
from tests import arms
from tests.arms import ROTATION, TRANSLATION, forward, manipulability, printed


def uniform(arm, n, seed=0):
    return arm.lower + np.random.default_rng(seed).uniform(size=(n, arm.dof)) * (arm.upper - arm.lower)


# The paper's arm, Table 1 read as modified DH with L1, L2 = 0.26, 0.18: every column in closed form.

PAPER = {
    "mid": (
        (0, 0, np.pi / 2, 0, np.pi / 2, 0),
        ("0.26000000", "0.18000000", "0.00000000"),
        "0.012168000000000",
        "0.006842934839798",
        "8.326483113066e-5",
        "0.06695467151789",
    ),
    "any": (
        (0.1, 0.2, 0.7, 0.3, 0.9, 0.4),
        ("0.37622094", "0.15428941", "0.07900515"),
        "0.009204531588685",
        "0.010275025011638",
        "9.457679229415e-5",
        "0.030224782169583",
    ),
    "zero": (
        (0,) * 6,
        ("0.44000000", "0.00000000", "0.00000000"),
        "0.0e-15",
        "0.012132827686",
        "0.0e-15",
        "0.0e-15",
    ),
}


@pytest.fixture(params=PAPER.values(), ids=PAPER.keys())
def paper_row(request):
    q, *columns = request.param
    return arms.paper(), np.array([q], float), columns


def test_paper_tip(paper_row):
    arm, q, (tip, *_) = paper_row
    assert list(forward(arm, q)[0][0]) == [printed(x) for x in tip]


def test_paper_manipulability(paper_row):
    arm, q, (_, w, *_) = paper_row
    assert manipulability(forward(arm, q)[2])[0] == printed(w)


def test_paper_penalty_factor(paper_row):
    arm, q, (_, _, factor, *_) = paper_row
    u = arm.to_u(q)[0]
    assert -np.expm1(-50 * np.prod(u * (1 - u))) == printed(factor)


def test_paper_reciprocal_condition(paper_row):
    arm, q, columns = paper_row
    singular = np.linalg.svd(forward(arm, q)[2][0], compute_uv=False)
    assert singular[-1] / singular[0] == printed(columns[-1])


def test_paper_product_of_margins_at_the_middle_is_9_over_65536():
    u = arms.paper().to_u(PAPER["mid"][0])
    assert np.prod(u * (1 - u)) == pytest.approx(9 / 65536, rel=1e-14)


@pytest.mark.parametrize("lengths", [(0.26, 0.18), (0.15, 0.15)])
def test_paper_manipulability_in_closed_form(lengths):
    L1, L2 = lengths
    arm = arms.paper(L1, L2)
    q = uniform(arm, 1000)
    _, q2, q3, _, q5, _ = q.T
    expected = L1 * L2 * np.abs(np.cos(q2) * np.sin(q3) * (L1 + L2 * np.cos(q3)) * np.sin(q5))
    np.testing.assert_allclose(manipulability(forward(arm, q)[2]), expected, atol=1e-16, rtol=1e-11)


def test_paper_squared_reach_in_closed_form():
    arm = arms.paper(0.26, 0.18)
    q = uniform(arm, 1000)
    squared = 0.26**2 + 0.18**2 + 2 * 0.26 * 0.18 * np.cos(q[:, 2])
    np.testing.assert_allclose((forward(arm, q)[0] ** 2).sum(axis=1), squared, rtol=1e-13)


@pytest.mark.parametrize(("lengths", "largest"), [((0.26, 0.18), 0.014256078741), ((0.15, 0.15), 0.004384253607)])
def test_paper_largest_manipulability(lengths, largest):
    arm = arms.paper(*lengths)

    def w(u):
        return manipulability(forward(arm, arm.lower + u * (arm.upper - arm.lower))[2])

    assert maximum(w, pilot_points(6)) == pytest.approx(largest, abs=1e-12)


def test_paper_mean_manipulability():
    arm = arms.paper(0.26, 0.18)
    u = Stream("plain", 1).points(0, 1 << 17, 6)
    w = manipulability(forward(arm, arm.lower + u * (arm.upper - arm.lower))[2])
    standard_error = w.std() / np.sqrt(len(w))
    assert abs(w.mean() - 8 * 0.26**2 * 0.18 / np.pi**3) < 4 * standard_error


# Published rows (facts-kinematics: robotics-toolbox-python, dVRK, the omni drivers' URDF).

PUMA = arms.puma(), np.deg2rad([0, 45, 180, 0, 45, 0])
PANDA = arms.panda(), np.array([0, -0.3, 0, -2.2, 0, 2.0, np.pi / 4])
PANDA_2 = arms.panda(), np.array([1.4, 0.2, 1.8, 0.7, 0.1, 3.1, 2.9])
MTM = arms.mtm(), np.zeros(7)
MTM_2 = arms.mtm(), np.array([0.1, 0.2, 0.1, 0.3, 0.4, 0.2, 0.5])
TOUCH = arms.touch(), (arms.touch().lower + arms.touch().upper) / 2


def jacobian(case):
    arm, q = case
    return forward(arm, q[None])[2]


@pytest.mark.parametrize(
    ("case", "w"),
    [
        (PUMA, "0.07861716534599998"),
        (PANDA, "0.0837515097"),
        (PANDA_2, "0.006559178039088"),
        (MTM, "0.0524972392"),
        (MTM_2, "0.0485115256"),
        (TOUCH, "0.0031872244"),
    ],
)
def test_published_manipulability(case, w):
    assert manipulability(jacobian(case))[0] == printed(w)


@pytest.mark.parametrize(
    ("case", "w"),
    [
        (PUMA, "0.11118146146764128"),
        (PANDA, "0.1438403199"),
        (MTM, "0.0371211538"),
        (MTM_2, "0.0348919651"),
        (TOUCH, "0.0032395712"),
    ],
)
def test_published_translation_manipulability(case, w):
    assert manipulability(jacobian(case), TRANSLATION)[0] == printed(w)


@pytest.mark.parametrize(
    ("case", "w"),
    [
        (PUMA, "2.449489742783178"),
        (PANDA, "2.7455821831"),
        (MTM, "3.0000000000"),
        (MTM_2, "2.9153063306"),
        (TOUCH, "2.5831526501"),
    ],
)
def test_published_rotation_manipulability(case, w):
    assert manipulability(jacobian(case), ROTATION)[0] == printed(w)


@pytest.mark.parametrize(
    ("case", "reciprocal"),
    [(PUMA, "0.1268386528"), (PANDA, "0.1122211713"), (TOUCH, "0.0373091555")],
)
def test_published_reciprocal_condition(case, reciprocal):
    """The Touch's stands in the facts as .0373091552, one 5 short."""
    assert 1 / np.linalg.cond(jacobian(case)[0]) == printed(reciprocal)


def test_published_smallest_singular_value_of_the_panda():
    assert np.linalg.svd(jacobian(PANDA)[0], compute_uv=False)[-1] == printed("0.2090134276")


@pytest.mark.parametrize(
    ("case", "tip"),
    [
        (PUMA, ("0.596303149", "-0.150050000", "0.657475732")),
        (MTM, ("0.00000000", "-0.36450000", "-0.12880000")),
        (MTM_2, ("0.03586246", "-0.3574284", "-0.02223981")),
    ],
)
def test_published_tip(case, tip):
    arm, q = case
    assert list(forward(arm, q[None])[0][0]) == [printed(x) for x in tip]


# Pinocchio, an independent library, on random chains.


def random_chain(seed):
    """1 to 12 joints with fixed ones in between; kinds, axes and poses at random, links up to 1 m."""
    rng = np.random.default_rng(seed)
    movable = 1 + seed % 12
    kinds = list(rng.choice(["revolute", "prismatic"], movable, p=[0.7, 0.3]))
    for place in rng.integers(0, movable + 1, rng.integers(0, 4)):
        kinds.insert(place, "fixed")

    def pose():
        lengths = rng.normal(size=3)
        lengths *= rng.uniform() / np.linalg.norm(lengths)
        return translation(*lengths) @ roll_pitch_yaw(*rng.uniform(-np.pi, np.pi, 3))

    def axis():
        if rng.uniform() < 0.3:
            return tuple(rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)])
        return tuple(rng.normal(size=3))

    joints = [Joint(f"j{k}", str(kind), pose(), (-1.0, 1.0), axis()) for k, kind in enumerate(kinds)]
    return SerialChain(tuple(joints), pose(), pose())


def pinocchio_forward(arm, q):
    model, parent, placement = pin.Model(), 0, pin.SE3(arm.T_base_first)
    for joint in arm.joints:
        placement = placement * pin.SE3(joint.T_parent_joint)
        if joint.kind != "fixed":
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            revolute = joint.kind == "revolute"
            kind = pin.JointModelRevoluteUnaligned if revolute else pin.JointModelPrismaticUnaligned
            parent = model.addJoint(parent, kind(axis), placement, joint.name)
            placement = pin.SE3.Identity()
    tip = pin.Frame("tip", parent, placement * pin.SE3(arm.T_last_tip), pin.FrameType.OP_FRAME)
    frame, data = model.addFrame(tip), model.createData()
    results = []
    for row in q:
        J = pin.computeFrameJacobian(model, data, row, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(model, data, row)
        pose = data.oMf[frame]
        results.append((pose.translation.copy(), pose.rotation.copy(), J.reshape(6, arm.dof).copy()))
    return [np.array(values) for values in zip(*results, strict=True)]


def random_postures(arm, n=5):
    return np.random.default_rng(arm.dof).uniform(-3, 3, (n, arm.dof))


@pytest.mark.parametrize("quantity", [0, 1, 2], ids=["tips", "orientations", "jacobians"])
@pytest.mark.parametrize("seed", range(50))
def test_formulas_agree_with_pinocchio(seed, quantity):
    arm = random_chain(seed)
    q = random_postures(arm)
    np.testing.assert_allclose(forward(arm, q)[quantity], pinocchio_forward(arm, q)[quantity], rtol=0, atol=1e-12)


@pytest.mark.parametrize("quantity", [0, 1, 2], ids=["tips", "orientations", "jacobians"])
@pytest.mark.parametrize("seed", [3, pytest.param(7, marks=pytest.mark.slow)])
def test_compiled_formulas_agree_with_pinocchio(seed, quantity):
    arm = random_chain(seed)
    q = random_postures(arm)
    np.testing.assert_allclose(arm.forward(q)[quantity], pinocchio_forward(arm, q)[quantity], rtol=0, atol=1e-12)


def test_random_chains_cover_every_kind_and_count():
    chains = [random_chain(seed) for seed in range(50)]
    kinds = {joint.kind for arm in chains for joint in arm.joints}
    assert (kinds, {arm.dof for arm in chains}) == ({"revolute", "prismatic", "fixed"}, set(range(1, 13)))


# The Jacobian is the derivative of the forward map.

DIFFERENTIATED = {
    "paper": arms.paper(),
    "panda": arms.panda(),
    "mixed": random_chain(9),
    "touch": arms.touch(),
}
STEP = 1e-6


def differences(arm, q, quantity):
    """Central differences of a quantity of the forward map, one per joint: shape (dof, n, ...)."""
    steps = STEP * np.eye(arm.dof)
    return np.array([(forward(arm, q + h)[quantity] - forward(arm, q - h)[quantity]) / (2 * STEP) for h in steps])


@pytest.mark.parametrize("arm", DIFFERENTIATED.values(), ids=DIFFERENTIATED)
def test_linear_rows_are_the_derivative_of_the_tip(arm):
    q = uniform(arm, 20)
    expected = np.moveaxis(differences(arm, q, 0), 0, -1)
    np.testing.assert_allclose(forward(arm, q)[2][:, :3], expected, atol=1e-8, rtol=0)


@pytest.mark.parametrize("arm", DIFFERENTIATED.values(), ids=DIFFERENTIATED)
def test_angular_rows_are_the_derivative_of_the_orientation(arm):
    q = uniform(arm, 20)
    R = forward(arm, q)[1]
    spin = differences(arm, q, 1) @ R.transpose(0, 2, 1)
    omega = np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)
    np.testing.assert_allclose(forward(arm, q)[2][:, 3:], np.moveaxis(omega, 0, -1), atol=1e-8, rtol=0)


def test_orientations_are_rotations():
    arm = random_chain(11)
    R = forward(arm, uniform(arm, 50))[1]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)


# Compiled forms.


@pytest.mark.parametrize("quantity", [0, 1, 2], ids=["tips", "orientations", "jacobians"])
def test_single_precision_is_within_2e_6_of_double(quantity):
    arm = arms.paper()
    q = uniform(arm, 2000)
    single, double = arm.forward(q, np.float32)[quantity], arm.forward(q)[quantity]
    np.testing.assert_allclose(single, double, rtol=0, atol=2e-6)


def test_single_precision_answers_in_single_precision():
    arm = arms.paper()
    assert arm.forward(uniform(arm, 3), np.float32)[2].dtype == np.float32


def test_results_do_not_depend_on_the_batch():
    arm = arms.paper()
    q = uniform(arm, 1000)
    parts = np.concatenate([arm.forward(q[k : k + 37])[2] for k in range(0, 1000, 37)])
    np.testing.assert_array_equal(parts, arm.forward(q)[2])


@pytest.mark.parametrize("threads", ["1", "3"])
def test_results_do_not_depend_on_the_threads(threads, monkeypatch):
    arm = arms.paper()
    q = uniform(arm, 50_000)
    monkeypatch.setenv("EIWA_THREADS", "2")
    two = arm.forward(q)[2]
    monkeypatch.setenv("EIWA_THREADS", threads)
    np.testing.assert_array_equal(arm.forward(q)[2], two)


def test_postures_map_the_unit_cube_to_the_ranges():
    arm = arms.paper(limits=(-1.0, 2.0))
    q = arm.postures(np.array([[0.0] * 6, [1.0] * 6])).q
    np.testing.assert_allclose(q, [[-1.0] * 6, [2.0] * 6], rtol=4e-16)


def test_postures_agree_with_forward():
    arm = arms.paper(limits=(-1.0, 2.0))
    at = arm.postures(np.random.default_rng(0).uniform(size=(100, 6)))
    np.testing.assert_allclose(at.jacobians, arm.forward(at.q)[2], atol=1e-15)


@pytest.mark.parametrize("seed", [seed for seed in range(50) if random_chain(seed).dof >= 6])
def test_the_reduced_jacobian_has_the_volume_of_the_jacobian(seed):
    arm = random_chain(seed)
    for h in np.random.default_rng(seed).uniform(-1, 1, (5, arm.dof)).tolist():
        columns = arm.at(h, h, arm.constants[2 * arm.dof :].tolist())
        assert volume(columns.reduced) == pytest.approx(volume(columns.jacobian), rel=1e-9, abs=1e-12)


MEETING = {"paper": (arms.paper, 3), "puma": (arms.puma, 3), "panda": (arms.panda, 3), "mtm": (arms.mtm, 4)}


@pytest.mark.parametrize(("arm", "axes"), MEETING.values(), ids=MEETING)
def test_the_reduced_jacobian_is_taken_where_most_axes_meet(arm, axes):
    """Shoulder or wrist: the linear part of as many columns is known to vanish."""
    arm, tape = arm(), Tape()
    u = [tape.node("input", j) for j in range(arm.dof)]
    p = [tape.node("parameter", k) for k in range(len(arm.constants))]
    linear = list(zip(*arm.columns(u, p).reduced[:3], strict=True))
    assert sum(column == (0.0, 0.0, 0.0) for column in linear) == axes


def test_no_rows_give_no_rows():
    assert [len(a) for a in arms.paper().forward(np.empty((0, 6)))] == [0, 0, 0]


@pytest.mark.parametrize("method", ["forward", "postures"])
def test_a_wrong_number_of_columns_is_refused(method):
    with pytest.raises(ValueError, match="5 columns"):
        getattr(arms.paper(), method)(np.zeros((3, 5)))


# What a chain is.


def test_joint_values_and_unit_cube_are_inverse_to_each_other():
    arm = arms.panda()
    u = np.random.default_rng(0).uniform(size=(10, 7))
    np.testing.assert_allclose(arm.to_u(arm.lower + u * (arm.upper - arm.lower)), u, atol=1e-14)


def test_a_joint_without_limits_covers_a_full_turn():
    arm = arms.planar(1.0)
    assert (arm.lower[0], arm.upper[0]) == (-np.pi, np.pi)


def test_a_joint_without_limits_is_not_limited():
    assert arms.planar(1.0).limited == (False,)


def test_a_joint_with_limits_is_limited():
    assert arms.mtm().limited == (True,) * 7


def test_link_length_sums_the_offsets_between_frames():
    assert arms.paper(0.26, 0.18).link_length == pytest.approx(0.44, abs=1e-15)


def test_two_designs_of_one_structure_share_it():
    assert arms.paper(0.26, 0.18).structure == arms.paper(0.15, 0.25, limits=(-2.0, 2.0)).structure


def test_a_link_of_length_zero_is_another_structure():
    assert arms.paper(0.26, 0.18).structure != arms.paper(0.26, 0.0).structure


def test_designs_that_share_a_structure_keep_their_lengths():
    q = np.zeros((1, 6))
    reached = [arms.paper(*lengths).forward(q)[0][0, 0] for lengths in ((0.26, 0.18), (0.15, 0.25), (0.1, 0.1))]
    assert reached == pytest.approx([0.44, 0.40, 0.20], abs=1e-15)


@pytest.mark.parametrize("name", ["lower", "upper", "Ts_fixed", "constants"])
def test_arrays_handed_out_are_read_only(name):
    with pytest.raises(ValueError, match="read-only"):
        getattr(arms.paper(), name)[...] = 0.0


def test_the_pilot_is_read_only():
    with pytest.raises(ValueError, match="read-only"):
        pilot_points(3)[0, 0] = 0.0


def revolute(name, limits=None):
    return Joint(name, "revolute", translation(0.1, 0, 0), limits)


BROKEN = {
    "no joint": ([], r"arm\.joints.*0 movable"),
    "only fixed joints": ([Joint("base", "fixed", np.eye(4))], r"arm\.joints.*0 movable"),
    "13 joints": ([revolute(f"j{k}") for k in range(13)], r"arm\.joints.*13 movable"),
    "infinite limit": ([revolute("elbow", (0.0, np.inf))], r"arm\.joints\.elbow\.limits.*finite"),
    "NaN limit": ([revolute("elbow", (np.nan, 1.0))], r"arm\.joints\.elbow\.limits.*finite"),
    "falling limits": ([revolute("elbow", (1.0, 0.0))], r"arm\.joints\.elbow\.limits.*increase"),
    "unlimited prismatic joint": (
        [Joint("rail", "prismatic", np.eye(4))],
        r"arm\.joints\.rail\.limits.*prismatic",
    ),
}


@pytest.mark.parametrize(("joints", "message"), BROKEN.values(), ids=BROKEN)
def test_a_chain_that_cannot_be_is_refused_by_path(joints, message):
    with pytest.raises(SpecError, match=message):
        SerialChain(tuple(joints), np.eye(4), np.eye(4))


def test_twelve_joints_are_allowed():
    joints = tuple(revolute(f"j{k}") for k in range(12))
    assert SerialChain(joints, np.eye(4), np.eye(4)).dof == 12


def test_transform_times_its_inverse_is_the_identity():
    T = translation(1, 2, 3) @ roll_pitch_yaw(0.1, 0.2, 0.3)
    np.testing.assert_allclose(T @ inverse(T), np.eye(4), atol=1e-15)


@pytest.mark.parametrize("quarters", range(-5, 6))
def test_quarter_turns_are_exact(quarters):
    assert set(np.abs(rotation_x(quarters * np.pi / 2)).ravel()) == {0.0, 1.0}


# Coupled limits.


def coupled(*couplings, limits=(-1.0, 1.0)):
    """Two links, and rows over their joints."""
    chain = arms.planar(0.3, 0.2)
    joints = tuple(replace(joint, limits=limits) for joint in chain.joints)
    return replace(chain, joints=joints, couplings=couplings)


def valid(arm, n=2000):
    """Joint vectors of random points of the unit cube, and which are valid, on NumPy columns."""
    u = np.random.default_rng(0).uniform(size=(n, arm.dof))
    columns = arm.columns(as_columns(u), list(arm.constants))
    return np.stack(columns.q, axis=1), np.broadcast_to(columns.valid, n)


def test_without_rows_every_posture_is_valid():
    assert coupled().columns(as_columns(np.zeros((1, 2))), list(coupled().constants)).valid is True


def test_a_row_bounds_a_sum_of_joints():
    q, found = valid(coupled(Coupling({"j0": 1.0, "j1": 2.0}, -0.5, 0.8)))
    total = q[:, 0] + 2 * q[:, 1]
    np.testing.assert_array_equal(found, (total >= -0.5) & (total <= 0.8))


def test_every_row_must_hold():
    q, found = valid(coupled(Coupling({"j0": 1.0, "j1": 1.0}, -0.5, 0.5), Coupling({"j0": 1.0, "j1": -1.0}, 0.0, 2.0)))
    sums, differences_ = q[:, 0] + q[:, 1], q[:, 0] - q[:, 1]
    np.testing.assert_array_equal(found, (np.abs(sums) <= 0.5) & (differences_ >= 0))


def test_a_row_over_a_joint_that_mimics_is_one_over_its_source():
    """q_1 = 3 q_0 + 0.1, so 0 <= q_1 <= 1 is -0.1 / 3 <= q_0 <= 0.3."""
    arm = coupled(Coupling({"j1": 1.0}, 0.0, 1.0))
    arm = replace(arm, joints=(arm.joints[0], replace(arm.joints[1], limits=None, mimic=Mimic("j0", 3.0, 0.1))))
    q, found = valid(arm)
    np.testing.assert_array_equal(found, (q[:, 0] >= -0.1 / 3) & (q[:, 0] <= 0.3))


def test_the_compiled_mask_is_that_of_the_formulas():
    arm = coupled(Coupling({"j0": 1.0, "j1": 1.0}, -0.5, 0.5))
    u = np.random.default_rng(0).uniform(size=(2000, 2))
    np.testing.assert_array_equal(arm.postures(u).valid, valid(arm)[1])


def test_bounds_of_a_row_are_no_part_of_the_structure():
    one, other = (coupled(Coupling({"j0": 1.0, "j1": 1.0}, -0.5, high)) for high in (0.5, 0.6))
    assert one.structure == other.structure
    assert one.structure != coupled(Coupling({"j0": 1.0}, -0.5, 0.5)).structure


# Joints that mimic others (random ones, against Pinocchio: tests/plugins/test_urdf.py).


@pytest.mark.parametrize("source", ["nothing", "j1"])
def test_a_mimic_of_no_free_joint_is_refused(source):
    arm = arms.planar(0.3, 0.2)
    with pytest.raises(SpecError, match=r"arm\.joints\.j1\.mimic.*Free joints: j0"):
        replace(arm, joints=(arm.joints[0], replace(arm.joints[1], mimic=Mimic(source))))


def test_the_column_of_a_source_sums_what_it_drives():
    """A pantograph: the second joint turns back what the first one turned, so the second link keeps its direction."""
    arm = arms.planar(0.3, 0.2)
    arm = replace(arm, joints=(arm.joints[0], replace(arm.joints[1], mimic=Mimic("j0", -1.0))))
    tips, _, jacobians = forward(arm, np.array([[0.5]]))
    np.testing.assert_allclose(tips[0], [0.3 * np.cos(0.5) + 0.2, 0.3 * np.sin(0.5), 0], atol=1e-16)
    np.testing.assert_allclose(jacobians[0, :, 0], [-0.3 * np.sin(0.5), 0.3 * np.cos(0.5), 0, 0, 0, 0], atol=1e-16)
