"""Stamped odometry and velocities, made into one control a step."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pgm.display import Shown, Summary
from pgm.errors import EvidenceError
from pgm.io.stamped import (
    SAME,
    as_stamps,
    as_table,
    clock,
    nearest,
    require_finite_rows,
    require_stamped,
    rows_text,
    sealed,
)
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.units import factor
from pgm.variables import Variable

Kind = Literal["odometry", "velocities"]
DT = "dt"


@dataclass(frozen=True, eq=False, repr=False)
class ControlReport(Shown):
    """The rows of one control's log, in its order, and the use that was made of each.

    Attributes
    ----------
    kind : {"odometry", "velocities"}
    stamps : ndarray
        (n,), seconds.
    counted : ndarray
        (n,): for how many seconds between the first and the last state each row counts.
    split : ndarray of bool
        (n,): whether a state stands within the time that the row covers. An increment is then
        divided in proportion to time, as if the motion had been steady; a velocity holds before
        and after the state.
    longest : float
        The longest time [s] that a row covers: so long, at worst, the motion is taken as steady.
    assumed : float
        How long [s] the first increment is taken to cover where no earlier stamp tells, else 0.
    backwards : int
        How many rows are stamped before the row above them; they are put in order of time.

    Examples
    --------
    >>> u = pgm.Variable("u")
    >>> rows = pgm.stamped([0.5, 1.5, 2.0], [1.0, 2.0, 3.0])
    >>> log = pgm.timeline([0.0, 1.0, 2.0], odometry={u: rows})
    >>> log.controls[u].counted
    array([0.5, 1. , 0.5])
    >>> log.controls[u].split
    array([False,  True, False])
    """

    kind: Kind
    stamps: Array
    counted: Array
    split: Mask
    longest: float
    assumed: float
    backwards: int

    @property
    def dropped(self) -> Integers:
        """The rows that count for nothing: they lie before the first state or after the last."""
        return np.flatnonzero(self.counted == 0.0)

    @property
    def _title(self) -> str:
        return self._lines()[0]

    def _summary(self) -> Summary:
        return Summary(self._title, self._lines()[1:])

    def _lines(self) -> list[str]:
        used = self.counted > 0.0
        split = (self.split & used).sum()
        what = "increments" if self.kind == "odometry" else "velocities"
        divided = "divided at a state" if self.kind == "odometry" else "held past a state"
        lines = [
            f"{used.size} {what}, {used.sum()} used{f', {split} of them {divided}' * bool(split)}; "
            f"the longest covers {self.longest:.4g} s"
        ]
        if self.assumed:
            lines.append(
                f"the first is taken to count from the first state on, {self.assumed:.4g} s"
            )
        if self.backwards:
            lines.append(f"{self.backwards} stamped before the row above, put in order of time")
        if self.dropped.size:
            lines.append(
                f"{self.dropped.size} dropped: before the first state or after the last "
                f"({rows_text(self.dropped)})"
            )
        return lines


def controls(
    variable: Variable, kind: Kind, value: Any, times: Array
) -> tuple[Array, ControlReport]:
    """One control a step, (T, d), with its duration where a component is called dt."""
    names = tuple(name for name in variable.components if name != DT)
    log = require_stamped(variable, value)
    if log.given:
        raise EvidenceError(
            f"{kind} of {variable!r} are given {list(log.given)}; only sensors have parents that "
            "differ from row to row",
            variable=variable,
        )
    raw = as_stamps(f"stamps of {variable!r}", log.stamps, variable)
    table = _table(variable, kind, names, log.values, raw.size)
    order = np.argsort(raw, kind="stable")
    stamps, table = _on_states(raw[order], times), table[order]
    _refuse_repeats(variable, kind, raw, order, stamps)
    cover = _since_previous if kind == "odometry" else _until_next
    starts, ends = cover(variable, stamps, times)

    # No state and no stamp lies within a piece of time.
    edges = np.union1d(times, stamps[(stamps > times[0]) & (stamps < times[-1])])
    row, length = np.searchsorted(ends, edges[1:]), np.diff(edges)
    first = np.searchsorted(edges, times[:-1])
    dt = np.diff(times)
    if kind == "odometry":
        share = length / (ends - starts)[row]  # exactly 1 where an increment stays whole
        data = np.add.reduceat(share[:, None] * table[row], first)
    else:
        step = np.searchsorted(times, edges[1:]) - 1
        angles = np.array([name in variable.angles for name in names], dtype=bool)
        start = table[row[first]]
        change = difference(table[row], start[step], angles)
        data = start + np.add.reduceat((length / dt[step])[:, None] * change, first)

    counted = np.zeros(raw.size)
    np.add.at(counted, row, length)
    within = np.searchsorted(times, ends) - np.searchsorted(times, starts, side="right")
    back = np.argsort(order)
    report = ControlReport(
        kind=kind,
        stamps=sealed(raw),
        counted=sealed(counted[back]),
        split=sealed((within > 0)[back]),
        longest=float((ends - starts)[counted > 0.0].max()),
        assumed=float(max(stamps[0] - times[0], 0.0)),
        backwards=int((np.diff(raw) < 0.0).sum()),
    )
    lasted = dt * _second(variable)
    columns = [lasted if name == DT else data[:, names.index(name)] for name in variable.components]
    return sealed(np.column_stack(columns)), report


def _second(variable: Variable) -> float:
    """A second in the unit of a variable's duration."""
    unit = variable.unit_of(DT) if DT in variable.components else ""
    size = factor("s", unit) if unit else 1.0
    if size is None:
        raise EvidenceError(
            f"the component {DT!r} of {variable!r} is filled in with durations, and its unit "
            f"{unit!r} is none of a time",
            variable=variable,
        )
    return size


