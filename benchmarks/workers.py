"""How much faster two one-thread workers are than one: python benchmarks/workers.py [--trials 48] [--visits 3]

The paper's search with random sampling, named designs and scenarios left out. Timed is the search from its third batch on,
when the workers have started and compiled; the best of several visits counts, as other processes only make it slower.
"""

import argparse
import tempfile
import time
from pathlib import Path

from eiwa.core.spec import check, read
from eiwa.study.run import Run, Silent
from eiwa.study.store import Store

PAPER = Path(__file__).parent.parent / "studies" / "paper.toml"
BATCH = 8


class Clock(Silent):
    """When rows were heard of."""

    def __init__(self):
        self.heard = []

    def __call__(self, stage, row):
        if stage == "search":
            self.heard.append(time.perf_counter())


def rate(workers, trials):
    """Trials per second."""
    tree = {k: v for k, v in read(PAPER).items() if k not in ("designs", "assumptions", "scenarios")}
    tree["study"] |= {"trials": trials, "batch": BATCH, "sampler": "random", "name": "workers"}
    tree["objectives"] = [{"metric": "F", "direction": "maximize"}]
    tree["sampling"] = tree.get("sampling", {}) | {"replicates": 1}
    tree["execution"] = {"workers": workers, "threads": 1}
    clock = Clock()
    with tempfile.TemporaryDirectory() as folder:
        Run(check(tree, PAPER), Store(Path(folder) / "workers"), clock).execute()
    return (trials - 2 * BATCH) / (clock.heard[-1] - clock.heard[2 * BATCH - 1])


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=48)
    options.add_argument("--visits", type=int, default=3)
    chosen = options.parse_args()
    best = {1: 0.0, 2: 0.0}
    for _ in range(chosen.visits):
        for workers in best:
            best[workers] = max(best[workers], rate(workers, chosen.trials))
        print(f"one {best[1]:.2f}/s, two {best[2]:.2f}/s: {best[2] / best[1]:.2f} times", flush=True)


if __name__ == "__main__":
    main()
