"""Read the answer of studies/assumptions.toml from its Parquet rows: python docs/examples/assumptions.py [FOLDER]"""

import math
import sys

import pyarrow.parquet as pq


def ratio(row, base, at):
    """F of one row over F of another under a scenario, with the error that their two errors make."""
    (F, se), (F_base, se_base) = ((r[f"metrics.F{at}"], r[f"metrics.F_se{at}"]) for r in (row, base))
    return f"{F / F_base:5.1f} ± {F / F_base * math.hypot(se / F, se_base / F_base):.1f}" if F_base else "unbounded"


rows = pq.read_table((sys.argv[1:] or ["runs/assumptions"])[0] + "/trials").to_pylist()
named = {row["name"]: row for row in rows if row["kind"] == "design"}
trials = sorted((row for row in rows if row["kind"] == "trial"), key=lambda row: row["parameters.split"])
scenarios = [column.removeprefix("metrics.F") for column in rows[0] if column.split("@")[0] == "metrics.F"]

print("F of both designs, and their ratio")
for at in scenarios:
    values = (f"{name} {row['metrics.F' + at]:.4f} ± {row['metrics.F_se' + at]:.4f}" for name, row in named.items())
    print(f"{at or '@reference':40}", *values, "gain", ratio(named["optimum"], named["original"], at))

print("\nF along L1 + L2 = 0.44 m, as a share of its maximum")
print(f"{'L1 / (L1 + L2)':40}", *(f"{row['parameters.split']:4.2f}" for row in trials[::2]), " within 5 %")
for at in scenarios:
    F = [row[f"metrics.F{at}"] for row in trials]
    flat = [row["parameters.split"] for row, f in zip(trials, F, strict=True) if f >= 0.95 * max(F)]
    print(f"{at or '@reference':40}", *(f"{f / max(F):4.2f}" for f in F[::2]), f" {flat[0]:.3f} to {flat[-1]:.3f}")
