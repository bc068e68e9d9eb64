"""A study whose objectives are straight lines in its paths, so that every analysis has a closed form."""

import numpy as np

from eiwa.core.interfaces import Operator
from eiwa.core.outcome import Outcome

SLOPES = {"arm.joints.upper.a": 2.0, "arm.joints.fore.a": -1.0, "layout.spacing": 0.5}
NOISE = {0: 0.0, 1: 0.003, 2: -0.001}
"""Of every replicate, the same for all designs."""


def evaluate(spec, overrides, replicates=1, *, parameters=None, named=False):
    """F = sum of slope times value, and its replicates; what else the study has is constant."""
    F = sum(slope * overrides[path] for path, slope in SLOPES.items() if path in overrides)
    numbers = {"F": F, "F_remaining": None, "reach": sum(v for p, v in overrides.items() if p.endswith(".a"))}
    objectives = [numbers[o.metric] for o in spec.objectives]
    lists = [[value + NOISE[k] for k in range(replicates)] if replicates > 1 else None for value in objectives]
    violations = [c.violation([numbers[c.metric]]) for c in spec.constraints]
    return Outcome({"": numbers}, objectives, violations, replicates, {"": Operator(0, 0)}, {}, lists)


def deviation(spec):
    """Of F under the study's tolerances."""
    return float(np.sqrt(sum((SLOPES.get(p, 0) * t.deviation) ** 2 for p, t in spec.tolerance.items())))
