"""What a contract is: a function of a subject that says what it measured, or raises what it missed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eiwa.core.errors import line_in
from eiwa.testing.subject import Subject

Contract = Callable[[Subject], str]
"""Its name and the first line of its docstring say what is promised; it returns what it measured."""

State = Literal["passed", "failed", "not applicable", "not run"]


class Violation(AssertionError):
    """A contract is broken: what was expected, what was seen, and what usually causes it."""

    def __init__(self, expected: str, seen: str, cause: str = "") -> None:
        self.expected, self.seen, self.cause = expected, seen, cause
        parts = [f"expected: {expected}", f"seen: {seen}", *([f"usual cause: {cause}"] if cause else [])]
        super().__init__("\n".join(parts))


class NotApplicable(str):
    """Why a contract has nothing to look at."""


@dataclass(frozen=True)
class Result:
    """How one contract went: ``said`` is what it measured, or everything there is to know about its failure."""

    contract: str
    promise: str
    state: State
    said: str


def name_of(contract: Contract) -> str:
    """The contract's name in words."""
    return contract.__name__.replace("_", " ")


_NOT_RUN: tuple[State, str] = ("not run", "mend the above first")


def run(contracts: Sequence[Contract], basic: Sequence[Contract], subject: Subject) -> list[Result]:
    """Try contracts in order; after a failure of a basic one, the others would only repeat it and are not run."""
    results: list[Result] = []
    stopped = False
    for contract in contracts:
        state, said = _tried(contract, subject) if not stopped else _NOT_RUN
        results.append(Result(name_of(contract), (contract.__doc__ or "").split("\n")[0], state, said))
        stopped = stopped or (state == "failed" and contract in basic)
    return results


def _tried(contract: Contract, subject: Subject) -> tuple[State, str]:
    try:
        with np.errstate(all="ignore"):  # what is not finite is told by the contracts themselves
            said = contract(subject)
    except Violation as violation:
        return "failed", str(violation)
    # A plugin may raise anything; the report goes on with the next contract.
    except Exception as error:
        return "failed", f"expected: an answer\nseen: {type(error).__name__}: {error}{line_in(subject.file, error)}"
    return "not applicable" if isinstance(said, NotApplicable) else "passed", said
