"""The engine side by side with what it could be and what else there is, on the same cores.

``python benchmarks/engine.py [--threads 1 2] [--samples N] [--repeats R] [--patience S] [--out FILE.json|FILE.parquet]``

Every contender takes samples of a 6-joint (the paper's) and a 7-joint arm (a Panda) from their number to a voxel
maximum for two bases, in double and single precision, visited in turn so that all see the same drift:

* ``eiwa``: :func:`eiwa.core.filling.fill` with the fused kernel, a new stream at every call;
* ``eiwa, array form``: the same with an arm that only has ``postures``, so that nothing of it is compiled in;
* ``roof``: roof.cpp, the same algorithm by hand in C++;
* ``NumPy``: one array per component and ``linalg.det(J Jt)``;
* ``Pinocchio C++``: pinocchio_loop.cpp; kinematics and w alone, without sampling, penalty and voxels;
* ``robotics-toolbox-python``: where it is importable; kinematics and w alone, one call per sample.

eiwa, NumPy and the roof visit the same samples of the key 1 once, and must leave the same maxima. The table has medians
and spreads [ns per sample] and the median over visits of the ratio to the roof; a second one relates the roof to
NumPy's matrix product on as many threads (flops as roof.cpp counts them). ``others`` is how many cores other processes
kept busy meanwhile: above 0.1 distrust what follows, on several threads above all.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from build import MissingDependencyError, build_pinocchio, build_roof, run_pinocchio, run_roof
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from eiwa.core.dexterity import Family, prepare
from eiwa.core.filling import Sampling, fill
from eiwa.core.interfaces import Arm, Postures
from eiwa.core.sampling import Stream
from eiwa.core.transforms import frozen, roll_pitch_yaw, translation
from eiwa.core.workspace import Grid, Target
from eiwa.plugins.arms.dh import DhParameters, chain
from eiwa.plugins.dexterity.yoshikawa import Yoshikawa
from eiwa.plugins.voxels.stores import Dense

PRECISIONS = {"f64": np.float64, "f32": np.float32}
TOLERANCES = {"f64": 1e-9, "f32": 1e-6}
VISIT = 5
"""Calls of which a visit reports the median, as the C++ programs do."""
SLOW = 1 << 16
"""Samples per call of the slow contenders."""
BLOCK = 4096
THRESHOLD = 0.3
K = {6: 12270.0, 7: 49080.0}
ALPHA = {6: (0, 90, -90, 0, -90, 90), 7: (0, -90, 90, 90, -90, 90, 90)}
A = {6: (0, 0, 0.26, 0.18, 0, 0), 7: (0, 0, 0, 0.0825, -0.0825, 0, 0.088)}
D = {6: (0, 0, 0, 0, 0, 0), 7: (0.333, 0, 0.316, 0, 0.384, 0, 0.107)}
LIMITS = {
    6: np.deg2rad([[-120] * 6, [120] * 6]),
    7: np.array(
        [
            [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
            [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
        ]
    ),
}
GRID = Grid.covering(np.array([[-0.38, 0.26, -0.08], [0.38, 0.52, 0.30]]), 0.01)
TARGETS = [Target(GRID, frozen(translation(x, 0.802, 0.10) @ roll_pitch_yaw(0, 0, -np.pi / 2))) for x in (0.1, -0.1)]


class Postured(Arm):
    """An arm that hides its formulas behind ``postures``."""

    def __init__(self, arm: Any) -> None:
        self.arm = arm
        self.dof, self.limited = arm.dof, arm.limited

    def postures(self, u: NDArray[np.float64]) -> Postures:
        """Those of the arm."""
        result: Postures = self.arm.postures(u)
        return result


def family(joints: int, normaliser: float, hidden: bool = False) -> Family:
    """The paper's index for one of the two arms."""
    rows = [
        {"name": f"q{j}", "alpha": ALPHA[joints][j], "a": A[joints][j], "d": D[joints][j], "limits": limits}
        for j, limits in enumerate(np.rad2deg(LIMITS[joints]).T.tolist())
    ]
    arm: Arm = chain(DhParameters.model_validate({"convention": "modified", "joints": rows}))
    index = Yoshikawa(K=K[joints], K_scaled=None, rows=tuple(range(6)))
    return Family((prepare(Postured(arm) if hidden else arm, index, normaliser, THRESHOLD),))


def fill_eiwa(member: Family, precision: str, samples: int, key: int) -> tuple[float, float]:
    """Sum of maxima, and hits per sample."""
    filled = fill(member, TARGETS, Dense("max"), Stream("plain", key), Sampling(samples, PRECISIONS[precision]))[0]
    return sum(float(f.values.sum()) for f in filled), sum(int(f.hits.sum()) for f in filled) / samples


