"""URDF arms against Pinocchio, against the same arms as DH tables, and against published numbers."""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from eiwa.core.errors import SpecError
from eiwa.core.outcome import evaluate
from eiwa.core.spec import check
from eiwa.core.transforms import roll_pitch_yaw
from eiwa.plugins.arms import dh
from eiwa.plugins.arms.urdf import chain
from eiwa.plugins.arms.urdf.file import model, way
from tests import arms, urdf
from tests.arms import ROTATION, TRANSLATION, forward, manipulability, printed
from tests.study import small
from tests.urdf import joint, robot

DEVICES = Path(__file__).parents[2] / "studies" / "devices"
TOUCH = (DEVICES / "touch.urdf").read_text()
TABLES = {"panda": arms.panda_table(), "ur5": arms.ur5_table(), "mtm": arms.mtm_table()}
TEXTS = {**{name: urdf.from_table(table) for name, table in TABLES.items()}, "touch": TOUCH}


def uniform(arm, n, seed=0):
    return arm.lower + np.random.default_rng(seed).uniform(size=(n, arm.dof)) * (arm.upper - arm.lower)


def model_of(text):
    with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
        file.write(text)
        file.flush()
        return model(Path(file.name), str(hash(text)))


def motion(text, names, moved):
    """G and g in q_moved = G q_names + g: every joint by the joints that mimic none, then those by the named ones."""
    joints = model_of(text).joints
    roots = [name for name, j in joints.items() if j.mimic is None]

    def by_roots(name):
        mimic = joints[name].mimic
        if mimic is None:
            return np.array([float(name == root) for root in roots]), 0.0
        row, offset = by_roots(mimic.joint)
        return mimic.multiplier * row, mimic.multiplier * offset + mimic.offset

    (A, a), (B, b) = (
        [np.array(part) for part in zip(*map(by_roots, chosen), strict=True)] for chosen in (moved, names)
    )
    G = A @ np.linalg.pinv(B)
    return G, a - G @ b


def by_pinocchio(text, arm, q, tip):
    """Tips, orientations and Jacobians of a file; its mimics are honoured here, by the chain rule."""
    m = pin.buildModelFromXML(text)
    data, frame = m.createData(), m.getFrameId(tip)
    G, g = motion(text, [j.name for j in arm.free], list(m.names[1:]))
    results = []
    for values in q @ G.T + g:
        whole = pin.neutral(m)
        for k, value in enumerate(values, start=1):
            i, continuous = m.joints[k].idx_q, m.joints[k].nq == 2
            whole[i : i + m.joints[k].nq] = (np.cos(value), np.sin(value)) if continuous else value
        J = pin.computeFrameJacobian(m, data, whole, frame, pin.LOCAL_WORLD_ALIGNED) @ G
        pin.framesForwardKinematics(m, data, whole)
        results.append((data.oMf[frame].translation.copy(), data.oMf[frame].rotation.copy(), J))
    return [np.array(values) for values in zip(*results, strict=True)]


# Pinocchio


@pytest.mark.parametrize("quantity", [0, 1, 2], ids=["tips", "orientations", "jacobians"])
@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_a_public_arm_agrees_with_pinocchio(tmp_path, text, quantity):
    arm = urdf.arm(tmp_path, text)
    q, tip = uniform(arm, 20), urdf.read(tmp_path, text).tip
    np.testing.assert_allclose(forward(arm, q)[quantity], by_pinocchio(text, arm, q, tip)[quantity], rtol=0, atol=1e-12)


