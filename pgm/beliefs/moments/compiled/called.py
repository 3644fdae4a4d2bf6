"""Functions for which sweeps in machine code wait: called here, as NumPy's passes call them."""

from __future__ import annotations

from threading import Lock

import numpy as np

from pgm.beliefs.moments.compiled.memory import aligned
from pgm.kernels.arrays import Array, Integers, address
from pgm.kernels.machine.emitter.waiting import ALIGNED
from pgm.kernels.machine.sweeps import told
from pgm.kernels.machine.sweeps.asking import Asking
from pgm.linearisation.failures import failure
from pgm.linearisation.family import Family
from pgm.linearisers import BoundFunction, Taylor

# The runs of a call: the only one, all, or some.
Some = int | slice | Integers


class Failed(Exception):
    """A function has failed for some runs alone, or where a belief may be wrong.

    NumPy's pass tells whether, and of which runs.
    """


class Call:
    """A CPD whose function is called: the points at which it is asked for, and its values there.

    `points` (count, n, runs) and `values` (count, d, runs) are for so many points at most.
    """

    def __init__(self, family: Family, count: int) -> None:
        _, runs, height, size = family.shape
        self.family = family
        self.points, self.values = np.zeros((count, size, runs)), np.zeros((count, height, runs))

    def answer(self, row: int, count: int, runs: Some) -> None:
        """Call the function at a row, at the first points of some runs."""
        function = self._bound(row, runs)
        asked = self.points[:count, :, runs]
        # The runs first, in memory of which the function may keep a view.
        points = asked.copy() if isinstance(runs, int) else asked.copy().transpose(2, 0, 1)
        points = points[..., 0, :] if count == 1 else points
        values = self._values(function, points)
        found = values[..., None, :] if count == 1 else values
        self.values[:count, :, runs] = found if isinstance(runs, int) else found.transpose(1, 2, 0)

    def _values(self, function: BoundFunction, points: Array) -> Array:
        try:
            return function(points)
        except Exception as error:
            mean = points[..., 0, :] if points.ndim > 1 + function.lead else points
            if type(self.family.lineariser) is Taylor:
                function(mean)  # which is called first where no machine code is
            refusal = failure(self.family, function, mean.T, error)
            if refusal is error:
                raise
            raise refusal from error

    def _bound(self, row: int, runs: Some) -> BoundFunction:
        """The function at a row, with the evidence of some runs."""
        function = self.family.at(row, row + 1).function
        assert function is not None
        if not isinstance(runs, np.ndarray):
            return function
        inputs = [v if v is None or len(v) == 1 else v[runs] for v in function.inputs]
        return function._replace(inputs=inputs)


class Lines(Call):
    """A CPD that is linearised here, by its lineariser, at the belief whose mean is asked for.

    Linearisations are put into memory for so many `rows` at a time; see `told.Lines`.
    """

    def __init__(self, family: Family, rows: int) -> None:
        super().__init__(family, 1)
        _, runs, height, size = family.shape
        self.runs = runs
        # Points that are drawn anew for each run depend on how many runs come before it.
        self.every = bool(getattr(family.lineariser, "fresh_per_run", False))
        self.cov = np.zeros((1, size, size, runs))
        self.value, self.matrix = (
            np.zeros((rows, height, runs)),
            np.zeros((rows, height, size, runs)),
        )
        exact = type(family.lineariser) is Taylor or not family.hidden
        self.error = None if exact else np.zeros((rows, height, height, runs))

    def answer(self, row: int, count: int, runs: Some) -> None:
        """Linearise the CPD at a row for some runs; or call its function, where `count` is one."""
        if count:
            super().answer(row, count, runs)
            return
        alone = self.every and isinstance(runs, np.ndarray)
        at = self.family.at(row, row + 1)
        if not alone:
            at = at._replace(function=self._bound(row, runs))
        mean, cov = (self._belief(cells[0], runs) for cells in (self.points, self.cov))
        line = self.family.line(at, mean, cov)
        place, some = row % len(self.value), runs if alone else slice(None)
        self.value[place][..., runs] = line.value[..., some]
        self.matrix[place][..., runs] = line.matrix[..., some]
        if self.error is not None:
            self.error[place][..., runs] = 0.0 if line.error is None else line.error[..., some]

    def _belief(self, cells: Array, runs: Some) -> Array:
        """Numbers of some runs, in memory that may be kept; of all where points are drawn anew."""
        found: Array = cells[..., runs].copy()
        if not (self.every and isinstance(runs, np.ndarray)):
            return found
        every = np.repeat(found[..., :1], self.runs, axis=-1)
        every[..., runs] = found
        return every


class Calls:
    """The functions that are called in a sweep, one at a time, and what is asked of them."""

    def __init__(self, runs: int) -> None:
        self.asked = np.zeros((5, runs))  # see `told.WHAT`
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
        begin, together = address(frames), self._runs_of(every, first, lanes)
        asked = self.asked[:, first : first + packs * lanes : lanes]
        made.begin(table, first, packs, begin)
        while self.failure is None:
            due = every if packs == 1 else _together(asked, every)
            what, count, row, step, _ = asked[:, due[0]].tolist()
            if step == np.inf:
                return
            runs = together if due is every else self._runs_of(due, first, lanes)
            self._call(self.each[int(what)], int(row), int(count), runs)
            made.go_on(begin, address(due), len(due))

    def _call(self, call: Call, row: int, count: int, runs: Some) -> None:
        with self._lock:
            try:
                call.answer(row, count, runs)
            except Exception as error:
                if not isinstance(runs, np.ndarray) and self.asked[told.SURE].all():
                    raise
                raise Failed(f"{call.family.cpd!r} failed in machine code") from error

    def _runs_of(self, packs: Integers, first: int, lanes: int) -> Some:
        if self._runs == 1:
            return 0
        if len(packs) * lanes == self._runs:
            return slice(None)
        found: Integers = (first + packs[:, None] * lanes + np.arange(lanes)).ravel()
        return found


def _together(asked: Array, every: Integers) -> Integers:
    """The packs, of those that are furthest behind, that ask for the same."""
    wanted = asked[: told.SURE]
    same = (wanted == wanted[:, :1]).all(axis=0)
    if same.all():
        return every
    what, count, row, step = wanted
    first = np.lexsort((row, count, what, step))[0]
    found: Integers = np.flatnonzero((wanted == wanted[:, first : first + 1]).all(axis=0))
    return found