def fill_numpy(joints: int, normaliser: float, precision: str, samples: int, key: int) -> tuple[float, float]:
    """The same by NumPy."""
    threads = int(os.environ["EIWA_THREADS"])
    grids = np.zeros((threads, 2 * GRID.cells), PRECISIONS[precision])
    hits = np.zeros((threads, 2 * GRID.cells), np.int64)

    def work(t: int) -> None:
        for start in range(t * BLOCK, samples, threads * BLOCK):
            u = Stream("plain", key).points(start, min(BLOCK, samples - start), joints).T.astype(PRECISIONS[precision])
            tip, raw = numpy_block(joints, u)
            value = np.minimum(raw / PRECISIONS[precision](normaliser), 1)
            value[value < THRESHOLD] = 0
            for k, target in enumerate(TARGETS):
                affine = target.to_cells().astype(tip.dtype)
                cell = np.floor(affine[:, :3] @ tip + affine[:, 3:]).astype(int)
                inside = ((cell >= 0) & (cell < np.array(GRID.shape)[:, None])).all(axis=0)
                flat = np.ravel_multi_index(tuple(cell[:, inside]), GRID.shape) + k * GRID.cells
                np.maximum.at(grids[t], flat, value[inside])
                np.add.at(hits[t], flat, 1)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, range(threads)))
    return float(grids.max(axis=0).sum(dtype=float)), int(hits.sum()) / samples


