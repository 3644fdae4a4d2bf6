"""Rows of a file or stream that were left out or mended, and why."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.display import Shown, Summary
from pgm.io.stamped import rows_text
from pgm.kernels.arrays import Integers

BACKWARDS = "stamped before the row above, put in order"


@dataclass(frozen=True, eq=False, repr=False)
class Dropped(Shown):
    """Rows of one stream that were dropped for one reason.

    Attributes
    ----------
    stream : str
        The stream's name, or a sensor's.
    fate : str
        Why the rows were dropped, or how they were mended.
    rows : ndarray of int
        Rows, from 0, in the order in which they were given.
    kept : bool
        Whether the rows are in the recording nevertheless.

    Examples
    --------
    >>> heard = pgm.recordings.Stream([0.0, 1.0], [[4.0], [float("nan")]], ("range",))
    >>> pgm.Recording(sightings={"radio": heard}).dropped[0]
    radio: 1 dropped: NaN, not taken (row 1)
    """

    stream: str
    fate: str
    rows: Integers
    kept: bool = False

    @property
    def text(self) -> str:
        """The fate in words, without the stream's name."""
        kind = "kept" if self.kept else "dropped"
        return f"{self.rows.size} {kind}: {self.fate} ({rows_text(self.rows)})"

    @property
    def _title(self) -> str:
        return f"{self.stream}: {self.text}"

    def _summary(self) -> Summary:
        return Summary(self._title)
