"""From traced columns to compiled code.

A traced function becomes one straight-line loop body over a block of samples; all rows of the block lie in one
scratch array at constant offsets, so that LLVM vectorises without alias checks. The text is stored in a file named by
the hash of everything it depends on (its own text, the sources of what it imports, versions, processor), because
numba's disk cache neither serves closures nor notices a callee that changed in another file.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from eiwa.core import compiled as compiled_module
from eiwa.core.sampling import BLOCK
from eiwa.core.symbols import Column, Symbol, Tape, empty_rows, rows_of

log = logging.getLogger(__name__)

Traceable = Callable[[list[Column], list[Column]], Sequence[Column]]
"""A function of input columns and parameters (scalars of the design) to output columns."""

STRIDE = {np.dtype(np.float64): BLOCK + 8, np.dtype(np.float32): BLOCK + 16}
"""Distance of two rows: one cache line more than the block, so that rows do not share cache sets."""


def thread_count() -> int:
    """Threads to use: ``EIWA_THREADS``, else the processors this process may run on."""
    wanted = os.environ.get("EIWA_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="eiwa")


def on_all_threads(work: Callable[..., Any], *arguments: Sequence[Any]) -> list[Any]:
    """``list(map(work, *arguments))``, on the threads of :func:`thread_count`, of which the caller's is one.

    Whoever is free takes the next item, so that a thread that the system starts late holds nobody up.
    """
    items = list(zip(*arguments, strict=True))
    threads = 1 if threading.current_thread().name.startswith("eiwa") else min(thread_count(), len(items))
    results: list[Any] = [None] * len(items)
    numbers = iter(range(len(items)))

    def take() -> None:
        for number in numbers:
            results[number] = work(*items[number])

    others = [_pool(thread_count() - 1).submit(take) for _ in range(threads - 1)]
    try:
        take()
    finally:
        begun = [other for other in others if not other.cancel()]
        wait(begun)
    for other in begun:
        other.result()
    return results


_own = threading.local()


def scratch(rows: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """This thread's 64-byte aligned scratch of so many block rows, with whatever was left in it."""
    size = rows * STRIDE[dtype]
    kept, key = _own.__dict__, dtype.str
    if key not in kept or kept[key].size < size:
        raw = np.zeros(size * dtype.itemsize + 64, np.uint8)
        offset = -raw.ctypes.data % 64
        kept[key] = raw[offset : offset + size * dtype.itemsize].view(dtype)
    result: NDArray[Any] = kept[key][:size]
    return result


def trace_block(function: Traceable, inputs: int, parameters: int, dtype: np.dtype[Any]) -> tuple[str, int]:
    """Source of ``block(w, p)``, which reads input rows of ``w`` and writes output rows behind them.

    Returns the source and the number of outputs.
    """
    tape = Tape(single=dtype == np.float32)
    u: list[Column] = [tape.node("input", j) for j in range(inputs)]
    p: list[Column] = [tape.node("parameter", j) for j in range(parameters)]
    outputs = list(function(u, p))
    needed = tape.needed(o.index for o in outputs if isinstance(o, Symbol))
    stride = STRIDE[dtype]
    literal = "np.float32({!r})" if tape.single else "{!r}"
    before: list[str] = []
    body: list[str] = []
    for index in needed:
        operation, operands = tape.nodes[index]
        if operation == "constant":
            before.append(f"t{index} = {literal.format(operands[0])}")
        elif operation == "parameter":
            before.append(f"t{index} = {'np.float32' if tape.single else ''}(p[{operands[0]}])")
        elif operation == "input":
            body.append(f"t{index} = w[s + {operands[0] * stride}]")
        else:
            body.append(f"t{index} = {_TEMPLATES[operation].format(*(f't{o}' for o in operands))}")
    for k, output in enumerate(outputs):
        value = f"t{output.index}" if isinstance(output, Symbol) else literal.format(float(output))
        body.append(f"w[s + {(inputs + k) * stride}] = {value}")
    lines = ["@compiled", "def block(w, p):"]
    lines += [f"    {line}" for line in before]
    lines += [f"    for s in range({BLOCK}):"]
    lines += [f"        {line}" for line in body]
    return "\n".join(lines) + "\n", len(outputs)


_TEMPLATES = {
    "add": "{} + {}",
    "sub": "{} - {}",
    "mul": "{} * {}",
    "div": "{} / {}",
    "neg": "-{}",
    "sqrt": "math.sqrt({})",
    "floor": "floor({})",
    "abs": "abs({})",
    "lt": "{} < {}",
    "le": "{} <= {}",
    "and": "{} & {}",
    "select": "select({}, {}, {})",
    "flip": "flip({}, {})",
    "power": "power({})",
}

_HEADER = """# Written by eiwa; the file's name is the hash of all that this code depends on.
import math

import numpy as np

from eiwa.core.compiled import compiled, flip, floor, power, select
"""


def cache_folder() -> Path:
    """Where generated kernels live: ``EIWA_CACHE``, else the user's cache folder."""
    if "EIWA_CACHE" in os.environ:
        return Path(os.environ["EIWA_CACHE"])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "eiwa"


def load_source(text: str, components: Sequence[ModuleType] = ()) -> ModuleType:
    """Import generated source through the kernel cache.

    Parameters
    ----------
    text
        The source without the header.
    components
        Modules whose compiled functions the source imports; their content is part of the hash.
    """
    content = _HEADER + text
    sources = [Path(str(m.__file__)).read_text() for m in (compiled_module, *components)]
    versions = [numba.__version__, np.__version__, sys.version, *compiled_module.cpu()]
    digest = hashlib.sha256("\0".join([content, *sources, *versions]).encode()).hexdigest()[:24]
    return _load(f"eiwa_kernel_{digest}", content)


