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
from pgm.kernels.machine.newton.blocks import Workspace
from pgm.kernels.machine.newton.equations import PACK, Kept, Layout
from pgm.kernels.machine.newton.squares import Rows
from pgm.kernels.machine.sweeps import told
from pgm.kernels.machine.sweeps.lines import Lines
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
def made(chain: told.Newton) -> Step:
    """The Gauss–Newton step of a chain."""
    module = Module()
    rows = [Rows(module, chain, each, f"squares {k}") for k, each in enumerate(chain.rows)]
    written = _Written(module, chain, rows)
    work = max([written.space.taken, *(written.carries + each.taken for each in rows)])
    return Step(module.compile().callable("newton"), work)


class _Written:
    """The step that is being written, of one run after another."""

    def __init__(self, module: Module, chain: told.Newton, rows: list[Rows]) -> None:
        kinds = ADDRESS, WHOLE, WHOLE, ADDRESS, ADDRESS
        self.code = code = module.function("newton", kinds, disjoint=True)
        self.table, first, last, self.work, equations = code.arguments
        self.equations: Address = equations
        self.chain, self.rows, self.layout = chain, rows, Layout(chain.size)
        self.w = w = Writer(code, self.table, chain, Lines(code))
        self.space = Workspace(code, self.work)
        self.kept = Kept(code, self.layout, self.space)
        size = self.layout.size
        # What is carried from slice to slice: equations going forward, moments going back.
        self.carried = self.kept.room(self.layout.across), self.kept.room(size)
        self.carries = self.space.taken
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
        self._carry_nothing()
        with code.loop(w.last // _AT_ONCE + 1) as part:
            start = part * _AT_ONCE
            end = (start + _AT_ONCE).at_most(w.last + 1)
            fresh = Memory(code, self._slice(start + 1), step=PACK, lanes=PACK)
            with code.loop((end.at_most(w.last) - start) * (layout.length // PACK)) as k:
                fresh.store(k, 0.0)
            given = self.table, run, start, end, self.equations, self.work + self.carries
            for each in self.rows:
                code.call(each.code, *given)
            with code.loop(end, start) as at:
                solved.set(self._eliminate(self._slice(at)))
                code.leave_unless(solved.get())
            code.leave_unless(solved.get())

    def _eliminate(self, place: Address) -> Number:
        """Eliminate a slice; whether that goes."""
        kept, layout, (own, right) = self.kept, self.layout, self.carried
        found = eliminate(
            kept.symmetric(place) - kept.symmetric(own),
            kept.matrix(place + layout.across),
            kept.column(place + layout.right) - kept.column(right),
        )
        kept.put(own, found.own)
        kept.put(right, found.right)
        kept.put(place, found.cov)
        kept.put(place + layout.across, found.gain)
        kept.put(place + layout.right, found.offset)
        goes: Number = found.share > 0.0
        return goes

    def _back(self) -> None:
        """Find slice after slice, going back."""
        code, w, chain, kept, layout = self.code, self.w, self.chain, self.kept, self.layout
        later_cov, later = self.carried
        self._carry_nothing()
        with code.loop(w.last + 1, down=True) as at:
            place = self._slice(at)
            mean, cov = substitute(
                kept.matrix(place + layout.across),
                kept.column(place + layout.right),
                kept.symmetric(place),
                kept.column(later),
                kept.symmetric(later_cov),
            )
            kept.put(later, mean)
            kept.put(later_cov, cov)
            reference, found = w.at(chain.reference, at), w.at(chain.found, at)
            variance = w.at(chain.variance, at)

            def tell(i: Whole | int) -> None:
                found.store(i, reference.load(i) + mean[i, 0])
                variance.store(i, cov[i, i])

            kept.each(tell)

    def _slice(self, at: Whole) -> Address:
        """The equations of a step."""
        return self.equations + at * self.layout.length

    def _carry_nothing(self) -> None:
        own, right = self.carried
        self.kept.clear(own, self.layout.across)
        self.kept.clear(right, self.layout.size)
