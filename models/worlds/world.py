"""A world of cells: where a robot may be, what it may do, and what it may read there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm

Array = npt.NDArray[np.float64]

# Rows are counted downwards, from the top. The next direction is the one to the right.
COMPASS = {"north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}


@dataclass(frozen=True, eq=False)
class World:
    """A robot among K cells, in the numbers of its three CPDs.

        p(x₀),    p(x_t | x_{t−1}, u_t),    p(z_t | x_t)

    Attributes
    ----------
    cell, action, reading : Discrete
        x, u and z.
    prior : ndarray
        (K,).
    motion : ndarray
        (K, actions, K), the last axis being the cell after the motion.
    sensor : ndarray
        (K, readings).
    places : ndarray
        (K, 2): row and column of each cell, rows from the top.
    """

    cell: pgm.Discrete
    action: pgm.Discrete
    reading: pgm.Discrete
    prior: Array
    motion: Array
    sensor: Array
    places: npt.NDArray[np.int_]

    def network(self) -> pgm.DynamicBayesianNetwork:
        """The world as a network; actions are an input, readings may be of any step."""
        x = self.cell
        return pgm.DynamicBayesianNetwork(
            prior=[pgm.TableCPD(x, table=self.prior)],
            transition=[pgm.TableCPD(x, given=(x.previous, self.action), table=self.motion)],
            observation=[pgm.TableCPD(self.reading, given=x, table=self.sensor)],
        )
