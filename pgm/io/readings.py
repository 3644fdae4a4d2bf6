"""Stamped measurements, each put at the state nearest in time."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.display import Shown, Summary
from pgm.errors import EvidenceError
from pgm.evidence import Constant, Sightings, sightings
from pgm.evidence.rows import as_rows, require_radians, taken_readings
from pgm.io.stamped import (
    SAME,
    Stamped,
    as_stamps,
    as_table,
    clock,
    nearest,
    require_finite_rows,
    require_stamped,
    rows_text,
    sealed,
)
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

NOT_TAKEN, COPY, BEFORE, AFTER, FAR = (
    "not taken",
    "a copy of an earlier row",
    "before the first state",
    "after the last state",
    "too far from any state",
)
# Reasons that have nothing to do with time.
UNTIMED = (NOT_TAKEN, COPY)


@dataclass(frozen=True, eq=False, repr=False)
class ReadingReport(Shown):
    """The measurements of one sensor's log in its order, each kept, or left out and why.

    Attributes
    ----------
    stamps : ndarray
        (M,), seconds; the logs of a list of them one after the other.
    step : ndarray of int
        (M,): the state nearest in time.
    shift : ndarray
        (M,): how far [s] that state is from the measurement, positive where it is later.
    reason : ndarray of str
        (M,): why the measurement was dropped, empty where it was kept.
    repeated : ndarray of bool
        (M,): whether a measurement kept has the stamp and the landmark of an earlier one kept. Both
        count in the evidence.
    copied : ndarray of bool
        (M,): whether a measurement has the stamp, the landmark and the value of an earlier one.
    backwards : int
        How many rows are stamped before the row above them.

    Examples
    --------
    >>> z = pgm.Variable("z")
    >>> rows = pgm.stamped([0.25, 2.0, 7.0], [4.0, 5.0, 6.0])
    >>> log = pgm.timeline([0.0, 1.0, 2.0], sensors={z: rows})
    >>> log.readings[z].shift
    array([-0.25,  0.  , -5.  ])
    >>> log.readings[z].kept
    array([ True,  True, False])
    """

    stamps: Array
    step: Integers
    shift: Array
    reason: npt.NDArray[np.str_]
    repeated: Mask
    copied: Mask
    backwards: int

    @property
    def kept(self) -> Mask:
        """The mask of measurements in the evidence, (M,); there they stand in the same order."""
        kept: Mask = self.reason == ""
        return kept

    @property
    def moved(self) -> Mask:
        """The mask of measurements kept that are not of the moment of their state, (M,)."""
        return self.kept & (np.abs(self.shift) > SAME)

    @property
    def dropped(self) -> Integers:
        """The rows of the measurements that are not in the evidence."""
        return np.flatnonzero(~self.kept)

    @property
    def _title(self) -> str:
        return self._lines()[0]

    def _summary(self) -> Summary:
        return Summary(self._title, self._lines()[1:])

    def _lines(self) -> list[str]:
        text = f"{self.kept.size} measurements, {self.kept.sum()} kept, {self.moved.sum()} moved"
        if self.moved.any():
            by = np.abs(self.shift[self.moved])
            text += f" by {np.median(by):.4g} s (median), {by.max():.4g} s at most"
        lines = [text]
        if self.repeated.any():
            copies = (self.repeated & self.copied).sum()
            value = f", {copies} of them the value, too: see drop_copies" * bool(copies)
            lines.append(f"{self.repeated.sum()} kept that repeat a stamp and landmark{value}")
        if self.backwards:
            lines.append(f"{self.backwards} stamped before the row above")
        for why in (NOT_TAKEN, COPY, BEFORE, AFTER, FAR):
            rows = np.flatnonzero(self.reason == why)
            if rows.size:
                gap = f", by {np.abs(self.shift[rows]).max():.4g} s"
                gap = "" if why in UNTIMED else gap + " at most" * (rows.size > 1)
                lines.append(f"{rows.size} dropped: {why}{gap} ({rows_text(rows)})")
        return lines


@dataclass(frozen=True, eq=False)
class Log:
    """The checked rows of a sensor's log; a list of logs is concatenated."""

    stamps: Array
    values: Array
    given: dict[Variable, Array]
    taken: Mask
    backwards: int

    @cached_property
    def copied(self) -> Mask:
        """The mask of rows that equal an earlier one in all they tell."""
        missing = np.isnan(self.values)  # one NaN does not equal another
        told = [self.stamps, missing, np.where(missing, 0.0, self.values), *self.given.values()]
        return _repeated(np.column_stack(told), self.taken)

    def wanted(self, drop_copies: bool) -> Mask:
        """The mask of rows that stand for a measurement."""
        return self.taken & ~self.copied if drop_copies else self.taken


