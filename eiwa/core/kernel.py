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
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from eiwa.core import compiled as compiled_module
from eiwa.core.sampling import BLOCK
from eiwa.core.symbols import Column, Symbol, Tape, empty_rows, stride

log = logging.getLogger(__name__)

Traceable = Callable[[list[Column], list[Column]], Sequence[Column]]
"""A function of input columns and parameters (scalars of the design) to output columns."""


PART = 1 << 13
"""Samples of a map that a thread takes at once."""


def aligned(size: int, dtype: Any) -> NDArray[Any]:
    """A new array that starts at a cache line, with whatever was left in it; shape (size,)."""
    dtype = np.dtype(dtype)
    raw = np.empty(size * dtype.itemsize + 64, np.uint8)
    offset = -raw.__array_interface__["data"][0] % 64
    return raw[offset : offset + size * dtype.itemsize].view(dtype)


def thread_count() -> int:
    """Threads to use: ``EIWA_THREADS``, else the processors this process may run on."""
    wanted = os.environ.get("EIWA_THREADS", "")
    if wanted.isdecimal() and int(wanted) > 0:
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
    if len(items) == 1 or threading.current_thread().name.startswith("eiwa") or (threads := thread_count()) == 1:
        return [work(*item) for item in items]
    threads = min(threads, len(items))
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


