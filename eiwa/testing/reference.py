"""Parts that subjects of one kind need of the others: arms for an index, measurements for a metric."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from eiwa.core.chain import Joint, SerialChain
from eiwa.core.derivative import on_arrays
from eiwa.core.evaluation import Measurement
from eiwa.core.interfaces import Postures
from eiwa.core.optimum import pilot_points
from eiwa.core.outcome import measurements
from eiwa.core.spec import check
from eiwa.core.transforms import frozen, rotation_x, translation
from eiwa.core.tree import Tree, replaced

TURN = 2.0
"""Joints turn by 2 rad to either side."""


def serial(joints: int) -> SerialChain:
    """An arm whose joints turn about x and -x alternately twisted axes, links of 0.1 to 0.3 m; at most 7 joints."""
    lengths = (0.0, 0.3, 0.25, 0.1, 0.12, 0.05, 0.08)[:joints]
    row = [
        Joint(
            f"joint {k}",
            "revolute",
            frozen(rotation_x(0.5 * np.pi * (k % 3 - 1)) @ translation(a, 0, 0.1)),
            (-TURN, TURN),
        )
        for k, a in enumerate(lengths)
    ]
    return SerialChain(tuple(row), frozen(translation(0.05, 0, 0.1)), frozen(np.eye(4)))


def sliding() -> SerialChain:
    """Three slides: the handle does not turn."""
    axes = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    row = tuple(Joint(name, "prismatic", frozen(np.eye(4)), (-0.2, 0.2), axis) for name, axis in axes.items())
    return SerialChain(row, frozen(np.eye(4)), frozen(np.eye(4)))


def unlimited() -> SerialChain:
    """Six joints, the last of which turns freely."""
    six = serial(6)
    free = Joint("free", "revolute", six.joints[-1].T_parent_joint)
    return SerialChain((*six.joints[:-1], free), six.T_last_tip, six.T_base_first)


@cache
def pilot(arm_of: Any, *arguments: Any) -> tuple[SerialChain, Postures]:
    """A reference arm and its postures at the pilot's points, read-only."""
    arm = arm_of(*arguments)
    postures = on_arrays(arm, pilot_points(arm.dof))
    for array in (postures.u, postures.q, postures.tips, postures.rotations, postures.jacobians, postures.valid):
        array.setflags(write=False)
    return arm, postures


STUDY: Tree = {
    "study": {"name": "contract", "seed": 1},
    "arm": {
        "kind": "dh",
        "convention": "modified",
        "joints": [
            {"name": "z", "kind": "prismatic", "limits": [-0.2, 0.2]},
            {"name": "y", "kind": "prismatic", "alpha": 90, "theta": 90, "limits": [-0.2, 0.2]},
            {"name": "x", "kind": "prismatic", "alpha": 90, "limits": [-0.2, 0.2]},
        ],
    },
    "layout": {"spacing": 0.3, "offset": [0.0, 0.4, 0.1]},
    "human": {"kind": "ehem", "samples": 4096},
    "dexterity": {"kind": "yoshikawa", "K_scaled": 3, "rows": ["x", "y", "z"], "threshold": 0.2},
    "voxels": {"kind": "dense", "size": 0.04},
    "sampling": {"samples": 16384, "replicates": 2},
}
CASES: dict[str, dict[str, Any]] = {
    "a design within reach": {},
    "one replicate": {},
    "a design out of reach": {"layout.offset": [0.0, 5.0, 0.1]},
    "elites": {"sampling.estimator": "elites", "sampling.tolerance": 0.5},
}
"""What a metric is asked about: values at paths of :data:`STUDY`."""


@cache
def measured(case: str) -> Measurement:
    """The measurement of a case."""
    if case == "one replicate":
        usual = measured("a design within reach")
        return replace(usual, replicates=usual.replicates[:1])
    spec = check(replaced(STUDY, CASES[case]), Path("contract.toml"))
    ((_, measurement),) = measurements(spec, {}, replicates=2)
    return measurement
