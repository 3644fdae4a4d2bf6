"""Functions for which sweeps in machine code wait: called here, as NumPy's passes call them."""

from __future__ import annotations

from functools import partial
from math import inf
from threading import Lock
from typing import NamedTuple, NoReturn

import numpy as np

from pgm.beliefs.moments.compiled.memory import address, aligned
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.machine.emitter.waiting import ALIGNED
from pgm.kernels.machine.sweeps import told
from pgm.kernels.machine.sweeps.asking import Asking
from pgm.linearisation.failures import failure
from pgm.linearisation.family import Family
from pgm.linearisers import BoundFunction, Line, Taylor
from pgm.linearisers.repeated import Repeated

# The runs of a call: the only one, all, or some.
Some = int | slice | Integers


class Failed(Exception):
    """A function has failed for some runs alone, or where a belief may be wrong.

    NumPy's pass tells whether, and of which runs.
    """


class Asked(NamedTuple):
    """For what a sweep waits: rows of a step, at so many points, or, at none, their lines.

    Answers are put from a place on.
    """

    first: int
    after: int
    place: int
    points: int

    @property
    def places(self) -> slice:
        """Where the answers of the rows are put."""
        return slice(self.place, self.place + self.after - self.first)


class _Bound(NamedTuple):
    """A function at so many points of all runs, where they are, and where its values are put.

    These arrays are as the function has them, (*batch, count, n) and (*batch, count, d), without
    an axis for a single point.
    """

    function: Repeated
    points: Array
    values: Array


class Call:
    """A CPD whose function is called: the points at which it is asked for, and its values there.

    `points` (count, n, runs) and `values` (rows, count, d, runs) are for so many points at most,
    and for so many rows of a step; `told` are the values as machine code is told of them.
    """

    def __init__(self, family: Family, count: int, rows: int) -> None:
        _, runs, height, size = family.shape
        self.family = family
        self.points = np.zeros((count, size, runs))
        self.told = self.values = np.zeros((rows, count, height, runs))
        self._bound: dict[int, _Bound] = {}

    def answer(self, asked: Asked, runs: Some) -> None:
        """Call the function at some rows, at the first points of some runs."""
        first, after, place, count = asked
        if place or after - first > 1 or isinstance(runs, np.ndarray):
            self._answer(asked, runs)
            return
        bound = self._bound.get(count) or self._bind(count)
        points = bound.points.copy("K")  # of which the function may keep a view
        try:
            bound.values[...] = bound.function(first, points)
        except Exception as error:
            self._refuse(self._function(asked, runs), points, error)

    def _bind(self, count: int) -> _Bound:
        """The function at so many points of all runs, at one row after another."""
        batch = self.family.batch
        points, values = (
            self._own(cells[:count], batch) for cells in (self.points, self.values[0])
        )
        function = self.family.repeated((count,) if count > 1 else ())
        self._bound[count] = found = _Bound(function, points, values)
        return found

    @staticmethod
    def _own(cells: Array, lead: tuple[int, ...]) -> Array:
        """Numbers at points (count, d, runs), as the function has them."""
        found = cells.transpose(2, 0, 1) if lead else cells[..., 0]
        return found[..., 0, :] if len(cells) == 1 else found

    def _answer(self, asked: Asked, runs: Some) -> None:
        """Call the function at any rows, for any runs."""
        function, count = self._function(asked, runs), asked.points
        some = [runs] if isinstance(runs, int) else runs
        cells = self.points[:count][..., some].copy()  # the runs first, as the function has them
        points = self._own(cells, () if isinstance(runs, int) else (len(cells[0, 0]),))
        try:
            values = function(points)
        except Exception as error:
            self._refuse(function, points, error)
        rows, height = asked.after - asked.first, self.values.shape[2]
        every = values.reshape(-1, count, rows, height).transpose(2, 1, 3, 0)
        self.values[asked.places, :count][..., some] = every

    def _refuse(self, function: BoundFunction, points: Array, error: Exception) -> NoReturn:
        """Raise the error that there is where no machine code is."""
        mean = points[..., 0, :] if points.ndim > 1 + function.lead else points
        if type(self.family.lineariser) is Taylor:
            function(mean)  # which is called first where no machine code is
        refusal = failure(self.family, function, mean.T, error)
        if refusal is error:
            raise error
        raise refusal from error

    def _function(self, asked: Asked, runs: Some) -> BoundFunction:
        """The function at some rows, with the evidence of some runs."""
        function = self.family.at(asked.first, asked.after).function
        assert function is not None
        if not isinstance(runs, np.ndarray):
            return function
        inputs = [v if v is None or len(v) == 1 else v[runs] for v in function.inputs]
        return function._replace(inputs=inputs)


class Lines(Call):
    """A CPD that is linearised here, by its lineariser, at the belief whose mean is asked for.

    Linearisations are put into memory for so many `rows` of a step; see `told.Lines`.
    """

    def __init__(self, family: Family, rows: int) -> None:
        super().__init__(family, 1, rows)
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

    def answer(self, asked: Asked, runs: Some) -> None:
        """Linearise the CPD at some rows for some runs; or call its function at a point."""
        if asked.points:
            super().answer(asked, runs)
            return
        line = self._line(asked, runs)
        where = (asked.places, ..., runs)
        rows, height, batch = asked.after - asked.first, self.value.shape[1], line.value.shape[1:]
        self.value[where] = line.value.reshape(rows, height, *batch)
        self.matrix[where] = line.matrix.reshape(rows, height, -1, *batch)
        if self.error is not None and line.error is not None:
            each = np.arange(rows)
            blocks = line.error.reshape(rows, height, rows, height, *batch)
            self.error[where] = blocks[each, :, each]
        elif self.error is not None:
            self.error[where] = 0.0

    def _line(self, asked: Asked, runs: Some) -> Line:
        """The linearisation of rows, as one vector, at the belief that is asked for."""
        alone = self.every and isinstance(runs, np.ndarray)
        at = self.family.at(asked.first, asked.after)
        if not alone:
            at = at._replace(function=self._function(asked, runs))
        mean, cov = (self._belief(cells[0], runs) for cells in (self.points, self.cov))
        line = self.family.line(at, mean, cov)
        if not alone:
            return line
        matrix, value, error = line
        some = None if error is None else error[..., runs]
        return Line(matrix[..., runs], value[..., runs], some)

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
        self.asked = np.zeros((told.ASKED, runs))  # see `told.WHAT`
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
        leader, all_of_them = asked[:, 0], address(every)
        made.begin(made.floats, begin, table, first, packs)
        go_on = partial(made.go_on, made.floats, begin)
        while self.failure is None:
            due = every if packs == 1 else _together(asked, every)
            alike = due is every
            now = leader if alike else asked[:, due[0]]
            what, count, row, after, place, step, _ = now.tolist()
            if step == inf:
                return
            runs = together if alike else self._runs_of(due, first, lanes)
            wanted = Asked(int(row), int(after), int(place), int(count))
            self._call(self.each[int(what)], wanted, runs)
            go_on(all_of_them if alike else address(due), len(due))

    def _call(self, call: Call, asked: Asked, runs: Some) -> None:
        with self._lock:
            try:
                call.answer(asked, runs)
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
    what, count, row, after, place, step = wanted
    first = np.lexsort((place, after, row, count, what, step))[0]
    found: Integers = np.flatnonzero((wanted == wanted[:, first : first + 1]).all(axis=0))
    return found
