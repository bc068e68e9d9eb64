"""What each dexterity index costs, beside Eq. (1)'s manipulability: samples to voxels on one thread.

``python benchmarks/indices.py [seconds]`` visits them in turn, on the arms of ``eiwa bench``, and prints the least time per
sample and its ratio to the least of ``yoshikawa`` on the same rows.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from eiwa.bench.cases import CASES, PRECISIONS
from eiwa.bench.measure import Contender, Record, interleaved, keys, visit
from eiwa.core import registry
from eiwa.core.dexterity import Family
from eiwa.core.filling import Sampling, fill
from eiwa.core.sampling import Stream

SAMPLES = 1 << 18
INDICES = ("yoshikawa", "condition", "smallest_singular_value", "isotropy", "joint_limits", "extended")
LIMITS = {"K_scaled": 3.0}


def families(joints: int, rows: str) -> dict[str, Family]:
    """An arm with each index."""
    known, case = registry.load(), CASES[joints]
    tables = {kind: {"kind": kind, "rows": rows} for kind in INDICES}
    tables["yoshikawa"] |= LIMITS
    tables["joint_limits"] = {"kind": "joint_limits"} | LIMITS
    free = replace(case, normaliser=None)
    return {kind: free.family(index=known.part("dexterity", table).build()) for kind, table in tables.items()}


def contender(kind: str, family: Family, joints: int, precision: str) -> Contender:
    """The whole way from samples to voxels, with a stream that nobody has asked for."""
    backend, targets = CASES[joints].setup.backend, CASES[joints].targets()
    amount = Sampling(SAMPLES, PRECISIONS[precision])

    def call(samples: int) -> None:
        fill(family, targets, backend, Stream("plain", next(keys)), replace(amount, samples=samples))

    return Contender(
        Record("compare", kind, "flow", "sample", joints, precision, 1, SAMPLES, 0.01), visit(call, SAMPLES)
    )


if __name__ == "__main__":
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    for rows in ("all", "translation"):
        for joints in CASES:
            members = families(joints, rows)
            for precision in PRECISIONS:
                contenders = [contender(kind, family, joints, precision) for kind, family in members.items()]
                least = {r.who: r.least or np.nan for r in interleaved(contenders, seconds, lambda text: None)}
                shown = ", ".join(f"{who} {1e9 * t:.1f} ns ({t / least['yoshikawa']:.2f})" for who, t in least.items())
                print(f"{rows}, {joints} joints, {precision}: {shown}", flush=True)
