"""Traced formulas without a compiler: a tape is recorded and played back on NumPy columns."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eiwa.core.interfaces import Array
from eiwa.core.symbols import Column, Symbol, Tape


def _lowest(shifted: Any) -> Any:
    """The small integer in the lowest bits of a double (:func:`eiwa.core.symbols.rounded`)."""
    return (np.asarray(shifted, np.float64).view(np.int64) << 52) >> 52


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "abs": np.abs,
    "lt": operator.lt,
    "le": operator.le,
    "and": np.logical_and,
    "select": np.where,
    "flip": lambda x, shifted: np.where(_lowest(shifted) & 1, -x, x),
    "power": lambda shifted: np.exp2(_lowest(shifted)),
}


@dataclass(frozen=True)
class Recording:
    """What a traced function did: its operations and the columns that it gave (nodes, or plain numbers)."""

    nodes: tuple[Any, ...]
    outputs: tuple[Any, ...]

    @classmethod
    def of(
        cls, function: Callable[[list[Column], list[Column]], Sequence[Column]], inputs: int, parameters: int
    ) -> Recording:
        """Trace ``function(u, p)``.

        Raises
        ------
        TypeError
            The function asks a column for its truth value.
        """
        tape = Tape()
        u = [tape.node("input", j) for j in range(inputs)]
        p = [tape.node("parameter", j) for j in range(parameters)]
        outputs = [("node", o.index) if isinstance(o, Symbol) else ("number", float(o)) for o in function(u, p)]
        return cls(tuple(tape.nodes), tuple(outputs))

    def play(self, inputs: Array, parameters: Array) -> Array:
        """The outputs (n, m) at inputs (n, k)."""
        values: list[Any] = []
        with np.errstate(all="ignore"):  # both branches of a select are computed
            for operation, operands in self.nodes:
                if operation == "input":
                    values.append(inputs[:, operands[0]])
                elif operation == "parameter":
                    values.append(float(parameters[operands[0]]))
                elif operation == "constant":
                    values.append(operands[0])
                else:
                    values.append(_OPERATIONS[operation](*(values[o] for o in operands)))
        columns = [values[o] if kind == "node" else o for kind, o in self.outputs]
        return np.stack([np.broadcast_to(np.asarray(c, float), len(inputs)) for c in columns], axis=1)
