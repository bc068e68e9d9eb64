"""An arm in plain NumPy that is right, as text, and what its author may get wrong."""

ARM = '''"""Three turning joints and a tool."""

import time
from dataclasses import dataclass

import numpy as np

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Arm, Postures

AXES = np.array([[0.0, 0, 1], [0, 1, 0], [0, 1, 0]])
LINKS = np.array([[0.0, 0, 0.1], [0.3, 0, 0], [0.25, 0, 0]])
TOOL = np.array([0.05, 0.02, 0.1])
LOW, SPAN = np.array([-2.0, -1.0, 0.2]), np.array([4.0, 2.0, 1.5])
EYE = np.eye(3)
kept = np.zeros((1 << 15, 3))
random = np.random.default_rng()


class ElbowParameters(Parameters):
    """A waist, a shoulder and an elbow."""

    scale: float = quantity(1.0, gt=0, description="Of all lengths.")


def turn(axis, angle):
    """Rodrigues: (n,) angles as (n, 3, 3)."""
    K = np.cross(EYE, axis)
    return EYE + np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K)


@dataclass
class Elbow(Arm):
    """Axes and origins, then J = [a x (p - o); a]."""

    scale: float
    dof, limited = 3, (True, True, True)
    calls, last = 0, 0.0

    def postures(self, u):
        n = len(u)
        q = LOW + SPAN * u
        R, p = np.broadcast_to(EYE, (n, 3, 3)), np.zeros((n, 3))
        axes, origins = [], []
        for j, (axis, link) in enumerate(zip(AXES, LINKS, strict=True)):
            axes.append(R @ axis)
            origins.append(p)
            R = R @ turn(axis, q[:, j])
            p = p + R @ link * self.scale
        flange, p = p, p + R @ TOOL * self.scale
        J = np.stack([np.concatenate([np.cross(a, p - o), a], axis=1) for a, o in zip(axes, origins, strict=True)], axis=2)
        valid = np.ones(n, bool)
        # here
        return Postures(u, q, p, R, J, valid, self.limited)


@hookimpl
def eiwa_arms():
    return [Plugin("elbow", ElbowParameters, lambda parameters: Elbow(parameters.scale))]
'''

EULER = """
        pitch, yaw = -np.arcsin(R[:, 2, 0]), np.arctan2(R[:, 1, 0], R[:, 0, 0])
        for k in range(n):
            c, s, cy, sy = np.cos(pitch[k]), np.sin(pitch[k]), np.cos(yaw[k]), np.sin(yaw[k])
            J[k, 3:] = np.linalg.inv([[c * cy, -sy, 0], [c * sy, cy, 0], [-s, 0, 1]]) @ J[k, 3:]"""

JACOBIANS = {
    "rows swapped": ("J = J[:, [3, 4, 5, 0, 1, 2]]", "with the angular rows above the linear ones"),
    "spatial": ("J[:, :3] += np.cross(p[:, None, :], J[:, 3:].swapaxes(1, 2)).swapaxes(1, 2)", "at the base origin"),
    "spatial and swapped": (
        "J[:, :3] += np.cross(p[:, None, :], J[:, 3:].swapaxes(1, 2)).swapaxes(1, 2); J = J[:, [3, 4, 5, 0, 1, 2]]",
        "(the spatial Jacobian), with the angular rows above",
    ),
    "body": ("J = np.kron(np.eye(2), R.swapaxes(1, 2)) @ J if n == 1 else np.stack([np.kron(np.eye(2), r.T) @ j for r, j "
             "in zip(R, J)])", "(the body Jacobian)"),
    "sign": ("J = -J", "with the opposite sign"),
    "degrees": ("J = J * np.pi / 180", "per degree"),
    "by u": ("J = J * SPAN", "by u instead of q"),
    "no angular rows": ("J[:, 3:] = 0", "without its angular rows"),
    "euler rates": (EULER, "rates of roll, pitch and yaw"),
    "flange": ("J[:, :3] = np.stack([np.cross(a, flange - o) for a, o in zip(axes, origins)], axis=2)",
               "(-0.05, -0.02, -0.1) m from the tip, in the tip's axes: is the tool left out"),
    "rotated base": ("J = J[:, [1, 2, 0, 4, 5, 3]]", "rows exchanged, or a base rotation left out"),
    "one sign": ("J[:, :, 1] *= -1", "column 1: has the opposite sign"),
    "two signs": ("J[:, :, 1:] *= -1", "columns 1, 2: has the opposite sign"),
    "one in degrees": ("J[:, :, 2] *= np.pi / 180", "column 2: is per degree"),
    "180 over pi": ("J[:, :, 0] *= 180 / np.pi", "column 0: is multiplied by 180 / pi"),
    "a factor": ("J[:, :, 2] *= 2", "column 2: is 2 times the right one"),
    "a zero": ("J[:, :, 0] = 0", "column 0: is zero"),
    "another joint's": ("J = J[:, :, [1, 0, 2]]", "column 0: is that of joint 1"),
    "cross product turned round": ("J[:, :3, 2] *= -1", "v = axis x (tip - joint), in this order"),
    "wrong lever": ("J[:, :3, 1] = np.cross(axes[1], p)", "column 1: has wrong linear rows"),
    "wrong axis": ("J[:, 3:, 1] = [0.0, 0, 1]", "column 1: has wrong angular rows"),
    "the joint's frame": ("J[:, :3, 1] = (R.swapaxes(1, 2) @ J[:, :3, 1, None])[..., 0]; J[:, 3:, 1] = [0.0, 0, 1]",
                          "column 1: has the right length but another direction"),
    "something else": ("J[:, 0, 2] += q[:, 0]; J[:, 4, 2] += q[:, 1]", "differs by more than a sign"),
    "rotations transposed": ("R = R.swapaxes(1, 2)", "column"),
}  # fmt: skip
"""What is done to the right Jacobian, and what the diagnosis must say."""

