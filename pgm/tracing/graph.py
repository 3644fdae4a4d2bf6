"""Straight-line lists of scalar operations, in which equal ones are found once."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any, Self

import numpy as np

from pgm.tracing.operations import BATCH, BOOLEAN, COMMUTATIVE

# A name, then numbers of earlier operations; ("constant", value), ("input", argument, component).
Operation = tuple[Any, ...]


class Graph:
    """Scalar operations, each on numbers of earlier ones.

    What simplifies does so exactly: no value of float64 changes by it, and no NaN is hidden.
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._places: dict[Any, int] = {}

    def copy(self) -> Self:
        """A graph to which more can be added."""
        found = type(self)()
        found.operations, found._places = self.operations.copy(), self._places.copy()
        return found

    def constant(self, value: float | bool | np.bool_) -> int:
        """The number of a constant."""
        if isinstance(value, bool | np.bool_):
            return self._placed(("constant", bool(value)), ("truth", bool(value)))
        value = float(value)
        return self._placed(("constant", value), struct.pack("d", value))  # tells 0.0 from −0.0

    def input(self, argument: int, component: int) -> int:
        """The number of one component of an argument."""
        return self._placed(("input", argument, component))

    def value(self, number: int) -> float | bool | None:
        """The value of a constant; None of any other operation."""
        operation = self.operations[number]
        return operation[1] if operation[0] == "constant" else None

    def is_boolean(self, number: int) -> bool:
        """Whether an operation is a comparison, or made of such."""
        name, *operands = self.operations[number]
        if name == "constant":
            return isinstance(operands[0], bool)
        if name == "where":
            return self.is_boolean(operands[1]) and self.is_boolean(operands[2])
        return name in BOOLEAN

    def add(self, name: str, *operands: int) -> int:
        """The number of an operation on earlier ones."""
        known = [self.value(k) for k in operands]
        if None not in known:
            with np.errstate(all="ignore"):
                return self.constant(BATCH[name](*known).item())
        found = self._simplified(name, operands, known)
        if found is not None:
            return found
        if name in COMMUTATIVE:
            operands = tuple(sorted(operands))
        return self._placed((name, *operands))

    def reachable(self, outputs: Iterable[int]) -> list[int]:
        """The operations that outputs are made of, in order."""
        needed: set[int] = set()
        stack = list(outputs)
        while stack:
            number = stack.pop()
            if number not in needed:
                needed.add(number)
                name, *operands = self.operations[number]
                stack += operands if name not in ("constant", "input") else []
        return sorted(needed)

    def _placed(self, operation: Operation, key: Any = None) -> int:
        key = operation if key is None else key
        found = self._places.get(key)
        if found is None:
            found = self._places[key] = len(self.operations)
            self.operations.append(operation)
        return found

    def _simplified(
        self, name: str, operands: tuple[int, ...], known: list[float | bool | None]
    ) -> int | None:
        first, last = operands[0], operands[-1]
        if name in ("multiply", "divide"):  # signs are taken out
            for k in (0, 1):
                if self.operations[operands[k]][0] == "negative":
                    bare = [*operands]
                    bare[k] = self.operations[operands[k]][1]
                    return self.add("negative", self.add(name, *bare))
        if name == "where":
            if known[0] is not None:
                return operands[1 if known[0] else 2]
            return last if operands[1] == last else None
        if name in ("add", "multiply"):
            for value, other in ((known[0], last), (known[-1], first)):
                if _is(value, 0.0 if name == "add" else 1.0):
                    return other
                if name == "multiply" and _is(value, -1.0):
                    return self.add("negative", other)
            if name == "add":
                for a, b in ((first, last), (last, first)):
                    if self.operations[b][0] == "negative":
                        return self.add("subtract", a, self.operations[b][1])
        elif name == "subtract":
            if _is(known[1], 0.0):
                return first
            if _is(known[0], 0.0):
                return self.add("negative", last)
            if self.operations[last][0] == "negative":
                return self.add("add", first, self.operations[last][1])
        elif name == "divide" and _is(known[1], 1.0):
            return first
        elif name in ("negative", "logical_not") and self.operations[first][0] == name:
            return int(self.operations[first][1])
        return None


def _is(value: float | bool | None, number: float) -> bool:
    return not isinstance(value, bool) and value == number
