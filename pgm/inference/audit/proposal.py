"""Proposals: draws of the components that the model leaves open, Gaussian or with Student tails."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import lgamma, log, pi

import numpy as np

from pgm.errors import NumericalError
from pgm.kernels import moments, normal, roots
from pgm.kernels.arrays import LOG_2PI, Array, Mask, transpose
from pgm.kernels.moments import Conditional

# The degrees of freedom of Student tails: as few as leave a covariance.
FREEDOM = 3.0


@dataclass(frozen=True, eq=False)
class Proposal:
    """Affine Gaussians, one a row: y = F x + b + L s, s ~ N(0, I), or multivariate Student t.

    Attributes
    ----------
    matrix : ndarray
        (rows, runs, n, m); m is 0 where nothing is given.
    offset : ndarray
        (rows, runs, n).
    lower : ndarray
        (rows, runs, n, n): L, with zero rows for components that are not free.
    regular : bool
        Whether all free components vary, so that they have a density.
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
        self, row: int, count: int, rng: np.random.Generator, tails: Mask | None = None
    ) -> Array:
        """White noise s, (runs, S, n), zero where determined; of Student's t where `tails`."""
        lower = self.lower[row]
        white = rng.standard_normal((lower.shape[0], count, lower.shape[-1]))
        if tails is not None:
            stretch = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, tails.shape))
            white *= np.where(tails, stretch, 1.0)[..., None]
        fixed = self._fixed[row]
        return np.where(fixed[:, None, :], 0.0, white) if fixed.any() else white

    def values(self, row: int, given: Array, white: Array) -> Array:
        """The draws (runs, S, n) given others (runs, S, m), of white noise."""
        return self._mean(row, given) + white @ transpose(self.lower[row])

    def whitened(self, row: int, given: Array, values: Array) -> Array:
        """The white noise (runs, S, n) of draws."""
        return normal.whitened(self.lower[row], values - self._mean(row, given))[0]

    def log_density(self, row: int, white: Array) -> Array:
        """The log-density (runs, S) of draws by the Gaussian, at their white noise."""
        return normal.log_density(self.lower[row], white)

    def log_tails(self, row: int, white: Array) -> Array:
        """The log-density (runs, S) by Student's t, less that by the Gaussian."""
        size = (~self._fixed[row]).sum(axis=-1)
        constant = np.array([_log_constant(k) for k in range(white.shape[-1] + 1)])[size]
        squared = (white * white).sum(axis=-1)
        power = 0.5 * (FREEDOM + size)[:, None]
        value: Array = constant[:, None] - power * np.log1p(squared / FREEDOM) + 0.5 * squared
        return value

    def _mean(self, row: int, given: Array) -> Array:
        mean: Array = given @ transpose(self.matrix[row]) + self.offset[row][:, None, :]
        return mean


def _log_constant(size: int) -> float:
    """The logarithm of the ratio of the constants of Student's t and of a Gaussian."""
    gammas = lgamma(0.5 * (FREEDOM + size)) - lgamma(0.5 * FREEDOM)
    return gammas + 0.5 * size * (LOG_2PI - log(FREEDOM * pi))
