"""Quicker disks, and evaluations that cost nothing where only the bookkeeping is tested."""

import os

import pytest

from eiwa.core.interfaces import Operator
from eiwa.core.outcome import Outcome
from eiwa.study import rows
from eiwa.study.store import Store


@pytest.fixture(autouse=True)
def unflushed(monkeypatch):
    """No test here loses power: what is written need not reach the disk."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def instead(spec, overrides, replicates=1, *, parameters=None, named=False):
    """An outcome that follows from the overrides alone."""
    values = [float(value) for _, value in sorted(overrides.items()) if not isinstance(value, str)]
    F = sum((k + 1) * value for k, value in enumerate(values)) / 3
    numbers = {"F": F, "F_se": None, "F_drift": 0.0, "singletons": 0.0, "reach": sum(values[:2])}
    violations = spec.inequalities(overrides, parameters or {})
    for i, constraint in enumerate(spec.constraints):
        if constraint.metric:
            violations[i] = constraint.violation([numbers[constraint.metric]])
    objectives = [numbers[o.metric] if o.metric else None if named else 1.0 - F for o in spec.objectives]
    scenarios = {scenario.label: numbers for scenario in spec.scenarios}
    replicated = {"": {"F": [F] * replicates}} if replicates > 1 else {}
    operators = dict.fromkeys(scenarios, Operator())
    return Outcome(scenarios, objectives, violations, replicates, operators, replicated)


@pytest.fixture
def loose(monkeypatch):
    """Parts stay as they were written."""
    monkeypatch.setattr(Store, "compact", lambda store: None)


@pytest.fixture
def no_work(monkeypatch):
    """Evaluations cost nothing."""
    monkeypatch.setattr(rows, "evaluate", instead)