OTHERS = {
    "nan": ("p[u[:, 0] > 0.9] = np.nan", "is_finite", "tips of posture"),
    "never valid": ("valid[:] = False", "is_finite", "none of 256 is valid"),
    "millimetres": ("p, J[:, :3] = 1e3 * p, 1e3 * J[:, :3]", "is_finite", "lengths in millimetres"),
    "an exception": ("raise RuntimeError('the elbow is stuck')", "has_the_right_shapes", "the elbow is stuck (line 53)"),
    "a transposed jacobian": ("J = J.swapaxes(1, 2)", "has_the_right_shapes", "jacobians must have shape (256, 6, 3)"),
    "tips of one sample": ("p = p[0]", "has_the_right_shapes", "tips must have shape (256, 3)"),
    "single precision": ("p = p.astype(np.float32)", "has_the_right_shapes", "tips: a NumPy array of float64"),
    "valid as numbers": ("valid = valid * 1.0", "has_the_right_shapes", "valid: a NumPy array of bool"),
    "another u": ("u = u[::-1]", "has_the_right_shapes", "the points that were asked for"),
    "degrees throughout": ("q, J = np.rad2deg(q), J * np.pi / 180", "measures_angles_in_radians", "np.deg2rad"),
    "wrapped joints": ("q = (3 * q + np.pi) % (2 * np.pi)", "moves_each_joint_through_its_range", "it turns back"),
    "a joint that stays": ("q[:, 2] = 1.0", "moves_each_joint_through_its_range", "joint 2 to move"),
    "no rotations": ("R = 2 * R", "turns_by_rotations", "R Rt = 1"),
    "a mirror": ("R = R * [1, 1, -1]", "turns_by_rotations", "det R = -1"),
    "random numbers": ("p = p + 1e-6 * random.normal(size=p.shape)", "is_deterministic", "random numbers"),
    "a counter": ("self.calls += 1; p = p + 1e-3 * (self.calls > 3)", "is_deterministic", "a call leaves behind"),
    "hidden state": ("self.last, p = p[0, 0], p + 1e-3 * (self.last - p[0, 0])", "is_deterministic", "a call leaves behind"),
    "a cache": ("p = self.__dict__.setdefault('cache', {}).setdefault(n, p)", "keeps_nothing_between_calls",
                "a cache that knows too little"),
    "one array for all": ("kept[:n] = p; p = kept[:n]", "keeps_nothing_between_calls", "Return a new one"),
    "a mean over samples": ("p = p - 1e-3 * p.mean(axis=0)", "does_not_depend_on_the_block", "normalisation over the samples"),
    "input changed": ("u *= 0.5", "leaves_its_input_alone", "u was changed by the call"),
    "shared work arrays": ("kept[:n] = p; time.sleep(1e-4); p = kept[:n].copy()", "may_be_asked_from_threads",
                           "which threads share"),
}  # fmt: skip
"""What is done before the arm answers, the contract that must notice it first, and words of its message."""


def text(change="", before=""):
    """The arm's file with a line put before its return, or before its first line of work."""
    changed = ARM.replace("# here", change)
    return changed.replace("n = len(u)", f"n = len(u)\n        {before}") if before else changed


def write(folder, change="", name="elbow", before=""):
    path = folder / f"{name}.py"
    path.write_text(text(change, before))
    return path