def _table(variable: Variable, kind: Kind, names: tuple[str, ...], values: Any, rows: int) -> Array:
    what = f"{kind} of {variable!r}"
    if rows == 0:
        raise EvidenceError(f"{what} have no rows; leave {variable!r} out", variable=variable)
    hint = (
        ' (the component "dt" is filled in)'
        if DT in variable.components
        else f'; to have a duration filled in, {variable!r} needs a component called "dt"'
    )
    table = as_table(what, values, rows, names, variable, hint)
    remedy = "unknown motion cannot be left out; leave the rows out where none was measured"
    require_finite_rows(what, table, variable, remedy)
    return table


def _on_states(stamps: Array, times: Array) -> Array:
    """Stamps, those equal to a state's time up to rounding being that time."""
    state = times[nearest(times, stamps)]
    return np.where(np.abs(stamps - state) <= SAME, state, stamps)


def _refuse_repeats(
    variable: Variable, kind: Kind, raw: Array, order: Integers, stamps: Array
) -> None:
    again = np.flatnonzero(np.diff(stamps) <= 0.0)
    if again.size:
        one, other = sorted(order[again[0] : again[0] + 2])
        raise EvidenceError(
            f"{kind} of {variable!r}: rows {one} and {other} have one stamp, {clock(raw[one])}"
            f"{f' ({again.size} such pairs)' if again.size > 1 else ''}; keep one of them, or "
            "merge them",
            variable=variable,
        )


def _since_previous(variable: Variable, stamps: Array, times: Array) -> tuple[Array, Array]:
    """Each increment's time: from the stamp before to its own."""
    begin, longest = min(times[0], stamps[0]), np.diff(stamps).max(initial=0.0)
    if stamps[-1] < times[-1]:
        raise EvidenceError(
            f"odometry of {variable!r} ends at {clock(stamps[-1])}, the states at "
            f"{clock(times[-1])}; motion in between is unknown: keep "
            f"times[times <= {float(stamps[-1])!r}]",
            variable=variable,
        )
    if stamps.size > 1 and stamps[0] - begin > longest + SAME:
        raise EvidenceError(
            f"odometry of {variable!r} begins at {clock(stamps[0])}, {stamps[0] - begin:.4g} s "
            f"after the first state, longer than any increment covers ({longest:.4g} s); keep "
            f"times[times >= {float(stamps[0])!r}], or put a row of zeros first, stamped where "
            "the first increment begins",
            variable=variable,
        )
    return np.concatenate([[begin], stamps[:-1]]), stamps


def _until_next(variable: Variable, stamps: Array, times: Array) -> tuple[Array, Array]:
    """Each velocity's time: from its stamp to the next."""
    end, longest = max(times[-1], stamps[-1]), np.diff(stamps).max(initial=0.0)
    if stamps[0] > times[0]:
        raise EvidenceError(
            f"velocities of {variable!r} begin at {clock(stamps[0])}, the states at "
            f"{clock(times[0])}; motion in between is unknown: keep "
            f"times[times >= {float(stamps[0])!r}]",
            variable=variable,
        )
    if end - stamps[-1] > longest + SAME:
        raise EvidenceError(
            f"velocities of {variable!r} end at {clock(stamps[-1])}, the states "
            f"{end - stamps[-1]:.4g} s later, longer than any other value is held "
            f"({longest:.4g} s); keep times[times <= {float(stamps[-1])!r}], or repeat the last "
            "value, stamped where it ends",
            variable=variable,
        )
    return stamps, np.concatenate([stamps[1:], [end]])
