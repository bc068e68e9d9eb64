"""A study that runs in a fraction of a second, as TOML text to change, and what two results must have in common."""

import json
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

from eiwa.core.spec import check
from eiwa.study.rows import VOLATILE
from eiwa.study.run import Run, Silent
from eiwa.study.store import Store

JOINTS = """joints = [
  { name = "waist", limits = [-120, 120] },
  { name = "shoulder", alpha = 90, limits = [-120, 120] },
  { name = "upper", alpha = -90, a = 0.26, limits = [-120, 120] },
  { name = "fore", a = 0.18, limits = [-120, 120] },
  { name = "pitch", alpha = -90, limits = [-120, 120] },
  { name = "roll", alpha = 90, limits = [-120, 120] },
]
"""

SEARCH = """[variables]
reach = { low = 0.20, high = 0.44 }
split = { low = 0.30, high = 0.80 }

[search]
"arm.joints.upper.a" = "reach * split"
"arm.joints.fore.a" = "reach * (1 - split)"
"layout.spacing" = { low = 0.20, high = 0.60 }

"""

OBJECTIVE = """[[objectives]]
metric = "F"
direction = "maximize"

"""

DESIGN = """[designs.optimum]
"arm.joints.upper.a" = 0.26
published = { F = 0.2732 }
"""

SMALL = f"""[study]
name = "small"
seed = 1
trials = 8
batch = 4

[arm]
kind = "dh"
convention = "modified"
{JOINTS}
[layout]
spacing = 0.20
offset = [0.0, 0.802, 0.10]
orientation = [0, 0, -90]

[human]
kind = "ehem"
samples = 4096

[dexterity]
kind = "yoshikawa"
K = 12270
threshold = 0.3

[voxels]
kind = "dense"
size = 0.05

[sampling]
samples = 4096
replicates = 2

{SEARCH}{OBJECTIVE}[[constraints]]
metric = "reach"
max = 0.40

{DESIGN}"""

TOP = "[study]"
"""What stands first: replace it to write keys before all tables."""

NO_SEARCH = {"trials = 8": "trials = 0", SEARCH: ""}
MISFIT = {OBJECTIVE: '[[objectives]]\ndirection = "minimize"\nover = "designs"\naggregate = "misfit"\n\n'}
SCENARIOS = '[scenarios]\n"dexterity.K" = [50, 12270]\n'

PAUSE = """
import math
import time
from pathlib import Path
from eiwa.core.hookspecs import Number, Parameters, Plugin, hookimpl
from eiwa.core.interfaces import Metric

HOLD = Path(__file__).with_name("hold")

class PauseParameters(Parameters):
    "Takes its time, and no end of it where a file beside it says after how many calls."
    seconds: float = 0.05

class Pause(Metric):
    calls = 0

    def __init__(self, seconds):
        self.seconds = seconds

    def __call__(self, measurement):
        time.sleep(self.seconds)
        Pause.calls += 1
        while Pause.calls > allowed():
            time.sleep(0.01)
        return {"pause": self.seconds}

def allowed():
    try:
        return int(HOLD.read_text())
    except FileNotFoundError:
        return math.inf

@hookimpl
def eiwa_metrics():
    numbers = (Number("pause", "s", "waiting"),)
    return [Plugin("pause", PauseParameters, lambda parameters: Pause(parameters.seconds), numbers)]
"""
"""A plugin file that makes evaluations slow enough to be interrupted: see :func:`hold`."""

BROKEN_ARM = """
from eiwa.core.hookspecs import Parameters, Plugin, hookimpl
from eiwa.core.interfaces import Arm

class BrokenParameters(Parameters):
    "An arm that cannot move."
    length: float = 0.3

class Broken(Arm):
    dof = 2
    limited = (True, True)
    def postures(self, u):
        raise RuntimeError("the elbow is stuck")

@hookimpl
def eiwa_arms():
    return [Plugin("broken", BrokenParameters, lambda parameters: Broken())]
"""


def text(changes=None, extra=""):
    """The study with some of its text replaced, each at its first occurrence, and more at its end."""
    result = SMALL
    for old, new in (changes or {}).items():
        assert old in result, old
        result = result.replace(old, new, 1)
    return result + extra


def tree(changes=None, extra=""):
    return tomllib.loads(text(changes, extra))


def spec(changes=None, extra="", path=Path("small.toml")):
    return check(tree(changes, extra), path)


def write(folder, changes=None, extra="", **files):
    """The study file in a folder, next to plugin files given as name=text."""
    for name, content in files.items():
        (folder / f"{name}.py").write_text(content)
    path = folder / "small.toml"
    path.write_text(text(changes, extra))
    return path


def broken_arm(folder):
    """A study of the arm that raises at every posture."""
    changes = {
        TOP: f'plugins = ["broken_arm.py"]\n{TOP}',
        'kind = "dh"\nconvention = "modified"\n' + JOINTS: 'kind = "broken"\n',
        SEARCH: '[search]\n"arm.length" = { low = 0.2, high = 0.4 }\n',
        DESIGN: "",
    }
    return write(folder, changes, broken_arm=BROKEN_ARM)


def paused(folder, trials, seconds=0.05, changes=None):
    """A study whose evaluations take their time."""
    all_changes = {TOP: f'plugins = ["pause.py"]\n{TOP}', "trials = 8": f"trials = {trials}", **(changes or {})}
    return write(folder, all_changes, f"[metrics.pause]\nseconds = {seconds}\n", pause=PAUSE)


def hold(folder, calls):
    """Every process that runs a paused study stands still after so many evaluations, until the file is deleted.

    What is done to it meanwhile finds it running, however late that is. Each replicate counts.
    """
    path = folder / "hold"
    path.write_text(str(calls))
    return path


def run(study, folder, listener=None):
    """Run a spec in a folder of runs; the store."""
    store = Store(Path(folder) / study.study.name)
    Run(study, store, listener or Silent()).execute()
    return store


def stable(rows, *kinds):
    """What must be equal in equal results, in an order that interruptions do not change."""
    kept = [{k: v for k, v in r.items() if k not in VOLATILE} for r in rows if not kinds or r["kind"] in kinds]
    return sorted(kept, key=lambda r: (r["kind"], str(r["name"]), -1 if r["number"] is None else r["number"]))


def results(store, *kinds):
    return stable(store.rows(), *kinds)


def parameters(store):
    """What the sampler chose, by trial number."""
    return {
        r["number"]: [v for k, v in sorted(r.items()) if k.startswith("parameters.")]
        for r in store.rows()
        if r["kind"] == "trial"
    }


def start(*arguments, folder, start_new_session=False, **environment):
    """``python -m eiwa ...`` in a folder; Ctrl-C reaches it even where the tests themselves run in the background."""
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "eiwa", *map(str, arguments)],
            cwd=folder,
            env=os.environ | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=start_new_session,
        )
    finally:
        signal.signal(signal.SIGINT, handler)


def eiwa(*arguments, folder, **environment):
    """The same, to its end: exit code, stdout, stderr."""
    process = start(*arguments, folder=folder, **environment)
    out, err = process.communicate(timeout=240)
    return process.returncode, out, err


def answer(*arguments, folder, **environment):
    """The JSON object of a command that succeeds."""
    code, out, err = eiwa(*arguments, "--json", folder=folder, **environment)
    assert code == 0, err
    return json.loads(out)
