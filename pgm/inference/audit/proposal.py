"""Proposals: draws of the components that the model leaves open, Gaussian or with Student tails."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import lgamma, log, pi

import numpy as np

from pgm.errors import NumericalError
from pgm.kernels import moments, normal, roots
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, transpose
from pgm.kernels.moments import Conditional


@dataclass(frozen=True, eq=False)
class Proposal:
    """Affine Gaussians, one a row: y = F x + b + L s, s ~ N(0, I), or multivariate Student t.

    matrix: (rows, runs, n, m); m is 0 where nothing is given.
    offset: (rows, runs, n).
    lower: (rows, runs, n, n): L, with zero rows for components that are not free.
    regular: Whether all free components vary, so that they have a density.
    """

    matrix: Array
    offset: Array
    lower: Array
    regular: bool

    @classmethod
    def make(cls, conditional: Conditional, free: Mask) -> Proposal:
        """Propose the free components, (rows, runs, n), of conditionals of all."""
        matrix, offset, cov = conditional
        # What an exact measurement determines may have a variance of zero less rounding.
        certain = moments.certain(cov, np.where(free, 0.0, np.inf))
        lower = roots.root(certain)
        if not roots.is_proper(lower):
            raise NumericalError(
                "the posterior's covariances are indefinite or not finite, so that nothing can be "
                "drawn from them; use a lineariser with positive weights, or a prior that says "
                "what is known"
            )
        regular = bool((roots.determined(lower) == ~free).all())
        return cls(matrix, offset, lower, regular)

    @cached_property
    def _fixed(self) -> Mask:
        return roots.determined(self.lower)

    def white(
        self, row: int, count: int, rng: np.random.Generator, away: Mask | None = None
    ) -> Array:
        """White noise s, (runs, S, n), zero where determined; of Student's t where `away`."""
        lower = self.lower[row]
        white = rng.standard_normal((lower.shape[0], count, lower.shape[-1]))
        if away is not None:
            stretch(white, away, rng)
        fixed = self._fixed[row]
        return np.where(fixed[:, None, :], 0.0, white) if fixed.any() else white

    def values(self, row: int, given: Array, white: Array) -> Array:
        """The draws (runs, S, n) given others (runs, S, m), of white noise."""
        return self._mean(row, given) + white @ transpose(self.lower[row])

    def whitened(self, row: int, given: Array, values: Array) -> Array:
        """The white noise (runs, S, n) of draws."""
        off = values - self._mean(row, given)
        if self._inverse is None:
            return normal.whitened(self.lower[row], off)[0]
        white: Array = off @ transpose(self._inverse[row])
        return white

    @cached_property
    def _inverse(self) -> Array | None:
        return normal.whitener(self.lower)

    @cached_property
    def _constants(self) -> tuple[Integers, Array]:
        """The number of free components, and the constant of the Gaussian's log-density."""
        size = (~self._fixed).sum(axis=-1)
        return size, -0.5 * (roots.log_determinant(self.lower) + size * LOG_2PI)

    def log_density(self, row: int, squared: Array) -> Array:
        """The log-density (runs, S) of draws by the Gaussian, at their |s|²."""
        value: Array = self._constants[1][row][:, None] - 0.5 * squared
        return value

    def log_tails(self, row: int, squared: Array) -> Array:
        """The log-density (runs, S) by Student's t, less that by the Gaussian."""
        return log_ratio(self._constants[0][row][:, None], squared)

    def _mean(self, row: int, given: Array) -> Array:
        mean: Array = given @ transpose(self.matrix[row]) + self.offset[row][:, None, :]
        return mean


# Degrees of freedom: four moments, and still eight times the mass of a Gaussian beyond three
# deviations of a plane.
FREEDOM = 5.0


def stretch(white: Array, where: Mask, rng: np.random.Generator) -> None:
    """Turn Gaussian noise (..., n) into that of a multivariate Student t, in place, where said."""
    white[where] *= np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (int(where.sum()), 1)))


def log_ratio(size: Integers, squared: Array) -> Array:
    """The log-density of Student's t less the Gaussian's, at |s|² of so many components."""
    constant = np.array([_log_constant(k) for k in range(int(size.max(initial=0)) + 1)])[size]
    power = 0.5 * (FREEDOM + size)
    value: Array = constant - power * np.log1p(squared / FREEDOM) + 0.5 * squared
    return value


def _log_constant(size: int) -> float:
    gammas = lgamma(0.5 * (FREEDOM + size)) - lgamma(0.5 * FREEDOM)
    return gammas + 0.5 * size * (LOG_2PI - log(FREEDOM * pi))
