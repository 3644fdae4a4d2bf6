"""Traces as machine code."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.numbers import Number, constant

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.memory import Memory


class Trace(Protocol):
    """A straight line of operations; see `pgm.tracing.graph.Graph`."""

    @property
    def operations(self) -> Sequence[Any]:
        """Names, each followed by places of earlier operations."""
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


# Where the observed components of arguments are: cells, and a place in them.
Inputs = Mapping[tuple[int, int], tuple["Memory", int]]


def traced(
    code: Code,
    function: Function,
    hidden: Sequence[Any],
    inputs: Inputs,
    *,
    slope: bool = False,
) -> tuple[list[Any], list[Any]]:
    """The value of a function, and its derivative, row by row, if it is asked for.

    `hidden` are the components of the belief in it; constants among the results are floats.
    """
    known = dict(zip(function.hidden, hidden, strict=True))

    def of(argument: int, component: int) -> Any:
        column = argument, component
        if column not in known:
            cells, place = inputs[column]
            known[column] = cells.load(place)
        return known[column]

    outputs = [*function.value, *(function.slope if slope else ())]
    due = [k for k in outputs if k is not None]
    found = dict(zip(due, written(code, function, due, of), strict=True))
    every = [0.0 if k is None else found[k] for k in outputs]
    return every[: len(function.value)], every[len(function.value) :]