@pytest.mark.parametrize("quantity", [0, 1, 2], ids=["tips", "orientations", "jacobians"])
@pytest.mark.parametrize("seed", range(30))
def test_a_random_tree_agrees_with_pinocchio(tmp_path, seed, quantity):
    text, tip = urdf.random_tree(seed)
    arm = urdf.arm(tmp_path, text, tip=tip)
    q = np.random.default_rng(seed).uniform(-2, 2, (5, arm.dof))
    found, expected = forward(arm, q)[quantity], by_pinocchio(text, arm, q, tip)[quantity]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_random_trees_cover_every_kind_and_mimic():
    """Fixed, continuous and prismatic joints; mimics of joints on the way and of joints beside it."""
    seen = set()
    for seed in range(30):
        text, tip = urdf.random_tree(seed)
        m = model_of(text)
        on_way = way(m, None, tip)
        seen |= {j.type for j in on_way}
        seen |= {("mimic", j.mimic.joint in {k.name for k in on_way}) for j in on_way if j.mimic}
    assert seen == {"revolute", "continuous", "prismatic", "fixed", ("mimic", True), ("mimic", False)}


# The same arm as a DH table


@pytest.mark.parametrize("quantity", [0, 1, 2], ids=["tips", "orientations", "jacobians"])
@pytest.mark.parametrize("name", TABLES)
def test_a_table_written_as_urdf_is_the_same_arm(tmp_path, name, quantity):
    table = dh.chain(TABLES[name])
    q = uniform(table, 50)
    found = forward(urdf.arm(tmp_path, TEXTS[name]), q)[quantity]
    np.testing.assert_allclose(found, forward(table, q)[quantity], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", TABLES)
def test_a_table_written_as_urdf_has_the_same_ranges(tmp_path, name):
    arm, table = urdf.arm(tmp_path, TEXTS[name]), dh.chain(TABLES[name])
    np.testing.assert_array_equal([arm.lower, arm.upper], [table.lower, table.upper])


def study(arm, path=Path("small.toml"), **changes):
    """The small study with another arm."""
    tree = small.tree(small.NO_SEARCH | {small.DESIGN: ""})
    return check({**tree, "arm": arm, **changes}, path)


def test_a_table_written_as_urdf_has_the_same_F(tmp_path):
    table = arms.paper_table(limits=(-2.0, 2.0))
    (tmp_path / "paper.urdf").write_text(urdf.from_table(table))
    as_urdf, as_table = {"kind": "urdf", "file": "paper.urdf"}, {"kind": "dh", **table.model_dump(mode="json")}
    more = {"sampling": {"samples": 1 << 16}}
    one, other = (evaluate(study(arm, tmp_path / "s.toml", **more), {}, 3) for arm in (as_urdf, as_table))
    assert other.scenarios[""]["F"] > 0
    assert abs(one.scenarios[""]["F"] - other.scenarios[""]["F"]) < 0.01 * other.scenarios[""]["F_se"]


# Published numbers (facts-kinematics: the omni drivers, robotics-toolbox-python, dVRK)


@pytest.mark.parametrize(
    ("name", "q", "rows", "w"),
    [
        ("touch", None, slice(None), "0.0031872244"),
        ("touch", None, TRANSLATION, "0.0032395712"),
        ("touch", None, ROTATION, "2.5831526501"),
        ("panda", (0, -0.3, 0, -2.2, 0, 2.0, np.pi / 4), slice(None), "0.0837515097"),
        ("panda", (0, -0.3, 0, -2.2, 0, 2.0, np.pi / 4), TRANSLATION, "0.1438403199"),
        ("panda", (1.4, 0.2, 1.8, 0.7, 0.1, 3.1, 2.9), slice(None), "0.006559178039088"),
        ("mtm", (0,) * 7, slice(None), "0.0524972392"),
        ("mtm", (0.1, 0.2, 0.1, 0.3, 0.4, 0.2, 0.5), TRANSLATION, "0.0348919651"),
    ],
)
def test_published_manipulability(tmp_path, name, q, rows, w):
    arm = urdf.arm(tmp_path, TEXTS[name])
    q = (arm.lower + arm.upper) / 2 if q is None else np.array(q)
    assert manipulability(forward(arm, q[None])[2], rows)[0] == printed(w)


# Mimics and limits


def two(*, limits=(-1.0, 1.0), mimic=("a", 2.0, 0.5), own=(-1.0, 2.0), kind="revolute"):
    """A joint a, and a joint b that mimics it."""
    return robot(
        joint("a", "revolute", "base", "one", limits=limits),
        joint("b", kind, "one", "two", (0.3, 0, 0), axis=(0, 1, 0), limits=own, mimic=mimic),
    )


@pytest.mark.parametrize(
    ("options", "ranges"),
    [
        ({}, (-0.75, 0.75)),
        ({"mimic": ("a", -2.0, 0.5)}, (-0.75, 0.75)),
        ({"mimic": ("a", 0.5, 0.0)}, (-1.0, 1.0)),
        ({"own": None}, (-1.0, 1.0)),
        ({"limits": (-0.1, 0.2)}, (-0.1, 0.2)),
    ],
)
def test_limits_of_a_mimic_narrow_those_of_its_source(tmp_path, options, ranges):
    arm = urdf.arm(tmp_path, two(**options))
    assert (arm.dof, arm.lower[0], arm.upper[0]) == (1, *ranges)


def test_a_mimic_that_leaves_no_range_is_told(tmp_path):
    with pytest.raises(SpecError, match=r"arm\.joints\.a\.limits = .*mimic"):
        urdf.arm(tmp_path, two(own=(5.0, 6.0)))


def test_a_joint_beside_the_way_limits_what_mimics_it(tmp_path):
    """The tip's only joint turns at twice a's angle less 0.5, and a is on another branch."""
    text = robot(
        joint("a", "revolute", "base", "side", limits=(-0.4, 0.1)),
        joint("b", "revolute", "base", "tip", limits=(-1.0, 1.0), mimic=("a", 2.0, -0.5)),
    )
    arm = urdf.arm(tmp_path, text, tip="tip")
    np.testing.assert_allclose([arm.lower[0], arm.upper[0]], [-1.0, -0.3], rtol=1e-15)


def test_a_mimic_of_multiplier_0_stands_still(tmp_path):
    arm = urdf.arm(tmp_path, two(mimic=("a", 0.0, 0.5), own=None))
    q = np.zeros((1, 1))
    np.testing.assert_allclose(forward(arm, q)[1][0], roll_pitch_yaw(0, 0.5, 0)[:3, :3], atol=1e-15)


def test_a_continuous_joint_is_not_limited(tmp_path):
    text = robot(joint("a", "continuous", "base", "one"))
    assert urdf.arm(tmp_path, text).limited == (False,)


def test_a_study_may_limit_a_continuous_joint(tmp_path):
    arm = urdf.arm(tmp_path, robot(joint("a", "continuous", "base", "one")), joints={"a": {"limits": [-1.0, 2.0]}})
    assert (arm.limited, arm.lower[0], arm.upper[0]) == ((True,), -1.0, 2.0)


def test_what_has_no_motion_is_not_read(tmp_path, capfd):
    """Meshes that do not exist, transmissions, unknown attributes, a namespace that nothing uses."""
    visual = '<visual><geometry><mesh filename="package://none/none.dae"/></geometry></visual>'
    text = TOUCH.replace('<link name="wrist"/>', f'<link name="wrist">{visual}</link><gazebo/><transmission/>')
    text = text.replace('type="revolute"', 'type="revolute" soft="1"').replace(
        '<robot name="touch">', '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">'
    )
    np.testing.assert_array_equal(urdf.arm(tmp_path, text).constants, urdf.arm(tmp_path, TOUCH).constants)
    assert capfd.readouterr() == ("", "")


# A file in a study


@pytest.fixture
def touch(tmp_path):
    (tmp_path / "touch.urdf").write_text(TOUCH)
    return study({"kind": "urdf", "file": "touch.urdf"}, tmp_path / "study.toml")


def built(spec, overrides):
    return chain(spec.design(overrides).plugins["arm"][1])


def test_a_resolved_study_is_a_study(touch):
    again = check({**touch.tree, "arm": touch.resolved["arm"]}, touch.path)
    assert again.hash == touch.hash


def test_the_resolved_study_names_base_and_tip(touch):
    assert (touch.resolved["arm"]["base"], touch.resolved["arm"]["tip"]) == ("base", "stylus")


def test_scaling_a_link_scales_the_joints_that_stand_on_it(touch):
    elbow = next(j for j in built(touch, {"arm.scale.upper_arm": 1.5}).joints if j.name == "elbow")
    np.testing.assert_allclose(elbow.T_parent_joint[:3, 3], [1.5 * 0.0075, 1.5 * 0.134, 0], rtol=1e-15)


def test_a_number_of_an_origin_is_a_path(touch):
    elbow = next(j for j in built(touch, {"arm.joints.elbow.xyz.1": 0.2}).joints if j.name == "elbow")
    np.testing.assert_array_equal(elbow.T_parent_joint[:3, 3], [0.0075, 0.2, 0])


def test_a_search_varies_lengths_as_a_tables(tmp_path):
    (tmp_path / "touch.urdf").write_text(TOUCH)
    search = {"arm.scale.upper_arm": {"low": 0.8, "high": 1.5}, "arm.joints.yaw.xyz.1": {"low": 0.05, "high": 0.2}}
    tree = small.tree({small.SEARCH: "", small.DESIGN: ""}) | {"arm": {"kind": "urdf", "file": "touch.urdf"}}
    spec = check({**tree, "search": search}, tmp_path / "study.toml")
    long = built(spec, spec.overrides({"arm.scale.upper_arm": 1.5, "arm.joints.yaw.xyz.1": 0.2}))
    link = np.hypot(0.0075, 0.134)
    assert long.link_length - built(spec, {}).link_length == pytest.approx(0.5 * link + 0.12, rel=1e-12)


def test_designs_of_one_file_share_a_kernel(touch):
    assert built(touch, {"arm.scale.upper_arm": 1.5}).structure == built(touch, {}).structure


def test_angles_in_degrees(tmp_path):
    joints = {"elbow": {"limits": [-45.0, 60.0]}}
    arm = urdf.arm(tmp_path, TOUCH, angles="deg", joints=joints)
    np.testing.assert_allclose([arm.lower[2], arm.upper[2]], np.deg2rad([-45, 60]), rtol=1e-15)
    np.testing.assert_allclose(arm.upper[:2], [0.98, 1.75], rtol=1e-15)


def test_the_file_is_part_of_the_hash(touch):
    before = touch.hash
    (touch.path.parent / "touch.urdf").write_text(TOUCH.replace("0.134", "0.135"))
    assert study({"kind": "urdf", "file": "touch.urdf"}, touch.path).hash != before


# Refused files

A = joint("a", "revolute", "base", "one", limits=(-1.0, 1.0))
B = joint("b", "revolute", "one", "two", limits=(-1.0, 1.0))
REFUSED = {
    "xacro": ('<robot xmlns:x="http://ros.org/wiki/xacro"><x:include filename="a"/></robot>', {}, "arm.file", "xacro arm.urdf >"),
    "broken XML": ("<robot", {}, "arm.file", "is not XML"),
    "another format": ("<sdf/>", {}, "arm.file", "begins with <sdf>"),
    "a joint without a parent": ('<robot><link name="a"/><joint name="j" type="fixed"/></robot>', {}, "arm.file", "parent"),
    "two numbers for three": (robot(A).replace('xyz="0.0 0.0 0.0"', 'xyz="0 0"'), {}, "arm.file", "Invalid vector length"),
    "a word for a number": (robot(A).replace('lower="-1.0"', 'lower="low"'), {}, "arm.file", "'low'"),
    "not a number": (robot(A).replace('lower="-1.0"', 'lower="nan"'), {}, "arm.file", "'a' has a number that is not finite"),
    "an axis of zeros": (robot(joint("a", "continuous", "base", "one", axis=(0, 0, 0))), {}, "arm.file", "axis of zeros"),
    "an unknown kind": (robot(A).replace("revolute", "ball"), {}, "arm.file", "ball"),
    "a floating joint": (robot(A, B).replace("revolute", "floating", 1), {}, "arm.file", "'a' is floating"),
    "a planar joint": (robot(A, B).replace("revolute", "planar", 1), {}, "arm.file", "'a' is planar"),
    "no limits": (robot(joint("a", "revolute", "base", "one")), {}, "arm.joints.a.limits", "no <limit> in the file"),
    "no limits of a slide": (robot(joint("a", "prismatic", "base", "one")), {}, "arm.joints.a.limits", "no <limit>"),
    "limits without a range": (robot(A).replace('upper="1.0"', 'upper="-1.0"'), {}, "arm.joints.a.limits", "leave no range"),
    "a name twice": (robot(A, B.replace('"b"', '"a"')), {}, "arm.file", "joints share the name a"),
    "two parents": (robot(A, B, joint("c", "fixed", "base", "two")), {}, "arm.file", "'two' is the child of two joints"),
    "a missing link": (robot(A).replace('<link name="one"/>', ""), {}, "arm.file", "'one' that the file does not have"),
    "a circle": (robot(A, B, joint("c", "fixed", "two", "base")), {"base": "base", "tip": "two"}, "arm.file", "circle"),
    "nothing but a circle": (robot(A, B, joint("c", "fixed", "two", "base")), {}, "arm.base", "0 links"),
    "two bases": (robot(A, joint("c", "fixed", "other", "three")), {}, "arm.base", "no joint's child: base, other"),
    "two tips": (robot(A, joint("c", "fixed", "base", "three")), {}, "arm.tip", "2 links below 'base' without"),
    "no such base": (robot(A), {"base": "bse"}, "arm.base = 'bse'", "Links: base, one"),
    "a tip that is not below": (robot(A, B), {"base": "two", "tip": "one"}, "arm.tip = 'one'", "Upwards from it: one, base"),
    "base and tip in one": (robot(A, B), {"base": "one", "tip": "one"}, "arm.tip = 'one'", "does not lie below"),
    "no such joint": (robot(A), {"joints": {"elbow": {}}}, "arm.joints.elbow", "Joints: a"),
    "limits of a fixed joint": (
        robot(A, joint("c", "fixed", "one", "two")), {"joints": {"c": {"limits": [0.0, 1.0]}}}, "arm.joints.c", "fixed"),
    "no such link to scale": (robot(A), {"scale": {"one": 2.0}}, "arm.scale.one", "Links: base"),
    "a mimic of nothing": (two(mimic=("c", 1.0, 0.0)), {}, "arm.joints.b", "'c' that the file does not have"),
    "a mimic of itself": (two(mimic=("b", 1.0, 0.0)), {}, "arm.joints.b", "circle: b <- b"),
    "a mimic of a fixed joint": (two().replace("revolute", "fixed", 1), {}, "arm.joints.b", "which is fixed"),
    "a coupling of nothing": (
        robot(A), {"coupled": [{"joints": {"elbow": 1.0}, "limits": [0.0, 1.0]}]}, "arm.coupled.0.joints.elbow",
        "Movable joints: a"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "table", "path", "words"), REFUSED.values(), ids=REFUSED)
def test_a_file_that_cannot_be_is_refused(tmp_path, text, table, path, words):
    with pytest.raises(SpecError) as error:
        urdf.arm(tmp_path, text, **table)
    (line,) = error.value.findings
    assert line.startswith(path)
    assert words in line
    assert "\n" not in line


def test_a_missing_parser_is_told_with_its_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "urdf_parser_py.urdf", None)
    with pytest.raises(SpecError, match=r'arm\.kind = .urdf.: .*pip install "eiwa\[urdf\]"'):
        urdf.read(tmp_path, robot(A))


def test_an_arm_of_few_directions_names_them(tmp_path):
    assert (
        "rank 2 at every posture"
        in urdf.arm(tmp_path, robot(A, B.replace('xyz="0.0 0.0 0.0"', 'xyz="1 0 0"'))).when_singular()
    )