def scratch(size: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """The same, but this thread's own, again and again."""
    kept, key = _own.__dict__, dtype.str
    if key not in kept or kept[key].size < size:
        kept[key] = aligned(size, dtype)
    result: NDArray[Any] = kept[key][:size]
    return result


def trace_block(
    function: Traceable, inputs: int, parameters: int, dtype: np.dtype[Any], samples: int = BLOCK
) -> tuple[str, int]:
    """Source of ``block(w, p)``, which reads input rows of ``w`` and writes output rows behind them.

    The rows of ``w`` have room for ``samples``. Returns the source and the number of outputs.
    """
    tape = Tape(single=dtype == np.float32)
    u: list[Column] = [tape.node("input", j) for j in range(inputs)]
    p: list[Column] = [tape.node("parameter", j) for j in range(parameters)]
    outputs = list(function(u, p))
    needed = tape.needed(o.index for o in outputs if isinstance(o, Symbol))
    step = stride(samples, dtype)
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
            body.append(f"t{index} = w[s + {operands[0] * step}]")
        else:
            body.append(f"t{index} = {_TEMPLATES[operation].format(*(f't{o}' for o in operands))}")
    for k, output in enumerate(outputs):
        value = f"t{output.index}" if isinstance(output, Symbol) else literal.format(float(output))
        body.append(f"w[s + {(inputs + k) * step}] = {value}")
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

from eiwa.core.compiled import compiled, fetch, flip, floor, hand_out, power, select
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


def tell_of_compiling(module: ModuleType) -> None:
    """Tell the log when the first call will have to compile rather than to read the cache."""
    folder = Path(str(module.__file__)).parent / "__pycache__"
    if not any(folder.glob(f"{module.__name__}.*.nbc")):
        log.warning("compiling a kernel for this arm and index (once; a few seconds)")


_RUN = """

@compiled
def run(w, p, inputs, y, first, last):
    for start in range(first, last, {samples}):
        n = min({samples}, last - start)
        for s in range(0, n, {block}):
            fetch(inputs, start + s, min({block}, n - s), w, s, {stride})
            block(w[s:], p)
        hand_out(w[{rows} * {stride} :], {stride}, n, y, start)
"""


class Map:
    """A traced function compiled for arrays: (n, inputs) -> (n, outputs), outputs with contiguous columns.

    ``inputs`` and ``outputs`` may be several widths: the columns are then read from and written into as many arrays.
    Up to ``samples`` at once are computed where they are handed out; of more, the results are copied together.
    With ``extra``, source that calls ``block`` (a flow, on blocks of its own), that is compiled instead, when it is called.
    """

    def __init__(
        self,
        function: Traceable,
        inputs: int | Sequence[int],
        parameters: int,
        dtype: Any = np.float64,
        extra: str = "",
        components: Sequence[ModuleType] = (),
        outputs: Sequence[int] = (),
        samples: int = BLOCK,
    ) -> None:
        self.dtype, self.samples = np.dtype(dtype), BLOCK if extra else samples
        widths = [inputs] if isinstance(inputs, int) else list(inputs)
        source, columns = trace_block(function, sum(widths), parameters, self.dtype, self.samples)
        ends = np.cumsum([0, *widths, *(outputs or [columns])]).tolist()
        rows = [slice(*pair) for pair in pairwise(ends)]
        self.inputs, self.outputs, step = widths, rows[len(widths) :], stride(self.samples, dtype)
        self.shape: tuple[int, int] = (ends[-1], step)
        self.read = [
            (k, part.start)
            for k, part in enumerate(rows[: len(widths)])
            if any(f"w[s + {row * step}]\n" in source for row in range(part.start, part.stop))
        ]
        run = _RUN.format(samples=self.samples, block=BLOCK, stride=step, rows=sum(widths))
        self.module = load_source(source + (extra or run), components)
        tell_of_compiling(self.module)
        if not extra:
            self.parts(*(np.zeros((1, width), self.dtype) for width in widths), np.zeros(parameters))

    @property
    def size(self) -> int:
        """Entries of the array that ``block`` works in."""
        return self.shape[0] * self.shape[1]

    def __call__(self, *arguments: NDArray[Any]) -> NDArray[Any]:
        """Evaluate every row of the input arrays with the parameters, which come last, on all threads."""
        (out,) = self.parts(*arguments)
        return out

    def parts(self, *arguments: NDArray[Any]) -> list[NDArray[Any]]:
        """The same for several output arrays."""
        *inputs, parameters = arguments
        n, before = len(inputs[0]), self.outputs[0].start
        _kept, table = self.layouts(inputs)
        if n <= self.samples:
            w = aligned(self.size, self.dtype)
            self.module.run(w, parameters, table, np.empty((0, 0), self.dtype), 0, n)
            return [w.reshape(self.shape)[rows, :n].T for rows in self.outputs]
        y = empty_rows(n, self.shape[0] - before, self.dtype)

        def work(start: int) -> None:
            w = scratch(self.size, self.dtype)
            self.module.run(w, parameters, table, y, start, min(start + PART, n))

        on_all_threads(work, range(0, n, PART))
        return [y[rows.start - before : rows.stop - before, :n].T for rows in self.outputs]

    def layouts(self, inputs: Sequence[NDArray[Any]]) -> tuple[list[NDArray[Any]], NDArray[np.int64]]:
        """The arrays to read, and where :func:`~eiwa.core.compiled.fetch` finds them as long as they are kept."""
        n = len(inputs[0])
        if (shapes := [np.shape(array) for array in inputs]) != [(n, width) for width in self.inputs]:
            raise ValueError(f"arrays of {n} rows must have {self.inputs} columns, not the shapes {shapes}")
        read = [_readable(inputs[k], self.dtype) for k, _ in self.read]
        found = [_layout(array, row) for array, (_, row) in zip(read, self.read, strict=True)]
        return read, np.array(found, np.int64).reshape(len(read), 5)


def _readable(array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The array, or a copy that :func:`~eiwa.core.compiled.fetch` can read."""
    (pitch, step), size = array.strides, dtype.itemsize
    adjacent = size in (pitch, step) and min(pitch, step) >= 0 and pitch % size == step % size == 0
    return array if adjacent and array.dtype == dtype and array.flags.aligned else np.ascontiguousarray(array, dtype)


def _layout(array: NDArray[Any], row: int) -> tuple[int, int, int, int, int]:
    """What :func:`~eiwa.core.compiled.fetch` needs to know of it, to read it into rows from ``row`` on."""
    pitch, step = array.strides
    address: int = array.__array_interface__["data"][0]
    return address, array.shape[1], pitch // array.itemsize, step // array.itemsize, row
