"""How much faster two one-thread workers are than one: python benchmarks/workers.py [--trials 48] [--visits 3]

The paper's search with random sampling, without its named designs. Timed are its batches from the third on,
when the workers have started and compiled; the quickest of several visits counts, as other processes only make it slower.
"""

import argparse
import tempfile
from itertools import pairwise
from pathlib import Path

from eiwa.core.spec import check, read
from eiwa.study.run import Run
from eiwa.study.store import Store

PAPER = Path(__file__).parent.parent / "studies" / "paper.toml"
BATCH = 8


def rate(workers, trials):
    """Trials per second in the quickest batch, asking and writing included."""
    tree = {k: v for k, v in read(PAPER).items() if k not in ("designs", "assumptions")}
    tree["study"] |= {"trials": trials, "batch": BATCH, "sampler": "random", "name": "workers"}
    tree["execution"] = {"workers": workers, "threads": 1}
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "workers")
        Run(check(tree, PAPER), store).execute()
        begun = {r["number"]: r["started"] for r in store.rows() if r["kind"] == "trial"}
    batches = [min(begun[n] for n in range(first, first + BATCH)) for first in range(2 * BATCH, trials, BATCH)]
    return BATCH / min((after - before).total_seconds() for before, after in pairwise(batches))


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
