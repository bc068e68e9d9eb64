"""The package from outside: what it exports, how it is started, and how little it imports to print its help."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import eiwa
from eiwa.core.version import __version__
from tests.study import small

HEAVY = {"numba", "llvmlite", "optuna", "pyarrow", "scipy", "matplotlib", "pandas", "sqlalchemy", "lxml", "moocore"}


def test_what_the_package_exports():
    assert eiwa.__all__ == ["evaluate", "load", "run"]
    assert all(getattr(eiwa, name).__doc__ for name in eiwa.__all__)


def modules(code):
    """Top-level modules that a fresh interpreter has after some code."""
    line = f"{code}; import json, sys; print(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", line], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


@pytest.mark.parametrize("code", ["import eiwa", "import eiwa.cli"])
def test_imports_nothing_heavy(code):
    assert modules(code) & HEAVY == set()


def test_findings_come_without_the_search():
    """A study file is checked without Optuna and Parquet."""
    assert modules("import eiwa.core.spec") & {"optuna", "pyarrow", "matplotlib", "lxml"} == set()


@pytest.mark.parametrize("command", [["-m", "eiwa"], ["-c", "from eiwa.cli import main; main()"]], ids=" ".join)
def test_starts(command):
    done = subprocess.run([sys.executable, *command, "--version"], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == (f"eiwa {__version__}\n", "")


def test_the_installed_script():
    script = Path(sys.executable).with_name("eiwa")
    if not script.exists():
        pytest.skip("eiwa is not installed as a script")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"eiwa {__version__}\n"


def test_the_steps_as_functions(tmp_path):
    spec = eiwa.load(small.write(tmp_path), {"study.trials": 4})
    outcome = eiwa.evaluate(spec, spec.designs["optimum"].overrides, replicates=2)
    store = eiwa.run(spec, tmp_path / "runs")
    table = store.table()
    assert table.num_rows == 1 + 4 + min(3, sum(table.column("feasible").to_pylist()[1:5]))
    design = table.to_pylist()[0]
    assert {n: design[f"metrics.{n}"] for n in outcome.scenarios[""]} == outcome.scenarios[""]


def test_paths_may_be_strings(tmp_path):
    spec = eiwa.load(str(small.write(tmp_path)))
    assert eiwa.run(spec, str(tmp_path / "runs")).folder == tmp_path / "runs/small"


def test_a_run_prints_nothing(tmp_path, capfd):
    """Only the command line prints."""
    eiwa.run(eiwa.load(small.write(tmp_path)), tmp_path / "runs")
    assert capfd.readouterr() == ("", "")


LOST = """
import ctypes, signal, time
from eiwa.cli import ctrl_c_comes_again

signal.signal(signal.SIGINT, signal.default_int_handler)

@ctypes.CFUNCTYPE(None)
def callback():
    raise KeyboardInterrupt

try:
    with ctrl_c_comes_again():
        callback()
        print("it was lost")
        time.sleep(60)
except KeyboardInterrupt:
    print("it came again")
"""


def test_ctrl_c_is_not_lost_in_a_callback():
    """As one is in a destructor; the one that comes again ends a sleep."""
    done = subprocess.run([sys.executable, "-c", LOST], capture_output=True, text=True, check=True, timeout=50)
    assert (done.stdout, done.stderr) == ("it was lost\nit came again\n", "")
