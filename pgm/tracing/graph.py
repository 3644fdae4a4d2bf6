"""Straight-line lists of scalar operations, in which equal ones are found once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Self

import numpy as np

from pgm.kernels.machine.emitter.functions import reachable
from pgm.tracing.operations import BATCH, BOOLEAN, COMMUTATIVE

# A name, then numbers of earlier operations; ("constant", value), ("input", argument, component).
Operation = tuple[Any, ...]


class Graph:
    """Scalar operations as nodes, each on earlier nodes.

    Operations are simplified exactly: no value of float64 changes by it, and no NaN is hidden.
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._places: dict[Operation | str, int] = {}

    def __repr__(self) -> str:
        return repr(self.operations)  # in which a NaN equals itself

    def copy(self) -> Self:
        """A graph to which more can be added."""
        found = type(self)()
        found.operations, found._places = self.operations.copy(), self._places.copy()
        return found

    def constant(self, value: float | bool | np.bool_) -> int:
        """The number of a constant."""
        value = bool(value) if isinstance(value, bool | np.bool_) else float(value)
        return self._placed(("constant", value), repr(value))  # as text 0.0 is not −0.0, nor False

    def input(self, argument: int, component: int) -> int:
        """The node number of one component of an argument."""
        return self._placed(("input", argument, component))

    def value(self, number: int) -> float | bool | None:
        """The value of a constant; None of any other operation."""
        operation = self.operations[number]
        return operation[1] if operation[0] == "constant" else None

    def is_boolean(self, number: int) -> bool:
        """Whether a node is a comparison, or a logical operation on comparisons."""
        name, *operands = self.operations[number]
        if name == "constant":
            return isinstance(operands[0], bool)
        if name == "where":
            return self.is_boolean(operands[1]) and self.is_boolean(operands[2])
        return name in BOOLEAN

    def add(self, name: str, *operands: int) -> int:
        """Add an operation on earlier nodes; returns its node number."""
        known = [self.value(k) for k in operands]
        if None not in known:
            with np.errstate(all="ignore"):
                return self.constant(BATCH[name](*known).item())
        found = self._simplified(name, operands)
        if found is not None:
            return found
        if name in COMMUTATIVE:
            operands = tuple(sorted(operands))
        return self._placed((name, *operands))

    def reachable(self, outputs: Iterable[int]) -> list[int]:
        """The nodes on which the outputs depend, in order."""
        return reachable(self.operations, outputs)

    def _placed(self, operation: Operation, text: str | None = None) -> int:
        found = self._places.setdefault(text or operation, len(self.operations))
        if found == len(self.operations):
            self.operations.append(operation)
        return found

    def _simplified(self, name: str, operands: tuple[int, ...]) -> int | None:
        a, b = operands[0], operands[-1]
        if name in ("negative", "logical_not"):
            return self._operand(name, a)
        if name == "where":
            truth = self.value(a)
            if operands[1] == b or truth is not None:
                return operands[1] if truth else b
        if name not in _NEUTRAL:
            return None
        for a, b in (operands, operands[::-1]) if name in COMMUTATIVE else (operands,):
            if self._is(b, _NEUTRAL[name]):
                return a
            if name == "multiply" and self._is(b, -1.0):
                return self.add("negative", a)
            bare = self._operand("negative", b)  # signs are taken out
            if bare is not None and name in _CONTRARY:
                return self.add(_CONTRARY[name], a, bare)
            if bare is not None:
                return self.add("negative", self.add(name, a, bare))
        if name == "subtract" and self._is(a, 0.0):
            return self.add("negative", b)
        bare = self._operand("negative", a) if name == "divide" else None
        return None if bare is None else self.add("negative", self.add(name, bare, b))

    def _operand(self, name: str, number: int) -> int | None:
        """The operand of an operation, where it is this one."""
        operation = self.operations[number]
        return operation[1] if operation[0] == name else None

    def _is(self, number: int, value: float) -> bool:
        known = self.value(number)
        return not isinstance(known, bool) and known == value


# What changes nothing, to the right.
_NEUTRAL = {"add": 0.0, "subtract": 0.0, "multiply": 1.0, "divide": 1.0}
_CONTRARY = {"add": "subtract", "subtract": "add"}
