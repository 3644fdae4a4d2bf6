"""The times of states: as they are given, or one at every stamp of a log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from pgm.errors import EvidenceError
from pgm.io.readings import Log
from pgm.io.stamped import SAME, as_stamps, clock, nearest, require_stamped
from pgm.kernels.arrays import Array
from pgm.variables import Variable


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
    """One axis of stamps, both in order: `own`, and others farther than a tolerance from the rest.

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
    """The first of the stamps, in order, and each next one that is farther than a gap."""
    if (np.diff(stamps) > gap).all():
        return stamps
    kept, k = [], 0
    while k < stamps.size:
        kept.append(k)
        k = int(np.searchsorted(stamps, stamps[k] + gap, side="right"))
    return stamps[kept]
