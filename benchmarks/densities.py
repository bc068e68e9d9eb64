"""One density over all variables against one for each, in TPE with two objectives: ``python benchmarks/densities.py``.

Prints the hypervolume after 150 trials (mean and standard deviation over six seeds) and the processor time of a trial.
"""

import time
import warnings

import moocore
import numpy as np
import optuna


def kursawe(x):
    """Disconnected front (Kursawe 1991)."""
    x = 10 * x - 5
    return -10 * np.exp(-0.2 * np.hypot(x[:-1], x[1:])).sum(), (np.abs(x) ** 0.8 + 5 * np.sin(x**3)).sum()


def zdt1(x):
    """Convex front (Zitzler, Deb and Thiele 2000)."""
    g = 1 + 9 * x[1:].mean()
    return x[0], g * (1 - np.sqrt(x[0] / g))


def links(x):
    """What counts is the sum of two lengths and their difference, as in an arm."""
    length = x[0] + x[1]
    return -np.exp(-4 * (length - 1.2) ** 2 - 6 * (x[0] - x[1] - 0.2) ** 2 - 3 * (x[2] - 0.3) ** 2), length


def found(problem, size, reference, joint, seed):
    sampler = optuna.samplers.TPESampler(seed=seed, multivariate=joint)
    study = optuna.create_study(directions=["minimize"] * 2, sampler=sampler)
    study.optimize(lambda t: problem(np.array([t.suggest_float(f"x{k}", 0, 1) for k in range(size)])), n_trials=150)
    return moocore.hypervolume(np.array([t.values for t in study.trials]), ref=np.array(reference))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    for problem, size, reference in ((kursawe, 3, [0.0, 15.0]), (zdt1, 4, [1.1, 6.0]), (links, 3, [0.0, 2.0])):
        for joint in (False, True):
            start = time.process_time()
            volumes = [found(problem, size, reference, joint, seed) for seed in range(6)]
            cost = (time.process_time() - start) / (6 * 150)
            what = "together" if joint else "one by one"
            print(f"{problem.__name__}, {what}: {np.mean(volumes):.4g} ± {np.std(volumes):.2g}, {1e3 * cost:.1f} ms")
