"""Arms with known numbers, and an arm's formulas on NumPy columns (nothing is compiled).

Sources: D. Zhang, J. Liu, G.-Z. Yang, Table 1 (paper); robotics-toolbox-python (Puma 560, Panda);
jhu-dvrk/sawIntuitiveResearchKit, share/kinematic/MTMR.json (MTM); public URDF of the omni drivers (Touch).
"""

from decimal import Decimal

import numpy as np
import pytest

from eiwa.core.chain import Joint, SerialChain
from eiwa.core.interfaces import Arm, Postures
from eiwa.core.linear import volume
from eiwa.core.symbols import as_columns
from eiwa.core.transforms import roll_pitch_yaw, translation
from eiwa.plugins.arms.dh import DhJoint, DhParameters, chain

FULL_TURN = (-np.pi, np.pi)


def table(alpha, a, d, theta=None, *, convention, limits=None, kinds=None, **tool):
    """DH parameters from columns; alpha, theta [deg]; limits [rad or m]: None, a pair, or a list of pairs."""
    n = len(alpha)
    theta = theta or (0,) * n
    kinds = kinds or ("revolute",) * n
    pairs = limits if isinstance(limits, list) else [limits] * n
    rows = [
        DhJoint(
            name=f"j{k + 1}",
            kind=kinds[k],
            alpha=float(np.deg2rad(alpha[k])),
            a=float(a[k]),
            d=float(d[k]),
            theta=float(np.deg2rad(theta[k])),
            limits=None if pairs[k] is None else [float(end) for end in pairs[k]],
        )
        for k in range(n)
    ]
    return DhParameters(convention=convention, angles="rad", joints=rows, **tool)


def paper_table(L1=0.26, L2=0.18, limits=FULL_TURN, convention="modified"):
    return table((0, 90, -90, 0, -90, 90), (0, 0, L1, L2, 0, 0), (0,) * 6, convention=convention, limits=limits)


def paper(*lengths, **options):
    return chain(paper_table(*lengths, **options))


def puma():
    return chain(
        table(
            (90, 0, -90, 90, -90, 0),
            (0, 0.4318, 0.0203, 0, 0, 0),
            (0.67183, 0, 0.15005, 0.4318, 0, 0),
            convention="standard",
        )
    )


PANDA_LIMITS = [
    (-2.8973, 2.8973),
    (-1.7628, 1.7628),
    (-2.8973, 2.8973),
    (-3.0718, -0.0698),
    (-2.8973, 2.8973),
    (-0.0175, 3.7525),
    (-2.8973, 2.8973),
]


def panda_table(tool=0.1034):
    return table(
        (0, -90, 90, 90, -90, 90, 90),
        (0, 0, 0, 0.0825, -0.0825, 0, 0.088),
        (0.333, 0, 0.316, 0, 0.384, 0, 0.107),
        convention="modified",
        limits=PANDA_LIMITS,
        tool=[0.0, 0.0, tool],
        tool_rpy=[0.0, 0.0, -np.pi / 4],
    )


def panda(tool=0.1034):
    return chain(panda_table(tool))


def mtm_table():
    low = (-1.13446, -0.31416, -0.872665, -1.6580, -1.6580, -0.785398, -8.37758)
    high = (0.698132, 1.13446, 0.610865, 3.5779, 3.2288, 0.785398, 7.85398)
    return table(
        (90, 0, -90, 90, -90, 90, 0),
        (0, 0.2794, 0.3645, 0, 0, 0, 0),
        (0, 0, 0, 0.1506, 0, 0, 0),
        (-90, -90, 90, 0, 0, -90, 90),
        convention="standard",
        limits=list(zip(low, high, strict=True)),
    )


def mtm():
    return chain(mtm_table())


def ur5_table():
    return table(
        (90, 0, 0, 90, -90, 0),
        (0, -0.425, -0.39225, 0, 0, 0),
        (0.089459, 0, 0, 0.10915, 0.09465, 0.0823),
        convention="standard",
        limits=(-2 * np.pi, 2 * np.pi),
    )


def ur5():
    return chain(ur5_table())


def touch():
    steps = [
        ("waist", (0, 0, 0.09), (0, 0, 0), (0, 0, 1), (-0.98, 0.98)),
        ("shoulder", (-0.0075, 0, 0.035), (0, 0, 0), (1, 0, 0), (0, 1.75)),
        ("elbow", (0.0075, 0.134, 0), (-1.5, 0, 0), (1, 0, 0), (-0.81, 1.25)),
        ("yaw", (0, 0.08, 0), (0, 0, 0), (0, 1, 0), (3.92, 8.83)),
        ("pitch", (0, 0.0525, 0), (0.5, 0, 0), (1, 0, 0), (-0.5, 1.75)),
        ("roll", (0, -0.023, 0), (3.14159, 3.14159, 0), (0, 1, 0), (-2.58, 2.58)),
    ]
    joints = [
        Joint(name, "revolute", translation(*xyz) @ roll_pitch_yaw(*rpy), limits, axis)
        for name, xyz, rpy, axis, limits in steps
    ]
    return SerialChain(tuple(joints), np.eye(4), np.eye(4))


def planar(*lengths):
    """Revolute joints about z, links along x."""
    joints = [Joint(f"j{k}", "revolute", translation(x, 0, 0)) for k, x in enumerate((0.0, *lengths[:-1]))]
    return SerialChain(tuple(joints), translation(lengths[-1], 0, 0), np.eye(4))


def gantry(*limits):
    """Prismatic joints along x, y and z: the tip is the joint vector."""
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    joints = [
        Joint(name, "prismatic", np.eye(4), pair, axis) for name, pair, axis in zip("xyz", limits, axes, strict=True)
    ]
    return SerialChain(tuple(joints), np.eye(4), np.eye(4))


def forward(arm, q):
    """Tips, orientations and Jacobians from the formulas on NumPy columns."""
    q = np.asarray(q, float)
    half_turns = q / np.where([joint.kind == "revolute" for joint in arm.free], np.pi, 1.0)
    columns = arm.at(as_columns(q), as_columns(half_turns), list(arm.constants[2 * arm.dof :]))

    def stacked(entries):
        return np.stack([np.broadcast_to(entry, len(q)) for entry in entries], axis=-1)

    rotations = np.stack([stacked(row) for row in columns.rotation], axis=1)
    jacobians = np.stack([stacked(row) for row in columns.jacobian], axis=1)
    return stacked(columns.tip), rotations, jacobians


def postures(arm, q):
    """Joint vectors as postures, inside the limits or not."""
    q = np.asarray(q, float)
    tips, rotations, jacobians = forward(arm, q)
    return Postures(arm.to_u(q), q, tips, rotations, jacobians, np.ones(len(q), bool), arm.limited)


def manipulability(jacobians, rows=slice(None)):
    """w of Jacobians (n, 6, dof) by the package's own formula."""
    return volume([as_columns(jacobians[:, row, :]) for row in range(6)[rows]])


TRANSLATION, ROTATION = slice(0, 3), slice(3, 6)


class ArrayArm(Arm):
    """An arm in plain NumPy: what it answers comes from a chain, but nobody can trace it."""

    def __init__(self, chain):
        self.chain = chain
        self.dof = chain.dof
        self.limited = chain.limited

    def postures(self, u):
        return self.chain.postures(u)


def printed(text):
    """A number that rounds to what was printed, 1e-15 at the finest."""
    last_place = 10.0 ** Decimal(text).as_tuple().exponent
    return pytest.approx(float(text), abs=max(0.501 * last_place, 1e-15), rel=0)
