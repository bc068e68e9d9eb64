"""The C++ programs of benchmarks/: built where there is a compiler, kept in the cache folder, run."""

from __future__ import annotations

import ctypes
import hashlib
import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eiwa.bench.cases import Case, Missing, shipped
from eiwa.core.compiled import cpu
from eiwa.core.kernel import cache_folder

log = logging.getLogger(__name__)

COMMON = ("-std=c++17", "-O3", "-march=native", "-pthread")
# g++ leaves instructions of a long loop body in the order of the source unless told: 3-8 % on the roof.
ROOF = ("-ffast-math", "-fopenmp-simd", "-fschedule-insns", "-fsched-pressure", "-Wno-maybe-uninitialized")
# The definitions that Pinocchio's own CMake target passes on to programs that include its headers; g++ 12 with
# AVX-512 warns wrongly, at length, about Eigen's copies of 6-vectors inside them.
PINOCCHIO = (
    "-shared",
    "-fPIC",
    "-DNDEBUG",
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
    "-Wno-stringop-overread",
)


@lru_cache
def built(source: str, flags: Sequence[str]) -> Path:
    """The compiled program or library of a source.

    Raises
    ------
    Missing
        There is no compiler or no source, the compiler refuses it, or the cache folder cannot be written.
    """
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        raise Missing("no C++ compiler; install g++ or set CXX")
    path = shipped(source)
    content = "\0".join([path.read_text(), _run([compiler, "--version"]), *flags, *cpu()])
    program = cache_folder() / "native" / f"{path.stem}_{hashlib.sha256(content.encode()).hexdigest()[:24]}"
    if not program.exists():
        log.warning("compiling %s (once; up to a minute)", source)
        try:
            program.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=program.parent) as folder:
                out = Path(folder) / program.name
                _run([compiler, *flags, str(path), "-o", str(out)])
                out.replace(program)
        except OSError as error:
            raise Missing(f"{program.parent}: cannot be written: {error.strerror}; set EIWA_CACHE") from None
    return program


def _run(words: Sequence[str]) -> str:
    """What a program prints."""
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        reason = next(iter(done.stderr.strip().splitlines()), f"exit code {done.returncode}")
        raise Missing(f"{Path(words[0]).name} fails: {reason}")
    return done.stdout


def roof(samples: int, threads: int, joints: int, precision: str, key: int = 1) -> dict[str, Any]:
    """One run of the hand-written flow; roof.cpp tells what it prints."""
    program = built("roof.cpp", (*COMMON, *ROOF))
    result: dict[str, Any] = json.loads(_run([str(program), *map(str, (samples, threads, joints, precision, key))]))
    return result


def pinocchio(case: Case, dtype: Any) -> Any:
    """Pinocchio's kinematics and w in C++, called for blocks of samples."""
    library = ctypes.CDLL(str(built("pinocchio.cpp", (*COMMON, *PINOCCHIO, *_headers()))))
    library.arm_open.restype = ctypes.c_void_p
    arguments = [np.ascontiguousarray(a, np.float64) for a in (case.rows, case.lower, case.span)]
    handle = ctypes.c_void_p(library.arm_open(case.joints, *map(_pointer, arguments), ctypes.c_double(case.K)))

    def evaluate(points: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
        u = np.ascontiguousarray(points)
        tips, raw = np.empty((len(u), 3)), np.empty(len(u))
        library.arm_evaluate(handle, ctypes.c_long(len(u)), _pointer(u), _pointer(tips), _pointer(raw))
        return tips, raw

    return evaluate


def _pointer(array: NDArray[np.float64]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _headers() -> list[str]:
    """Include folders of the `pin` wheel and of Eigen; only headers are used, nothing is linked."""
    folders = (Path(entry) / "cmeel.prefix" / "include" for entry in sys.path)
    include = next((f for f in folders if (f / "pinocchio" / "config.hpp").is_file()), None)
    if include is None:
        raise Missing("Pinocchio's headers are not installed: pip install pin")
    places = (include / "eigen3", Path("/usr/include/eigen3"), Path("/usr/local/include/eigen3"))
    eigen = next((f for f in places if (f / "Eigen" / "Core").is_file()), None)
    if eigen is None:
        raise Missing("Eigen's headers are not installed: apt-get install libeigen3-dev")
    return ["-isystem", str(include), "-isystem", str(eigen)]


GEMM = """
import sys, time, numpy as np
kind, n = np.dtype(sys.argv[1]), 1024
a = np.random.default_rng(0).random((n, n)).astype(kind); b = a.T.copy(); c = a @ b
times = []
for _ in range(7):
    start = time.perf_counter(); np.matmul(a, b, out=c); times.append(time.perf_counter() - start)
print(2 * n**3 / sorted(times)[3])
"""


def gemm(dtype: Any, threads: int) -> float:
    """Flop/s of NumPy's matrix product, in a process of its own whose BLAS has that many threads."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
    environment = {**os.environ, **dict.fromkeys(names, str(threads))}
    words = [sys.executable, "-c", GEMM, np.dtype(dtype).str]
    return float(subprocess.run(words, env=environment, check=True, capture_output=True, text=True).stdout)
