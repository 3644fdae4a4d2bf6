"""Traces as machine code."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

from pgm.kernels.machine.code import Code
from pgm.kernels.machine.numbers import Number, constant


class Trace(Protocol):
    """A straight line of operations; see `pgm.tracing.graph.Graph`."""

    @property
    def operations(self) -> Sequence[tuple[Any, ...]]:
        """The operations, each on earlier ones."""
        ...

    def reachable(self, outputs: Iterable[int]) -> list[int]:
        """The operations on which the outputs depend, in order."""
        ...


def written(
    code: Code,
    trace: Trace,
    outputs: Sequence[int],
    inputs: Callable[[int, int], Number | float],
) -> list[Number | float]:
    """Write the operations of a trace; returns its outputs, of constants as floats or bools.

    `inputs` gives a component of an argument, once for each that is read.
    """
    values: dict[int, Number | float] = {}
    for place in trace.reachable(outputs):
        name, *operands = trace.operations[place]
        if name == "constant":
            values[place] = operands[0]
        elif name == "input":
            values[place] = inputs(*operands)
        else:
            first, *others = (values[operand] for operand in operands)
            values[place] = code.applied(name, constant(code, first), *others)
    return [values[place] for place in outputs]
