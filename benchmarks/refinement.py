"""How fast elite refinement approaches the true maximum per voxel, and what its own estimate of the rest is worth.

``python benchmarks/refinement.py`` refines the optimum of studies/paper.toml at 20 and 10 mm, and compares F at every
doubling of the evaluations with the supremum per voxel that closed-form inverse kinematics gives (tests/core/supremum.py,
9^3 points a voxel), and with plain samples of the same number.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from eiwa.core.elites import CAUTION  # noqa: E402
from eiwa.core.evaluation import Measurement  # noqa: E402
from eiwa.core.outcome import evaluate, measurements  # noqa: E402
from eiwa.core.spec import load  # noqa: E402
from eiwa.core.transforms import inverse  # noqa: E402
from tests.core.supremum import PaperArm  # noqa: E402


def true_F(measurement: Measurement, points: int = 9) -> float:
    """F from the suprema of both arms on E's grid."""
    arm = PaperArm(0.26, 0.18, np.deg2rad(120), 12270.0)
    first, layout = measurement.first, measurement.setup.layout
    cells = np.argwhere(first.E_sum > 0)
    lows = (cells + np.array(first.V.grid.origin)) * first.V.grid.r
    weights = first.E_sum[tuple(cells.T)]
    total = 0.0
    for side in (+1, -1):
        best = arm.cells(inverse(layout.T_world_base(side)), lows, first.V.grid.r, points)
        values = np.minimum(best / measurement.dexterity.normaliser, 1.0)
        total += layout.alpha * float(
            (np.where(values >= measurement.dexterity.threshold, values, 0.0) * weights).sum()
        )
    return total / float(weights.sum())


if __name__ == "__main__":
    for size in (0.02, 0.01):
        settings = {"scenarios": {}, "metrics": {}, "voxels.size": size, "sampling.replicates": 1}
        elites = {"sampling.estimator": "elites", "sampling.samples": 1 << 23, "sampling.tolerance": 1e-9}
        spec = load(ROOT / "studies" / "paper.toml", settings | elites)
        overrides = spec.designs["optimum"].overrides
        ((_, measurement),) = measurements(spec, overrides)
        truth = true_F(measurement)
        print(f"r = {1e3 * size:g} mm, true F = {truth:.4f}")
        print(f"{'evaluations':>12} {'elites':>8} {'error':>8} {'estimated':>10} {'plain':>8} {'error':>8}")
        assert measurement.first.refinement is not None
        history = measurement.first.refinement.history
        wanted = 1 << 18
        for n, F in history:
            if n < wanted:
                continue
            wanted *= 2
            half = [value for m, value in history if m <= 0.501 * n]
            rest = CAUTION * (F - half[-1]) / truth if half else float("nan")
            plain = load(ROOT / "studies" / "paper.toml", settings | {"sampling.samples": n})
            sampled = evaluate(plain, overrides).scenarios[""]["F"] or 0.0
            errors = (f"{1 - F / truth:8.1%}", f"{rest:10.1%}", f"{sampled:8.4f}", f"{1 - sampled / truth:8.1%}")
            print(f"{n:12,} {F:8.4f}", *errors)
