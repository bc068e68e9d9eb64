"""How eiwa compiles: numba options that let LLVM vectorise, and the few operations that numba lacks.

``fastmath`` leaves out ``reassoc``, so that sums keep their written order and results do not depend on the
vector width; ``error_model="numpy"`` removes the branch that a checked division costs. 512-bit vectors are
preferred where the processor has them, which must be said before numba compiles anything.
"""

from __future__ import annotations

import fcntl
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, TypeVar

import numba
from llvmlite import binding, ir
from numba import carray, types
from numba.core.cgutils import get_or_insert_function
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

F = TypeVar("F", bound=Callable[..., Any])

LANES = 16
"""Entries that :func:`compress` handles at once."""
FASTMATH = {"contract", "nsz", "arcp", "nnan", "ninf"}


def cpu() -> tuple[str, str]:
    """Name and feature string of the processor that code is compiled for."""
    features = binding.get_host_cpu_features().flatten()
    if "+avx512f" in features and "-prefer-256-bit" not in features:
        features += ",-prefer-256-bit"
    return binding.get_host_cpu_name(), features


numba.config.CPU_NAME, numba.config.CPU_FEATURES = cpu()


def compiled(function: F) -> F:
    """Compile without the GIL and cache on disk."""
    options = {"nogil": True, "cache": True, "fastmath": FASTMATH, "error_model": "numpy"}
    decorated: Any = numba.njit(**options)(function)
    _share(decorated._cache)
    compile_for = decorated.compile

    def undisturbed(signature: Any) -> Any:
        with _ctrl_c_waits():
            return compile_for(signature)

    decorated.compile = undisturbed
    return decorated  # type: ignore[no-any-return]


class _Held:
    """A handler that holds back the first Ctrl-C."""

    def __init__(self, before: Callable[..., Any]) -> None:
        self.before, self.came = before, False

    def __call__(self, number: int, frame: Any) -> None:
        if self.came:
            self.before(number, frame)
        self.came = True


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Hear a first Ctrl-C afterwards: a callback of numba's compiler would swallow it and leave an error of another kind."""
    before = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if not (main and callable(before)) or isinstance(before, _Held):
        yield
        return
    held = _Held(before)
    signal.signal(signal.SIGINT, held)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if held.came:
            before(signal.SIGINT, None)


def _share(cache: Any) -> None:
    """Let processes use numba's cache at the same time, and nobody depend on it.

    numba puts a file's name into its index before it writes the file, and two processes may choose the same name: one
    at a time, they do not. What cannot be read, as after a power loss, is compiled again; what cannot be written, as on
    a full disk, is not kept.
    """
    load, save = cache.load_overload, cache.save_overload

    def read(*signature: Any) -> Any:
        with _turn(cache.cache_path):
            try:
                return load(*signature)
            # Unpickling what is left of a file can raise anything.
            except Exception:
                with suppress(OSError):
                    cache.flush()
                return None

    def write(*overload: Any) -> None:
        with _turn(cache.cache_path), suppress(OSError):
            save(*overload)

    cache.load_overload, cache.save_overload = read, write


_in_turn: set[str] = set()


@contextmanager
def _turn(folder: str) -> Iterator[None]:
    """Be the only process that uses a folder of compiled code, where it can be written at all; may be nested."""
    with ExitStack() as stack:
        if folder not in _in_turn:
            with suppress(OSError):
                os.makedirs(folder, exist_ok=True)
                lock = stack.enter_context(open(os.path.join(folder, "lock"), "a"))
                fcntl.flock(lock, fcntl.LOCK_EX)
                stack.callback(fcntl.flock, lock, fcntl.LOCK_UN)  # also where a fork has the file open too
                _in_turn.add(folder)
                stack.callback(_in_turn.discard, folder)
        yield


@intrinsic  # type: ignore[untyped-decorator]
def select(typing: Any, condition: Any, a: Any, b: Any) -> Any:
    """``a if condition else b`` without a branch."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(*args)

    return a(types.boolean, a, a), build


@intrinsic  # type: ignore[untyped-decorator]
def floor(typing: Any, x: Any) -> Any:
    """Largest integer not above x, kept a float."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = args[0].type
        return builder.call(builder.module.declare_intrinsic("llvm.floor", [kind]), args)

    return x(x), build


@intrinsic  # type: ignore[untyped-decorator]
def flip(typing: Any, x: Any, shifted: Any) -> Any:
    """x with its sign flipped where the lowest bit of ``shifted``'s representation is set."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bits = 64 if args[0].type == ir.DoubleType() else 32
        word = ir.IntType(bits)
        sign = builder.shl(builder.bitcast(args[1], word), word(bits - 1))
        return builder.bitcast(builder.xor(builder.bitcast(args[0], word), sign), args[0].type)

    return x(x, x), build


@intrinsic  # type: ignore[untyped-decorator]
def power(typing: Any, shifted: Any) -> Any:
    """2^n for the small integer n in the lowest bits of ``shifted``'s representation."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bits, fraction = (64, 52) if args[0].type == ir.DoubleType() else (32, 23)
        word = ir.IntType(bits)
        bias = word((1 << (bits - fraction - 2)) - 1 << fraction)
        exponent = builder.shl(builder.bitcast(args[0], word), word(fraction))
        return builder.bitcast(builder.add(exponent, bias), args[0].type)

    return shifted(shifted), build


