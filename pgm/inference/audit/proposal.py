"""Gaussian proposals: draws of the components that the model leaves open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.errors import NumericalError
from pgm.kernels import moments, normal, roots
from pgm.kernels.arrays import Array, Mask, transpose
from pgm.kernels.moments import Conditional


@dataclass(frozen=True, eq=False)
class Proposal:
    """Affine Gaussians, one a row: y = F x + b + L s, s ~ N(0, I).

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

    def draw(
        self, row: int, given: Array, count: int, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Draws (runs, S, n) given others (runs, S, m), and their log-densities (runs, S)."""
        lower = self.lower[row]
        white = rng.standard_normal((lower.shape[0], count, lower.shape[-1]))
        fixed = roots.determined(lower)
        if fixed.any():
            white = np.where(fixed[:, None, :], 0.0, white)
        mean = given @ transpose(self.matrix[row]) + self.offset[row][:, None, :]
        return mean + white @ transpose(lower), normal.log_density(lower, white)
