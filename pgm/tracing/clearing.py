"""Traces cleared in machine code: values and slopes that are surely right, at the points of a call.

Judging a trace (`pgm.tracing.judging`) takes some hundred calls of NumPy, whatever the number of
points. Nearly always nothing is wrong. That is found here in two calls of machine code, before and
after the function is asked: points are laid out, and values compared, by the same measures. What is
in the least in doubt is not cleared, and judged there. So nothing is decided here but that there is
nothing to decide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache, reduce
from itertools import accumulate
from operator import add
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array, address
from pgm.kernels.step import turns
from pgm.tracing.measures import (
    APART,
    BESIDE,
    DOUBT,
    EVEN,
    NEAR,
    OF_ITSELF,
    OF_LARGEST,
    OF_NOISE,
    OF_PREDICTION,
    OF_VALUE,
    ROUNDING,
    SCALES,
    UNTOLD,
    VALUES_OF_NOISE,
    shares,
)
from pgm.tracing.program import Program

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.code import Code
    from pgm.kernels.machine.emitter.memory import Memory
    from pgm.kernels.machine.emitter.numbers import Number
    from pgm.kernels.machine.emitter.wholes import Address, Whole
    from pgm.tracing.slopes import Slopes

# Longer traces and larger derivatives are judged by NumPy alone, whose time they take up.
_OPERATIONS, _ENTRIES = 400, 40
# For how many numbers of points the extent of memory is kept.
_EXTENTS = 16
# A unit in the last place of x is between these shares of it.
_UNIT = 2.0**-53, 2.0**-52


class Standing(NamedTuple):
    """Points (k, widths) whose components stand in memory, and the deviations by which to judge.

    Attributes
    ----------
    number : int
        k of them.
    places : sequence of int
        Three for each component of the arguments side by side, and then for each column of the
        derivative, of its deviation: the address of the component's numbers, how many floats they
        are apart from row to row, and the address of the row of each point, (k,) of int64.
    squared : bool
        Whether variances stand there in place of deviations.
    kept : object
        What owns that memory.
    """

    number: int
    places: Sequence[int] | npt.NDArray[np.int64]
    squared: bool
    kept: object

    @classmethod
    def of(cls, flat: Array, std: Array | None) -> Standing:
        """Points (k, widths), with deviations (k, n) if derivatives were used."""
        flat, (order, rows) = np.ascontiguousarray(flat), in_order(len(flat))
        std = None if std is None else np.ascontiguousarray(std)
        places: list[int] = []
        for each in (flat,) if std is None else (flat, std):
            begin, width = address(each), each.shape[1]
            for k in range(width):
                places += (begin + 8 * k, width, rows)
        return cls(len(flat), places, False, (flat, std, order))


class _Extent(NamedTuple):
    """The memory for clearing a number of points.

    rows: At how many points the function is asked.
    even: How many of the points, at even distances, differences are taken about.
    numbers: How many floats there are in all.
    begins: How many bytes after the points that are asked begin the values, the slopes, the moves
        and the deviations.
    shares: The address of the shares of a deviation by which points lie beside others.
    kept: What owns these.
    """

    rows: int
    even: int
    numbers: int
    begins: tuple[int, ...]
    shares: int
    kept: Array


class Clearing:
    """A trace with its derivative, of which points are cleared.

    Parameters
    ----------
    trace : Program
        The value (D,): that which is differentiated, (d,), and derivatives that were given.
    slopes : Slopes
        Of the value (d,) by n columns.
    differentiated : bool
        Whether the points' derivatives were used.
    """

    def __init__(self, trace: Program, slopes: Slopes, *, differentiated: bool) -> None:
        self.trace, self.slopes, self.program = trace, slopes, slopes.program
        self.widths, self.columns = sum(trace.widths), slopes.columns.tolist()
        self.beside = differentiated and bool(self.columns)
        self.differs = self.beside and not self.program.smooth
        size = len(self.columns)
        self.moves = size + (size > 1) if self.differs else 0
        # Loops read these: scales, steps to both sides, and the directions of moves.
        together = [[near * sign**j for j in range(size)] for near, sign in NEAR]
        directions = np.eye(size)
        if size > 1:
            directions = np.concatenate([directions, [slopes.shares]])
        self._extents: dict[int, _Extent] = {}
        self._constants = np.array(SCALES), np.array(together), directions

    @property
    def able(self) -> bool:
        """Whether the trace is short enough for this."""
        entries = len(self.program.value) * max(len(self.columns), 1)
        return len(self.program.graph.operations) <= _OPERATIONS and entries <= _ENTRIES

    def clears(self, points: Standing) -> bool:
        """Whether all is surely right at points."""
        places = np.array(points.places, dtype=np.int64)
        return self.clears_at(points.number, address(places), squared=points.squared)

    def clears_at(self, count: int, places: int, *, squared: bool) -> bool:
        """Whether all is surely right at points of which the `places` stand at an address."""
        extent = self._extents.get(count)
        if extent is None:
            if len(self._extents) >= _EXTENTS:
                self._extents.clear()
            extent = self._extents[count] = self._extent(count)
        # Memory of its own, as the function may keep a view of what it is asked.
        room = np.empty(extent.numbers)
        asked = np.ndarray((extent.rows, self.widths), float, room)
        begin = address(room)
        told, slope, moves, spread = [begin + far for far in extent.begins]
        before, after = self._code
        own = begin, told, slope, moves, spread, places, extent.shares
        if before(*own, *self._fixed, count, extent.even, squared):
            return False
        due = self.slopes.function(asked)
        if due is None or due.shape != (extent.rows, len(self.trace.value)):
            return False
        due = np.ascontiguousarray(due)
        return not after(told, slope, moves, address(due), self._fixed[0], count, extent.even)

    def _extent(self, count: int) -> _Extent:
        """The memory that so many points take."""
        size = len(self.columns)
        even = min(EVEN, count) if self.differs else 0
        every = count * (1 + self.beside)
        rows = every + len(SCALES) * even * self.moves * 4
        lengths = (
            rows * self.widths,
            every * len(self.trace.value),
            count * size * len(self.program.value) * self.differs,
            len(SCALES) * even * self.moves * size,
            count * size * self.beside,
        )
        begins = tuple(8 * first for first in accumulate(lengths[:-1]))
        kept, beside = _shares(count, size)
        return _Extent(rows, even, sum(lengths) + 1, begins, beside, kept)

    def __getstate__(self) -> dict[str, Any]:
        own = {k: value for k, value in self.__dict__.items() if k not in ("_code", "_fixed")}
        return own | {"_extents": {}}  # which has addresses

    @cached_property
    def _fixed(self) -> tuple[int, ...]:
        """The addresses of what loops read: scales, steps to both sides, directions of moves."""
        return tuple(map(address, self._constants))

    @cached_property
    def _code(self) -> tuple[Any, Any]:
        """Two functions, of addresses and counts, which give 1 if something is in doubt."""
        from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
        from pgm.kernels.machine.emitter.module import Module

        module = Module(contract=False)
        counts = WHOLE, WHOLE
        before = module.function("before", (*(ADDRESS,) * 10, *counts, WHOLE), WHOLE)
        self._lay_out(before)
        after = module.function("after", (*(ADDRESS,) * 5, *counts), WHOLE)
        self._compare(after)
        compiled = module.compile(0)
        return compiled.callable("before"), compiled.callable("after")

    # Before the function is asked

    def _lay_out(self, code: Code) -> None:
        """Write the trace's values at points and beside them, and where else it is to be asked."""
        *addresses, count, even, squared = code.arguments
        places, memories = addresses.pop(5), list(map(code.memory, addresses))
        asked, told, slope, moves, std, share, *constants = memories
        scales, near, directions = constants
        doubtful = code.varying(False)
        width, size = self.widths, len(self.columns)
        sources = _sources(code, places, width + size * self.beside)
        with code.loop(count) as k:
            x = [_at(code, source, k) for source in sources[:width]]
            _keep(asked, k, x)
            doubtful.set(doubtful.get() | ~(reduce(add, map(abs, x)) < math.inf))
            value, steep = self._evaluated(code, x, slope=self.differs)
            _keep(told, k, value)
            if self.beside:
                spread = [_at(code, source, k) for source in sources[width:]]
                roots = [(each > 0.0).where(each, 0.0).apply("sqrt") for each in spread]
                spread = [
                    _told((squared > 0).where(root, each))
                    for root, each in zip(roots, spread, strict=True)
                ]
                _keep(std, k, spread)
                own = [share.load(k * size + j) for j in range(size)]
                steps = [BESIDE * a * b for a, b in zip(own, spread, strict=True)]
                y = self._moved(x, steps)
                _keep(asked, count + k, y)
                _keep(told, count + k, self._evaluated(code, y)[0])
                if self.differs:
                    _keep(slope, k, steep)
                    doubt = self._in_doubt(code, x, steep, spread, own, near)
                    doubtful.set(doubtful.get() | doubt)
        if self.differs:
            with code.loop(even) as e:
                where = _even(code, e, count), count, e, even
                doubt = self._laid_around(code, asked, moves, std, scales, directions, where)
                doubtful.set(doubtful.get() | doubt)
        code.give(_flag(code, doubtful.get()))

    def _evaluated(
        self, code: Code, x: Sequence[Number], *, slope: bool = False, alone: bool = False
    ) -> tuple[list[Any], list[Any]]:
        """The trace's value, and its slope, row by row, if asked; `alone` the slope of a part."""
        from pgm.kernels.machine.emitter.traces import written

        starts = np.cumsum([0, *self.trace.widths]).tolist()

        def of(argument: int, component: int) -> Any:
            return x[starts[argument] + component]

        trace: Any = self.trace.graph
        program: Any = self.program.graph

        value = [] if alone else written(code, trace, self.trace.value, of)
        if not slope:
            return value, []
        due = [k for k in self.program.slope if k is not None]
        found = dict(zip(due, written(code, program, due, of), strict=True))
        return value, [0.0 if k is None else found[k] for k in self.program.slope]

    def _moved(self, x: Sequence[Any], steps: Sequence[Any]) -> list[Any]:
        found = list(x)
        for column, step in zip(self.columns, steps, strict=True):
            found[column] = found[column] + step
        return found

    def _in_doubt(
        self,
        code: Code,
        x: Sequence[Any],
        slope: Sequence[Any],
        spread: Sequence[Any],
        own: Sequence[Any],
        near: Memory,
    ) -> Number:
        """Whether a slope is unlike those to both sides; see `Slopes.doubts`."""
        found, size = code.varying(False), len(self.columns)
        with code.loop(len(NEAR)) as at:
            steps = [near.load(at * size + j) * own[j] * spread[j] for j in range(size)]
            back = [-step for step in steps]
            above = self._evaluated(code, self._moved(x, steps), slope=True, alone=True)[1]
            below = self._evaluated(code, self._moved(x, back), slope=True, alone=True)[1]
            doubtful = found.get()
            for k, (here, one, other) in enumerate(zip(slope, above, below, strict=True)):
                if all(isinstance(each, float) for each in (here, one, other)):
                    continue
                one, deviation = code.constant(0.0) + one, spread[k % size]
                middle = 0.5 * (one + other)
                off = (abs(here - middle) - abs(one - other)) * deviation
                unit = abs(middle) * deviation + float(self.slopes.noise[k // size])
                doubtful = doubtful | (off > DOUBT * (unit > 0.0).where(unit, 1.0))
            found.set(doubtful)
        return found.get()

    def _laid_around(
        self,
        code: Code,
        asked: Memory,
        moves: Memory,
        std: Memory,
        scales: Memory,
        directions: Memory,
        where: tuple[Whole, Whole, Whole, Whole],
    ) -> Number:
        """Write the points of differences about one, and the moves to them; see `Differed`.

        The result is whether it is in doubt that a step is large enough. `where` are the number of
        the point, how many points there are, and both of those at even distances.
        """
        k, count, e, even = where
        size, doubtful = len(self.columns), code.varying(False)
        x = [asked.load(k * self.widths + i) for i in range(self.widths)]
        spread = [std.load(k * size + j) for j in range(size)]
        with code.loop(len(SCALES)) as s:
            scale, steps = scales.load(s), []
            for column, deviation in zip(self.columns, spread, strict=True):
                step, least, most = scale * deviation, *(u * APART * abs(x[column]) for u in _UNIT)
                doubtful.set(doubtful.get() | ((step >= least) & (step < most)))
                steps.append((step >= most).where(step, 0.0))
            with code.loop(self.moves) as m:
                place = (even * s + e) * self.moves + m
                move = []
                for j, (column, step) in enumerate(zip(self.columns, steps, strict=True)):
                    moved = x[column] + step * directions.load(m * size + j)
                    move.append(moved - x[column])
                _keep(moves, place, move)
                for q, times in enumerate((1.0, -1.0, 2.0, -2.0)):
                    point = self._moved(x, [times * each for each in move])
                    _keep(asked, count * 2 + place * 4 + q, point)
        return doubtful.get()

    # After

    def _compare(self, code: Code) -> None:
        """Write whether some value, or some slope, is not surely right."""
        *addresses, count, even = code.arguments
        told, slope, moves, due, scales = map(code.memory, addresses)
        height, angles = len(self.trace.value), self._angles
        own = len(self.program.value)
        rows, inf = count * (1 + self.beside), math.inf
        largest = [code.varying(0.0) for _ in range(height)]
        with code.loop(rows) as k:
            for i, held in enumerate(largest):
                size = abs(due.load(k * height + i))
                held.set(((size > held.get()) & (size < inf)).where(size, held.get()))
        sizes = [each.get() for each in largest]
        if height > own:  # derivatives that were given have one
            whole = sizes[own]
            for each in sizes[own + 1 :]:
                whole = (each > whole).where(each, whole)
            sizes[own:] = [whole] * (height - own)
        least = []
        for i, each in enumerate(sizes):
            most = (each > 1.0).where(each, 1.0) if angles[i] else each
            share = VALUES_OF_NOISE * float(self.slopes.noise[i]) if i < own else 0.0
            least.append(OF_LARGEST * most + share)
        doubtful = code.varying(False)
        with code.loop(rows) as k:
            for i in range(height):
                value, answer = due.load(k * height + i), told.load(k * height + i)
                known = abs(value) < inf
                off = answer - value
                error = abs(off - turns(off) if angles[i] else off)
                fine = known & (error <= least[i] + OF_VALUE * abs(value))
                fine = fine | (~known & ~(abs(answer) < inf))
                doubtful.set(doubtful.get() | ~fine)
        if self.differs:
            with code.loop(even) as e:
                where = _even(code, e, count), count, e, even
                wrong = self._differs_at(code, told, slope, moves, due, scales, where)
                doubtful.set(doubtful.get() | wrong)
        code.give(_flag(code, doubtful.get()))

    def _differs_at(
        self,
        code: Code,
        told: Memory,
        slope: Memory,
        moves: Memory,
        due: Memory,
        scales: Memory,
        where: tuple[Whole, Whole, Whole, Whole],
    ) -> Number:
        """Whether a slope is unlike differences of the function; see `Differed.fault`.

        `where` is as of `_laid_around`.
        """
        k, count, e, even = where
        height, own, size = len(self.trace.value), len(self.program.value), len(self.columns)
        found = code.varying(False)

        def change(i: int, place: Whole, scale: Number) -> Number:
            value = [due.load((count * 2 + place * 4 + q) * height + i) for q in range(4)]
            near, far = value[0] - value[1], value[2] - value[3]
            if self._angles[i]:
                near, far = near - turns(near), far - turns(far)
            return (8.0 * near - far) / (12.0 * scale)

        with code.loop(len(SCALES)) as s:
            scale, squares = scales.load(s), [code.varying(0.0) for _ in range(own)]
            first = (even * s + e) * self.moves
            with code.loop(self.moves) as m:
                for i, square in enumerate(squares):
                    one = change(i, first + m, scale)
                    square.set(square.get() + one * one)
            least = []
            for i, square in enumerate(squares):
                size_, noise = OF_PREDICTION * square.get().apply("sqrt"), self.slopes.noise[i]
                most = OF_NOISE * float(noise)
                rounding = ROUNDING / scale * abs(told.load(k * height + i))
                least.append((size_ > most).where(size_, most) + rounding)
            with code.loop(self.moves) as m:
                move = [moves.load((first + m) * size + j) for j in range(size)]
                wrong = found.get()
                for i in range(own):
                    answer, moved = code.constant(0.0), code.constant(False)
                    for j, each in enumerate(move):
                        answer = answer + slope.load((k * own + i) * size + j) * each
                        moved = moved | (each != 0.0)
                    answer, one = answer / scale, change(i, first + m, scale)
                    error, large = abs(answer - one), abs(one)
                    large = (large > abs(answer)).where(large, abs(answer))
                    wrong = wrong | ((error > least[i]) & (error > OF_ITSELF * large) & moved)
                found.set(wrong)
        return found.get()

    @property
    def _angles(self) -> list[bool]:
        """Which components of the value are angles; no derivative is."""
        own = self.slopes.angles.tolist()
        return [*own, *[False] * (len(self.trace.value) - len(own))]


def _even(code: Code, e: Whole, count: Whole) -> Whole:
    """The number of a point at even distances, of the first and the last, and those between."""
    place = code.variable(e)
    with code.when(count > EVEN):
        place.set(e * (count - 1) // (EVEN - 1))
    return place.get()


def _sources(code: Code, places: Address, count: int) -> list[tuple[Any, ...]]:
    """Where components stand: their numbers, how far apart these are, and the points' rows."""
    from pgm.kernels.machine.emitter.memory import Cells
    from pgm.kernels.machine.emitter.wholes import Address, Whole

    addresses, wholes = Cells(code, places, Address), Cells(code, places, Whole)
    return [
        (
            code.memory(addresses.load(3 * k)),
            wholes.load(3 * k + 1),
            Cells(code, addresses.load(3 * k + 2), Whole),
        )
        for k in range(count)
    ]


def _at(code: Code, source: tuple[Any, ...], k: Whole) -> Number:
    """A component of a point."""
    memory, apart, rows = source
    found: Number = memory.load(rows.load(k) * apart)
    return found


def _keep(memory: Memory, row: Whole, numbers: Sequence[Any]) -> None:
    """Write numbers to a row."""
    for i, number in enumerate(numbers):
        memory.store(row * len(numbers) + i, number)


def _told(deviation: Number) -> Number:
    """A deviation to judge by, as of `slopes.told`."""
    return ((deviation > 0.0) & (deviation < math.inf)).where(deviation, UNTOLD)


def _flag(code: Code, truth: Number) -> Whole:
    return code.rounded(truth.where(1.0, 0.0))


@lru_cache(maxsize=16)
def _shares(count: int, size: int) -> tuple[Array, int]:
    """The shares of a deviation by which points lie beside others, (k, n), and their address."""
    found = shares((count, size))
    return found, address(found)


@lru_cache(maxsize=16)
def in_order(count: int) -> tuple[npt.NDArray[np.int64], int]:
    """The rows of points that stand in order, (k,), and their address."""
    found = np.arange(count, dtype=np.int64)
    return found, address(found)
