"""Denavit-Hartenberg tables against the product of their elementary transforms, written out."""

import numpy as np
import pytest
from pydantic import ValidationError

from eiwa.core.errors import SpecError
from eiwa.core.outcome import evaluate
from eiwa.core.spec import load
from eiwa.plugins.arms.dh import DhJoint, DhParameters, chain, eiwa_arms
from tests import arms
from tests.arms import FULL_TURN, forward, paper, paper_table, table
from tests.study import small


def Rx(a):
    return np.array([[1, 0, 0, 0], [0, np.cos(a), -np.sin(a), 0], [0, np.sin(a), np.cos(a), 0], [0, 0, 0, 1]])


def Rz(a):
    return np.array([[np.cos(a), -np.sin(a), 0, 0], [np.sin(a), np.cos(a), 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def Ry(a):
    return np.array([[np.cos(a), 0, np.sin(a), 0], [0, 1, 0, 0], [-np.sin(a), 0, np.cos(a), 0], [0, 0, 0, 1]])


def T(x=0.0, y=0.0, z=0.0):
    return np.array([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def written_out(parameters, q):
    """The textbook product at one joint vector; angles in rad."""
    M, values = np.eye(4), iter(q)
    for row in parameters.joints:
        value = 0.0 if row.kind == "fixed" else next(values)
        turn = Rz(row.theta + (value if row.kind == "revolute" else 0.0))
        move = T(z=row.d + (value if row.kind == "prismatic" else 0.0))
        if parameters.convention == "modified":
            M = M @ Rx(row.alpha) @ T(row.a) @ turn @ move
        else:
            M = M @ turn @ move @ T(row.a) @ Rx(row.alpha)
    roll, pitch, yaw = parameters.tool_rpy
    return M @ T(*parameters.tool) @ Rz(yaw) @ Ry(pitch) @ Rx(roll)


def mixed(convention):
    """Every kind of row, every column in use, and a tool."""
    return table(
        (20, -70, 90, 45, -30),
        (0.1, 0.2, 0.0, 0.05, 0.3),
        (0.3, 0.0, 0.1, -0.2, 0.15),
        (10, -20, 0, 90, 30),
        convention=convention,
        kinds=("revolute", "prismatic", "fixed", "revolute", "prismatic"),
        limits=[(-1.0, 2.0), (0.1, 0.4), None, None, (-0.2, 0.2)],
        tool=[0.1, -0.2, 0.3],
        tool_rpy=[0.3, -0.4, 0.5],
    )


CONVENTIONS = ["standard", "modified"]


@pytest.mark.parametrize("quantity", [0, 1], ids=["tips", "orientations"])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_table_is_the_product_of_its_transforms(convention, quantity):
    parameters = mixed(convention)
    q = np.random.default_rng(0).uniform(-2, 2, (20, 4))
    poses = np.array([written_out(parameters, row) for row in q])
    expected = (poses[:, :3, 3], poses[:, :3, :3])[quantity]
    np.testing.assert_allclose(forward(chain(parameters), q)[quantity], expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_the_papers_table_is_the_product_of_its_transforms(convention):
    parameters = paper_table(convention=convention)
    q = np.random.default_rng(0).uniform(-3, 3, (20, 6))
    expected = [written_out(parameters, row)[:3, 3] for row in q]
    np.testing.assert_allclose(forward(chain(parameters), q)[0], expected, rtol=0, atol=1e-15)


def test_the_ur5_stretched_out():
    """q = 0: the links lie along -x, the wrist along -y and -z."""
    tip = forward(arms.ur5(), np.zeros((1, 6)))[0][0]
    expected = [-0.425 - 0.39225, -0.10915 - 0.0823, 0.089459 - 0.09465]
    np.testing.assert_allclose(tip, expected, atol=1e-15)


def test_degrees_and_radians_describe_the_same_arm():
    rows = [{"name": "a", "alpha": 30.0, "a": 0.1, "theta": 45.0, "limits": [-90.0, 60.0]}]
    in_rad = [
        {
            "name": "a",
            "alpha": np.pi / 6,
            "a": 0.1,
            "theta": np.pi / 4,
            "limits": [-np.pi / 2, np.pi / 3],
        }
    ]
    one, other = (
        chain(DhParameters.model_validate({"convention": "standard", "angles": unit, "joints": joints}))
        for unit, joints in (("deg", rows), ("rad", in_rad))
    )
    np.testing.assert_allclose(one.constants, other.constants, atol=1e-15)


def test_limits_of_a_prismatic_joint_are_in_metres_whatever_the_unit_of_angles():
    rows = [DhJoint(name="rail", kind="prismatic", limits=[0.1, 0.4])]
    arm = chain(DhParameters(convention="standard", angles="deg", joints=rows))
    assert (arm.lower[0], arm.upper[0]) == (0.1, 0.4)


def test_angles_are_degrees_unless_said_otherwise():
    arm = chain(DhParameters(convention="standard", joints=[DhJoint(name="a", limits=[-180.0, 90.0])]))
    assert (arm.lower[0], arm.upper[0]) == (-np.pi, np.pi / 2)


def test_the_tools_angles_follow_the_unit():
    joints = [DhJoint(name="a")]
    arm = chain(DhParameters(convention="standard", joints=joints, tool_rpy=[0.0, 0.0, 90.0]))
    np.testing.assert_array_equal(forward(arm, np.zeros((1, 1)))[1][0], Rz(np.pi / 2)[:3, :3].round())


def test_a_joint_keeps_its_name():
    assert [joint.name for joint in paper().joints] == ["j1", "j2", "j3", "j4", "j5", "j6"]


def test_zeros_of_the_table_stay_zeros():
    """alpha = 90 deg must fold: the kernel of Table 1 has two lengths and twelve ranges as parameters."""
    assert len(paper().constants) == 12 + 2


@pytest.mark.parametrize("limits", [FULL_TURN, (-2.0, 2.0)])
def test_limits_make_a_joint_limited(limits):
    assert paper(limits=limits).limited == (True,) * 6


# Refused tables.

ROW = {"name": "a"}
REFUSED = {
    "no convention": ({"joints": [ROW]}, "convention"),
    "unknown convention": ({"convention": "classic", "joints": [ROW]}, "'standard' or 'modified'"),
    "no joints": ({"convention": "standard", "joints": []}, "joints"),
    "unknown key": ({"convention": "standard", "joints": [{**ROW, "offset": 1.0}]}, "offset"),
    "no name": ({"convention": "standard", "joints": [{"a": 1.0}]}, "name"),
    "a name that is no path": ({"convention": "standard", "joints": [{"name": "a.b"}]}, "name"),
    "a name twice": ({"convention": "standard", "joints": [ROW, ROW]}, "share the name a"),
    "falling limits": (
        {"convention": "standard", "joints": [{**ROW, "limits": [1.0, -1.0]}]},
        "must increase",
    ),
    "empty range": ({"convention": "standard", "joints": [{**ROW, "limits": [1.0, 1.0]}]}, "must increase"),
    "infinite limit": (
        {"convention": "standard", "joints": [{**ROW, "limits": [0.0, np.inf]}]},
        "finite number",
    ),
    "NaN length": ({"convention": "standard", "joints": [{**ROW, "a": np.nan}]}, "finite number"),
    "falling coupled limits": (
        {"convention": "standard", "joints": [ROW], "coupled": [{"joints": {"a": 1.0}, "limits": [1.0, 0.0]}]},
        "must increase",
    ),
    "coupled limits of nothing": (
        {"convention": "standard", "joints": [ROW], "coupled": [{"joints": {}, "limits": [0.0, 1.0]}]},
        "at least 1 item",
    ),
    "unlimited prismatic joint": (
        {"convention": "standard", "joints": [{**ROW, "kind": "prismatic"}]},
        "prismatic joint needs limits",
    ),
    "limits of a fixed joint": (
        {"convention": "standard", "joints": [{**ROW, "kind": "fixed", "limits": [0.0, 1.0]}]},
        "fixed joint has no limits",
    ),
}


@pytest.mark.parametrize(("document", "message"), REFUSED.values(), ids=REFUSED)
def test_a_table_that_cannot_be_is_refused(document, message):
    with pytest.raises(ValidationError, match=message):
        DhParameters.model_validate(document)


def test_a_table_of_fixed_rows_is_refused_by_path():
    (plugin,) = eiwa_arms()
    rows = [DhJoint(name="a", kind="fixed")]
    with pytest.raises(SpecError, match=r"arm\.joints.*fixed"):
        plugin.build(DhParameters(convention="standard", joints=rows))


# What to look at when singular.


def test_table_1_read_as_standard_names_the_rank_of_both_readings():
    explanation = paper(convention="standard").when_singular()
    assert "rank 5" in explanation
    assert "convention = 'modified' the same table has rank 6" in explanation


def test_an_arm_that_is_singular_either_way_points_to_the_rows():
    crank = table((0,), (0.3,), (0,), convention="standard")
    assert "dexterity.rows" in chain(crank).when_singular()


def test_the_explanation_names_the_field():
    assert paper(convention="standard").when_singular().startswith("arm.convention = 'standard'")


# Coupled limits.


def coupled(limits, angles="deg", **row):
    joints = [
        DhJoint(name="turn", a=0.1, limits=[-90.0, 90.0] if angles == "deg" else [-1.5, 1.5]),
        DhJoint(name="elbow", a=0.1, limits=[-90.0, 90.0] if angles == "deg" else [-1.5, 1.5]),
        DhJoint(name="slide", kind="prismatic", limits=[0.0, 0.3]),
        DhJoint(name="hand", kind="fixed"),
    ]
    rows = [{"joints": row, "limits": limits}]
    return DhParameters(convention="standard", angles=angles, joints=joints, coupled=rows)


@pytest.mark.parametrize(
    ("parameters", "row"),
    [
        (coupled([-90.0, 45.0], turn=1.0, elbow=1.0), [1, 1, 0, -np.pi / 2, np.pi / 4]),
        (coupled([-1.0, 0.5], "rad", turn=1.0, elbow=-2.0), [1, -2, 0, -1.0, 0.5]),
        (coupled([0.0, 0.2], slide=1.0), [0, 0, 1, 0.0, 0.2]),
        (coupled([0.0, 90.0], turn=1.0, slide=180.0), [1, 0, np.pi, 0.0, np.pi / 2]),
    ],
    ids=["degrees", "radians", "metres", "degrees per metre"],
)
def test_coupled_limits_follow_the_unit_of_angles(parameters, row):
    np.testing.assert_allclose(chain(parameters).rows, [row], rtol=1e-15)


@pytest.mark.parametrize("name", ["hand", "wrist"])
def test_coupled_limits_of_no_movable_joint_are_refused(name):
    with pytest.raises(SpecError, match=rf"arm\.coupled\.0\.joints\.{name}: .*Movable joints: turn, elbow, slide"):
        chain(coupled([0.0, 1.0], **{name: 1.0}))


def study(folder, row):
    changes = small.NO_SEARCH | {small.DESIGN: "", small.JOINTS: f"{small.JOINTS}coupled = [{row}]\n"}
    return load(small.write(folder, changes))


def test_a_study_couples_limits(tmp_path):
    """Shoulder and upper arm in [-120, 120] each, and their sum in [-60, 60]: 7/16 of the square."""
    spec = study(tmp_path, "{ joints = { shoulder = 1, upper = 1 }, limits = [-60, 60] }")
    numbers = evaluate(spec, {}).scenarios[""]
    assert numbers["valid_share"] == pytest.approx(7 / 16, abs=2e-3)
    free = evaluate(spec, {"arm.coupled.0.limits": [-240, 240]}).scenarios[""]
    assert (free["valid_share"], free["F"] > numbers["F"]) == (1.0, True)


def test_a_bound_of_a_row_is_a_path(tmp_path):
    spec = study(tmp_path, "{ joints = { shoulder = 1, upper = 1 }, limits = [-60, 60] }")
    arm = spec.design({"arm.coupled.0.limits.1": 30, "arm.coupled.0.joints.upper": 2}).setup(1).arm
    np.testing.assert_allclose(arm.rows, [[0, 1, 2, 0, 0, 0, -np.pi / 3, np.pi / 6]], rtol=1e-15)


def test_a_row_of_falling_limits_is_told_by_path(tmp_path):
    with pytest.raises(SpecError, match=r"arm\.coupled\.0\.limits = \[60, -60\]: must increase"):
        study(tmp_path, "{ joints = { shoulder = 1 }, limits = [60, -60] }")