@intrinsic  # type: ignore[untyped-decorator]
def float64_from_bits(typing: Any, bits: Any) -> Any:
    """The double with these 64 bits."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.uint64), build


@intrinsic  # type: ignore[untyped-decorator]
def float32_from_bits(typing: Any, bits: Any) -> Any:
    """The single with the low 32 of these 64 bits."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(builder.trunc(args[0], ir.IntType(32)), ir.FloatType())

    return types.float32(types.uint64), build


@intrinsic  # type: ignore[untyped-decorator]
def compress(typing: Any, cells: Any, picks: Any, start: Any, count: Any, offset: Any) -> Any:
    """Move those of 16 int32 ``cells`` from ``start`` on that are not negative to ``count``, ``offset`` added.

    Their numbers go into ``picks``. Returns the new count; the 16 entries behind the old one are overwritten.
    """

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        i32 = ir.IntType(32)
        lanes, mask_type = ir.VectorType(i32, LANES), ir.VectorType(ir.IntType(1), LANES)
        zeros = ir.Constant(lanes, [0] * LANES)
        arrays = [make_array(kind)(context, builder, a) for kind, a in zip(signature.args[:2], args[:2], strict=True)]
        _, _, first, total, shift = args

        def splat(x: Any) -> Any:
            one = builder.insert_element(ir.Constant(lanes, ir.Undefined), builder.trunc(x, i32), i32(0))
            return builder.shuffle_vector(one, ir.Constant(lanes, ir.Undefined), zeros)

        def at(array: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(array.data, [index]), lanes.as_pointer())

        block = builder.load(at(arrays[0], first), align=4)
        mask = builder.icmp_signed(">=", block, zeros)
        numbers = builder.add(ir.Constant(lanes, list(range(LANES))), splat(first))
        operation = ir.FunctionType(lanes, [lanes, mask_type, lanes])
        chosen = get_or_insert_function(builder.module, operation, f"llvm.experimental.vector.compress.v{LANES}i32")
        for array, values in zip(arrays, (builder.add(block, splat(shift)), numbers), strict=True):
            builder.store(builder.call(chosen, [values, mask, zeros]), at(array, total), align=4)
        return builder.add(total, builder.zext(builder.ctpop(builder.bitcast(mask, ir.IntType(16))), total.type))

    return types.int64(cells, picks, types.int64, types.int64, types.int64), build


@intrinsic  # type: ignore[untyped-decorator]
def entries_at(typing: Any, address: Any, like: Any) -> Any:
    """A pointer to entries of the array's kind at an address."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

    return types.CPointer(like.dtype)(types.int64, like), build


@intrinsic  # type: ignore[untyped-decorator]
def transpose(typing: Any, source: Any, first: Any, pitch: Any, target: Any, start: Any, stride: Any) -> Any:
    """Write 2 adjacent entries of 4 samples, ``pitch`` entries apart, into 2 rows, ``stride`` entries apart."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        read, write = (make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 3))
        _, at, pitch, _, to, stride = args
        kind = read.type.pointee

        def vector(pointer: Any, index: Any, size: int) -> Any:
            return builder.bitcast(builder.gep(pointer, [index]), ir.VectorType(kind, size).as_pointer())

        def shuffled(a: Any, b: Any, picks: Sequence[int]) -> Any:
            return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), 4), picks))

        align, pairs = context.get_abi_sizeof(kind), []
        for _ in range(4):
            pairs.append(builder.load(vector(read, at, 2), align=align))
            at = builder.add(at, pitch)
        # In this order the rows come of the halves' interleaving, one instruction each.
        even, odd = (shuffled(pairs[k], pairs[k + 2], (0, 1, 2, 3)) for k in (0, 1))
        for picks in ((0, 4, 2, 6), (1, 5, 3, 7)):
            builder.store(shuffled(even, odd, picks), vector(write, to, 4), align=align)
            to = builder.add(to, stride)
        return context.get_dummy_value()

    return types.void(source, types.int64, types.int64, target, types.int64, types.int64), build


@compiled
def fetch(layouts: Any, first: Any, n: Any, w: Any, start: Any, stride: Any) -> None:
    """Read n samples of arrays from ``first`` on into rows of ``w``, ``stride`` entries apart, at ``start``.

    ``layouts``: each array's address, columns, distances of samples and of columns (one of them 1), and first row.
    """
    for layout in layouts:
        array, rows = carray(entries_at(layout[0], w), (1 << 48,)), w[start + layout[4] * stride :]
        width, pitch, step = layout[1], layout[2], layout[3]
        whole = n - n % 4 if pitch != 1 and width > 1 else 0
        for s in range(0, whole, 4):
            for j in range(0, width, 2):
                k = min(j, width - 2)
                transpose(array, (first + s) * pitch + k, pitch, rows, k * stride + s, stride)
        for j in range(width):
            row, column = rows[j * stride :], array[j * step + first * pitch :]
            if pitch == 1:
                for s in range(n):
                    row[s] = column[s]
            else:
                for s in range(whole, n):
                    row[s] = column[s * pitch]


@compiled
def hand_out(w: Any, stride: Any, n: Any, rows: Any, start: Any) -> None:
    """Copy n samples of the rows of ``w`` into ``rows``, from ``start`` on."""
    for k in range(rows.shape[0]):
        row, copy = w[k * stride :], rows[k, start:]
        for s in range(n):
            copy[s] = row[s]
