"""Streams put in order: rows sorted by time, empty and doubled ones left out; each is told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.io.dropped import BACKWARDS, Dropped
from pgm.kernels.arrays import Integers, Mask
from pgm.recordings.drives.stream import Stream

EMPTY = "NaN, not taken"
DOUBLE = "equal to an earlier row"
REPEATED = "other values for a stamp and subject seen before"
TOO_EARLY = "motion at the first moment, before which there is no pose"
AGAIN = "equal to an earlier row of the same stamp, and driven too"
OTHER_TRUTH = "other values for a stamp seen before"


def ordered(name: str, stream: Stream) -> tuple[Stream, list[Dropped]]:
    """A stream in order of time."""
    back = np.flatnonzero(np.diff(stream.stamps) < 0.0) + 1
    if not back.size:
        return stream, []
    found = stream.take(np.argsort(stream.stamps, kind="stable"))
    return found, [Dropped(name, BACKWARDS, back, kept=True)]


def increments(name: str, stream: Stream) -> tuple[Stream, list[Dropped]]:
    """Odometry in order, without increments that take no time at its very beginning.

    Equal increments of one stamp may be two motions or one row that came twice: they are told of.
    """
    found, fates = ordered(name, stream)
    early = found.stamps <= (found.stamps[:1] if found.begin is None else found.begin)
    early[: 1 if found.begin is None else 0] = False  # which says when the second begins
    if early.any():
        rows = np.argsort(stream.stamps, kind="stable")[early]
        fates.append(Dropped(name, TOO_EARLY, np.sort(rows)))
        found = found.take(~early)
    again = _again(stream, values=True) & stream.values.any(axis=1)
    if again.any():
        fates.append(Dropped(name, AGAIN, np.flatnonzero(again), kept=True))
    return found, fates


def sightings(name: str, stream: Stream) -> tuple[Stream, list[Dropped]]:
    """Measurements in order of time, without empty or duplicate rows."""
    fates = []
    empty = np.isnan(stream.values).all(axis=1)
    double = ~empty & _again(stream, values=True)
    repeated = ~empty & ~double & _again(stream, values=False)
    for rows, fate, kept in (
        (empty, EMPTY, False),
        (double, DOUBLE, False),
        (repeated, REPEATED, True),
    ):
        if rows.any():
            fates.append(Dropped(name, fate, np.flatnonzero(rows), kept=kept))
    found, told = ordered(name, stream)
    if (empty | double).any():
        keep = ~(empty | double)
        found, _ = ordered(name, stream.take(keep))
    return found, [*fates, *told]


def reference(name: str, stream: Stream) -> tuple[Stream, list[Dropped]]:
    """Truth in order, one row a stamp: the first of several."""
    found, fates = sightings(name, stream)
    again = _again(stream, values=False)
    fates = [fate for fate in fates if fate.fate != REPEATED]
    if (np.diff(found.stamps) == 0.0).any():
        found = found.take(np.unique(found.stamps, return_index=True)[1])
        double = again & ~_again(stream, values=True)
        fates.append(Dropped(name, OTHER_TRUTH, np.flatnonzero(double)))
    return found, fates


def known(fate: Dropped, told: Sequence[Dropped]) -> bool:
    """Whether rows that are kept were told of before, of a recording that was changed in part."""
    return fate.fate in (REPEATED, AGAIN) and any(
        (each.stream, each.fate) == (fate.stream, fate.fate) for each in told
    )


def _again(stream: Stream, *, values: bool) -> Mask:
    """The mask of rows that have the stamp and subject, and the values, of an earlier row."""
    again = np.zeros(len(stream), dtype=bool)
    if len(stream) < 2:
        return again
    order = np.argsort(stream.stamps, kind="stable")
    same = np.diff(stream.stamps[order]) == 0.0
    rows = np.sort(order[np.append(same, False) | np.append(False, same)])
    if not rows.size:
        return again
    keys = [stream.stamps[rows]]
    if stream.subject is not None:
        _, numbers = np.unique(stream.subject[rows].astype(str), return_inverse=True)
        keys.append(numbers.astype(float))
    if values:
        keys += [*stream.values[rows].T]
    table = np.nan_to_num(np.column_stack(keys), nan=np.inf)
    first: Integers = np.unique(table, axis=0, return_index=True)[1]
    again[rows] = True
    again[rows[first]] = False
    return again
