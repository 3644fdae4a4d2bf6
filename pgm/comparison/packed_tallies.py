"""Tallies of many statistics whose moments lie side by side, so that blocks are joined at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pgm.comparison.tally import Tally
from pgm.kernels.arrays import Array
from pgm.variables import Variable

Key = tuple[str, Variable]
Tallies = Mapping[Key, Tally]


class PackedTallies(Mapping[Key, Tally]):
    """The tallies of a method over some runs.

    whole: The tally of all cells, which are its last axis.
    cells: By statistic its cells in that.
    constants: By statistic its value by step, (steps,), which all runs have; NaN where there is
        none.
    """

    def __init__(
        self, whole: Tally, cells: Mapping[Key, int | slice], constants: Mapping[Key, Array]
    ) -> None:
        self._whole, self._cells, self._constants = whole, cells, constants

    def __getitem__(self, key: Key) -> Tally:
        """The tally of a statistic."""
        known, mean, spread, runs, centre, scatter = self._whole
        if key in self._constants:
            return _constant(self._constants[key], runs)
        own = self._cells[key]
        known, mean, spread = (each[:, own] for each in (known, mean, spread))
        return Tally(known, mean, spread, runs, centre[:, own], scatter[..., own])

    def __iter__(self) -> Iterator[Key]:
        """The statistics."""
        return iter([*self._cells, *self._constants])

    def __len__(self) -> int:
        """How many statistics there are."""
        return len(self._cells) + len(self._constants)

    def __reduce__(self) -> Any:
        return PackedTallies, (self._whole, self._cells, self._constants)

    def joined(self, other: PackedTallies) -> PackedTallies:
        """The tallies over these runs and the next, of the same statistics."""
        return PackedTallies(self._whole.joined(other._whole), self._cells, self._constants)


def joined(one: Tallies, other: Tallies) -> Tallies:
    """The tallies over some runs and over the next."""
    if isinstance(one, PackedTallies) and isinstance(other, PackedTallies):
        return one.joined(other)
    found = dict(one)
    for key, tally in other.items():
        found[key] = found[key].joined(tally) if key in found else tally
    return found


def _constant(values: Array, runs: float) -> Tally:
    """The moments of values by step that so many runs have."""
    due = ~np.isnan(values)
    centre = np.array([values[due].sum(), float(np.count_nonzero(due))])
    known, mean = np.where(due, runs, 0.0), np.where(due, values, 0.0)
    return Tally(known, mean, np.zeros(len(values)), runs, centre, np.zeros((2, 2)))
