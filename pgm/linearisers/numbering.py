"""The numbers of runs in the texts of errors."""

from __future__ import annotations

from typing import NamedTuple

from pgm.kernels.arrays import Index


class Numbering(NamedTuple):
    """The user's runs along an axis of runs, which counts them from `first` on.

    Where all sightings of a step are tried with each of k `candidates`, the places of the axis are
    a sighting, one of `runs` runs and a candidate each, of which candidates vary fastest. Where
    `runs` alone is given, they are a hypothesis and a run each. Elsewhere both are None. Where the
    axis has `chosen` runs alone, these are their numbers.
    """

    first: int = 0
    runs: int | None = None
    candidates: int | None = None
    chosen: tuple[int, ...] | None = None

    def run(self, place: int) -> int:
        """The user's number of the run at a place of the axis."""
        if self.chosen is not None:
            return self.chosen[place]
        if self.runs is None:
            return self.first + place
        return self.first + place // (self.candidates or 1) % self.runs

    def words(self, place: int) -> str:
        """The run at a place of the axis in words, with the candidate that is tried there."""
        tried = "" if self.candidates is None else f", candidate {place % self.candidates}"
        return f"run {self.run(place)}{tried}"

    def only(self, places: int) -> int | None:
        """The user's number of the run of an axis of so many places, None where it has several."""
        return self.first if self.run(places - 1) == self.first else None

    def several(self, places: int) -> str:
        """The runs of an axis of so many places in words."""
        if places == 1:
            return self.words(0)
        first, last = self.first, self.run(places - 1)
        return f"run {first}" if first == last else f"in a call for runs {first} to {last}"

    def of(self, places: Index) -> Numbering:
        """The numbering of an axis of these places alone, of a user's runs."""
        if isinstance(places, slice):
            return self._replace(first=self.first + places.start)
        chosen = tuple(map(self.run, places.tolist()))
        return self._replace(first=chosen[0], chosen=chosen)


# Of all runs, from zero on.
COUNTED = Numbering()
