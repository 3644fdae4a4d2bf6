"""Sweeps in twice the digits in machine code: steps that are traces, around beliefs in memory.

What a step computes comes as traces, of pairs of numbers as of single ones; here is what runs, and
in which order. Products and sums are never contracted: pairs live on what each of them rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from math import prod

from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Cells
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number, constant
from pgm.kernels.machine.emitter.traces import written
from pgm.kernels.machine.emitter.variables import Variable, held
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.sweeps.chain import Sweep, each_run
from pgm.kernels.machine.sweeps.cpd import keep, linearised, readings
from pgm.kernels.machine.sweeps.motion import line_of
from pgm.kernels.machine.sweeps.told import Array, Motion, Sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import Matrix, most, where

Arrays = tuple[Array, ...]
# The arguments of a trace: the numbers of each, by their place.
Source = Callable[[int], Number]


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
    motion : Motion or None
        A transition to be linearised at each known belief; it is kept where `move` is read.
    sensors : tuple of Sensor
        To be linearised at each predicted belief; `scalars` are then what comes of them.
    difference : Function
        A trace: of two floats, their difference in twice the digits.
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
    motion: Motion | None
    sensors: tuple[Sensor, ...]
    difference: Function
    predicted: Arrays
    known: Arrays


@dataclass(frozen=True)
class Behind:
    """Sweeps back: beliefs are smoothed by a message, or from the belief of the next step.

    Attributes
    ----------
    smoothing, bayes, message, carried : Function
        Traces: of a known belief and a message, what is smoothed, and one where the belief of the
        next step is to be tried; of the known, what is smoothed, the transition, and the predicted
        and what is smoothed of the next step, what is smoothed, and its gain; of a message and a
        scalar measurement, or a transition's matrix, the message before. The second is long: it is
        None in a sweep that tells whether it is needed.
    move, known, predicted, taken : tuple of Array
        What a sweep forward was told and has left; of `known` the belief alone, and of `taken` with
        the scalars' rows.
    bounds, sweeps : int
        Places in the table: as of `Ahead`, and of the address of three numbers: the first and the
        last step of the first sweep, and how many sweeps there are, each a step later.
    smoothed, here, gain : tuple of Array
        Each step's smoothed belief with its shares of rounding, the message to its predicted
        belief, and the gain, with one where it was used, or is needed.
    """

    smoothing: Function
    bayes: Function | None
    message: Function
    carried: Function
    move: Arrays
    known: Arrays
    predicted: Arrays
    taken: Arrays
    bounds: int
    sweeps: int
    smoothed: Arrays
    here: Arrays
    gain: Arrays


def length(chain: Ahead | Behind) -> int:
    """How many operations the steps of a chain are."""
    parts = (getattr(chain, each.name) for each in fields(chain))
    return sum(len(part.operations) for part in parts if isinstance(part, Function))


@lru_cache(maxsize=64)
def made(chain: Ahead | Behind, lanes: int, level: int) -> Sweep:
    """The sweep of a chain, of single runs or of packs: ``sweep(table, first, last)``.

    It is compiled at a level of optimisation, 0 or 1: steps are straight lines.
    """
    module = Module(contract=False)
    code = module.function("sweep", (ADDRESS, WHOLE, WHOLE), lanes=lanes)
    table, first, last = code.arguments
    w = Writer(code, table, chain, Lines(code))
    addresses = Cells(code, table, Address)
    bounds = Cells(code, addresses.load(chain.bounds), Whole)
    if isinstance(chain, Ahead):
        with each_run(w, first, last):
            _ahead(w, chain, bounds)
    else:
        sweeps = Cells(code, addresses.load(chain.sweeps), Whole)
        begin, end, count = (sweeps.load(k) for k in range(3))
        with each_run(w, first, last), code.loop(count) as k:
            _behind(w, chain, bounds, begin + k, end + k)
    return module.compile(level).callable("sweep")


def _ahead(w: Writer, chain: Ahead, bounds: Cells[Whole]) -> None:
    """Write the sweep forward of the runs at hand."""
    code, width = w.code, len(chain.predicted)
    state = _Carried(w, chain.begin)
    begin = zip(chain.begin, _stored(w, chain.begin), strict=True)
    state.set([source(k) for array, source in begin for k in range(_size(array))])
    with code.loop(w.last + 1) as at:
        with code.when(at > 0):
            if chain.motion is not None:
                mean, cov = _moments(state, chain)
                line_of(w, chain.motion, at - 1, mean, mean, cov)
            move = _stored(w, chain.move, at - 1)
            state.set(_applied(w, chain.prediction, [*state.sources[:width], *move]))
        state.keep(chain.predicted, at)
        if chain.sensors:
            _read(w, chain, at, *_moments(state, chain), bounds.load(at))
        with code.loop(bounds.load(at + 1), bounds.load(at)) as row:
            scalar = _stored(w, chain.scalars, row)
            found = _applied(w, chain.measurement, [*state.sources, *scalar])
            state.set(found)
            _keep(w, chain.taken, found[state.size :], row)
        state.keep(chain.known, at)


def _moments(state: _Carried, chain: Ahead) -> tuple[Matrix, Matrix]:
    """The mean and the covariance of a belief that does not depend on δ, in single floats."""
    mean, _, cov = state.sources[:3]
    size = chain.begin[0].shape[0]
    rows = [[cov(i * size + j) for j in range(size)] for i in range(size)]
    found = Matrix([0.5 * (rows[i][j] + rows[j][i]) for j in range(size)] for i in range(size))
    return Matrix.column(mean(i) for i in range(size)), found


def _read(w: Writer, chain: Ahead, at: Whole, mean: Matrix, cov: Matrix, first: Whole) -> None:
    """Linearise the measurements of a step, and keep them as scalars from a first one on."""
    place = w.code.variable(first)
    for sensor in chain.sensors:
        if sensor.bounds is None:
            _linearised(w, chain, sensor, at, mean, cov, place)
        else:
            begin, end = w.sightings(sensor, at)
            with w.code.loop(end, begin) as row:
                _linearised(w, chain, sensor, row, mean, cov, place)


def _linearised(
    w: Writer,
    chain: Ahead,
    sensor: Sensor,
    row: Whole,
    mean: Matrix,
    cov: Matrix,
    place: Variable[Whole],
) -> None:
    """Linearise a sighting, and keep its components as the next scalars, [h, z − b, r, whether]."""
    parents, size = sensor.parents, mean.shape[0]
    x = mean.part(parents, (0,))
    line = linearised(w, sensor, row, x, cov.part(parents, parents))
    keep(w, sensor, row, x, line)
    values = w.matrices.beside(readings(w, sensor, row, line.value))
    constant_of, own = line.value - line.matrix @ x, line.own.diagonal
    for k, value in enumerate(values):
        seen = value == value if sensor.missing else w.true
        slope = dict(zip(parents, line.matrix.rows[k], strict=True))
        found = [where(seen, slope.get(j, 0.0), 0.0) for j in range(size)]
        given = [[value], [constant_of[k, 0]]]
        offset = _applied(w, chain.difference, [each.__getitem__ for each in given])
        found += [0.0] * size + [where(seen, each, 0.0) for each in offset]
        found += [where(seen, own[k], 1.0), 0.0, seen.number()]
        _keep(w, chain.scalars, found, place.get())
        place.set(place.get() + 1)


def _behind(w: Writer, chain: Behind, bounds: Cells[Whole], begin: Whole, end: Whole) -> None:
    """Write a sweep back from a step to another, of the runs at hand."""
    code = w.code
    later, smooth, now = (
        _Carried(w, each) for each in (chain.here, chain.smoothed, chain.smoothed)
    )
    with code.loop(end + 1, begin, down=True) as at:
        known = _stored(w, chain.known, at)
        found = _applied(w, chain.smoothing, [*known, *later.sources])
        now.set(found)
        used, close = w.at(chain.gain[-1], at), constant(code, found[-1])
        if chain.bayes is None:
            with code.when(at < end):
                used.store(0, most(used.load(0), close))
        else:
            used.store(0, 0.0)
            with code.when((at < end) & code.some(close != 0.0)):
                after = [*_stored(w, chain.move, at), *_stored(w, chain.predicted, at + 1)]
                better = _applied(w, chain.bayes, [*known, *now.sources, *after, *smooth.sources])
                now.set(better)
                _keep(w, chain.gain, better[now.size :], at)
        smooth.set(now.numbers)
        smooth.keep(chain.smoothed, at)
        first = bounds.load(at)
        with code.loop(bounds.load(at + 1), first, down=True) as row:
            scalar = _stored(w, chain.taken, row)
            later.set(_applied(w, chain.message, [*later.sources, *scalar]))
        later.keep(chain.here, at)
        with code.when(at > begin):
            matrix = _stored(w, chain.move[:2], at - 1)
            later.set(_applied(w, chain.carried, [*later.sources, *matrix]))


class _Carried:
    """Numbers that are carried from step to step, in variables: as many as arrays have, zeros."""

    def __init__(self, w: Writer, arrays: Arrays) -> None:
        self._w = w
        self._variables = [[held(w.code, 0.0) for _ in range(_size(each))] for each in arrays]

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

    @property
    def numbers(self) -> list[Number]:
        """All numbers, as they are at this point of the code."""
        return [variable.get() for each in self._variables for variable in each]

    def set(self, numbers: Sequence[Number | float]) -> None:
        """Replace the first numbers by others."""
        every = (variable for each in self._variables for variable in each)
        for variable, number in zip(every, numbers, strict=False):
            variable.set(number)

    def keep(self, arrays: Arrays, row: Whole) -> None:
        """Put the numbers into arrays at a row."""
        _keep(self._w, arrays, self.numbers, row)


def _size(array: Array) -> int:
    return prod(array.shape)


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
