"""The squares of a CPD's residuals, linearised along a trajectory, in the normal equations.

A residual is r = z − h(x) of a measurement z, or y − f(x) of a transition to y. With its slope S in
the components of x, and −1 in those of y, and with the inverse W of its noise's covariance, Sᵀ W S
is added to the equations, and Sᵀ W r to their right side. Small ones are written in straight lines,
for some rows at once, as lanes of packs; large ones by loops, row by row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby, product
from typing import Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Cells, Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.matrices.in_memory.frame import Frame
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.matrices.loops import Loops
from pgm.kernels.machine.matrices.protocol import Matrices
from pgm.kernels.machine.newton import problem
from pgm.kernels.machine.newton.equations import Layout
from pgm.kernels.machine.sweeps import cpd as cpds
from pgm.kernels.machine.sweeps.cpd import Line
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import is_zero, where
from pgm.kernels.step import AnyMatrix

# Products that are written as straight lines.
_MOST = 300
# Functions that stay by themselves are compiled faster: LLVM's analyses grow by their squares.
_APART: Any = {"internal": True, "inline": False, "disjoint": True}


def is_small(height: int, every: int) -> bool:
    """Whether residuals of so many components, of so many variables, are straight lines."""
    return height * every * (every + 1) // 2 <= _MOST


class Rows:
    """The rows of a CPD that is being written: a function, and the rows at hand.

    The function is ``add(table, run, begin, end, equations, room)``, of the steps from `begin` up
    to `end`; `room` says how many floats it works in.
    """

    def __init__(
        self, module: Module, chain: problem.Newton, cpd: problem.Squares, name: str
    ) -> None:
        kinds = ADDRESS, WHOLE, WHOLE, WHOLE, ADDRESS, ADDRESS
        self.code = code = module.function(name, kinds, lanes=cpd.lanes, **_APART)
        table, self.run, begin, end, self.equations, room = code.arguments
        self.cpd, self.layout, self.reference = cpd, Layout(chain.size), chain.reference
        self.places = cpd.parents + cpd.child
        frame = Frame(code, room)
        small = is_small(cpd.height, len(self.places))
        self.matrices: Matrices = Lines(code) if small else Loops(code, frame)
        self.w = Writer(code, table, cpd, self.matrices)
        self._along = Writer(code, table, chain.reference, self.matrices)
        self._along.run = self.run
        addresses = Cells(code, table, Address)
        self._steps = None if cpd.steps is None else addresses.load(cpd.steps)
        self._count = Cells(code, table, Whole).load(cpd.count)
        if cpd.bounds is None:
            self._first, self._last = begin, end.at_most(self._count)
        else:
            bounds = Cells(code, addresses.load(cpd.bounds), Whole)
            self._first, self._last = bounds.load(begin), bounds.load(end)
        if small:
            self._by_packs()
        else:
            self._row_by_row()
        self.room = frame.size

    def _by_packs(self) -> None:
        code, lanes, layout = self.code, self.cpd.lanes, self.layout
        every = range(len(self.places))
        room = code.room(len(every) * (len(every) + 1))
        with code.loop((self._last - self._first + (lanes - 1)) // lanes) as pack:
            begin = self._first + pack * lanes
            row = begin.at_most(self._count - lanes)
            squares, right = self._squares(row)
            due: list[tuple[int, Any]] = []
            for i in every:
                for j in range(i + 1):
                    targets = sorted(layout.squares(self.places[i], self.places[j]))
                    due += [(target, squares[i, j]) for target in targets]
            due += [(layout.side(place), right[i, 0]) for i, place in enumerate(self.places)]
            due = [(target, number) for target, number in due if not is_zero(number)]
            for k, (_, number) in enumerate(due):
                room.store(k, number)
            add = self._adding([target for target, _ in due])
            ending = (self._last - row).at_most(code.whole(lanes))
            with code.loop(ending, begin - row) as lane:
                code.call(add, self._cells(row + lane).address, room.address + lane)

    def _row_by_row(self) -> None:
        with self.code.loop(self._last, self._first) as row:
            squares, right = self._squares(row)
            cells = self._cells(row)
            for i, place in enumerate(self.places):
                target = self.layout.side(place)
                cells.store(target, cells.load(target) + right[i, 0])
            self._add(cells, squares)

    def _squares(self, row: Whole) -> tuple[AnyMatrix, AnyMatrix]:
        """The squares Sᵀ W S of rows, and Sᵀ W r."""
        w, cpd, matrices = self.w, self.cpd, self.matrices
        w.run = row
        x, size = self._point(row), len(cpd.parents)
        mean = self._vector(x[:size])
        line = cpds.linearised(w, cpd, self.run, mean, mean)
        residual, line = self._residual(line, x[size:])
        cpds.keep(w, cpd, self.run, mean, line)
        slope = line.matrix
        if cpd.child:
            own = range(cpd.height)
            minus = matrices.constant([[-1.0 if i == j else 0.0 for j in own] for i in own])
            slope = matrices.above(slope.T, minus).T
        weighed = (line.noise @ slope).T
        return weighed.times(slope.T), weighed @ residual

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

    def _vector(self, numbers: Sequence[Number]) -> AnyMatrix:
        """The vector of numbers."""
        zeros = self.matrices.constant([[0.0] * len(numbers)]).T
        return self.matrices.replaced(zeros, dict(enumerate(numbers)))

    def _residual(self, line: Line, child: Sequence[Number]) -> tuple[AnyMatrix, Line]:
        """Residuals; and the line, moved where a transition's child is on another branch."""
        cpd, w, matrices, value = self.cpd, self.w, self.matrices, line.value
        given = self._vector(child) if cpd.readings is None else w.column(cpd.readings, self.run)
        left = cpds.on_branch(w, given, value, cpd.angles)
        w.keep(cpd.moved, left, self.run)
        residual = left - value
        if cpd.missing:
            both = zip(matrices.beside(left), matrices.beside(residual), strict=True)
            found = [where(a == a, b, 0.0) for a, b in both]
            residual = matrices.with_columns(residual, {0: found})
        if cpd.readings is None:
            moved = {k: value[k, 0] + (given[k, 0] - left[k, 0]) for k in cpd.angles}
            line = line._replace(value=matrices.replaced(value, moved))
        return residual, line

    def _add(self, cells: Memory, squares: AnyMatrix) -> None:
        """Add squares to the equations of a step, stretch by stretch of places in a row."""
        code, layout = self.code, self.layout
        stretches = list(_stretches(self.places, layout.size))
        for (i, place, count), (j, other, many) in product(stretches, repeat=2):
            if place // layout.size > other // layout.size:
                continue  # across there is one block
            first = layout.square(place, other)
            with code.loop(count) as a, code.loop(many) as b:
                target = a * layout.size + b + first
                cells.store(target, cells.load(target) + squares[a + i, b + j])


Stretch = tuple[int, int, int]


def _stretches(places: Sequence[int], size: int) -> Iterator[Stretch]:
    """Where places of a slice follow each other: the first one's number, itself, and how many."""
    for _, group in groupby(enumerate(places), lambda each: (each[1] - each[0], each[1] // size)):
        (number, place), *rest = group
        yield number, place, 1 + len(rest)
