"""The squares of a CPD's residuals, linearised along a trajectory, in the normal equations.

A residual is r = z − h(x) of a measurement z, or y − f(x) of a transition to y. With its slope S in
the components of x, and −1 in those of y, and with the inverse W of its noise's covariance, Sᵀ W S
is added to the equations, and Sᵀ W r to their right side. Small ones are written in straight lines,
for some rows at once, as lanes of packs; large ones by loops, row by row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Cells, Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.traces import traced
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.newton.blocks import Block, Workspace
from pgm.kernels.machine.newton.equations import Layout
from pgm.kernels.machine.sweeps import cpd as cpds
from pgm.kernels.machine.sweeps import told
from pgm.kernels.machine.sweeps.lines import Lines
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import Matrix, is_zero, where

# Products that are written as straight lines.
_MOST = 300
# Functions that stay by themselves are compiled faster: LLVM's analyses grow by their squares.
_APART: Any = {"internal": True, "inline": False, "disjoint": True}


def is_small(height: int, every: int) -> bool:
    """Whether residuals of so many components, of so many variables, are straight lines."""
    return height * every * (every + 1) // 2 <= _MOST


class Rows:
    """The rows of a CPD that is being written: a function, and the rows at hand.

    The function is ``add(table, run, begin, end, equations, work)``, of the steps from `begin` up
    to `end`; `taken` says how many floats it works in.
    """

    def __init__(self, module: Module, chain: told.Newton, cpd: told.Squares, name: str) -> None:
        kinds = ADDRESS, WHOLE, WHOLE, WHOLE, ADDRESS, ADDRESS
        self.code = code = module.function(name, kinds, lanes=cpd.lanes, **_APART)
        table, self.run, begin, end, self.equations, work = code.arguments
        self.cpd, self.layout, self.reference = cpd, Layout(chain.size), chain.reference
        lines = Lines(code)
        self.w = Writer(code, table, cpd, lines)
        self._along = Writer(code, table, chain.reference, lines)
        self._along.run = self.run
        self.space = Workspace(code, work)
        addresses = Cells(code, table, Address)
        self._steps = None if cpd.steps is None else addresses.load(cpd.steps)
        self._count = Cells(code, table, Whole).load(cpd.count)
        if cpd.bounds is None:
            self._first, self._last = begin, end.at_most(self._count)
        else:
            bounds = Cells(code, addresses.load(cpd.bounds), Whole)
            self._first, self._last = bounds.load(begin), bounds.load(end)
        self.places = cpd.parents + cpd.child
        if is_small(cpd.height, len(self.places)):
            self._straight()
        else:
            self._by_loops()

    @property
    def taken(self) -> int:
        """The floats that the function works in."""
        return self.space.taken

    def _straight(self) -> None:
        code, lanes = self.code, self.cpd.lanes
        due: list[tuple[int, Any]] = []
        every = range(len(self.places))
        room = code.room(len(every) * (len(every) + 3) // 2)
        with code.loop((self._last - self._first + (lanes - 1)) // lanes) as pack:
            begin = self._first + pack * lanes
            row = begin.at_most(self._count - lanes)
            self.w.run = row
            x = self._point(row)
            mean = Matrix.column(x[: len(self.cpd.parents)])
            line = cpds.linearised(self.w, self.cpd, self.run, mean, mean)
            residual, shift = self._residual([value for (value,) in line.value.rows], x)
            line = line._replace(value=line.value + Matrix.column(shift))
            cpds.keep(self.w, self.cpd, self.run, mean, line)
            pairs = zip(line.matrix.rows, self._own(), strict=True)
            slope = Matrix([*by_parents, *by_child] for by_parents, by_child in pairs)
            weighed = (line.noise @ slope).T
            squares = weighed.times(slope.T)
            for i in every:
                for j in range(i + 1):
                    due.append((self.layout.square(self.places[i], self.places[j]), squares[i, j]))
            right = weighed @ Matrix.column(residual)
            due += [(self.layout.side(place), right[i, 0]) for i, place in enumerate(self.places)]
            due = [(target, number) for target, number in due if not is_zero(number)]
            for k, (_, number) in enumerate(due):
                room.store(k, number)
            add = self._adding([target for target, _ in due])
            ending = (self._last - row).at_most(code.whole(lanes))
            with code.loop(ending, begin - row) as lane:
                code.call(add, self._cells(row + lane).address, room.address + lane)

    def _adding(self, targets: Sequence[int]) -> Code:
        """The function that adds the squares of a lane to the equations of its step.

        Outside of the loop of lanes LLVM does not look for what one lane leaves to the next.
        """
        code = self.code.module.function(f"{self.code.name} added", (ADDRESS, ADDRESS), **_APART)
        cells = Memory(code, code.arguments[0])
        found = Memory(code, code.arguments[1], step=self.cpd.lanes)
        sums = [cells.load(target) + found.load(k) for k, target in enumerate(targets)]
        for target, number in zip(targets, sums, strict=True):
            cells.store(target, number)
        return code

    def _by_loops(self) -> None:
        code, w, space, cpd = self.code, self.w, self.space, self.cpd
        height, size, run = cpd.height, len(cpd.parents), self.run
        slope = space.block(height, len(self.places)).fill(0.0)
        for i in range(len(cpd.child)):
            slope.store(i, size + i, -1.0)
        matrix = Block(space, slope.address, height, size, wide=slope.wide)
        point, weight = space.block(size, 1), space.block(height, height)
        off = space.block(height, 1)
        with code.loop(self._last, self._first) as row:
            w.run = row
            x = self._point(row)
            for i in range(size):
                point.store(i, 0, x[i])
            if cpd.function is None:
                assert cpd.matrix is not None
                assert cpd.offset is not None
                _copied(code, w.at(cpd.matrix, run), matrix)
                line = matrix @ point
                given = w.at(cpd.offset, run)
                value = [line.load(i, 0) + given.load(i) for i in range(height)]
            else:
                given_of = cpds.inputs(w, cpd, run)
                value, slopes = traced(code, cpd.function, x[:size], given_of, slope=True)
                for k, number in enumerate(slopes):
                    if not is_zero(number):
                        matrix.store(*divmod(k, size), number)
            residual, shift = self._residual(value, x)
            if cpd.function is not None and cpd.matrix is not None:
                assert cpd.offset is not None
                _copied_out(code, matrix, w.at(cpd.matrix, run))
                line, kept = matrix @ point, w.at(cpd.offset, run)
                for i, number in enumerate(value):
                    kept.store(i, number + shift[i] - line.load(i, 0))
            for i, number in enumerate(residual):
                off.store(i, 0, number)
            _copied(code, w.at(cpd.noise, run), weight)
            weighed = (weight @ slope).T
            squares, right = weighed.times(slope.T), weighed @ off
            cells = self._cells(row)
            for i, place in enumerate(self.places):
                target = self.layout.side(place)
                cells.store(target, cells.load(target) + right.load(i, 0))
            self._add(cells, squares)

    def _point(self, row: Whole) -> list[Number]:
        """The components of the slices that the rows at hand know, at the reference."""
        lanes, size = range(self.cpd.lanes), self.layout.size
        found = [Number(self.code, "poison", self.cpd.lanes)] * len(self.places)
        for lane in lanes:
            at = self._step(row + lane if lane else row)
            here, later = self._slice(at), None
            for k, place in enumerate(self.places):
                if place >= size and later is None:
                    later = self._slice(at + 1)
                cells = here if place < size else later
                assert cells is not None
                found[k] = found[k].with_lane(lane, cells.load(place % size))
        return found

    def _slice(self, at: Whole) -> Memory:
        """The reference at a step."""
        place = self._along.at(self.reference, at)
        return Memory(self.code, place.address, step=place.step, lanes=1)

    def _step(self, row: Whole) -> Whole:
        return row if self._steps is None else Cells(self.code, self._steps, Whole).load(row)

    def _cells(self, row: Whole) -> Memory:
        """The equations of a row's step."""
        place = self.equations + self._step(row) * self.layout.length
        return Memory(self.code, place, lanes=1)

    def _own(self) -> list[list[float]]:
        """The slope of a residual in the child of a transition."""
        size = range(len(self.cpd.child))
        return [[-1.0 if i == j else 0.0 for j in size] for i in range(self.cpd.height)]

    def _residual(self, value: Sequence[Any], x: Sequence[Number]) -> tuple[list[Any], list[Any]]:
        """Residuals of a value; and its shift, where a transition's child is on another branch."""
        cpd, w = self.cpd, self.w
        if cpd.readings is None:
            given = list(x[len(cpd.parents) :])
        else:
            given = [number for (number,) in w.column(cpd.readings, self.run).rows]
        left = list(given)
        for k in cpd.angles:
            left[k] = step.nearest(given[k], value[k])
        w.keep(cpd.moved, Matrix.column(left), self.run)
        found = [a - b for a, b in zip(left, value, strict=True)]
        if cpd.missing:
            found = [where(a == a, b, 0.0) for a, b in zip(left, found, strict=True)]
        turning = cpd.angles if cpd.readings is None else ()
        shift = [given[k] - left[k] if k in turning else 0.0 for k in range(cpd.height)]
        return found, shift

    def _add(self, cells: Memory, squares: Block) -> None:
        """Add squares to the equations of a step, stretch by stretch of places in a row."""
        code, layout = self.code, self.layout
        stretches = list(_stretches(self.places, layout.size))
        for (i, place, count), (j, other, many) in _pairs(stretches):
            first = layout.square(place, other)
            with code.loop(count) as a, code.loop(many) as b:
                target = a * layout.wide + b + first
                cells.store(target, cells.load(target) + squares.load(a + i, b + j))


Stretch = tuple[int, int, int]


def _stretches(places: Sequence[int], size: int) -> Iterator[Stretch]:
    """Where places of a slice follow each other: the first one's number, itself, and how many."""
    for _, group in groupby(enumerate(places), lambda each: (each[1] - each[0], each[1] // size)):
        (number, place), *rest = group
        yield number, place, 1 + len(rest)


def _pairs(stretches: Sequence[Stretch]) -> Iterator[tuple[Stretch, Stretch]]:
    """Pairs of stretches, each with itself too, whose places are in order."""
    ordered = sorted(stretches, key=lambda each: each[1])
    for k, first in enumerate(ordered):
        for later in ordered[k:]:
            yield first, later


def _copied(code: Code, cells: Memory, block: Block) -> None:
    """Copy a matrix into a block."""
    height, width = block.shape
    with code.loop(height) as i, code.loop(width) as j:
        block.store(i, j, cells.load(i * width + j))


def _copied_out(code: Code, block: Block, cells: Memory) -> None:
    """Copy a block into a matrix."""
    height, width = block.shape
    with code.loop(height) as i, code.loop(width) as j:
        cells.store(i * width + j, block.load(i, j))
