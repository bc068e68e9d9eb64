"""One trial of the paper's study against a Pinocchio C++ loop, side by side on the same cores.

``python benchmarks/trial.py [--threads N]`` builds the C++ program (benchmarks/build.py), then times alternately

* a whole trial of eiwa: 2^20 samples, both arms, 10 mm voxels, from design to F; and
* Pinocchio: forward kinematics, Jacobian and sqrt det(J Jt) of as many samples, without sampling, penalty and voxels.

It prints medians, their spread, the ratio, and the peak memory of this process [MiB].
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import sys
import tempfile
import time
from pathlib import Path

SAMPLES = 1 << 20
ROOT = Path(__file__).resolve().parent.parent


def trial_seconds(lengths: tuple[float, float]) -> float:
    """Seconds of one warm trial."""
    start = time.perf_counter()
    evaluate(SPEC, {"arm.joints.upper.a": lengths[0], "arm.joints.fore.a": lengths[1]})
    return time.perf_counter() - start


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--repeats", type=int, default=9)
    arguments = parser.parse_args()
    os.environ["EIWA_THREADS"] = str(arguments.threads)

    from build import build_pinocchio, run_pinocchio

    from eiwa.core.outcome import evaluate
    from eiwa.core.spec import load

    settings = {"voxels.size": 0.01, "scenarios": {}, "metrics": {}, "sampling.samples": SAMPLES}
    SPEC = load(ROOT / "studies" / "paper.toml", settings)
    trial_seconds((0.25, 0.19))  # compile, and compute E, which a search computes once
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        binary = build_pinocchio(Path(folder))
        for k in range(arguments.repeats):
            ours.append(1e9 * trial_seconds((0.26 - 0.001 * k, 0.18)) / SAMPLES)
            theirs.append(run_pinocchio(binary, SAMPLES // 8, arguments.threads, 120.0)["ns_per_sample"])
    result = {
        "threads": arguments.threads,
        "eiwa_ns_per_sample": round(statistics.median(ours), 2),
        "eiwa_spread": [round(min(ours), 2), round(max(ours), 2)],
        "pinocchio_ns_per_sample": round(statistics.median(theirs), 1),
        "pinocchio_spread": [round(min(theirs), 1), round(max(theirs), 1)],
        "ratio": round(statistics.median(theirs) / statistics.median(ours), 1),
        "peak_memory_MiB": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }
    json.dump(result, sys.stdout, indent=1)
    print()
