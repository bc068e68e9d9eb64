"""Contract tests for authors of plugins: what eiwa expects of an arm, an index, a human model, a voxel backend, a metric.

``eiwa plugins check`` runs them from the command line; in a test suite::

    import pytest
    from eiwa import testing

    DEVICE = testing.subject("my_device.py", {"travel": [0.3, 0.2, 0.2]})

    @pytest.mark.parametrize("contract", testing.contracts(DEVICE.kind))
    def test_contract(contract):
        contract(DEVICE)

A contract is a function of a subject. It returns what it measured, or raises a :class:`Violation` that says what was
expected, what was seen, and what usually causes it. Nothing here needs pytest.
"""

from __future__ import annotations

from collections.abc import Sequence

from eiwa.testing import arms, dexterity, humans, metrics, voxels
from eiwa.testing.contract import Contract, NotApplicable, Result, Violation, name_of, run
from eiwa.testing.subject import Subject, subject

__all__ = ["Contract", "NotApplicable", "Result", "Subject", "Violation", "check", "contracts", "name_of", "subject"]

_KINDS = {"arm": arms, "dexterity": dexterity, "human": humans, "voxels": voxels, "metrics": metrics}


def contracts(kind: str) -> Sequence[Contract]:
    """Every contract of a kind of plugin: arm, dexterity, human, voxels, metrics."""
    found: Sequence[Contract] = _KINDS[kind].CONTRACTS
    return found


def check(subject: Subject) -> list[Result]:
    """Run every contract of the subject's kind; after one that all others build on, a failure ends the list."""
    module = _KINDS[subject.kind]
    return run(module.CONTRACTS, module.BASIC, subject)
