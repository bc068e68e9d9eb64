"""Contracts of metrics, on designs that eiwa brings along."""

from __future__ import annotations

import math
import time

import numpy as np

from eiwa.core.evaluation import Measurement
from eiwa.core.interfaces import Metric
from eiwa.testing.contract import Contract, Violation
from eiwa.testing.reference import CASES, measured
from eiwa.testing.subject import Subject


def builds(subject: Subject) -> str:
    """build(parameters) returns a Metric."""
    if not isinstance(subject.part, Metric):
        cause = "build is a function that does not return what it makes, or the class does not derive from Metric."
        raise Violation("an eiwa.core.interfaces.Metric", f"{type(subject.part).__name__}", cause)
    return type(subject.part).__name__


def declares_its_numbers(subject: Subject) -> str:
    """Every number has a name of its own, a description, and bounds in order."""
    names = [number.name for number in subject.plugin.numbers]
    for number in subject.plugin.numbers:
        if not (number.name.isidentifier() and names.count(number.name) == 1):
            raise Violation("names that differ and hold letters, digits and _ only", f"{names}")
        if not number.description or not number.low <= number.high:
            raise Violation(f"{number.name}: a description, and low <= high", f"{number}")
    return ", ".join(names)


def returns_what_it_declares(subject: Subject) -> str:
    """Whatever the design, the declared numbers are returned, and no others: finite floats or None."""
    wanted = {number.name for number in subject.plugin.numbers}
    for case in CASES:
        numbers = subject.part(measured(case))
        if not isinstance(numbers, dict) or set(numbers) != wanted:
            seen = sorted(numbers) if isinstance(numbers, dict) else type(numbers).__name__
            raise Violation(f"a dict with {sorted(wanted)}", f"{seen}, of {case}")
        for name, value in numbers.items():
            if value is not None and (not isinstance(value, float | int) or isinstance(value, bool)):
                raise Violation(f"{name}: a float or None", f"{value!r}, of {case}", "a NumPy array: use float(...).")
            if value is not None and not math.isfinite(value):
                cause = "a mean or a quotient over no cells: say what it is there, or None where it does not apply."
                raise Violation(f"{name}: a finite number, or None", f"{value}, of {case}", cause)
    return ", ".join(CASES)


def keeps_its_bounds(subject: Subject) -> str:
    """No number leaves the bounds that it declares."""
    said = []
    for number in subject.plugin.numbers:
        values = {case: subject.part(measured(case))[number.name] for case in CASES}
        for case, value in values.items():
            if value is not None and not number.low - 1e-9 <= value <= number.high + 1e-9:
                raise Violation(f"{number.name} between {number.low:g} and {number.high:g}", f"{value:.6g}, of {case}")
        known = [value for value in values.values() if value is not None]
        said.append(f"{number.name} {min(known):.3g} to {max(known):.3g}" if known else f"{number.name} always None")
    return ", ".join(said)


def is_deterministic(subject: Subject) -> str:
    """The same numbers for the same measurement, whatever was asked before, from another metric built alike too."""
    other = subject.build()
    first = {case: subject.part(measured(case)) for case in CASES}
    for case in reversed(CASES):
        for who, numbers in (("asked again", subject.part(measured(case))), ("built again", other(measured(case)))):
            if numbers != first[case]:
                cause = "random numbers, or something kept on self between calls."
                raise Violation(f"{first[case]} of {case}", f"{numbers}, {who}", cause)
    return "bit by bit"


def leaves_the_measurement_alone(subject: Subject) -> str:
    """V and E are not written to."""
    for case in CASES:
        before = _sums(measured(case))
        subject.part(measured(case))
        if _sums(measured(case)) != before:
            raise Violation("V and E as they were", f"changed, of {case}", "an operation in place: work on a copy.")
    return "V and E unchanged"


def tells_its_speed(subject: Subject) -> str:
    """How long it takes once the measurement is there."""
    measurement = measured(next(iter(CASES)))
    start = time.perf_counter()
    subject.part(measurement)
    return f"{1e3 * (time.perf_counter() - start):.2g} ms"


def _sums(measurement: Measurement) -> list[bytes]:
    """The bits of what a metric is most tempted to change."""
    first = measurement.first
    arrays = (first.V.right.values, first.V.left.values, first.E.right, first.E.left)
    return [np.ascontiguousarray(array).tobytes() for array in arrays]


BASIC: tuple[Contract, ...] = (builds, declares_its_numbers, returns_what_it_declares)
CONTRACTS: tuple[Contract, ...] = (
    *BASIC,
    keeps_its_bounds,
    is_deterministic,
    leaves_the_measurement_alone,
    tells_its_speed,
)
