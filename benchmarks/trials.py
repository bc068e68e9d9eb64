"""What a search at a refined F costs: ``python benchmarks/trials.py [trials]`` runs the paper's study with elites.

Its metrics are F and size alone; 1 % tolerance, r = 20 mm, one replicate, no named designs; once with one K and once
with the three of the study,
each in a process of its own, after a short run that compiles. Prints seconds, those of all processors together, and
the largest resident memory.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PAPER = Path(__file__).resolve().parents[1] / "studies" / "paper.toml"
SAMPLING = '[sampling]\nestimator = "elites"\ntolerance = 0.01\nsamples = 16_777_216\nreplicates = 1\n\n'
KEPT = ("F", "reach", "total_link_length")
RUN = "import sys; from eiwa.cli import main; sys.argv = ['eiwa', 'study', 'run', sys.argv[1], '--runs', sys.argv[2]]; main()"


def study(trials: int, scenarios: bool) -> str:
    """The paper's study at the benchmark's setting."""
    tables = re.split(r"(?m)^(?=\[)", PAPER.read_text())
    dropped = r"\[(designs|assumptions|sampling" + ("" if scenarios else "|scenarios") + r")\b"
    kept = [t for t in tables if not re.match(dropped, t)]
    metrics = [t for t in kept if not t.startswith("[metrics.") or re.match(r"\[metrics\.(\w+)\]", t)[1] in KEPT]
    return re.sub(r"(?m)^trials = .*$", f"trials = {trials}", "".join(metrics)) + "\n" + SAMPLING


def measured(trials: int, scenarios: bool, folder: str) -> tuple[float, float, float]:
    """Wall time [s] and processors' time [s] of the whole command, and its largest resident memory [MiB]."""
    path = Path(folder) / f"{trials}-{scenarios}.toml"
    path.write_text(study(trials, scenarios))
    command = [sys.executable, "-c", RUN, str(path), str(Path(folder) / path.stem)]
    start = time.perf_counter()
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"the study failed with status {status}")
    busy = usage.ru_utime + usage.ru_stime
    return time.perf_counter() - start, busy, usage.ru_maxrss / (1024 if sys.platform == "linux" else 1024**2)


if __name__ == "__main__":
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    with tempfile.TemporaryDirectory() as folder:
        times = []
        for scenarios in (False, True):
            measured(8, scenarios, folder)
            seconds, busy, memory = measured(trials, scenarios, folder)
            times.append(seconds)
            print(
                f"{3 if scenarios else 1} K: {seconds:.1f} s ({busy:.1f} s of processors), {memory:.0f} MiB", flush=True
            )
        print(f"ratio {times[1] / times[0]:.2f}")
