"""Users' functions as machine code is told of them: traces, equal by what they compute."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any


@dataclass(frozen=True, eq=False)
class Function:
    """A user's function and its derivative, as a trace: scalar operations, each on earlier ones.

    Functions of the same operations are equal.

    Attributes
    ----------
    operations : tuple
        As of a graph of `pgm.tracing`: a name, then places of earlier operations.
    value, slope : tuple of int, tuple of (int or None)
        The operations that are the value (d,), and the derivative (d n,), row by row; None is zero.
    hidden, observed : tuple of (int, int)
        An argument, and a component of it: of each component of the belief, and of each input.
    """

    operations: tuple[Any, ...]
    value: tuple[int, ...]
    slope: tuple[int | None, ...]
    hidden: tuple[tuple[int, int], ...]
    observed: tuple[tuple[int, int], ...]

    @cached_property
    def _key(self) -> str:
        # As text, in which a NaN equals itself, and zeros of either sign differ.
        return repr((self.operations, self.value, self.slope, self.hidden, self.observed))

    @cached_property
    def _hash(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Function) and self._key == other._key)

    def __hash__(self) -> int:
        return self._hash

    def reachable(self, outputs: Iterable[int]) -> list[int]:
        """The operations on which some depend, in order."""
        return reachable(self.operations, outputs)


def reachable(operations: Sequence[Any], outputs: Iterable[int]) -> list[int]:
    """The places of operations on which some depend, in order."""
    needed: set[int] = set()
    stack = list(outputs)
    while stack:
        number = stack.pop()
        if number not in needed:
            needed.add(number)
            name, *operands = operations[number]
            stack += operands if name not in ("constant", "input") else []
    return sorted(needed)
