"""Diffuse beliefs: some directions have infinite variance; measurements inform along the others.

Given a flat prior a belief is the limit of N(μ, P + κ O Oᵀ) as κ grows; the columns of O are the
directions of which nothing is known yet, the *open* ones. A measurement z = H x + e, e ~ N(0, R),
of d components has an innovation ν = z − Hμ of covariance S + κ U Uᵀ, with S = H P Hᵀ + R and
U = H O. Let C be a matrix of d − rank U independent rows with C U = 0: combinations of the
components that do not depend on open directions. As κ → ∞,

    νᵀ (S + κ U Uᵀ)⁻¹ ν  →  (Cν)ᵀ (C S Cᵀ)⁻¹ Cν.

The limit has as many degrees of freedom as C has rows (Koopman, Exact initial Kalman filtering and
smoothing for nonstationary time series models, 1997; Durbin & Koopman, 2012, 5.2 and 7.2). A
component of z is unknown where its row of U is not zero. Of two unknown ones a difference may be
known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import moments
from pgm.kernels.arrays import (
    Array,
    Index,
    Integers,
    Mask,
    apply,
    block,
    independent,
    sandwich,
    variances,
)
from pgm.kernels.roots import NEGLIGIBLE

# In the elimination of U an entry below this share of its summands is rounding.
_RANK = 1e-10
# A component without noise counts as if its noise's standard deviation were this share of the
# largest entry of its row of U.
_EXACT = 1e-8


class Diffuse(NamedTuple):
    """The covariances of beliefs P + κ O Oᵀ, in the limit of an infinite κ.

    `cov` P is (..., n, n), `open` O (..., n, q), zero where all is known. O was found as sums:
    `size` (..., n, q) are the sums of its summands' absolute values, of which a share of 10⁻¹³ may
    be rounding.
    """

    cov: Array
    open: Array
    size: Array

    @classmethod
    def known(cls, cov: Array) -> Diffuse:
        """Beliefs of finite covariances P (..., n, n): no direction is unknown."""
        none = np.zeros((*cov.shape[:-1], 0))
        return cls(cov, none, none)

    @property
    def unknown(self) -> Mask:
        """The mask (..., n) of components of infinite variance: their row of O is not exactly zero.

        Rounding has been cleared from O when the belief was made.
        """
        return np.asarray(np.any(self.open, axis=-1))

    @property
    def shown(self) -> Array:
        """The covariance as users see it: an unknown component has variance ∞, covariances of 0."""
        unknown = self.unknown
        if not unknown.any():
            return self.cov
        both: Mask = unknown[..., None] | unknown[..., None, :]
        cov = np.where(both, 0.0, self.cov)
        np.einsum("...ii->...i", cov)[unknown] = np.inf
        return cov

    def of(self, places: Index) -> Diffuse:
        """The belief over the components at some `places` of the n."""
        return Diffuse(
            block(self.cov, places, places), self.open[..., places, :], self.size[..., places, :]
        )

    def at(self, rows: Index) -> Diffuse:
        """The beliefs at some rows of the first axis, which are steps."""
        return Diffuse(*(part[rows] for part in self))

    def reach(self, matrix: Array) -> Array:
        """U = H O, (..., d, q): how measurements H (..., d, n) depend on the open directions O.

        Entries that may be rounding alone are zero.
        """
        found = matrix @ self.open
        rounding = NEGLIGIBLE * (np.abs(matrix) @ self.size)
        clean: Array = np.where(np.abs(found) > rounding, found, 0.0)
        return clean

    def measured(self, matrix: Array, noise: Array) -> Diffuse:
        """The covariances of measurements z = H x + e before their values are taken.

        They are S + κ U Uᵀ, with S = H P Hᵀ + R, for H (..., d, n), `matrix`, and R (..., d, d),
        `noise`.
        """
        spread = moments.predict(self.cov, matrix, noise)
        return Diffuse(spread, self.reach(matrix), np.abs(matrix) @ self.size)

    def innovations(
        self, matrix: Array, residual: Array, noise: Array
    ) -> tuple[Array, Array, Integers]:
        """The innovations (..., d) of measurements z = H x + e, their covariances, and rank U.

        `matrix` is H (..., d, n), `residual` ν = z − Hμ (..., d), `noise` R (..., d, d). Where
        U = H O is zero, the first result is ν, and the second is S (..., d, d). Elsewhere they are
        Cν and C S Cᵀ, filled up to d components: each of the rank U combinations that are unknown
        is a zero of unit variance, which adds nothing to the normalised square. The third result
        is rank U (...), the number of these.
        """
        _, reach, _ = measured = self.measured(matrix, noise)
        lead = reach.shape[:-2]
        missing: Integers = np.zeros(lead, dtype=np.intp)
        lost: Mask = np.any(reach, axis=(-2, -1))
        spread = measured.cov
        if not lost.any():
            return np.broadcast_to(residual, reach.shape[:-1]), spread, missing
        residual = np.broadcast_to(residual, reach.shape[:-1]).copy()
        spread = np.broadcast_to(spread, (*lead, *spread.shape[-2:])).copy()
        matrix, noise, cov = (
            np.broadcast_to(part, (*lead, *part.shape[-2:]))[lost]
            for part in (matrix, noise, self.cov)
        )
        turn, known = _combined(reach[lost], noise)
        # C H comes before P, which may be large along what is unknown.
        turned = moments.predict(cov, turn @ matrix, sandwich(turn, noise))
        residual[lost] = np.where(known, apply(turn, residual[lost]), 0.0)
        spread[lost] = independent(turned, known)
        missing[lost] = (~known).sum(axis=-1)
        return residual, spread, missing


def _combined(reach: Array, noise: Array) -> tuple[Array, Mask]:
    """Combinations C (k, d, d) of k measurements' components, and the mask (k, d) of known ones.

    Row i of C is a combination of the d components. The mask is true where it depends on no open
    direction, its row of C U being zero. C comes from a Gaussian elimination of U, `reach`
    (k, d, q), in which components count in standard deviations of their `noise` (k, d, d). The
    pivot is always the component that depends most on an open direction, and its row is masked out.
    Multiples of it, by factors of one at the most, are subtracted from the rows not yet masked out:
    so precise components are not lost among imprecise ones.
    """
    own, largest = variances(noise), np.abs(reach).max(axis=-1)
    exact = _EXACT * np.where(largest > 0.0, largest, 1.0)
    unit = np.where(own > 0.0, np.sqrt(np.maximum(own, 0.0)), exact)
    left = reach / unit[..., None]
    columns = np.abs(left).max(axis=-2, keepdims=True)
    left = left / np.where(columns > 0.0, columns, 1.0)
    size, each = np.abs(left), np.arange(len(left))
    turn = np.broadcast_to(np.eye(left.shape[-2]), (*left.shape[:-1], left.shape[-2])).copy()
    known = np.ones(left.shape[:-1], dtype=bool)
    for _ in range(min(left.shape[-2:])):
        left = np.where(known[..., None] & (np.abs(left) > _RANK * size), left, 0.0)
        row, column = np.divmod(np.abs(left).reshape(len(left), -1).argmax(axis=-1), left.shape[-1])
        pivot = left[each, row, column]
        there = pivot != 0.0
        known[each, row] &= ~there
        factor = left[each, :, column] / np.where(there, pivot, 1.0)[:, None]
        factor = np.where(known, factor, 0.0)
        left = left - factor[..., None] * left[each, row][:, None]
        size = size + np.abs(factor)[..., None] * size[each, row][:, None]
        turn = turn - factor[..., None] * turn[each, row][:, None]
    return turn / unit[:, None, :], known
