"""The beliefs of readings given all readings but their own, by sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from pgm.display import Summary
from pgm.errors import Unanswered
from pgm.posteriors.belief_kind import SMOOTHED, Kind
from pgm.posteriors.by_sensor import EachSensor
from pgm.variables import Variable


class LeftOut(EachSensor[Any]):
    """A mapping of the variables of sensors to the beliefs of their readings, each left out.

    A belief is what a measurement of the sensor has: a `Gaussian` or a `Table`, one row a reading.
    Those of a sensor are found, by `find`, when they are first asked for.
    """

    _what = "readings"

    def __init__(self, sensors: Iterable[Variable], find: Callable[[Variable], Any]) -> None:
        super().__init__(dict.fromkeys(sensors))
        self._find = find

    def __getitem__(self, variable: Variable) -> Any:
        """The beliefs of a sensor's readings."""
        found = super().__getitem__(variable)
        if found is None:
            found = self._found[variable] = self._find(variable)
        return found

    def _summary(self) -> Summary:
        told = {v: found for v, found in self._found.items() if found is not None}
        return Summary(self._title, [f"{v!r}: {found._title}" for v, found in told.items()])


def require_all(kind: Kind) -> None:
    """Refuse beliefs of readings given all others, of a posterior that does not know all."""
    if kind != SMOOTHED:
        raise Unanswered(
            f"left_out knows all readings but one, and this posterior is {kind}: take pgm.smooth; "
            "posterior.predicted[z] has what the readings before each tell of it"
        )
