"""Arrays of beliefs on a card that stay there, the runs beside each other."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, address
from pgm.kernels.machine.emitter.driver import Device, Held
from pgm.kernels.machine.studies.sums import Cells
from pgm.resources import NUMBER


class CardCells(NamedTuple):
    """Numbers on a card, (rows, cells, runs): where they lie."""

    memory: Held
    rows: int
    cells: int
    runs: int

    @classmethod
    def empty(cls, device: Device, rows: int, cells: int, runs: int) -> CardCells:
        """Room for so many."""
        return cls(device.held(NUMBER * rows * cells * runs), rows, cells, runs)

    def of(self, run: int) -> Cells:
        """Where they lie from a run on."""
        return Cells(self.memory.address + NUMBER * run, 1, self.cells * self.runs, self.runs)

    def copy(self, runs: slice) -> Array:
        """The numbers of successive runs, copied to this machine's memory: (rows, cells, runs)."""
        found = np.empty((self.rows, self.cells, runs.stop - runs.start))
        self._move(self.memory.device.get, found, runs)
        return found

    def fill(self, numbers: Array, runs: slice) -> None:
        """Put numbers (rows, cells, runs) of successive runs there."""
        self._move(self.memory.device.put, np.ascontiguousarray(numbers), runs)

    def _move(self, move: Any, here: Array, runs: slice) -> None:
        width, lines = NUMBER * (runs.stop - runs.start), self.rows * self.cells
        place = self.memory.address + NUMBER * runs.start
        move(place, address(here), width, lines, width, NUMBER * self.runs)
