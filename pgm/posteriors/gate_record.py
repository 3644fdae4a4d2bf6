"""The record of a gate: what it decided about the sightings of one sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.kernels.arrays import (
    Array,
    Index,
    Mask,
    cut,
)


@dataclass(eq=False)
class GateRecord:
    """A sensor's gate decisions, filled in by a forward pass.

    `gate` is the probability of the χ² quantile; `given` (M, runs, d) marks the components that
    were measured, and `rejected` (M, runs) the sightings left out. `square` (M, runs) is νᵀS⁻¹ν of
    the innovation ν, S its covariance, NaN where nothing was measured or decided. The record of a
    window, a stretch of consecutive steps, is a view of the whole one.
    """

    gate: float
    given: Mask
    rejected: Mask
    square: Array

    @classmethod
    def empty(cls, gate: float, given: Mask) -> GateRecord:
        """The record of M sightings of which none is judged yet: none rejected, all squares NaN.

        `gate` is the probability of the gate's χ² quantile, and `given` (M, runs, d) marks the
        components that were measured.
        """
        shape = given.shape[:2]
        return cls(gate, given, np.zeros(shape, dtype=bool), np.full(shape, np.nan))

    def window(self, rows: slice) -> GateRecord:
        """The gate decisions for some rows, as a view."""
        return GateRecord(self.gate, self.given[rows], self.rejected[rows], self.square[rows])

    def of(self, runs: Index) -> GateRecord:
        """The gate decisions for some runs, as a view if they are a slice."""
        return GateRecord(
            self.gate, cut(self.given, runs), cut(self.rejected, runs), cut(self.square, runs)
        )

    @property
    def judged(self) -> tuple[Mask, Mask]:
        """Masks (M, runs) of rejected sightings, and of sightings that the gate has judged."""
        return self.rejected, ~np.isnan(self.square)

    @classmethod
    def joined(cls, parts: Sequence[GateRecord]) -> GateRecord:
        """The record of all runs, concatenated from the records of parts of the runs."""
        arrays = zip(*((part.given, part.rejected, part.square) for part in parts), strict=True)
        given, rejected, square = (np.concatenate(each, axis=1) for each in arrays)
        return cls(parts[0].gate, given, rejected, square)

    def put(self, row: int, part: GateRecord) -> None:
        """Copy the gate decisions of a window, `part`, into the rows from `row` on."""
        rows = slice(row, row + len(part.rejected))
        self.rejected[rows], self.square[rows] = part.rejected, part.square
