"""Proposals: draws of the free components of slices, from conditional Gaussians.

A component is *free* if it has noise given its parents in the model; any other component is a
function of its parents and the free ones, and is not proposed. A *slice* is a step of a chain, or
all variables of a network without time. S is the number of draws of a run, n that of the components
of a slice, m that of the components of the states before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.beliefs.moments.trajectories.student import log_ratio, stretch
from pgm.errors import NumericalError
from pgm.kernels import moments, normal_density, roots, solving
from pgm.kernels.angles import difference
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, transpose
from pgm.kernels.moments import Conditional


@dataclass(frozen=True, eq=False)
class Proposal:
    """Affine Gaussians of slices y given the states x before them, one for each slice and run.

    A *row* is a slice: arrays have one for each step, or a single one. The Gaussians are
    y = F x + b + L s with white noise s ~ N(0, I), which may be replaced by noise of Student's t
    for wider tails. L is lower triangular.

    matrix : ndarray
        (rows, runs, n, m): F; m is 0 where nothing is given.
    offset : ndarray
        (rows, runs, n): b.
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
        """The proposal of the `free` components, from Gaussians of all components given x.

        `conditional` has these Gaussians, (rows, runs, ...); `free` is a mask (rows, runs, n). A
        NumericalError is raised if covariances are indefinite.
        """
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
        """The mask of components at which the diagonal of L is zero, (rows, runs, n)."""
        return roots.determined(self.lower)

    def white(
        self, row: int, count: int, rng: np.random.Generator, away: Mask | None = None
    ) -> Array:
        """Draw white noise s for S = `count` draws, (runs, S, n).

        It is zero in components at which the diagonal of L is zero.

        away: The mask of the draws that have noise of Student's t instead, (runs, S); None if none
            has.
        """
        lower = self.lower[row]
        white = rng.standard_normal((lower.shape[0], count, lower.shape[-1]))
        if away is not None:
            stretch(white, away, rng)
        fixed = self._fixed[row]
        return np.where(fixed[:, None, :], 0.0, white) if fixed.any() else white

    def values(self, row: int, given: Array, white: Array) -> Array:
        """The draws F x + b + L s, (runs, S, n).

        `given` is x, (runs, S, m), and `white` the white noise s, (runs, S, n).
        """
        return self._mean(row, given) + white @ transpose(self.lower[row])

    def whitened(
        self, rows: int | slice, given: Array, values: Array, turned: Mask | None = None
    ) -> Array:
        """The white noise s, (..., S, n), that makes given draws: the inverse of `values`.

        `given` is x, (..., S, m), and `values` are the draws F x + b + L s, (..., S, n), of which
        components that are `turned` (n,) may be off by whole turns. Leading axes are (runs,) of a
        row, and (k, runs) of k rows.
        """
        off = values - self._mean(rows, given)
        if turned is not None:
            off = difference(off, np.zeros(off.shape[-1]), turned)
        if self._inverse is None:
            return normal_density.whitened(self.lower[rows], off)[0]
        white: Array = off @ transpose(self._inverse[rows])
        return white

    @cached_property
    def _inverse(self) -> Array | None:
        """L⁻¹ of all rows, (rows, runs, n, n); None if some component has no noise in L."""
        return normal_density.whitener(self.lower)

    @cached_property
    def size(self) -> Integers:
        """The number of components with noise in L, (rows, runs)."""
        found: Integers = (~self._fixed).sum(axis=-1)
        return found

    @cached_property
    def level(self) -> Array:
        """The Gaussian's log-density at s = 0, (rows, runs)."""
        found: Array = -0.5 * (solving.log_determinant(self.lower) + self.size * LOG_2PI)
        return found

    def log_density(self, rows: int | slice, squared: Array) -> Array:
        """The log-density of draws by the Gaussian, (..., S); `squared` is |s|², (..., S)."""
        value: Array = self.level[rows][..., None] - 0.5 * squared
        return value

    def log_tails(self, rows: int | slice, squared: Array) -> Array:
        """The log-density of draws by Student's t, less that by the Gaussian, (..., S).

        `squared` is |s|², (..., S), with the white noise s of the draws.
        """
        return log_ratio(self.size[rows][..., None], squared)

    def _mean(self, rows: int | slice, given: Array) -> Array:
        """The conditional means F x + b, (..., S, n), given x (..., S, m)."""
        mean: Array = given @ transpose(self.matrix[rows]) + self.offset[rows][..., None, :]
        return mean


@dataclass(frozen=True, eq=False)
class Path:
    """The Gaussian law of all variables: of the first slice, then each given the states before it.

    first : Proposal
        One row, of the states at step 0; in a network without time of all variables.
    later : Proposal or None
        T rows, of the slices at steps 1 to T given the states before; None in a network without
        time.
    """

    first: Proposal
    later: Proposal | None = None

    def at(self, index: int) -> tuple[Proposal, int]:
        """The proposal that slice `index` is drawn from, and the row of it that is the slice's."""
        if not index:
            return self.first, 0
        assert self.later is not None
        return self.later, index - 1

    @property
    def regular(self) -> bool:
        """Whether all free components of all slices have a density."""
        return self.first.regular and (self.later is None or self.later.regular)