def numpy_block(joints: int, u: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Tips (3, n) and w with its penalty (n,), from u (joints, n); every component is a contiguous row."""
    low, high = LIMITS[joints].astype(u.dtype)
    q = low[:, None] + u * (high - low)[:, None]
    sines, cosines = np.sin(q), np.cos(q)
    x, y, z = np.repeat(np.eye(3, dtype=u.dtype)[:, :, None], u.shape[1], axis=2)
    o = np.zeros_like(x)
    axes, origins = [], []
    for j, (alpha, a, d) in enumerate(zip(np.deg2rad(ALPHA[joints]), A[joints], D[joints], strict=True)):
        c, s = u.dtype.type(math.cos(alpha)), u.dtype.type(math.sin(alpha))
        y, z = c * y + s * z, c * z - s * y
        o = o + u.dtype.type(a) * (x if j else np.eye(3, dtype=u.dtype)[:, :1]) + u.dtype.type(d) * z
        axes.append(z)
        origins.append(o)
        x, y = cosines[j] * x + sines[j] * y, cosines[j] * y - sines[j] * x
    J = np.empty((u.shape[1], 6, joints), u.dtype)
    for j, (z, p) in enumerate(zip(axes, origins, strict=True)):
        lever = o - p
        for i in range(3):
            J[:, i, j] = z[i - 2] * lever[i - 1] - z[i - 1] * lever[i - 2]
            J[:, 3 + i, j] = z[i]
    w = np.sqrt(np.maximum(np.linalg.det(J @ J.transpose(0, 2, 1)), 0))
    return o, w * -np.expm1(-u.dtype.type(K[joints]) * np.prod(u * (1 - u), axis=0))


GEMM = """
import sys, time, numpy as np
kind, n = np.dtype(sys.argv[1]), 1024
a = np.random.default_rng(0).random((n, n)).astype(kind); b = a.T.copy(); c = a @ b
times = []
for _ in range(9):
    start = time.perf_counter(); np.matmul(a, b, out=c); times.append(time.perf_counter() - start)
print(2e-9 * n**3 / sorted(times)[4])
"""


def gemm(precision: str, threads: int) -> float:
    """GFLOP/s of NumPy's matrix product, in a process of its own whose BLAS has that many threads."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
    environment = {**os.environ, **dict.fromkeys(names, str(threads))}
    words = [sys.executable, "-c", GEMM, np.dtype(PRECISIONS[precision]).str]
    return float(subprocess.run(words, env=environment, check=True, capture_output=True, text=True).stdout)


def toolbox_ns(joints: int, samples: int = 200) -> float:
    """ns per sample of robotics-toolbox-python: its Jacobian, one call per joint vector, and w."""
    import roboticstoolbox as rtb  # type: ignore[import-not-found]

    rows = zip(np.deg2rad(ALPHA[joints]), A[joints], D[joints], strict=True)
    robot = rtb.DHRobot([rtb.RevoluteMDH(alpha=alpha, a=a, d=d) for alpha, a, d in rows])
    low, high = LIMITS[joints]
    start = time.perf_counter()
    for q in np.random.default_rng(0).uniform(low, high, (samples, joints)):
        J = robot.jacob0(q)
        math.sqrt(max(0.0, np.linalg.det(J @ J.T)))
    return 1e9 * (time.perf_counter() - start) / samples


def visit(call: Callable[[int, int], Any], samples: int, keys: Iterator[int]) -> float:
    """Median ns per sample of a few calls, each with a stream that was not asked for before."""
    times = []
    call(min(samples, SLOW), next(keys))
    for _ in range(VISIT):
        start = time.perf_counter()
        call(samples, next(keys))
        times.append(1e9 * (time.perf_counter() - start) / samples)
    return statistics.median(times)


def _unused_keys() -> Iterator[int]:
    key = 1 << 20
    while True:
        key += 1
        yield key


@contextmanager
def others(into: list[float]) -> Iterator[None]:
    """Append how many cores other processes kept busy meanwhile (Linux; else nothing)."""
    ticks, before, start = os.sysconf("SC_CLK_TCK"), _busy(), time.perf_counter()
    own = sum(os.times()[:4])
    yield
    with suppress(TypeError):
        busy = (_busy() - before) / ticks - (sum(os.times()[:4]) - own)  # type: ignore[operator]
        into.append(max(0.0, busy / (time.perf_counter() - start)))


def wait(patience: float) -> None:
    """Until other processes use less than a tenth of a core, or so many seconds."""
    end = time.perf_counter() + patience
    while time.perf_counter() < end:
        load: list[float] = []
        with others(load):
            time.sleep(0.2)
        if not load or load[0] < 0.1:
            return


def _busy() -> int | None:
    try:
        fields = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    except OSError:
        return None
    return sum(fields) - fields[3] - fields[4]


def check_agreement(roof: Path, joints: int, precision: str, samples: int) -> dict[str, Any]:
    """The roof's run with key 1; raises where eiwa or NumPy leave other maxima."""
    result: dict[str, Any] = run_roof(roof, samples, 1, joints, precision)
    member = family(joints, float(result["normaliser"]))
    result["relative_difference"] = {}
    for name, (total, hits) in {
        "eiwa": fill_eiwa(member, precision, samples, 1),
        "NumPy": fill_numpy(joints, float(result["normaliser"]), precision, samples, 1),
    }.items():
        difference = abs(total / float(result["checksum"]) - 1)
        result["relative_difference"][name] = difference
        # NumPy's det(J Jt) squares the condition number, and a tip in single precision may fall into the next cell.
        loose = 1e-4 if (name, precision) == ("NumPy", "f32") else TOLERANCES[precision]
        if difference > loose or not math.isclose(hits, float(result["hits"]), rel_tol=1e-8 if loose < 1e-8 else 1e-4):
            raise ValueError(f"{name}, {joints} joints, {precision}: {total}, {hits}; the roof has {result}")
    return result


def measure(arguments: argparse.Namespace, folder: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Records of the contenders, and of the matrix product."""
    roof, keys, samples = build_roof(folder), _unused_keys(), arguments.samples
    os.environ["EIWA_THREADS"] = "1"
    flops, contenders = {}, []
    for joints in (6, 7):
        for precision in PRECISIONS:
            facts = check_agreement(roof, joints, precision, 1 << 18)
            normaliser, flops[joints, precision] = float(facts["normaliser"]), int(facts["flops_per_sample"])
            for name, hidden in (("eiwa", False), ("eiwa, array form", True)):
                member = family(joints, normaliser, hidden)

                def by_eiwa(n: int, key: int, member: Family = member, precision: str = precision) -> Any:
                    return fill_eiwa(member, precision, n, key)

                size = 2 * SLOW if hidden else samples
                contenders.append((name, joints, precision, lambda t, f=by_eiwa, n=size: visit(f, n, keys)))

            def by_numpy(n: int, key: int, j: int = joints, f: float = normaliser, p: str = precision) -> Any:
                return fill_numpy(j, f, p, n, key)

            def by_roof(t: int, j: int = joints, p: str = precision) -> float:
                return float(run_roof(roof, samples, t, j, p)["ns_per_sample"])

            contenders.append(("roof", joints, precision, by_roof))
            contenders.append(("NumPy", joints, precision, lambda t, f=by_numpy: visit(f, SLOW, keys)))
    try:
        pinocchio = build_pinocchio(folder)
        contenders.append(
            ("Pinocchio C++", 6, "f64", lambda t: float(run_pinocchio(pinocchio, SLOW, t)["ns_per_sample"]))
        )
    except (MissingDependencyError, subprocess.CalledProcessError) as error:
        print(f"without Pinocchio: {error}", file=sys.stderr)
    if importlib.util.find_spec("roboticstoolbox"):
        contenders += [("robotics-toolbox-python", j, "f64", lambda t, j=j: toolbox_ns(j)) for j in (6, 7)]

    times: dict[tuple[str, int, str, int], list[float]] = {}
    rates: dict[tuple[str, int], list[float]] = {}
    load: dict[int, list[float]] = {}
    for repeat in range(-1, arguments.repeats):  # the first round compiles and warms up
        for threads in arguments.threads:
            os.environ["EIWA_THREADS"] = str(threads)
            for precision in PRECISIONS if repeat >= 0 else ():
                wait(arguments.patience)
                rates.setdefault((precision, threads), []).append(gemm(precision, threads))
            for name, joints, precision, call in contenders:
                if (name == "robotics-toolbox-python" and threads > 1) or (repeat < 0 and not name.startswith("eiwa")):
                    continue
                wait(arguments.patience)
                with others(load.setdefault(threads, [])):
                    value = call(threads)
                if repeat >= 0:
                    times.setdefault((name, joints, precision, threads), []).append(value)
    records = []
    for (name, joints, precision, threads), values in times.items():
        ratios = [a / b for a, b in zip(values, times["roof", joints, precision, threads], strict=True)]
        records.append(
            {"contender": name, "joints": joints, "precision": precision, "threads": threads}
            | {"ns_per_sample": statistics.median(values), "least": min(values), "most": max(values)}
            | {"ratio_to_roof": statistics.median(ratios), "others_busy": statistics.median(load[threads] or [0.0])}
        )
    products = []
    for (precision, threads), values in rates.items():
        rate = statistics.median(values)
        for joints in (6, 7):
            record: dict[str, Any] = {"precision": precision, "threads": threads, "gemm_gflops": rate, "joints": joints}
            record["flops_per_sample"] = flops[joints, precision]
            for name in ("roof", "eiwa"):
                speed = flops[joints, precision] / statistics.median(times[name, joints, precision, threads])
                record |= {f"{name}_gflops": speed, f"{name}_share": speed / rate}
            products.append(record)
    return records, products


def show(records: list[dict[str, Any]], products: list[dict[str, Any]]) -> None:
    """Print both tables."""
    threads = sorted({r["threads"] for r in records})
    table = Table(title="ns per sample: median (least - most), ratio to the roof")
    for title in ("joints", "precision", "contender", *(f"{t} thread{'s' * (t > 1)}" for t in threads)):
        table.add_column(title, justify="left" if title == "contender" else "right")
    for joints in (6, 7):
        for precision in PRECISIONS:
            rows = [r for r in records if (r["joints"], r["precision"]) == (joints, precision)]
            for name in dict.fromkeys(r["contender"] for r in sorted(rows, key=lambda r: r["ns_per_sample"])):
                cells = []
                for t in threads:
                    found = [r for r in rows if r["contender"] == name and r["threads"] == t]
                    cells += [_cell(found[0]) if found else ""]
                table.add_row(str(joints), precision, name, *cells)
            table.add_section()
    share = Table(title="Against NumPy's matrix product [GFLOP/s]")
    for title in ("joints", "precision", "threads", "flops/sample", "product", "roof", "eiwa"):
        share.add_column(title, justify="right")
    for p in products:
        counts = (str(p["joints"]), p["precision"], str(p["threads"]), str(p["flops_per_sample"]))
        speeds = (f"{p[f'{name}_gflops']:.0f} ({p[f'{name}_share']:.0%})" for name in ("roof", "eiwa"))
        share.add_row(*counts, f"{p['gemm_gflops']:.0f}", *speeds)
    console = Console(width=None if sys.stdout.isatty() else 110)
    console.print(table, share)
    for t in threads:
        busy = next(r["others_busy"] for r in records if r["threads"] == t)
        console.print(f"others, {t} thread{'s' * (t > 1)}: {busy:.2f} cores busy")


def _cell(record: dict[str, Any]) -> str:
    digits = 1 if record["ns_per_sample"] < 200 else 0
    a, b, c = (f"{record[k]:.{digits}f}" for k in ("ns_per_sample", "least", "most"))
    ratio = record["ratio_to_roof"]
    return f"{a} ({b} - {c}) {ratio:6.{2 if ratio < 100 else 0}f}"


def write(path: Path, records: list[dict[str, Any]], products: list[dict[str, Any]]) -> None:
    """JSON with both lists, or Parquet with the contenders' records and the rest in the schema's metadata."""
    if path.suffix == ".parquet":
        import pyarrow
        import pyarrow.parquet

        table = pyarrow.Table.from_pylist(records)
        pyarrow.parquet.write_table(table.replace_schema_metadata({"product": json.dumps(products)}), path)
    else:
        path.write_text(json.dumps({"contenders": records, "product": products}, indent=1) + "\n")


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--samples", type=int, default=1 << 20, help="per call of the fast contenders")
    parser.add_argument("--repeats", type=int, default=9, help="visits of every contender")
    parser.add_argument("--patience", type=float, default=0.0, help="seconds to wait for other processes, per visit")
    parser.add_argument("--out", type=Path, help="a .json or .parquet file")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        records, products = measure(arguments, Path(folder))
    show(records, products)
    if arguments.out:
        write(arguments.out, records, products)


if __name__ == "__main__":
    main()
