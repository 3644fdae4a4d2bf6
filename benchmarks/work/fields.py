"""Linear Gaussian networks in which each variable hangs on those before it: grids and chains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from benchmarks.work.asked import Array, Asked

NEXT = 0.49  # what a variable of a grid takes over from each of two before it
LINK = 0.98  # and one of a chain from the one before it
NOISE = 1.0  # variance of what is new in each
READ, READ_NOISE = 10, 0.01  # every tenth is read, with this variance


@dataclass(frozen=True, eq=False)
class Field:
    """A grid of scalars, some of which are read; a chain is one of a single row.

    Attributes
    ----------
    rows, columns : int
    weight : float
        Of each variable above, and to the left, in the mean of one.
    readings : ndarray
        Of every tenth variable, row by row.
    """

    rows: int
    columns: int
    weight: float
    readings: Array

    @property
    def units(self) -> int:
        """How many variables there are."""
        return self.rows * self.columns

    def before(self, k: int) -> list[int]:
        """The variables on which one hangs."""
        row, column = divmod(k, self.columns)
        return [k - self.columns] * (row > 0) + [k - 1] * (column > 0)

    def asked(self) -> Asked:
        """All variables that are not readings."""
        scalars = tuple(pgm.Variable(f"x{k}") for k in range(self.units))
        cpds: list[pgm.GaussianCPD | pgm.LinearGaussianCPD] = []
        evidence = {}
        for k, x in enumerate(scalars):
            given = {scalars[j]: self.weight for j in self.before(k)}
            cpds.append(
                pgm.LinearGaussianCPD(x, given=given, cov=NOISE)
                if given
                else pgm.GaussianCPD(x, mean=0.0, cov=NOISE)
            )
        for x, value in zip(scalars[::READ], self.readings.tolist(), strict=True):
            z = pgm.Variable(f"z{x.name}")
            cpds.append(pgm.LinearGaussianCPD(z, given={x: 1.0}, cov=READ_NOISE))
            evidence[z] = value
        return Asked(pgm.BayesianNetwork(cpds), evidence, (scalars,))


def grid(side: int) -> Field:
    """A square of side² variables."""
    return _read(side, side, NEXT)


def chain(length: int) -> Field:
    """A chain that is not declared over time."""
    return _read(1, length, LINK)


def _read(rows: int, columns: int, weight: float, seed: int = 0) -> Field:
    count = len(range(0, rows * columns, READ))
    return Field(rows, columns, weight, np.random.default_rng(seed).standard_normal(count))
