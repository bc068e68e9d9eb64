"""Build and run the C++ programs that the sampler is compared with: a Pinocchio loop and the roof.

`python benchmarks/build.py` compiles `pinocchio_loop.cpp` into a temporary folder against the headers of the
`pin` wheel of the running Python, runs it on 1 and 2 threads and prints one JSON object per line; its times
are wall time in ns per sample and its checksum is the mean of w = sqrt(det(J J^T)) in m^3.
`roof.cpp` is eiwa's own algorithm by hand; it needs nothing but a compiler, its head says what it prints.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SOURCE = Path(__file__).resolve().with_name("pinocchio_loop.cpp")
ROOF_SOURCE = SOURCE.with_name("roof.cpp")
SYSTEM_EIGEN = (Path("/usr/include/eigen3"), Path("/usr/local/include/eigen3"))
UPPER_ARM_M = 0.26
FOREARM_M = 0.18
CHECKSUM_RTOL = 0.05
"""Relative tolerance of the mean of w: the 4096 random joint vectors give a standard error near 1 %."""

# The definitions that Pinocchio's own CMake target passes on to programs that include its headers.
PINOCCHIO_DEFINITIONS = (
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
)

# g++ 12 with AVX-512 warns wrongly, at length, about Eigen's copies of 6-vectors inside Pinocchio's headers.
QUIET = ("-Wno-stringop-overread",)

# g++ leaves instructions of a long loop body in the order of the source unless told: 3-8 % on the roof.
ROOF_FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-fschedule-insns", "-fsched-pressure")


class MissingDependencyError(RuntimeError):
    """Something that the build needs is not installed; the message says what to install."""


def find_pinocchio_include() -> Path:
    """Return the include folder of the `pin` wheel (Pinocchio and Boost headers) of this Python."""
    for entry in sys.path:
        include = Path(entry) / "cmeel.prefix" / "include"
        if (include / "pinocchio" / "config.hpp").is_file():
            return include
    raise MissingDependencyError(
        "Pinocchio's headers were not found: install the wheel with 'pip install pin' in this Python."
    )


def find_eigen_include(pinocchio_include: Path) -> Path:
    """Return the folder that holds `Eigen/Core`: the wheel's own where it has one, else the system's."""
    for include in (pinocchio_include / "eigen3", *SYSTEM_EIGEN):
        if (include / "Eigen" / "Core").is_file():
            return include
    raise MissingDependencyError("Eigen's headers were not found: install them with 'apt-get install libeigen3-dev'.")


def find_compiler() -> str:
    """Return the C++ compiler: `CXX` where it is set, else g++."""
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        raise MissingDependencyError("No C++ compiler was found: install one with 'apt-get install g++'.")
    return compiler


def compile_command(binary: Path) -> list[str]:
    """Return the command that compiles the loop to `binary`.

    Only headers of Pinocchio and Boost are used, so none of the wheel's libraries is linked.
    """
    include = find_pinocchio_include()
    eigen = find_eigen_include(include)
    flags = ["-std=c++17", "-O3", "-march=native", "-DNDEBUG", "-pthread", *PINOCCHIO_DEFINITIONS, *QUIET]
    headers = ["-isystem", str(include), "-isystem", str(eigen)]
    return [find_compiler(), *flags, *headers, str(SOURCE), "-o", str(binary)]


def build_pinocchio(out_dir: Path) -> Path:
    """Compile the loop into `out_dir` (made if missing; takes about a minute) and return the program."""
    out_dir.mkdir(parents=True, exist_ok=True)
    binary = out_dir / "pinocchio_loop"
    subprocess.run(compile_command(binary), check=True)
    return binary


def run_pinocchio(binary: Path, samples: int, threads: int, limit_deg: float = 120.0) -> dict[str, str | float]:
    """Run the loop and return its JSON object: times in ns per sample, checksum in m^3, limit in degrees."""
    words = [str(binary), str(samples), str(threads), repr(limit_deg)]
    printed = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    result: dict[str, str | float] = json.loads(printed)
    return result


def build_roof(out_dir: Path) -> Path:
    """Compile the roof into `out_dir` (made if missing; takes seconds) and return the program."""
    out_dir.mkdir(parents=True, exist_ok=True)
    binary = out_dir / "roof"
    flags = ["-std=c++17", *ROOF_FLAGS, "-pthread", "-Wno-maybe-uninitialized"]
    subprocess.run([find_compiler(), *flags, str(ROOF_SOURCE), "-o", str(binary)], check=True)
    return binary


def run_roof(
    binary: Path, samples: int, threads: int, joints: int, precision: str, key: int = 1
) -> dict[str, str | float]:
    """Run the roof and return its JSON object; `precision` is 'f64' or 'f32', `key` the stream's."""
    words = [str(binary), str(samples), str(threads), str(joints), precision, str(key)]
    printed = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    result: dict[str, str | float] = json.loads(printed)
    return result


def expected_mean(limit_deg: float) -> float:
    """Return the exact mean of w in m^3 for joint angles uniform in +-limit_deg (90 to 180 degrees).

    w = L1 L2 |cos q2| |sin q3| (L1 + L2 cos q3) |sin q5|; at 180 degrees the mean is 8 L1^2 L2 / pi^3.
    """
    t = math.radians(limit_deg)
    mean_cos = (2.0 - math.sin(t)) / t
    mean_sin = (1.0 - math.cos(t)) / t
    mean_elbow = UPPER_ARM_M * mean_sin + FOREARM_M * math.sin(t) ** 2 / (2.0 * t)
    return UPPER_ARM_M * FOREARM_M * mean_cos * mean_elbow * mean_sin


def check_checksum(result: dict[str, str | float]) -> None:
    """Raise where the mean of w in m^3 of a run is not the exact one within the sampling error."""
    exact = expected_mean(float(result["limit_deg"]))
    if not math.isclose(float(result["checksum"]), exact, rel_tol=CHECKSUM_RTOL):
        raise ValueError(f"mean of w is {result['checksum']} m^3, expected {exact:.6f} m^3")


def main(samples: int = 1_000_000) -> None:
    """Build in a temporary folder, run on 1 and 2 threads and print the JSON lines."""
    with tempfile.TemporaryDirectory() as folder:
        binary = build_pinocchio(Path(folder))
        for threads in (1, 2):
            result = run_pinocchio(binary, samples, threads)
            check_checksum(result)
            print(json.dumps(result), flush=True)


if __name__ == "__main__":
    try:
        main()
    except MissingDependencyError as error:
        sys.exit(str(error))
