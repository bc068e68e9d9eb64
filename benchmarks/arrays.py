"""What eiwa adds around a plugin in plain NumPy: ``python benchmarks/arrays.py [seconds]``.

An index and an arm that answer from stored arrays cost next to nothing, so their whole flow, samples to voxels on one
thread, is what the array form adds to a plugin's own time. The arm's arrays are in C order, as NumPy makes them, and once
with contiguous columns, as eiwa's own arms make them. Printed beside the flow with nothing but compiled parts and the
hand-written C++ loop; the least time per sample of each.
"""

import os
import sys
from dataclasses import replace

os.environ["EIWA_THREADS"] = "1"

import numpy as np

from eiwa.bench.cases import CASES
from eiwa.bench.compare import SAMPLES, VOXEL, _flow, _roof
from eiwa.bench.measure import Contender, Record, interleaved, visit
from eiwa.core.dexterity import Family
from eiwa.core.interfaces import Arm, DexterityIndex
from eiwa.core.sampling import ARRAY_BLOCK, Stream


class StoredIndex(DexterityIndex):
    """The same values for every block."""

    def __init__(self, values):
        self._values = values

    def values(self, postures, prepared):
        return self._values[: len(postures.u)]


class StoredArm(Arm):
    """The same postures for every block."""

    def __init__(self, arm, postures):
        self.dof, self.limited, self._stored = arm.dof, arm.limited, postures

    def postures(self, u):
        n, p = len(u), self._stored
        parts = {name: getattr(p, name)[:n] for name in ("q", "tips", "rotations", "jacobians", "valid")}
        return replace(p, u=u, **parts)


def least(joints, seconds):
    """Least time of every flow [ns a sample]."""
    case = CASES[joints]
    arm = case.setup.arm
    postures = arm.postures(Stream("plain", 1).points(0, ARRAY_BLOCK, joints))
    names = ("q", "tips", "rotations", "jacobians", "valid")
    in_c_order = replace(postures, **{name: np.ascontiguousarray(getattr(postures, name)) for name in names})
    index = StoredIndex(abs(postures.jacobians[:, 0, 0]).copy())
    family = case.family()
    record = Record("compare", "compiled", "flow", "sample", joints, "f64", 1, SAMPLES, VOXEL)
    compiled = Contender(record, visit(_flow(family, case, "f64"), SAMPLES))
    contenders = [compiled, *_roof(family, case, record, {1: compiled}, {})]
    (member,) = family.members  # prepared already: stored answers are what a study refuses
    parts = {
        "index": {"index": index},
        "arm": {"arm": StoredArm(arm, in_c_order)},
        "arm in columns": {"arm": StoredArm(arm, postures)},
    }
    for who, part in parts.items():
        flow = _flow(Family((replace(member, **part),)), case, "f64")
        contenders.append(Contender(replace(record, who=who), visit(flow, SAMPLES)))
    found = interleaved([c for c in contenders if c.record.part == "flow"], seconds, lambda text: None)
    return {r.who: 1e9 * r.least for r in found}


if __name__ == "__main__":
    for joints in CASES:
        ns = least(joints, float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
        times = ", ".join(f"{who} {t:.1f} ns ({t / ns['roof']:.2f})" for who, t in ns.items())
        print(f"{joints} joints, f64 (beside the roof): {times}", flush=True)
