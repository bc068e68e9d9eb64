"""How eiwa compiles: numba options that let LLVM vectorise, and the few operations that numba lacks.

``fastmath`` leaves out ``reassoc``, so that sums keep their written order and results do not depend on the
vector width; ``error_model="numpy"`` removes the branch that a checked division costs. 512-bit vectors are
preferred where the processor has them, which must be said before numba compiles anything.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from llvmlite import binding, ir
from numba import types
from numba.extending import intrinsic

F = TypeVar("F", bound=Callable[..., Any])

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
    decorated: F = numba.njit(**options)(function)
    return decorated


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
