"""The truth between its rows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pgm.errors import EvidenceError
from pgm.io.stamped import SAME, as_stamps, clock
from pgm.recordings.drives.motion import joined
from pgm.recordings.drives.stream import Stream

HEADING = "heading"


def cut(truth: Stream, first: float, last: float) -> Stream:
    """The rows between two times, with rows interpolated at both, whose variances are unknown."""
    known = truth.stamps
    rows = truth.take((known >= first) & (known <= last))
    edges = [t for t in (first, last) if len(known) and known[0] < t < known[-1] and t not in known]
    if not edges:
        return rows
    ends = at(truth, edges, None)
    both = joined(rows, ends.replace(variances=np.full(ends.values.shape, np.nan)))
    return both.take(np.argsort(both.stamps, kind="stable"))


def at(truth: Stream, times: npt.ArrayLike, longest: float | None) -> Stream:
    """The truth at given times, on a line between its rows."""
    asked, known = as_stamps("times", times), truth.stamps
    outside = (asked < known[0] - SAME) | (asked > known[-1] + SAME)
    if outside.any():
        raise EvidenceError(
            f"the truth is of {clock(known[0])} to {clock(known[-1])}, and not of "
            f"{clock(asked[outside.argmax()])}"
        )
    if longest is not None:
        after = np.searchsorted(known, asked - SAME).clip(0, known.size - 1)
        gap = known[after] - known[np.maximum(after - 1, 0)]
        within = (np.abs(known[after] - asked) > SAME) & (gap > longest)
        if within.any():
            row = int(within.argmax())
            raise EvidenceError(
                f"the truth has a gap of {gap[row]:.4g} s around {clock(asked[row])}, longer than "
                f"longest={longest!r}"
            )
    values = truth.values
    if HEADING in truth.components:
        heading = np.unwrap(truth[HEADING])
        values = np.column_stack([values[:, : truth.place(HEADING)], heading])
    columns = [np.interp(asked, known, column) for column in values.T]
    return Stream(asked, np.column_stack(columns), truth.components)
