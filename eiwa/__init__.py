"""eiwa: design-space exploration for master devices.

The Python interface is this module's functions; each has the command of the same name behind it::

    import eiwa
    spec = eiwa.load("studies/paper.toml")
    outcome = eiwa.evaluate(spec, spec.designs["optimum"].overrides, replicates=4)
    store = eiwa.run(spec, "runs")
    table = store.table()                  # a pyarrow table, as pandas and polars read it
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eiwa.core.outcome import Outcome
    from eiwa.core.spec import StudySpec
    from eiwa.study.store import Store

__all__ = ["evaluate", "load", "run"]


def load(path: str | Path, settings: Mapping[str, Any] | None = None) -> StudySpec:
    """Read and check a study file; ``settings`` puts other values at some paths first."""
    from eiwa.core import spec

    return spec.load(Path(path), settings)


def evaluate(spec: StudySpec, overrides: Mapping[str, Any] | None = None, replicates: int = 1) -> Outcome:
    """Evaluate one design under all scenarios of the study; ``replicates`` > 1 gives ``F_se``."""
    from eiwa.core import outcome

    return outcome.evaluate(spec, overrides or {}, replicates)


def run(spec: StudySpec, runs: str | Path = "runs") -> Store:
    """Run a study to its target, or continue it, and return its store."""
    from eiwa.study import run as study

    return study.run(spec, Path(runs))
