"""The record of a gate: which sightings of a sensor it has rejected, and how far off each was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.kernels.arrays import Array, Mask, cut


@dataclass(eq=False)
class GateRecord:
    """The decisions of a sensor's gate, written by a forward pass; parts of it are views.

    `gate` is the probability, `given` (M, runs, d) the components that were measured; `square` (M,
    runs) is νᵀS⁻¹ν, NaN where nothing was measured or decided.
    """

    gate: float
    given: Mask
    rejected: Mask
    square: Array

    @classmethod
    def empty(cls, gate: float, given: Mask) -> GateRecord:
        """Before anything is decided."""
        shape = given.shape[:2]
        return cls(gate, given, np.zeros(shape, dtype=bool), np.full(shape, np.nan))

    def window(self, rows: slice) -> GateRecord:
        """Some rows."""
        return GateRecord(self.gate, self.given[rows], self.rejected[rows], self.square[rows])

    def of(self, runs: slice) -> GateRecord:
        """Some runs."""
        return GateRecord(
            self.gate, cut(self.given, runs), cut(self.rejected, runs), cut(self.square, runs)
        )

    @property
    def judged(self) -> tuple[Mask, Mask]:
        """Sightings that were rejected, and those about which was decided, (M, runs)."""
        return self.rejected, ~np.isnan(self.square)

    @classmethod
    def joined(cls, parts: Sequence[GateRecord]) -> GateRecord:
        """The record of all runs, from those of parts of them."""
        arrays = zip(*((part.given, part.rejected, part.square) for part in parts), strict=True)
        given, rejected, square = (np.concatenate(each, axis=1) for each in arrays)
        return cls(parts[0].gate, given, rejected, square)

    def put(self, row: int, part: GateRecord) -> None:
        """Take over what a window has decided."""
        rows = slice(row, row + len(part.rejected))
        self.rejected[rows], self.square[rows] = part.rejected, part.square
