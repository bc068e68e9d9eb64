"""What a study costs its master beside the evaluations: python benchmarks/master.py

Evaluations take no time here; Optuna's search, its storage and the Parquet rows are real. Prints the mean cost of a trial
over the first 1000 trials of two searches, and what it takes to find that a study of 5000 trials is complete.
"""

import argparse
import tempfile
import time
from pathlib import Path
from unittest.mock import patch

from eiwa.core.interfaces import Operator
from eiwa.core.outcome import Outcome
from eiwa.core.spec import check, read
from eiwa.study import rows
from eiwa.study.run import Run
from eiwa.study.store import Store

PAPER = Path(__file__).parent.parent / "studies" / "paper.toml"


def study(trials, objectives=1, storage=None, sampler="tpe"):
    """The paper's study without named designs; two objectives come with two constraints."""
    tree = read(PAPER)
    tree["study"] |= {"trials": trials, "sampler": sampler, "name": "master"}
    tree["objectives"] = [{"metric": "F", "direction": "maximize"}]
    if objectives == 2:
        tree["objectives"].append({"metric": "reach", "direction": "minimize"})
        tree["constraints"] = [{"metric": "reach", "max": 0.42}, {"metric": "F", "min": 0.05}]
    if storage:
        tree["execution"] = {"storage": storage}
    for table in ("designs", "assumptions", "scenarios"):
        tree.pop(table, None)
    return check(tree, PAPER)


def instead(spec, overrides, replicates=1, *, parameters=None, named=False):
    """An outcome that costs nothing and gives the search something to climb."""
    values = [float(v) for _, v in sorted(overrides.items())]
    F = max(0.0, 1.0 - sum((v - 0.3) ** 2 for v in values)) / 2
    numbers = {"F": F, "reach": sum(values[:2])}
    objectives = [numbers[o.metric] for o in spec.objectives]
    violations = [c.violation([numbers[c.metric]]) for c in spec.constraints]
    return Outcome({"": numbers}, objectives, violations, replicates, {"": Operator()})


def seconds(spec, folder):
    """Wall time and processor time of a run, and its store."""
    store = Store(Path(folder) / spec.study.name)
    with patch.object(rows, "evaluate", instead):
        clocks = time.perf_counter, time.process_time
        begun = [clock() for clock in clocks]
        Run(spec, store).execute()
        return *(clock() - since for clock, since in zip(clocks, begun, strict=True)), store


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--storage", help="URL of Optuna's storage instead of the journal file")
    options.add_argument("--trials", type=int, default=1000)
    options.add_argument("--profile", action="store_true")
    chosen = options.parse_args()
    for objectives in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            spec = study(chosen.trials, objectives, chosen.storage)
            if chosen.profile:
                import cProfile
                import pstats

                profile = cProfile.Profile()
                profile.runcall(seconds, spec, folder)
                pstats.Stats(profile).sort_stats("cumulative").print_stats(45)
            else:
                wall, busy, _ = seconds(spec, folder)
                each = 1000 / chosen.trials
                print(
                    f"{objectives} objective(s), {chosen.trials} trials: {each * wall:.1f} ms a trial, {each * busy:.1f} busy"
                )
    if chosen.storage:
        return
    with tempfile.TemporaryDirectory() as folder:
        spec = study(5000, 2, sampler="random")
        wall, busy, store = seconds(spec, folder)
        print(f"5000 random trials: {wall:.1f} s ({busy:.1f} s busy), {len(store.parts)} parts")
        again = min(seconds(spec, folder)[:2] for _ in range(3))
        print(f"resuming them: {again[0]:.2f} s ({again[1]:.2f} s busy)")


if __name__ == "__main__":
    main()
