"""Gauss–Newton steps of a chain in machine code.

A chain linearised at a trajectory is a least-squares problem, whose normal equations have a block
for each slice and one for each pair of neighbours. On the way forward slices are eliminated, on the
way back their means are found, with the blocks of the inverse; see `normal_equations`. No
covariance is carried forward, and no noise may be singular.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.variables import Variable
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.matrices.in_memory.frame import Frame
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.matrices.loops import Loops
from pgm.kernels.machine.matrices.protocol import Belief, Matrices
from pgm.kernels.machine.newton import problem
from pgm.kernels.machine.newton.equations import PACK, Layout
from pgm.kernels.machine.newton.squares import Rows
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.normal_equations import eliminate, substitute

# So many steps are linearised before they are eliminated: their equations are still at hand.
_AT_ONCE = 64


class Step(NamedTuple):
    """A Gauss–Newton step, ``step(table, first, last, work, equations)``, of the runs of a call.

    It tells of each run whether its equations have no solution. `work` are so many floats to work
    in, and `equations` as many as `Layout.length` for each step from 0 on.
    """

    call: Callable[[int, int, int, int, int], None]
    work: int


@lru_cache(maxsize=128)
def made(chain: problem.Newton) -> Step:
    """The Gauss–Newton step of a chain."""
    module = Module()
    rows = [Rows(module, chain, each, f"squares {k}") for k, each in enumerate(chain.rows)]
    written = _Written(module, chain, rows)
    # More of LLVM's passes take twice as long, and make no faster code of it.
    return Step(module.compile(1).callable("newton"), written.frame.size)


class _Written:
    """The step that is being written, of one run after another."""

    def __init__(self, module: Module, chain: problem.Newton, rows: list[Rows]) -> None:
        kinds = ADDRESS, WHOLE, WHOLE, ADDRESS, ADDRESS
        self.code = code = module.function("newton", kinds, disjoint=True)
        self.table, first, last, work, equations = code.arguments
        self.equations: Address = equations
        self.chain, self.rows, self.layout = chain, rows, Layout(chain.size)
        self.frame = frame = Frame(code, work)
        # Rows are linearised one after another, in the same room.
        self.room = frame.take(max((each.room for each in rows), default=0))
        self.matrices: Matrices = Lines(code) if self.layout.straight else Loops(code, frame)
        self.w = w = Writer(code, self.table, chain, self.matrices)
        with code.loop(last, first) as run:
            w.run = run
            with code.when(w.at(chain.active).load(0) > 0.0):
                solved = code.varying(True)
                self._forward(run, solved)
                with code.when(solved.get()):
                    self._back()
                with code.when(~solved.get()):
                    w.ended(0).store(0, 1.0)

    def _forward(self, run: Whole, solved: Variable[Number]) -> None:
        """Linearise a run, and eliminate slice after slice, as long as that goes."""
        code, w, layout = self.code, self.w, self.layout
        begin, first = w.at(self.chain.begin), self._slice(code.whole(0))
        with code.loop(layout.length) as k:
            Memory(code, first).store(k, begin.load(k))
        carried = self._nothing()  # of the equations of the slices before
        with code.loop(w.last // _AT_ONCE + 1) as part:
            start = part * _AT_ONCE
            end = (start + _AT_ONCE).at_most(w.last + 1)
            fresh = Memory(code, self._slice(start + 1), step=PACK, lanes=PACK)
            with code.loop((end.at_most(w.last) - start) * (layout.length // PACK)) as k:
                fresh.store(k, 0.0)
            given = self.table, run, start, end, self.equations, self.room
            for each in self.rows:
                code.call(each.code, *given)
            with code.loop(end, start) as at:
                solved.set(self._eliminate(self._slice(at), carried))
                code.leave_unless(solved.get())
            code.leave_unless(solved.get())

    def _eliminate(self, place: Address, carried: Belief) -> Number:
        """Eliminate a slice; whether that goes."""
        matrices, (own, across, right) = self.matrices, self._cells(place)
        size = self.layout.size
        with matrices.scratch():
            found = eliminate(
                matrices.symmetric(own, size) - carried.cov,
                matrices.matrix(across, size, size),
                matrices.column(right, size) - carried.mean,
            )
            carried.set(found.right, found.own)
            matrices.keep(own, found.cov)
            matrices.keep(across, found.gain)
            matrices.keep(right, found.offset)
            goes: Number = found.share > 0.0
        return goes

    def _back(self) -> None:
        """Find slice after slice, going back."""
        code, w, chain = self.code, self.w, self.chain
        matrices, size = self.matrices, self.layout.size
        later = self._nothing()
        with code.loop(w.last + 1, down=True) as at, matrices.scratch():
            own, across, right = self._cells(self._slice(at))
            mean, cov = substitute(
                matrices.matrix(across, size, size),
                matrices.column(right, size),
                matrices.symmetric(own, size),
                later.mean,
                later.cov,
            )
            later.set(mean, cov)
            w.keep(chain.found, w.column(chain.reference, at) + mean, at)
            variance = w.at(chain.variance, at)
            for k, number in enumerate(cov.diagonal):
                variance.store(k, number)

    def _slice(self, at: Whole) -> Address:
        """The equations of a step."""
        return self.equations + at * self.layout.length

    def _cells(self, place: Address) -> list[Memory]:
        """The cells of a slice: its own matrix, that across, and the right side."""
        begins = 0, self.layout.across, self.layout.right
        return [Memory(self.code, place + begin) for begin in begins]

    def _nothing(self) -> Belief:
        """A vector and a symmetric matrix that are carried from slice to slice: zeros at first."""
        zeros = self.matrices.constant([[0.0] * self.layout.size] * self.layout.size)
        return self.matrices.carried(zeros.part((0,), range(self.layout.size)).T, zeros)
