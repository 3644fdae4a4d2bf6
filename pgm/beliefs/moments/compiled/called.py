"""Functions for which sweeps in machine code wait: called here, as NumPy's passes call them."""

from __future__ import annotations

from threading import Lock

import numpy as np

from pgm.beliefs.moments.compiled.memory import address, aligned
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.machine import told
from pgm.kernels.machine.asking import Asking
from pgm.kernels.machine.waiting import ALIGNED
from pgm.linearisation.family import Family
from pgm.linearisation.rows import At
from pgm.linearisers import Taylor

# The runs of a call: the only one, all, or some.
Some = int | slice | Integers


class Failed(Exception):
    """A function has failed for some runs alone, or where a belief may be wrong.

    NumPy's pass tells whether, and of which runs.
    """


class Call:
    """A CPD whose function is called: the beliefs at which it is asked for, and what it answers.

    Arrays have rows first and runs last; see `told.Called`.
    """

    def __init__(self, family: Family, rows: int) -> None:
        _, runs, height, size = family.shape
        self.family, self._runs = family, runs
        # Points that are drawn anew for each run depend on how many runs come before it.
        self._whole = bool(getattr(family.lineariser, "fresh_per_run", False)) and runs > 1
        self.mean, self.cov = np.zeros((rows, size, runs)), np.zeros((rows, size, size, runs))
        self.value, self.matrix = np.zeros((rows, height, runs)), np.zeros((rows, height, size, runs))
        exact = type(family.lineariser) is Taylor or not family.hidden
        self.error = None if exact else np.zeros((rows, height, height, runs))

    def linearise(self, row: int, runs: Some) -> None:
        """Linearise the CPD at a row, for some runs."""
        place = row % len(self.mean)
        at = self._at(row, runs)
        mean, cov = (self._asked(each[place], runs) for each in (self.mean, self.cov))
        line = self.family.line(at, mean, cov)
        self._answer(self.value[place], line.value, runs)
        self._answer(self.matrix[place], line.matrix, runs)
        if self.error is not None:
            error = np.zeros(()) if line.error is None else line.error
            self._answer(self.error[place], error, runs)

    def evaluate(self, row: int, runs: Some) -> None:
        """Call the function at a row, for some runs."""
        place = row % len(self.mean)
        function = self._at(row, runs).function
        assert function is not None
        value = function(self._asked(self.mean[place], runs).T)
        self._answer(self.value[place], value.T, runs)

    def _at(self, row: int, runs: Some) -> At:
        """The CPD at a row with the evidence of some runs."""
        at = self.family.at(row, row + 1)
        if self._whole or not isinstance(runs, np.ndarray):
            return at
        function = at.function
        assert function is not None
        inputs = [v if v is None or len(v) == 1 else v[runs] for v in function.inputs]
        return at._replace(function=function._replace(inputs=inputs))

    def _asked(self, cells: Array, runs: Some) -> Array:
        """The beliefs of some runs, in an array that may be kept."""
        some: Array = cells[..., runs].copy()
        if not self._whole or not isinstance(runs, np.ndarray):
            return some
        every = np.repeat(some[..., :1], self._runs, axis=-1)
        every[..., runs] = some
        return every

    def _answer(self, cells: Array, found: Array, runs: Some) -> None:
        if self._whole and isinstance(runs, np.ndarray) and found.ndim:
            found = found[..., runs]
        cells[..., runs] = found


class Calls:
    """The functions that are called in a sweep, one at a time, and what is asked of them."""

    def __init__(self, runs: int) -> None:
        self.asked = np.zeros((4, runs))  # see `told.WHAT`
        self.each: list[Call] = []
        self.failure: BaseException | None = None
        self._lock, self._runs = Lock(), runs

    def sweep(self, made: Asking, table: int, first: int, last: int, lanes: int) -> None:
        """Sweep the runs from `first` to below `last`, at least as many as lanes."""
        packs = (last - first) // lanes
        try:
            self._packs(made, table, first, packs, lanes)
            if first + packs * lanes < last:
                # The last pack shares runs, which may be at another place of a step by then.
                self._packs(made, table, last - lanes, 1, lanes)
        except BaseException as error:
            self.failure = self.failure or error

    def _packs(self, made: Asking, table: int, first: int, packs: int, lanes: int) -> None:
        frames, every = aligned(packs * made.floats, ALIGNED), np.arange(packs)
        asked = self.asked[:, first : first + packs * lanes : lanes]
        made.begin(table, first, packs, address(frames))
        while self.failure is None:
            due = every if packs == 1 else _together(asked, every)
            what, row, step, _ = asked[:, due[0]].tolist()
            if step == np.inf:
                return
            some = (first + due[:, None] * lanes + np.arange(lanes)).ravel()
            self._call(int(what), int(row), some)
            made.go_on(address(frames), address(due), len(due))

    def _call(self, what: int, row: int, runs: Integers) -> None:
        every = len(runs) == self._runs
        some: Some = runs
        if every:
            some = 0 if self._runs == 1 else slice(None)
        call = self.each[what // 2]
        answer = call.evaluate if what % 2 else call.linearise
        with self._lock:
            try:
                answer(row, some)
            except Exception as error:
                if every and self.asked[told.SURE].all():
                    raise
                raise Failed(f"{call.family.cpd!r} failed in machine code") from error


def _together(asked: Array, every: Integers) -> Integers:
    """The packs, of those that are furthest behind, that ask for the same."""
    same = (asked[:3] == asked[:3, :1]).all(axis=0)
    if same.all():
        return every
    what, row, step, _ = asked
    first = np.lexsort((row, what, step))[0]
    found: Integers = np.flatnonzero((asked[:3] == asked[:3, first : first + 1]).all(axis=0))
    return found
