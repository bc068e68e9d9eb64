"""What subjects are asked about: points of the unit cube, neighbouring parameters; and how long they take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from eiwa.core.errors import EiwaError
from eiwa.core.findings import validated
from eiwa.core.interfaces import Array
from eiwa.core.registry import load
from eiwa.core.sampling import MAX_DIMENSIONS, Stream
from eiwa.core.tree import leaves, replaced
from eiwa.testing.subject import Subject


def points(dof: int, count: int) -> Array:
    """Points of the unit cube, the same every time; shape (count, dof)."""
    return Stream("sobol" if dof <= MAX_DIMENSIONS else "plain", 7).points(0, count, dof)


def variations(subject: Subject) -> Iterator[tuple[str, Any]]:
    """The path of every number and switch among the parameters, and a part built with that one changed."""
    context = load(folder=subject.folder).context
    tree = subject.parameters.model_dump(mode="json")
    for path, value in leaves(tree):
        values = enumerate(value) if isinstance(value, list) else [(None, value)]
        for position, entry in values:
            where = path if position is None else f"{path}.{position}"
            for changed in _neighbours(entry):
                try:
                    table = replaced(tree, {where: changed}, {})
                    parameters = validated(type(subject.parameters), table, subject.kind, context)
                    yield where, subject.plugin.build(parameters)
                except EiwaError:
                    continue  # a value that the model refuses is no neighbour
                break


def _neighbours(value: Any) -> tuple[Any, ...]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int):
        return value + 1, value - 1
    return (value * 0.93 + 1e-3,) if isinstance(value, float) else ()


def accuracy(error: float) -> str:
    """An error in words: 'exactly', or 'to 3e-16'."""
    return f"to {error:.0e}" if error else "exactly"


SECONDS = 0.2
"""How long a speed is measured."""


def rate(call: Callable[[], Any], count: int) -> str:
    """How many of ``count`` things a call does a second, by the quickest of several calls: '1.3 M'."""
    best, start = float("inf"), time.perf_counter()
    while time.perf_counter() - start < SECONDS or best == float("inf"):
        begin = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begin)
    per_second = count / max(best, 1e-9)
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if per_second >= size:
            return f"{per_second / size:.3g} {unit}"
    return f"{per_second:.3g}"
