"""Visits in turn, so that all see the same drift of the machine; their medians, spreads and ratios as one table."""

from __future__ import annotations

import itertools
import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from eiwa.core.compiled import cpu
from eiwa.core.version import __version__

CALLS, ENOUGH, WARM = 5, 0.1, 0.05
"""A visit reports the median of so many calls, of fewer when they have taken ``ENOUGH`` seconds, after others that took
``WARM`` seconds: until then a system may leave threads that have slept on one processor."""
PACKAGES = ("numpy", "numba", "llvmlite", "pin", "jax", "torch", "pytorch_kinematics", "roboticstoolbox-python")

keys = itertools.count(1 << 20)
"""Keys of streams that were not asked for before: eiwa keeps samples that are asked for again."""
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Record:
    """One line of the results.

    ``what``: compare, share or scaling; ``part``: flow (samples to voxels), rest (what eiwa adds to a plugin in
    NumPy), product (the flow's flops as a matrix product), a stage of a trial, or the setting that varies. ``seconds`` is the
    median over the visits, ``least`` the least, ``lower`` and ``upper`` the quartiles; each per ``unit``, a sample or a
    trial. ``ratio``, the median over visits too: to eiwa (compare), to a trial (share), to the
    case of the comparison (scaling). ``tip_error`` [m] and ``dexterity_error`` (of the largest): the largest difference
    from eiwa; one who does not ``agree`` is not timed. ``voxel`` in m; ``flops`` per sample, as roof.cpp counts them;
    ``others``: cores that other processes kept busy meanwhile.
    """

    what: str
    who: str
    part: str
    unit: str
    joints: int
    precision: str
    threads: int
    samples: int
    voxel: float
    visits: int = 0
    seconds: float | None = None
    least: float | None = None
    lower: float | None = None
    upper: float | None = None
    ratio: float | None = None
    agrees: bool | None = None
    tip_error: float | None = None
    dexterity_error: float | None = None
    flops: int | None = None
    others: float | None = None


@dataclass(frozen=True, eq=False)
class Contender:
    """Something to visit again and again: ``visit()`` gives seconds per sample; ``base`` is whom its ratio is to."""

    record: Record
    visit: Callable[[], float]
    base: Contender | None = None


def visit(call: Callable[[int], Any], samples: int) -> Callable[[], float]:
    """A visit: seconds per sample of a few calls after short ones that warm up."""

    def timed() -> float:
        warm = time.perf_counter() + WARM
        call(max(1, samples // 16))
        while time.perf_counter() < warm:
            call(samples)
        times: list[float] = []
        while len(times) < CALLS and sum(times) < ENOUGH:
            start = time.perf_counter()
            call(samples)
            times.append(time.perf_counter() - start)
        return statistics.median(times) / samples

    return timed


def interleaved(contenders: Sequence[Contender], seconds: float, tell: Tell) -> list[Record]:
    """Visit all in turn, again and again until ``seconds`` have passed, at least once; who is wrong is not visited."""
    wrong = [c.record for c in contenders if c.record.agrees is False]
    contenders = [c for c in contenders if c.record.agrees is not False]
    times: dict[Contender, list[float]] = {c: [] for c in contenders}
    load: list[float] = []
    end = time.perf_counter() + seconds
    while not load or time.perf_counter() < end:
        with others(load):
            for contender in contenders:
                tell(f"visit {len(load) + 1}: {contender.record.who}")
                with cores(contender.record.threads):
                    times[contender].append(contender.visit())
    return [_summed_up(c, times, statistics.median(load)) for c in contenders] + wrong


def _summed_up(contender: Contender, times: dict[Contender, list[float]], load: float) -> Record:
    mine = times[contender]
    lower, middle, upper = (float(q) for q in np.quantile(mine, (0.25, 0.5, 0.75)))
    base = contender.base and times[contender.base]
    ratio = statistics.median(a / b for a, b in zip(mine, base, strict=True)) if base else 1.0
    found = {"visits": len(mine), "seconds": middle, "least": min(mine), "lower": lower, "upper": upper}
    return Record(**{**asdict(contender.record), **found, "ratio": ratio, "others": None if load < 0 else load})


@contextmanager
def cores(count: int) -> Iterator[None]:
    """Let eiwa use so many threads and, on Linux, hold all threads of this process to as many processors."""
    wanted, allowed = os.environ.get("EIWA_THREADS"), _allowed()
    os.environ["EIWA_THREADS"] = str(count)
    _hold(sorted(allowed)[:count])
    try:
        yield
    finally:
        _hold(allowed)
        del os.environ["EIWA_THREADS"]
        if wanted is not None:
            os.environ["EIWA_THREADS"] = wanted


def _allowed() -> list[int]:
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def _hold(processors: Sequence[int]) -> None:
    """Threads that libraries have started (JAX, OpenMP) do not ask how many threads eiwa may use."""
    if processors and processors != _allowed():
        for thread in os.listdir("/proc/self/task"):
            with suppress(ProcessLookupError):
                os.sched_setaffinity(int(thread), processors)


@contextmanager
def others(into: list[float]) -> Iterator[None]:
    """Append how many cores other processes kept busy meanwhile; -1 where the system does not tell."""
    before, own, start = _busy(), sum(os.times()[:4]), time.perf_counter()
    yield
    after, spent = _busy(), sum(os.times()[:4]) - own
    if before is None or after is None:
        into.append(-1.0)
    else:
        into.append(max(0.0, (after - before - spent) / (time.perf_counter() - start)))


def _busy() -> float | None:
    try:
        ticks = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    except OSError:
        return None
    return (sum(ticks) - ticks[3] - ticks[4]) / os.sysconf("SC_CLK_TCK")


def machine() -> dict[str, Any]:
    """Where and with what the records were made, as columns."""
    name, features = cpu()
    versions = {"eiwa": __version__, "python": platform.python_version()}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return {
        "started": datetime.now(UTC),
        "host": platform.node(),
        "cpu": name,
        "features": " ".join(f[1:] for f in features.split(",") if f.startswith("+")),
        "versions": json.dumps(versions),
    }


def write(records: Iterable[Record], where: dict[str, Any], path: Path) -> None:
    """One Parquet table: a row a record, with the machine's columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {"str": pa.string(), "int": pa.int64(), "float": pa.float64(), "bool": pa.bool_()}
    schema = [(f.name, kinds[str(f.type).split(" ")[0]]) for f in fields(Record)]
    schema += [(name, pa.timestamp("us", tz="UTC") if name == "started" else pa.string()) for name in where]
    table = pa.Table.from_pylist([{**asdict(r), **where} for r in records], schema=pa.schema(schema))
    pq.write_table(table, path, compression="zstd")


def read(path: Path) -> tuple[list[Record], dict[str, Any]]:
    """What :func:`write` wrote."""
    import pyarrow.parquet as pq

    rows = pq.read_table(path).to_pylist()
    names = [f.name for f in fields(Record)]
    return [Record(**{n: row[n] for n in names}) for row in rows], {k: v for k, v in rows[0].items() if k not in names}