def checked(variable: Variable, value: Any) -> Log:
    """The rows of a sensor's log, or of a list of logs."""
    logs = _logs(variable, value)
    each = [as_stamps(f"stamps of {variable!r}", log.stamps, variable) for log in logs]
    counts = [part.size for part in each]
    values = _values(variable, logs, counts)
    stamps = np.concatenate(each)
    require_radians(variable, values[np.argsort(stamps, kind="stable")])
    taken: Mask = np.asarray(~np.isnan(values).all(axis=-1))
    given = {
        parent: _given(variable, parent, logs, counts, taken) for parent in _parents(variable, logs)
    }
    backwards = sum(int((np.diff(part) < 0.0).sum()) for part in each)
    return Log(stamps, values, given, taken, backwards)


def readings(
    variable: Variable, log: Log, times: Array, tolerance: float | None, drop_copies: bool
) -> tuple[Sightings, ReadingReport]:
    """The sightings of a sensor's log, each at the nearest state, and the report."""
    stamps = log.stamps
    step = nearest(times, stamps)
    shift = times[step] - stamps
    reason = _reasons(log, shift, times, tolerance, drop_copies)
    kept = reason == ""
    if log.taken.any() and not kept.any():
        raise EvidenceError(
            f"no measurement of {variable!r} is near a state: stamps from {clock(stamps.min())} to "
            f"{clock(stamps.max())}, states from {clock(times[0])} to {clock(times[-1])}"
            f"{'' if tolerance is None else f', tolerance {tolerance:.4g} s'}; are both in "
            "seconds of the same clock?",
            variable=variable,
        )
    report = ReadingReport(
        stamps=sealed(stamps),
        step=sealed(step),
        shift=sealed(shift),
        reason=sealed(reason),
        repeated=sealed(_repeated(np.column_stack([stamps, *log.given.values()]), kept)),
        copied=sealed(log.copied),
        backwards=log.backwards,
    )
    seen = {parent: sealed(table[kept]) for parent, table in log.given.items()}
    return sightings(sealed(log.values[kept]), step=sealed(step[kept]), given=seen), report


def _logs(variable: Variable, value: Any) -> list[Stamped]:
    logs = list(value) if isinstance(value, (list, tuple)) else [value]
    if not logs:
        raise EvidenceError(
            f"sensor {variable!r} has an empty list of logs; leave it out", variable=variable
        )
    return [require_stamped(variable, log) for log in logs]


def _parents(variable: Variable, logs: Sequence[Stamped]) -> tuple[Variable, ...]:
    """The parents given with the logs, the same in each."""
    for log in logs:
        if set(log.given) != set(logs[0].given):
            raise EvidenceError(
                f"the logs of {variable!r} are given {list(logs[0].given)} and {list(log.given)}; "
                "every log of a sensor must be given the same variables",
                variable=variable,
            )
    for parent in logs[0].given:
        if not isinstance(parent, Variable):
            raise EvidenceError(
                f"measurements of {variable!r} are given {parent!r}, which is no variable",
                variable=variable,
            )
    return tuple(logs[0].given)


def _values(variable: Variable, logs: Sequence[Stamped], counts: Sequence[int]) -> Array:
    what = f"measurements of {variable!r}"
    tables = [
        as_table(what, log.values, count, variable.components, variable)
        for log, count in zip(logs, counts, strict=True)
    ]
    values = np.concatenate(tables)
    taken_readings(variable, values)  # refuses infinity
    return values


def _given(
    variable: Variable,
    parent: Variable,
    logs: Sequence[Stamped],
    counts: Sequence[int],
    taken: Mask,
) -> Array:
    """The parents' values at each measurement, (M, d)."""
    what = f"{parent!r}, given for the measurements of {variable!r}"
    tables = []
    for log, count in zip(logs, counts, strict=True):
        value = log.given[parent]
        if isinstance(value, Constant):
            table = np.broadcast_to(as_rows(parent, value.value, None), (count, parent.dimension))
        else:
            table = as_table(what, value, count, parent.components, parent)
        tables.append(table)
    table = np.concatenate(tables)
    needed = np.where(taken[:, None], table, 0.0)
    require_finite_rows(what, needed, parent, "a measurement is explained only by what is known")
    return table


def _reasons(
    log: Log, shift: Array, times: Array, tolerance: float | None, drop_copies: bool
) -> npt.NDArray[np.str_]:
    """Why each measurement is dropped, empty where it is kept."""
    before, after = log.stamps < times[0], log.stamps > times[-1]
    if tolerance is None:
        first, last = 0.5 * np.diff(times)[[0, -1]]
        reach = np.select([before, after], [first, last], default=np.inf)
    else:
        reach = np.full(log.stamps.shape, tolerance)
    far = np.abs(shift) > reach + SAME
    return np.select(
        [~log.taken, log.copied & drop_copies, far & before, far & after, far],
        [NOT_TAKEN, COPY, BEFORE, AFTER, FAR],
        "",
    )


def _repeated(keys: Array, kept: Mask) -> Mask:
    """The mask of kept rows whose key equals an earlier kept row's."""
    rows = np.flatnonzero(kept)
    result = kept.copy()
    result[rows[np.unique(keys[rows], axis=0, return_index=True)[1]]] = False
    return result
