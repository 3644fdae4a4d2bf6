"""Sweeps in twice the digits in machine code: steps that are traces, around beliefs in memory.

What a step computes comes as traces, of pairs of numbers as of single ones; here is what runs, and
in which order. Products and sums are never contracted: pairs live on what each of them rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

from pgm.kernels.machine.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.memory import Cells
from pgm.kernels.machine.module import Module
from pgm.kernels.machine.numbers import Number
from pgm.kernels.machine.sweeps import Sweep, each_run
from pgm.kernels.machine.told import Array, Function
from pgm.kernels.machine.traces import written
from pgm.kernels.machine.variables import Variable
from pgm.kernels.machine.wholes import Address, Whole
from pgm.kernels.machine.writer import Writer, held

Arrays = tuple[Array, ...]
# The arguments of a trace: the numbers of each, by their place.
Source = Callable[[int], Number]
# The first passes of LLVM are enough: steps are straight lines.
_LEVEL = 1


@dataclass(frozen=True)
class Ahead:
    """A sweep forward: beliefs are predicted, and take in scalar measurements one by one.

    Attributes
    ----------
    prediction, measurement : Function
        Traces: of a belief and a transition, the next belief; of a belief, what is known beside it,
        and a scalar, all three of them anew.
    begin : tuple of Array
        The belief to begin with, and what is known beside it, at one row.
    move : tuple of Array
        Of each transition.
    scalars, taken : tuple of Array
        Of each scalar measurement, in order: itself, and what has come of it.
    bounds : int
        The place in the table of the address of the first scalar of each step, and one more.
    predicted, known : tuple of Array
        Each step's belief before its measurements, and the belief and what is known after them.
    """

    prediction: Function
    measurement: Function
    begin: Arrays
    move: Arrays
    scalars: Arrays
    taken: Arrays
    bounds: int
    predicted: Arrays
    known: Arrays


@lru_cache(maxsize=64)
def made(chain: Ahead, lanes: int) -> Sweep:
    """The sweep of a chain, of single runs or of packs: ``sweep(table, first, last)``."""
    module = Module(contract=False)
    code = module.function("sweep", (ADDRESS, WHOLE, WHOLE), lanes=lanes)
    table, first, last = code.arguments
    w = Writer(code, table, chain)
    bounds = Cells(code, Cells(code, table, Address).load(chain.bounds), Whole)
    with each_run(w, first, last):
        _ahead(w, chain, bounds)
    return module.compile(_LEVEL).callable("sweep")


def _ahead(w: Writer, chain: Ahead, bounds: Cells[Whole]) -> None:
    """Write the sweep forward of the runs at hand."""
    code, width = w.code, len(chain.predicted)
    state = _Carried(w, chain.begin)
    with code.loop(w.last + 1) as at:
        with code.when(at > 0):
            move = _stored(w, chain.move, at - 1)
            state.set(_applied(w, chain.prediction, [*state.sources[:width], *move]))
        state.keep(chain.predicted, at)
        with code.loop(bounds.load(at + 1), bounds.load(at)) as row:
            scalar = _stored(w, chain.scalars, row)
            found = _applied(w, chain.measurement, [*state.sources, *scalar])
            state.set(found)
            _keep(w, chain.taken, found[state.size :], row)
        state.keep(chain.known, at)


class _Carried:
    """Numbers that are carried from step to step, in variables: those of some arrays at a row."""

    def __init__(self, w: Writer, arrays: Arrays) -> None:
        self._w = w
        self._variables: list[list[Variable[Number]]] = []
        for source, array in zip(_stored(w, arrays), arrays, strict=True):
            numbers = [source(k) for k in range(_size(array))]
            self._variables.append([held(w.code, number) for number in numbers])

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return sum(map(len, self._variables))

    @property
    def sources(self) -> list[Source]:
        """The numbers, array by array, as they are at this point of the code."""

        def source(variables: list[Variable[Number]]) -> Source:
            return lambda k: variables[k].get()

        return [source(each) for each in self._variables]

    def set(self, numbers: Sequence[Number | float]) -> None:
        """Replace the first numbers by others."""
        every = (variable for each in self._variables for variable in each)
        for variable, number in zip(every, numbers, strict=False):
            variable.set(number)

    def keep(self, arrays: Arrays, row: Whole) -> None:
        """Put the numbers into arrays at a row."""
        numbers = [variable.get() for each in self._variables for variable in each]
        _keep(self._w, arrays, numbers, row)


def _size(array: Array) -> int:
    size = 1
    for length in array.shape:
        size *= length
    return size


def _stored(w: Writer, arrays: Arrays, row: Whole | None = None) -> list[Source]:
    """The numbers of arrays at a row; what is not asked for is not read."""
    return [w.at(array, row).load for array in arrays]


def _keep(w: Writer, arrays: Arrays, numbers: Sequence[Number | float], row: Whole) -> None:
    """Put numbers into arrays at a row, one array after another; those beyond are left out."""
    place = 0
    for array in arrays:
        cells = w.at(array, row)
        for k in range(_size(array)):
            cells.store(k, numbers[place + k])
        place += _size(array)


def _applied(w: Writer, function: Function, given: Sequence[Source]) -> list[Number | float]:
    """The numbers that a trace finds, of some arguments."""
    return written(w.code, function, function.value, lambda k, component: given[k](component))
