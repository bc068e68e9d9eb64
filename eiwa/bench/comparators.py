"""Other ways to a tip and to Eq. (1), each put into eiwa's own flow in the place of arm and index.

A comparator is a function of points u of the unit cube, shape (n, joints), to tips (n, 3) [m] and Eq. (1) before
normalisation (n,). Those that are libraries are used as their documentation says, in their fastest batched form.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.bench import native
from eiwa.bench.cases import Case, Missing
from eiwa.core.dexterity import Family
from eiwa.core.linear import determinant

Evaluate = Callable[[NDArray[np.float64]], tuple[NDArray[Any], NDArray[Any]]]


@dataclass(frozen=True)
class Comparator:
    """One of the others.

    ``module``: what must be importable; ``parallel``: whether several threads help; ``samples``: of a call on one thread.
    """

    who: str
    build: Callable[[Case, Any], Evaluate]
    module: str = "numpy"
    precisions: Sequence[str] = ("f64", "f32")
    parallel: bool = True
    samples: int = 1 << 16

    def evaluate(self, case: Case, dtype: Any) -> Evaluate:
        """Its function for an arm.

        Raises
        ------
        Missing
            Its library, or what builds it, is not there.
        """
        if find_spec(self.module) is None:
            raise Missing(f"{self.module} is not installed")
        return self.build(case, dtype)


@dataclass(frozen=True, eq=False)
class Foreign(Family):
    """A family whose kinematics and index are somebody else's; sampling and voxels stay eiwa's."""

    function: Evaluate

    @property
    def alike(self) -> bool:
        """Nothing can be compiled in."""
        return False

    def answers(self, u: NDArray[Any]) -> list[NDArray[Any]]:
        """All postures are valid."""
        tips, raw = self.function(u)
        return [np.ones((len(u), 1)), tips, np.empty((len(u), 0)), raw[:, None]]

    @property
    def widths(self) -> tuple[int, ...]:
        """No Jacobian."""
        return 1, 3, 0, 1

    def rows(self, u: NDArray[Any], dtype: Any = np.float64) -> NDArray[Any]:
        """Tips x, y, z [m] and the index, shape (4, n)."""
        tips, raw = self.function(u)
        return np.vstack([tips.T, raw]).astype(dtype, copy=False)


def kinematics(xp: Any, case: Case, q: Any) -> tuple[list[Any], list[Any], list[list[Any]]]:
    """Tip, last frame's axes and Jacobian [row][joint] at joint values q (joints, n), one array per component.

    ``xp`` is numpy or what has its functions; floats that are 0 or 1 are left out of the arithmetic.
    """
    sines, cosines = xp.sin(q), xp.cos(q)
    x, y, z = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    tip: list[Any] = [0.0, 0.0, 0.0]
    axes, origins = [], []
    for j, (alpha, a, d) in enumerate(zip(case.alpha, case.a, case.d, strict=True)):
        c, s = float(np.cos(np.deg2rad(alpha)).round(15)), float(np.sin(np.deg2rad(alpha)).round(15))
        y, z = _sum(c, y, s, z), _sum(c, z, -s, y)
        tip = _sum(1.0, tip, a, x)
        tip = _sum(1.0, tip, d, z)
        axes.append(z)
        origins.append(tip)
        x, y = _sum(cosines[j], x, sines[j], y), _sum(cosines[j], y, -sines[j], x)
    twists = []
    for axis, origin in zip(axes, origins, strict=True):
        lever = [a - b for a, b in zip(tip, origin, strict=True)]
        twists.append([_times(axis[i - 2], lever[i - 1]) - _times(axis[i - 1], lever[i - 2]) for i in range(3)] + axis)
    return tip, [x, y, z], [[twist[row] for twist in twists] for row in range(6)]


def _sum(a: Any, v: Sequence[Any], b: Any, w: Sequence[Any]) -> list[Any]:
    """a v + b w."""
    return [_times(a, x) + _times(b, y) for x, y in zip(v, w, strict=True)]


def _times(a: Any, b: Any) -> Any:
    for p, q in ((a, b), (b, a)):
        if isinstance(p, float) and p in (0.0, 1.0, -1.0):
            return 0.0 if p == 0.0 else q if p == 1.0 else -q
    return a * b


def penalty(xp: Any, case: Case, u: Any) -> Any:
    """1 - exp(-K prod u (1 - u)) of points (joints, n)."""
    return -xp.expm1(-case.K * xp.prod(u * (1 - u), axis=0))


def stacked(xp: Any, J: Sequence[Sequence[Any]], like: Any) -> Any:
    """The Jacobian as one array (n, 6, joints)."""
    rows = [[xp.broadcast_to(xp.asarray(entry, like.dtype), like.shape) for entry in row] for row in J]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def manipulability(xp: Any, J: Sequence[Sequence[Any]]) -> Any:
    """|det J| when square, else sqrt det(J Jt), by minors on components."""
    if len(J[0]) == 6:
        return xp.abs(determinant(J))
    gram = [[sum(_times(a, b) for a, b in zip(p, r, strict=True)) for r in J] for p in J]
    return xp.sqrt(xp.maximum(determinant(gram), 0))


def _by_numpy(closed: bool) -> Callable[[Case, Any], Evaluate]:
    def build(case: Case, dtype: Any) -> Evaluate:
        lower, span = case.lower[:, None].astype(dtype), case.span[:, None].astype(dtype)

        def evaluate(points: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
            u = points.T.astype(dtype, order="C")
            tip, _, J = kinematics(np, case, lower + u * span)
            if closed:
                w = manipulability(np, J)
            else:
                A = stacked(np, J, u[0])
                w = np.sqrt(np.maximum(np.linalg.det(A @ A.transpose(0, 2, 1)), 0))
            return np.stack(tip, axis=-1), w * penalty(np, case, u)

        return evaluate

    return build


def _by_jax(case: Case, dtype: Any) -> Evaluate:
    jax = importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    jnp = jax.numpy
    lower, span = jnp.asarray(case.lower[:, None], dtype), jnp.asarray(case.span[:, None], dtype)

    @jax.jit  # type: ignore[untyped-decorator]
    def compiled(u: Any) -> Any:
        tip, _, J = kinematics(jnp, case, lower + u * span)
        return jnp.stack([*tip, manipulability(jnp, J) * penalty(jnp, case, u)])

    def evaluate(points: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
        out = np.asarray(compiled(points.T.astype(dtype, order="C")))
        return out[:3].T, out[3]

    return evaluate


def _by_torch(case: Case, dtype: Any) -> Evaluate:
    torch, pk = importlib.import_module("torch"), importlib.import_module("pytorch_kinematics")
    torch.set_num_threads(1)  # eiwa's flow shares the blocks out among threads
    kind = torch.float64 if dtype == np.float64 else torch.float32
    last = root = pk.frame.Frame("base", pk.frame.Link("base"), pk.frame.Joint(dtype=kind))
    for j, T in enumerate(case.setup.arm.Ts_fixed[:-1]):  # type: ignore[attr-defined]
        offset = pk.Transform3d(matrix=torch.tensor(np.array(T), dtype=kind), dtype=kind)
        joint = pk.frame.Joint(f"j{j}", offset=offset, joint_type="revolute", dtype=kind)
        last.add_child(pk.frame.Frame(f"f{j}", pk.frame.Link(f"l{j}"), joint))
        last = last.children[0]
    chain = pk.SerialChain(pk.Chain(root, dtype=kind), last.name, dtype=kind)
    lower, span = torch.tensor(case.lower, dtype=kind), torch.tensor(case.span, dtype=kind)

    def evaluate(points: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
        u = torch.from_numpy(points).to(kind)
        with torch.no_grad():
            J, T = chain.jacobian(lower + u * span, ret_eef_pose=True)
            w = torch.sqrt(torch.clamp(torch.linalg.det(J @ J.transpose(1, 2)), min=0))
            raw = w * -torch.expm1(-case.K * torch.prod(u * (1 - u), dim=1))
        return T[:, :3, 3].numpy(), raw.numpy()

    return evaluate


def _by_toolbox(case: Case, dtype: Any) -> Evaluate:
    rtb = importlib.import_module("roboticstoolbox")
    ets = rtb.ETS()
    for alpha, a, d in case.rows.tolist():
        ets = ets * rtb.ET.Rx(alpha) * rtb.ET.tx(a) * rtb.ET.Rz() * rtb.ET.tz(d)

    def evaluate(points: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
        q = case.lower + points * case.span
        return ets.eval(q)[:, :3, 3], ets.manipulability(q) * penalty(np, case, points.T)

    return evaluate


def _by_pinocchio(case: Case, dtype: Any) -> Evaluate:
    pin = importlib.import_module("pinocchio")
    model = pin.Model()
    for j, T in enumerate(case.setup.arm.Ts_fixed[:-1]):  # type: ignore[attr-defined]
        model.addJoint(j, pin.JointModelRZ(), pin.SE3(np.array(T)), f"j{j}")
    data = model.createData()

    def evaluate(points: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
        tips, w = np.empty((len(points), 3)), np.empty(len(points))
        for s, q in enumerate(case.lower + points * case.span):
            J = pin.computeJointJacobians(model, data, q)
            tips[s] = data.oMi[case.joints].translation
            w[s] = abs(np.linalg.det(J)) if case.joints == 6 else np.sqrt(max(0.0, np.linalg.det(J @ J.T)))
        return tips, w * penalty(np, case, points.T)

    return evaluate


SLOW = 1 << 14
COMPARATORS = (
    Comparator("NumPy, linalg.det", _by_numpy(closed=False)),
    Comparator("NumPy, closed form", _by_numpy(closed=True)),
    Comparator("JAX", _by_jax, "jax"),
    Comparator("Pinocchio, C++", native.pinocchio, precisions=("f64",)),
    Comparator("Pinocchio, Python", _by_pinocchio, "pinocchio", ("f64",), parallel=False, samples=SLOW),
    Comparator("pytorch_kinematics", _by_torch, "pytorch_kinematics", samples=SLOW),
    Comparator("robotics-toolbox", _by_toolbox, "roboticstoolbox", ("f64",), parallel=False, samples=SLOW),
)
