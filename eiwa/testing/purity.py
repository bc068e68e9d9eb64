"""Contracts of what must be a function of each sample alone: arms and dexterity indices."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eiwa.core.interfaces import Array
from eiwa.testing.contract import Violation

Arrays = Mapping[str, Array]
"""Arrays by name, one row a sample."""

ROUNDING = 1e-9
"""Relative difference that the order of additions explains, with room to spare."""
THREADS, ROUNDS = 4, 24


@dataclass(frozen=True)
class Asked:
    """A function of samples and the samples to ask it about.

    ``part``: what to call it in messages; ``answer``: from input arrays to output arrays, where an output ``valid``
    tells which rows count.
    """

    part: str
    answer: Callable[[Arrays], Arrays]
    inputs: Arrays

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(next(iter(self.inputs.values())))

    def __call__(self, rows: slice | NDArray[np.intp]) -> Arrays:
        """The answer about some samples, which are handed over as fresh copies."""
        return self.answer({name: np.array(array[rows]) for name, array in self.inputs.items()})


def copied(arrays: Arrays) -> Arrays:
    """Copies that nobody else holds."""
    return {name: np.array(array) for name, array in arrays.items()}


def difference(wanted: Arrays, seen: Arrays, tolerance: float) -> str:
    """Where two answers differ by more than the tolerance times their largest entry; empty where they do not."""
    valid = wanted.get("valid")
    if valid is not None and (wanted["valid"] != seen["valid"]).any():
        row = int(np.argmax(wanted["valid"] != seen["valid"]))
        return f"valid of sample {row} is {seen['valid'][row]}, not {wanted['valid'][row]}"
    for name, array in wanted.items():
        if name != "valid" and (problem := _unlike(name, array, seen[name], valid, tolerance)):
            return problem
    return ""


def _unlike(name: str, wanted: Array, seen: Array, valid: Array | None, tolerance: float) -> str:
    if wanted.shape != seen.shape:
        return f"{name} have shape {seen.shape}, not {wanted.shape}"
    kept = np.ones(len(wanted), bool) if valid is None else np.asarray(valid, bool)
    gap = np.where(kept.reshape(-1, *[1] * (wanted.ndim - 1)), np.abs(seen - wanted), 0.0)
    if gap.size == 0 or (gap <= tolerance * np.abs(wanted[kept]).max(initial=1e-300)).all():
        return ""
    where = tuple(int(i) for i in np.unravel_index(int(np.nan_to_num(gap, nan=np.inf).argmax()), gap.shape))
    entry = f"{list(where[1:])}" if len(where) > 1 else ""
    return f"{name}{entry} of sample {where[0]} is {seen[where]:.6g}, not {wanted[where]:.6g}"


def same_again(asked: Asked, rebuilt: Asked) -> str:
    """Asked twice, and built twice from the same parameters: the same bits."""
    everything = slice(None)
    first = copied(asked(everything))
    for who, other in ((f"the same {asked.part}", asked), (f"a second {asked.part} of the same parameters", rebuilt)):
        if problem := difference(first, other(everything), 0.0):
            cause = "random numbers, the clock, or something that a call leaves behind."
            raise Violation("the same answer to the same samples", f"{who}, asked again: {problem}", cause)
    return "bit by bit"


def no_memory(asked: Asked, rebuilt: Asked) -> str:
    """Asked about A, B and A again: B as a part answers that was asked nothing before, A as the first time."""
    half = asked.samples // 2
    a, b = slice(0, half), slice(half, 2 * half)
    answer = asked(a)
    kept, after = copied(answer), asked(b)
    if problem := difference(kept, answer, 0.0):
        cause = "the same array is filled and returned every time. Return a new one."
        raise Violation("arrays that are left alone once they are returned", f"after the next call {problem}", cause)
    for wanted, seen in ((rebuilt(b), after), (kept, asked(a))):
        if problem := difference(wanted, seen, 0.0):
            cause = (
                "something kept on self or in the module: a counter, the last posture, a cache that knows too little."
            )
            raise Violation("the same answer whatever was asked before", f"after another call {problem}", cause)
    return "nothing kept between calls"


def no_neighbours(asked: Asked) -> str:
    """The answer about a block is that of its parts, in any order."""
    whole = copied(asked(slice(None)))
    n = asked.samples
    order = np.random.default_rng(0).permutation(n)
    cuts = {
        "first sample alone": np.array([0]),
        "last 7 samples": np.arange(n - 7, n),
        "samples in another order": order,
    }
    exact = True
    for name, rows in {**cuts, "first third": np.arange(n // 3)}.items():
        part, wanted = asked(rows), {key: array[rows] for key, array in whole.items()}
        if problem := difference(wanted, part, ROUNDING):
            cause = "a mean, maximum or normalisation over the samples, or one sample's value used for all."
            raise Violation("answers that do not depend on the other samples of a block", f"{name}: {problem}", cause)
        exact = exact and not difference(wanted, part, 0.0)
    return "bit by bit" if exact else "up to rounding"


def input_intact(asked: Asked) -> str:
    """The arrays that are handed in are not written to."""
    inputs = copied(asked.inputs)
    asked.answer(inputs)
    for name, array in inputs.items():
        if not np.array_equal(array, asked.inputs[name]):
            cause = f"an operation in place ({name} *= ..., out={name}). Work on a copy."
            raise Violation(f"{name} as it was", f"{name} was changed by the call", cause)
    for array in inputs.values():
        array.setflags(write=False)
    try:
        asked.answer(inputs)
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise Violation("arrays that may be read-only", f"ValueError: {error}", "an operation in place.") from error
    return "read-only arrays will do"


def threads_agree(asked: Asked) -> str:
    """Several threads that ask about blocks of their own get what one thread gets."""
    blocks = np.array_split(np.arange(asked.samples), THREADS)
    alone = [copied(asked(rows)) for rows in blocks]

    def work(thread: int) -> str:
        problems = (difference(alone[thread], asked(blocks[thread]), 0.0) for _ in range(ROUNDS))
        return next((p for p in problems if p), "")

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(THREADS) as pool:
            problems = [p for p in pool.map(work, range(THREADS)) if p]
    finally:
        sys.setswitchinterval(interval)
    if problems:
        cause = "work arrays on self or in the module, which threads share. Make them in the call."
        raise Violation(f"{THREADS} threads that do not disturb each other", problems[0], cause)
    return f"{THREADS} threads"
