"""Means and standard errors over runs that come in blocks, in memory of one block."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import Array


class Tally(NamedTuple):
    """The moments of values (runs, steps, ...) by step, and of their sums over the steps of a run.

    Of the values x at a step: `known` their number, `mean` and `spread`, Σ (x − mean)², each
    (steps, ...). Of the pairs of a run's sum of values and their number: `runs`, `centre` (2, ...)
    the mean of these pairs, and `scatter` (2, 2, ...) the sum of the products of their deviations.
    Values that are NaN count for nothing. Blocks are joined by the formulas of Chan, Golub &
    LeVeque (Updating formulae and a pairwise algorithm for computing sample variances, 1979), which
    lose no digits where a mean is large.
    """

    known: Array
    mean: Array
    spread: Array
    runs: float
    centre: Array
    scatter: Array

    @classmethod
    def of(cls, values: Array) -> Tally:
        """The moments of one block."""
        known = ~np.isnan(values)
        count = known.sum(axis=0).astype(np.float64)
        filled = np.where(known, values, 0.0)
        mean = filled.sum(axis=0) / np.maximum(count, 1.0)
        spread = np.where(known, (filled - mean) ** 2, 0.0).sum(axis=0)
        return cls.of_sums(count, mean, spread, filled.sum(axis=1), known.sum(axis=1))

    @classmethod
    def of_sums(
        cls, known: Array, mean: Array, spread: Array, total: Array, number: Array
    ) -> Tally:
        """The moments of one block by step, and by its runs' sums of values and their numbers.

        `total` and `number` are (runs, ...).
        """
        pairs = np.stack([total, number.astype(np.float64)])
        centre = pairs.mean(axis=1)
        off = pairs - centre[:, None]
        scatter = np.einsum("ir...,jr...->ij...", off, off)
        return cls(known, mean, spread, float(len(total)), centre, scatter)

    def joined(self, other: Tally) -> Tally:
        """The moments of two blocks."""
        count = self.known + other.known
        share = other.known / np.maximum(count, 1.0)
        off = other.mean - self.mean
        spread = self.spread + other.spread + off**2 * self.known * share
        runs = self.runs + other.runs
        apart = other.centre - self.centre
        product = apart[:, None] * apart * (self.runs * other.runs / runs)
        return Tally(
            count,
            self.mean + off * share,
            spread,
            runs,
            self.centre + apart * (other.runs / runs),
            self.scatter + other.scatter + product,
        )

    def by_step(self) -> tuple[Array, Array]:
        """The mean at each step, (steps, ...), and its standard error over runs."""
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.where(self.known > 0.0, self.mean, np.nan)
            error = np.sqrt(self.spread / (self.known * (self.known - 1.0)))
        return mean, np.where(self.known > 1.0, error, np.nan)

    def over_all(self) -> tuple[Array, Array]:
        """The mean over runs and steps, (...), and its standard error over runs.

        Runs are independent, steps of one run are not: the error is that of the ratio of the sum of
        each run's values to their number, NaN of a single run.
        """
        (total, number), ((xx, xn), (_, nn)) = self.centre, self.scatter
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = total / number
            square = np.maximum(xx - 2.0 * mean * xn + mean**2 * nn, 0.0)
            error = np.sqrt(square / (self.runs * (self.runs - 1.0))) / number
        if self.runs < 2.0:
            error = np.full_like(error, np.nan)
        return mean, error
