"""Motion between stamps: each odometry or velocity row as a motion with a duration.

Steady motion is an arc. Rows are divided along it and composed as motions of the plane are, so that
no sum of increments stands for their composition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.boundary import is_number
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.io.stamped import SAME, clock, rows_text
from pgm.kernels import twists
from pgm.kernels.arrays import Array, Integers
from pgm.recordings.drives.stream import Stream

ARC, PLANAR, TURNS = ("distance", "turn"), ("forward", "left", "turn"), ("rot1", "trans", "rot2")
ODOMETRY = (ARC, PLANAR, TURNS)
WHEELS = ("left", "right")
SPEEDS, PLANAR_SPEEDS = ("v", "omega"), ("v_forward", "v_left", "omega")
VELOCITIES = (SPEEDS, PLANAR_SPEEDS)
# Steps of a period, at the most.
_MOST = 1e8


@dataclass(frozen=True, eq=False)
class Spans:
    """Rows of motion that follow each other without gaps.

    what: Odometry or velocities, for messages.
    starts, ends: (n,): the time of each row, seconds.
    whole: (n, 3): forward [m], left [m], turn [rad].
    steady: (n, 3): the twist of each row over its time; None where it follows from the motion.
    """

    what: str
    starts: Array
    ends: Array
    whole: Array
    steady: Array | None

    @property
    def axis(self) -> Array:
        """The times at which rows begin and end."""
        return np.unique(np.concatenate([self.starts[:1], self.ends]))

    def require_time(self) -> None:
        """Refuse motion without rows."""
        if not len(self.whole):
            raise EvidenceError(f"the {self.what} cover no time; two stamps or more were due")

    def every(self, period: float) -> Array:
        """The times a period apart, from the first on."""
        if not (is_number(period) and period > 0.0):
            raise EvidenceError(f"period= is a positive number of seconds, not {period!r}")
        self.require_time()
        first, last = self.axis[[0, -1]]
        number = (last - first) / period
        if not 1.0 - SAME <= number <= _MOST:
            raise EvidenceError(
                f"period={float(period)!r} divides {last - first:.4g} s into {number:.4g} steps; "
                f"1 to {_MOST:.0g} were due"
            )
        times: Array = first + period * np.arange(int(number + SAME) + 1)
        return times

    def between(self, times: Array) -> Array:
        """The motion from each time to the next, (m − 1, 3)."""
        row, share, step = self._pieces(times)
        found = np.zeros((len(times) - 1, 3))
        moved, first = np.unique(step, return_index=True)
        if moved.size:
            found[moved] = twists.composed(self._parts(row, share), first)
        return found

    def arcs(self, times: Array) -> Array | None:
        """The distance and turn from each time to the next; None where these are no arcs."""
        row, share, step = self._pieces(times)
        if self.steady is None or self.steady[:, 1].any() or np.unique(step).size < step.size:
            return None
        found = np.zeros((len(times) - 1, 2))
        found[step] = share[:, None] * self.steady[row][:, [0, 2]]
        return found

    def _pieces(self, times: Array) -> tuple[Integers, Array, Integers]:
        """Spans of time cut at row boundaries.

        Each piece has its row, its share of the row, and its span.
        """
        self.require_time()
        first, last = self.starts[0], self.ends[-1]
        for time in (times[0], times[-1]):
            if not first - SAME <= time <= last + SAME:
                raise EvidenceError(
                    f"the {self.what} cover {clock(first)} to {clock(last)}, and not {clock(time)}"
                )
        inner = np.clip(times, first, last)
        edges = np.union1d(inner, self.ends[(self.ends > inner[0]) & (self.ends < inner[-1])])
        # Rows that take no time are pieces of their own, at the end of a step.
        at_once = self.starts == self.ends
        sudden = np.flatnonzero(at_once & (self.ends > inner[0]) & (self.ends <= inner[-1]))
        lasting = np.flatnonzero(~at_once)
        row = np.append(lasting[np.searchsorted(self.ends[lasting], edges[1:])], sudden)
        ends = np.append(edges[1:], self.ends[sudden])
        length = np.append(np.diff(edges), np.ones(sudden.size))
        order = np.lexsort([row, ends])
        row, ends, length = row[order], ends[order], length[order]
        lasts = np.where(at_once, 1.0, self.ends - self.starts)
        return row, length / lasts[row], np.searchsorted(inner[1:], ends)

    def _parts(self, row: Integers, share: Array) -> Array:
        """Motions over fractions of rows; whole rows stay exact."""
        found = self.whole[row]
        cut = np.flatnonzero(share != 1.0)
        if cut.size:
            found[cut] = twists.motions(self._twists()[row[cut]], share[cut])
        return found

    def _twists(self) -> Array:
        if self.steady is not None:
            return self.steady
        turn = np.abs(self.whole[:, 2])
        if (around := turn >= twists.WHOLE).any():
            row = int(around.argmax())
            raise EvidenceError(
                f"{self.what}, row {row}: a turn of {self.whole[row, 2]:.4g} rad, a whole one, "
                "from which no course in between follows; keep to the stamps, or give distance "
                "and turn"
            )
        return twists.twists(self.whole)


def of_odometry(stream: Stream) -> Spans:
    """The motion of increments, each since the stamp before."""
    first = 0 if stream.begin is not None else 1
    edges = stream.stamps if stream.begin is None else np.append(stream.begin, stream.stamps)
    values, steady = stream.values[first:], None
    if stream.components == PLANAR:
        whole = values
    elif stream.components == TURNS:
        heading = values[:, 0]
        whole = np.column_stack(
            [
                values[:, 1] * np.cos(heading),
                values[:, 1] * np.sin(heading),
                heading + values[:, 2],
            ]
        )
    else:
        steady = np.insert(values, 1, 0.0, axis=1)
        whole = twists.motions(steady)
    return Spans("odometry", edges[:-1], edges[1:], whole, steady)


def of_velocities(stream: Stream) -> Spans:
    """The motion of velocities, each held until the next stamp; the last for no time."""
    values = stream.values[:-1]
    if stream.components == SPEEDS:
        values = np.insert(values, 1, 0.0, axis=1)
    steady = values * np.diff(stream.stamps)[:, None]
    return Spans(
        "velocities", stream.stamps[:-1], stream.stamps[1:], twists.motions(steady), steady
    )


def of_wheels(left: Array, right: Array, wheelbase: float) -> Array:
    """The motion of two wheels: straight on, and the turn; (n, 2)."""
    if not (is_number(wheelbase) and wheelbase > 0.0):
        raise EvidenceError(f"wheelbase= is a positive number of metres, not {wheelbase!r}")
    return np.column_stack([(left + right) / 2.0, (right - left) / wheelbase])


def require_motion(what: str, stream: Stream, known: tuple[tuple[str, ...], ...]) -> None:
    """Refuse components that do not describe a motion, and motion with missing values."""
    if stream.components not in known:
        raise EvidenceError(
            f"{what} has the components ({listed(stream.components)}); known are "
            + "; ".join(f"({listed(names)})" for names in known)
        )
    rows = np.flatnonzero(~np.isfinite(stream.values).all(axis=1))
    if rows.size:
        raise EvidenceError(
            f"{what}, {rows_text(rows)}: NaN or infinite; unknown motion cannot be left out: leave "
            "the rows out where none was measured"
        )


def cut_odometry(stream: Stream, first: float, last: float) -> Stream:
    """The increments from one time to another, the outer ones cut along their arcs."""
    spans = of_odometry(stream)
    axis = spans.axis
    if first <= axis[0] and last >= axis[-1]:
        return stream
    low, high = max(first, axis[0]), min(last, axis[-1])
    if low >= high:
        return Stream([], [], stream.components)
    rows = stream.take((stream.stamps > low) & (stream.stamps <= high))
    cut = {low, high} - set(axis.tolist())
    if not cut:
        return rows.replace(begin=low)
    # A share of an arc is an arc; a share of (rot1, trans, rot2) is none of these.
    edges = np.union1d(axis[(axis > low) & (axis < high)], [low, high])
    arcs = spans.arcs(edges) if stream.components == ARC else None
    if arcs is not None:
        return Stream(edges[1:], arcs, ARC, begin=low)
    return Stream(edges[1:], spans.between(edges), PLANAR, begin=low)


def cut_velocities(stream: Stream, first: float, last: float) -> Stream:
    """The velocities from one time to another, the first one held from an earlier stamp."""
    stamps = stream.stamps
    found = stream.take((stamps >= first) & (stamps <= last))
    before = np.flatnonzero(stamps < first)
    if before.size and stamps[-1] > first and not (len(found) and found.stamps[0] == first):
        head = stream.take(before[-1:]).replace(stamps=[first])
        found = joined(head, found)
    after = np.flatnonzero(stamps > last)
    if after.size and len(found) and found.stamps[-1] < last:
        found = joined(found, found.take(slice(-1, None)).replace(stamps=[last]))
    return found


def joined(one: Stream, other: Stream) -> Stream:
    """The rows of two streams of one kind, concatenated."""
    both = one.cov is not None and other.cov is not None
    return one.replace(
        stamps=np.concatenate([one.stamps, other.stamps]),
        values=np.concatenate([one.values, other.values]),
        cov=np.concatenate([one.cov, other.cov]) if both else None,
    )