_modules: dict[str, ModuleType] = {}


def _load(name: str, content: str) -> ModuleType:
    if name not in _modules:
        path = _store(name, content)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        _modules[name] = module
    return _modules[name]


def _store(name: str, content: str) -> Path:
    """The file of that content, in the cache folder or, where that cannot be written, in a temporary one."""
    for folder in (
        cache_folder() / "kernels",
        Path(tempfile.gettempdir()) / f"eiwa-{os.getuid()}" / "kernels",
    ):
        path = folder / f"{name}.py"
        if path.exists() and path.read_text() == content:
            return path
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile("w", dir=folder, suffix=".tmp", delete=False) as file:
                file.write(content)
            os.replace(file.name, path)
        except OSError as error:
            log.info("kernel cache %s cannot be written (%s)", folder, error.strerror)
            continue
        return path
    raise OSError(f"no folder for compiled kernels can be written; set EIWA_CACHE (tried {folder})")


def compile_now(module: ModuleType, call: Callable[[], Any]) -> None:
    """Run ``call`` once, telling the log when that has to compile rather than to read the cache."""
    folder = Path(str(module.__file__)).parent / "__pycache__"
    cached = any(folder.glob(f"{module.__name__}.*.nbc"))
    start = time.perf_counter()
    if not cached:
        log.warning("compiling a kernel for this arm and index (once; a few seconds)")
    call()
    log.info("kernel %s ready in %.2f s", module.__name__, time.perf_counter() - start)


def _map_source(source: str, inputs: Sequence[int], outputs: Sequence[int], stride: int, by_rows: bool) -> str:
    """Source of ``run``, which takes samples ``begin ... end - 1`` from input to output arrays through ``block``.

    Outputs are handed over with a column per row; inputs too, unless a sample per row (``by_rows``).
    """
    x, y = ([f"{name}{k}" for k in range(len(widths))] for name, widths in (("x", inputs), ("y", outputs)))
    lines = ["", "@compiled", f"def run(begin, end, p, w, {', '.join((*x, *y))}):"]
    lines += [f"    {name} = {name}[begin:end]" for name in x if by_rows]
    lines += [f"    for start in range(0, end - begin, {BLOCK}):", f"        count = min({BLOCK}, end - begin - start)"]
    lines += ["        first = np.uint64(begin + start)"]  # unsigned: no look for places counted from the end
    loop = "        for s in range(count):"
    row, read, written = 0, [loop, "            pass"] if by_rows else [], []
    for name, width in zip((*x, *y), (*inputs, *outputs), strict=True):
        for j in range(width):
            here, sample = f"w[{row * stride} + s]", "first + np.uint64(s)"
            if name in y:
                written += [loop, f"            {name}[{j}, {sample}] = {here}"]
            elif f"w[s + {row * stride}]\n" in source:
                there = f"{name}[start + s, {j}]" if by_rows else f"{name}[{j}, {sample}]"
                read += [] if by_rows else [loop]
                read += [f"            {here} = {there}"]
            row += 1
    return "\n".join([*lines, *read, "        block(w, p)", *written, ""])


class Map:
    """A traced function compiled for arrays: (n, inputs) -> (n, outputs), outputs with contiguous columns.

    Inputs cost least with contiguous columns too, or, ``by_rows``, with contiguous rows.

    ``inputs`` and ``outputs`` may be several widths: the columns are then read from and written into as many arrays.
    ``extra`` is source that may call ``block`` too (a flow); it is compiled into the same module.
    """

    CHUNK = 1 << 14

    def __init__(
        self,
        function: Traceable,
        inputs: int | Sequence[int],
        parameters: int,
        dtype: Any = np.float64,
        extra: str = "",
        components: Sequence[ModuleType] = (),
        outputs: Sequence[int] = (),
        by_rows: bool = False,
    ) -> None:
        self.dtype, self.by_rows = np.dtype(dtype), by_rows
        widths = [inputs] if isinstance(inputs, int) else list(inputs)
        source, columns = trace_block(function, sum(widths), parameters, self.dtype)
        self.outputs = list(outputs) or [columns]
        rows = [f"w[s + {row * STRIDE[self.dtype]}]\n" in source for row in range(sum(widths))]
        self.read = [any(rows[sum(widths[:k]) :][:width]) for k, width in enumerate(widths)]
        run = _map_source(source, widths, self.outputs, STRIDE[self.dtype], by_rows)
        self.module = load_source(source + run + extra, components)
        self.rows = sum(widths) + columns
        empty = [np.zeros((1, width), self.dtype) for width in widths]
        compile_now(self.module, lambda: self.parts(*empty, np.zeros(parameters)))

    def __call__(self, *arguments: NDArray[Any]) -> NDArray[Any]:
        """Evaluate every row of the input arrays with the parameters, which come last, on all threads."""
        (out,) = self.parts(*arguments)
        return out

    def parts(self, *arguments: NDArray[Any]) -> list[NDArray[Any]]:
        """The same for several output arrays."""
        *inputs, parameters = arguments
        n = len(inputs[0])
        x = [np.asarray(a if read else a[:0], self.dtype) for a, read in zip(inputs, self.read, strict=True)]
        y = [empty_rows(n, width, self.dtype) for width in self.outputs]
        arrays = [*map(np.ascontiguousarray if self.by_rows else rows_of, x), *y]

        def work(start: int) -> None:
            w = scratch(self.rows, self.dtype)
            self.module.run(start, min(start + self.CHUNK, n), parameters, w, *arrays)

        on_all_threads(work, range(0, n, self.CHUNK))
        return [rows[:, :n].T for rows in y]
