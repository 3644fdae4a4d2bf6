"""The front door for a user's own log: stamped rows in, evidence of a dynamic network out."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import is_number
from pgm.display import TITLE, Listing, Shown, Summary
from pgm.errors import EvidenceError
from pgm.immutable import Immutable
from pgm.io.controls import ControlReport, Kind, controls
from pgm.io.readings import Log, ReadingReport, checked, readings
from pgm.io.stamped import SAME, Stamped, as_stamps, clock, nearest, require_stamped, sealed
from pgm.kernels.arrays import Array
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class Timeline(Shown, Immutable):
    """A log laid on the times of the states; printed, it says what became of every row.

    Attributes
    ----------
    times : ndarray
        (T+1,): of the states x[0..T], seconds.
    dt : ndarray
        (T,): the durations of the steps 1..T, seconds.
    evidence : mapping of Variable
        Controls (T, d) and sightings, ready for `filter` and `smooth`.
    controls : mapping of Variable to ControlReport
        The fate of each control's rows.
    readings : mapping of Variable to ReadingReport
        The fate of each sensor's measurements.

    Examples
    --------
    >>> z = pgm.Variable("z")
    >>> log = pgm.timeline([0.0, 1.0, 2.0], sensors={z: pgm.stamped([1.9, 0.1], [4.0, 5.0])})
    >>> log.steps, log.dt
    (2, array([1., 1.]))
    >>> log.evidence[z].step
    array([2, 0])
    """

    times: Array
    dt: Array
    evidence: Mapping[Variable, Any]
    controls: Mapping[Variable, ControlReport]
    readings: Mapping[Variable, ReadingReport]

    @property
    def steps(self) -> int:
        """T, the last step."""
        return self.dt.size

    @property
    def _title(self) -> str:
        first, last = self.times[[0, -1]]
        return (
            f"Timeline of {self.times.size} states, {clock(first)} to {clock(last)}; steps of "
            f"{np.median(self.dt):.4g} s (median), {self.dt.min():.4g} to {self.dt.max():.4g} s"
        )

    def _summary(self) -> Summary:
        told = {variable: report._lines() for variable, report in self.controls.items()}
        told |= {variable: report._lines() for variable, report in self.readings.items()}
        rows = [
            ("" if k else f"{variable.name:<9}", line)
            for variable, lines in told.items()
            for k, line in enumerate(lines)
        ]
        return Summary(self._title, [Listing(("", ""), rows, names=2, cell=TITLE)])


@public
def timeline(
    times: npt.ArrayLike | None = None,
    *,
    odometry: Mapping[Variable, Stamped] | None = None,
    velocities: Mapping[Variable, Stamped] | None = None,
    sensors: Mapping[Variable, Stamped | Sequence[Stamped]] | None = None,
    tolerance: float | None = None,
    drop_copies: bool = False,
) -> Timeline:
    """Lay a log of stamped rows on the states: controls by step, measurements by state.

    Rows may come in any order, and every control and sensor has its own stamps. Stamps less than
    a microsecond apart are of one moment.

    Parameters
    ----------
    times : array_like, optional
        (T+1,): of the states x[0..T], seconds, increasing. Without them there is a state at every
        stamp, of controls and of measurements, in the time that all controls cover, so that no
        measurement is moved.
    odometry : mapping of Variable to Stamped, optional
        ``{u: pgm.stamped(stamps, increments)}``: each increment is the motion since the previous
        stamp. A step's control is the sum of its increments; one that a state divides is divided
        in proportion to time. An increment that coincides with a step is taken over digit for
        digit. Where the log begins after the first state, the first increment is taken to count
        from that state on, if it covers no longer than the longest of the others.
    velocities : mapping of Variable to Stamped, optional
        ``{u: pgm.stamped(stamps, values)}``: each value holds until the next stamp, the last one
        at most as long as the longest of the others. A step's control is the average over time.
    sensors : mapping of Variable to Stamped or list of Stamped, optional
        ``{z: pgm.stamped(stamps, values, {m: landmarks})}``: each measurement goes to the state
        nearest in time; midway, to the earlier one. Repeated measurements all count.
    tolerance : float, optional
        Seconds by which a measurement may be moved. With `times`, one farther from every state is
        dropped; by default every measurement between the first and the last state is kept, and one
        outside them if it is within half of the first or the last step. Without `times`, 0 by
        default, one farther from the other states gets a state of its own.
    drop_copies : bool
        Whether to drop a measurement whose stamp, value and observed parents are those of an
        earlier row, as of a message that came twice.

    Returns
    -------
    Timeline
        The evidence, and a report on every row: how far it was moved, or why it was dropped.

    Raises
    ------
    EvidenceError
        If times do not increase, rows do not fit their stamps or their variable, numbers are NaN
        or infinite (a measurement may lack components, NaN: without any it is dropped as not
        taken), controls do not reach from the first state to the last, two rows of a control have
        one stamp, the tolerance is negative, or none of a sensor's measurements is kept.

    Notes
    -----
    Where a control has a component called ``dt``, it is filled with the duration of the step in
    seconds; the rows hold its other components, in order. Where it has none, the rows hold all.

    Sums and averages are right for motion that is steady within a step, and for small turns. What
    does not add up, such as (first turn, translation, second turn), can be neither added nor
    divided: it needs states at its own stamps, and at no others. A divided increment is as good as
    the motion within it is steady; the noise of a part must grow with its share, as does one with
    variances proportional to ``dt`` or to distance and turn.

    A moved measurement is in error by what the robot does meanwhile.

    Examples
    --------
    >>> from pgm import Variable
    >>> from pgm.io import stamped, timeline
    >>> u, z = Variable("u", components=("distance", "turn", "dt")), Variable("z")
    >>> log = timeline(
    ...     [0.0, 1.0, 2.0],
    ...     odometry={u: stamped([0.5, 1.5, 2.0], [[1.0, 0.0], [2.0, 0.2], [3.0, 0.0]])},
    ...     sensors={z: stamped([1.9, 0.1, 7.0], [4.0, 5.0, 6.0])},
    ... )
    >>> log.evidence[u]
    array([[2. , 0.1, 1. ],
           [4. , 0.1, 1. ]])
    >>> log.evidence[z].step
    array([2, 0])
    >>> log
    Timeline of 3 states, 0 s to 2 s; steps of 1 s (median), 1 to 1 s
      u          3 increments, 3 used, 1 of them divided at a state; the longest covers 1 s
                 the first is taken to count from the first state on, 0.5 s
      z          3 measurements, 2 kept, 2 moved by 0.1 s (median), 0.1 s at most
                 1 stamped before the row above
                 1 dropped: after the last state, by 5 s (row 2)
    """
    if tolerance is not None and not (is_number(tolerance) and tolerance >= 0.0):
        raise EvidenceError(f"tolerance must be 0 or more seconds, not {tolerance!r}")
    if not isinstance(drop_copies, bool):
        raise EvidenceError(f"drop_copies is True or False, not {drop_copies!r}")
    groups: dict[str, Mapping[Variable, Any]] = {
        name: {} if logs is None else logs
        for name, logs in (("odometry", odometry), ("velocities", velocities), ("sensors", sensors))
    }
    _check_variables(groups)
    kinds: dict[Variable, Kind] = {
        **dict.fromkeys(groups["odometry"], "odometry"),
        **dict.fromkeys(groups["velocities"], "velocities"),
    }
    logs = {z: checked(z, rows) for z, rows in groups["sensors"].items()}
    if times is None:
        tolerance = 0.0 if tolerance is None else tolerance
        rows = {u: groups[kind][u] for u, kind in kinds.items()}
        states = states_of(rows, logs, tolerance, drop_copies)
    else:
        states = given_states(times)
    driven = {u: controls(u, kind, groups[kind][u], states) for u, kind in kinds.items()}
    seen = {z: readings(z, log, states, tolerance, drop_copies) for z, log in logs.items()}
    return Timeline(
        times=sealed(states),
        dt=sealed(np.diff(states)),
        evidence=MappingProxyType({v: made for v, (made, _) in {**driven, **seen}.items()}),
        controls=MappingProxyType({u: report for u, (_, report) in driven.items()}),
        readings=MappingProxyType({z: report for z, (_, report) in seen.items()}),
    )


def _check_variables(groups: Mapping[str, Mapping[Variable, Any]]) -> None:
    """Every key a variable, and in one group only."""
    found: dict[Variable, str] = {}
    for group, logs in groups.items():
        if not isinstance(logs, Mapping):
            raise EvidenceError(
                f"{group} are given by variable, {{variable: pgm.stamped(stamps, values)}}, not as "
                f"{type(logs).__name__}"
            )
        for variable in logs:
            if not isinstance(variable, Variable) or variable != variable.template:
                raise EvidenceError(
                    f"{group} are given by variable; {variable!r} is none, or is one of a single "
                    "step",
                    variable=variable,
                )
            if variable in found:
                raise EvidenceError(
                    f"{variable!r} is given both as {found[variable]} and as {group}; a log of two "
                    "kinds of rows needs two variables",
                    variable=variable,
                )
            found[variable] = group


def given_states(times: npt.ArrayLike) -> Array:
    """Times (T+1,) that increase."""
    states = as_stamps("times", times)
    if states.size < 2:
        raise EvidenceError(f"times has {states.size} states; a timeline needs two or more")
    back = np.flatnonzero(np.diff(states) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise EvidenceError(
            f"times: row {row} ({float(states[row])!r} s) is not after row {row - 1} "
            f"({float(states[row - 1])!r} s); np.unique(times) puts states in order, each once",
            step=row,
        )
    return states


def states_of(
    controls: Mapping[Variable, object],
    logs: Mapping[Variable, Log],
    tolerance: float,
    drop_copies: bool,
) -> Array:
    """Times of a state at every stamp, in the time that all controls cover.

    A measurement no farther than the tolerance from a control's stamp needs no state of its own,
    nor does one so near to the state of an earlier measurement.
    """
    driven = {
        u: as_stamps(f"stamps of {u!r}", require_stamped(u, rows).stamps, u)
        for u, rows in controls.items()
    }
    for u, stamps in driven.items():
        if not stamps.size:
            raise EvidenceError(f"{u!r} has no rows; leave it out", variable=u)
    first = max((stamps.min() for stamps in driven.values()), default=-np.inf)
    last = min((stamps.max() for stamps in driven.values()), default=np.inf)
    if first > last:
        spans = (f"{u!r} {clock(s.min())} to {clock(s.max())}" for u, s in driven.items())
        raise EvidenceError(
            f"the controls have no time in common ({'; '.join(spans)}); are all in seconds of the "
            "same clock?"
        )
    own = _within(driven.values(), first, last)
    heard = _within((log.stamps[log.wanted(drop_copies)] for log in logs.values()), first, last)
    states = joined(own, heard, tolerance)
    if states.size < 2:
        raise EvidenceError(
            f"without times, states are at the stamps of the log, of which {states.size} will do; "
            "a timeline needs two or more"
        )
    return states


def joined(own: Array, others: Array, tolerance: float = 0.0) -> Array:
    """One increasing axis of stamps: `own`, and others further than a tolerance from it.

    Stamps of one moment are one.
    """
    own, gap = _apart(own, SAME), tolerance + SAME
    if own.size:
        others = others[np.abs(own[nearest(own, others)] - others) > gap]
    return np.sort(np.concatenate([own, _apart(others, gap)]))


def _within(parts: Iterable[Array], first: float, last: float) -> Array:
    """The stamps between two times, in order."""
    stamps = np.sort(np.concatenate([np.empty(0), *parts]))
    return stamps[(stamps >= first) & (stamps <= last)]


def _apart(stamps: Array, gap: float) -> Array:
    """The first stamp, and each later one further than a gap from the one kept before."""
    if (np.diff(stamps) > gap).all():
        return stamps
    kept, k = [], 0
    while k < stamps.size:
        kept.append(k)
        k = int(np.searchsorted(stamps, stamps[k] + gap, side="right"))
    return stamps[kept]
