"""Draws of runs by counters: run k has the same numbers alone, among others, and in any order.

Each request for n numbers a run has counters of its own, as `pgm.kernels.philox` takes them:

    (k B + b, row, variable, request),   b = 0, 1, ..., B − 1,   B = ⌈n / 4⌉

of run k; `row` is a step, or the place of a reading in the evidence; `variable` is the place of the
child among the network's variables; `request` counts what one CPD asks for at one row, as noise and
its scale. Runs that follow each other have counters that do so, too: one call makes their words.
"""

from __future__ import annotations

import math

import numpy as np

from pgm.errors import ModelError
from pgm.kernels import philox
from pgm.kernels.arrays import Array, Integers

# As many runs as machine code works on together.
_FEW = 8


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
    """The methods of a `numpy.random.Generator` that CPDs with Gaussian and robust noise ask for.

    Results have the axes (*rows, runs) first.
    """

    def __init__(self, draws: CountedDraws, variable: int, rows: Integers) -> None:
        self.draws, self.variable, self.rows, self.requests = draws, variable, rows, 0

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
