"""Draws of runs by counters: run k has the same numbers alone, among others, and in any order.

Each request for n numbers a run has counters of its own, as `pgm.kernels.philox` takes them:

    (k B + b, row, variable, request),   b = 0, 1, ..., B − 1,   B = ⌈n / 4⌉

of run k; `row` is a step, or the place of a reading in the evidence; `variable` is the place of the
child among the network's variables; `request` counts what one CPD asks for at one row, as noise and
its scale. Runs that follow each other have counters that do so, too: one call makes their words.

A case of a CPD, which holds in some runs, has requests of its own, of which numbers are made for
all runs: so those of a run do not depend on which cases hold in others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from pgm.errors import ModelError
from pgm.kernels import philox
from pgm.kernels.arrays import Array, Integers

# As many runs as machine code works on together.
_FEW = 8
# More cases than a CPD may have whose draws are counted, and more than its requests.
CASES = 2**12


class CountedDraws:
    """The draws of runs `first`, `first` + 1, ... of a seed, as a `Generator` for each row.

    Machine code, if it is asked for by `compiled`, gives the same words, and normal numbers that
    are the same to rounding.
    """

    def __init__(self, seed: int, first: int, runs: int, *, compiled: bool = False) -> None:
        self.source, self.first, self.runs = philox.Philox(seed), first, runs
        self.compiled = compiled and runs >= _FEW

    def at(self, variable: int, rows: int | Integers) -> Stream:
        """The draws of a CPD's child at one step, or at the rows (m,) of a sensor."""
        return Stream(self, variable, np.asarray(rows))


class Stream:
    """The methods of a `numpy.random.Generator` that CPDs whose draws are counted ask for.

    Results have the axes (*rows, runs) first. Requests are counted from `case` · 2¹² on.
    """

    def __init__(self, draws: CountedDraws, variable: int, rows: Integers, case: int = 0) -> None:
        self.draws, self.variable, self.rows = draws, variable, rows
        self.case, self.requests = case, case * CASES

    def of_case(self, number: int, which: Integers) -> CaseStream:
        """The draws of a case, at those of the flattened rows and runs where it holds, (m,)."""
        case = self.case * CASES + number + 1
        return CaseStream(Stream(self.draws, self.variable, self.rows, case), which)

    def random(self, size: tuple[int, ...]) -> Array:
        """Uniform numbers in (0, 1)."""
        count = self._count(size)
        if self.draws.compiled:
            return self._compiled(size, count, normal=False)
        lead = (*self.rows.shape, self.draws.runs)
        blocks = -(-count // philox.BLOCK)
        words = [
            self.draws.source.words(
                (self.draws.first * blocks, row, self.variable, self.requests),
                self.draws.runs * blocks * philox.BLOCK,
            )
            for row in self.rows.reshape(-1).tolist()
        ]
        self.requests += 1
        each = np.reshape(words, (*lead, blocks * philox.BLOCK))[..., :count]
        return philox.uniforms(each).reshape(size)

    def _count(self, size: tuple[int, ...]) -> int:
        """How many numbers are asked for, of each row and run."""
        lead = (*self.rows.shape, self.draws.runs)
        if size[: len(lead)] != lead:
            raise ModelError(
                f"draws of shape {size} are asked for, where those of {lead} rows and runs are "
                "counted: a noise of one's own draws one number, or one vector, for each"
            )
        return math.prod(size[len(lead) :])

    def _compiled(self, size: tuple[int, ...], count: int, *, normal: bool) -> Array:
        from pgm.kernels.machine.studies import draws  # here, as llvmlite may not be installed

        own, request = self.draws, self.requests
        self.requests += 1
        which = own.first, own.runs, self.rows.reshape(-1), self.variable, request, count
        return draws.numbers(own.source, *which, normal=normal).reshape(size)

    def standard_normal(self, size: tuple[int, ...]) -> Array:
        """Standard normal numbers."""
        if self.draws.compiled:
            return self._compiled(size, self._count(size), normal=True)
        return philox.normals(self.random(size))

    def chisquare(self, df: float, size: tuple[int, ...]) -> Array:
        """χ² numbers with `df` degrees of freedom."""
        return philox.chi_squares(self.random(size), df)


class CaseStream:
    """The draws of one case of a CPD, whose results have the axis of rows and runs (m,) first."""

    def __init__(self, stream: Stream, which: Integers) -> None:
        self.stream, self.which = stream, which

    def of_case(self, number: int, which: Integers) -> CaseStream:
        """The draws of a case within the case, at some of its rows and runs."""
        return CaseStream(self.stream.of_case(number, which).stream, self.which[which])

    def _some(self, draw: Callable[[tuple[int, ...]], Array], size: tuple[int, ...]) -> Array:
        """Some of the numbers of all rows and runs."""
        own = size[1:]
        whole = draw((*self.stream.rows.shape, self.stream.draws.runs, *own))
        found: Array = whole.reshape(-1, *own)[self.which]
        return found

    def random(self, size: tuple[int, ...]) -> Array:
        """Uniform numbers in (0, 1)."""
        return self._some(self.stream.random, size)

    def standard_normal(self, size: tuple[int, ...]) -> Array:
        """Standard normal numbers."""
        return self._some(self.stream.standard_normal, size)

    def chisquare(self, df: float, size: tuple[int, ...]) -> Array:
        """χ² numbers with `df` degrees of freedom."""
        return self._some(partial(self.stream.chisquare, df), size)
