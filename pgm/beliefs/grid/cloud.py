"""The cells of a grid as points of the states, a cloud for each step."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.grid.lattice import Lattice
from pgm.beliefs.points.cloud import Cloud
from pgm.kernels.arrays import Array


class CellClouds:
    """The beliefs of a grid by step, (runs, steps, *cells), as clouds of the centres of cells.

    A cloud is made when it is asked for, and the last one is kept. Cells of probability zero are
    left out.
    """

    def __init__(self, lattice: Lattice, values: npt.NDArray[Any]) -> None:
        self._lattice, self._values = lattice, values
        self._last: tuple[int, Cloud] | None = None

    def __getitem__(self, step: int) -> Cloud:
        """The cloud of a step."""
        if self._last is None or self._last[0] != step:
            self._last = step, cloud_of(self._lattice, self._values[:, step])
        return self._last[1]

    def __getstate__(self) -> dict[str, Any]:
        # What was made last is not part of the value.
        return {"_lattice": self._lattice, "_values": self._values, "_last": None}


def cloud_of(lattice: Lattice, values: npt.NDArray[Any]) -> Cloud:
    """The cloud of the beliefs of runs, (runs, *cells), at one step.

    A particle's components are those of the states, one after another; its weight is the cell's
    share of the run's probability.
    """
    order = [axis for places in lattice.of.values() for axis in places]
    states, log_weights = list[Array](), list[Array]()
    for belief in values:
        places = np.nonzero(belief)
        weights = belief[places].astype(np.float64)
        centres = (lattice.axes[axis].centres[places[axis]] for axis in order)
        states.append(np.stack(list(centres)))
        log_weights.append(np.log(weights / weights.sum()))
    starts = np.cumsum([0, *map(len, log_weights)])
    return Cloud(np.concatenate(states, axis=1), np.concatenate(log_weights), starts)
