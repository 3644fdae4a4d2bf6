"""The dense joint of components, made of linearised CPDs in decimals, with nothing rounded.

A child joins its parents, y = F p + b + n, with the covariance F P Fᵀ + Σ, and F P with all before.
One that is observed joins, is conditioned on component by component,

    G = P eₖ / s,   m ← m + G (z − mₖ),   P ← P − G eₖᵀ P,   s = eₖᵀ P eₖ,

and leaves again. A component with s = 0 is determined by what was read before: its measurement
agrees, or contradicts the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import NamedTuple

import numpy as np

from pgm.kernels import decimals
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, transpose, variances
from pgm.kernels.decimals import ONE, ZERO, Decimals

# What cancels to less than this share of its summands' deviations is rounding of F, which is known
# to half a unit in its last place: with no noise, y is determined.
ROUNDED = Decimal(2) ** -51


class Read(NamedTuple):
    """Conditioning on a component: ln p of its values and where they contradict the model, (V, N').

    `moved` (V,) is by how much the columns beyond N' together may move ln p.
    """

    log_density: Array
    contradiction: Mask
    moved: Array


@dataclass(eq=False)
class Joint:
    """The joint of components so far: V runs with a covariance each, or V = 1 for all runs.

    Columns of `mean` (V, size, N) go through everything as a mean does; `edge` (V, size) are the
    prior's deviations, all summands taken as positive; a number below the share `nothing` of a
    variance of such a deviation is rounding of the digits.
    """

    mean: Decimals
    cov: Decimals
    edge: Decimals
    nothing: Decimal

    @classmethod
    def empty(cls, stacked: int, size: int, columns: int, nothing: Decimal) -> Joint:
        """Without components yet: all of their rows are zero."""
        zeros = decimals.zeros
        return cls(
            zeros(stacked, size, columns),
            zeros(stacked, size, size),
            zeros(stacked, size),
            nothing,
        )

    def add(
        self,
        places: Integers,
        parents: Integers,
        matrix: Decimals,
        offset: Decimals,
        noise: Decimals,
    ) -> None:
        """A child with F (V, d, n), b (V, d, N) and noise (V, d, d)."""
        self.mean[:, places] = decimals.product(matrix, self.mean[:, parents]) + offset
        cross = decimals.product(matrix, self.cov[:, parents])
        own = decimals.product(cross[:, :, parents], transpose(matrix))
        size = np.abs(matrix)
        prior = decimals.product(size, self.edge[:, parents][..., None])[..., 0]
        deviation = decimals.sqrt(np.maximum(variances(self.cov), ZERO)[:, parents])
        now = decimals.product(size, deviation[..., None])[..., 0]
        variance = variances(noise)
        rounding = np.where(variance == ZERO, ROUNDED * ROUNDED * now * now, ZERO)
        least = np.maximum(rounding, self.nothing * prior * prior)
        nothing = np.asarray(variances(own) <= least, dtype=bool)
        cross[nothing] = ZERO
        own = np.where(nothing[..., :, None] | nothing[..., None, :], ZERO, own)
        self.cov[:, places] = cross
        self.cov[:, :, places] = transpose(cross)
        self.cov[:, places[:, None], places] = own + noise
        self.edge[:, places] = decimals.sqrt(prior * prior + variance)

    def read(self, place: int, value: Decimals, allowed: Decimals) -> Read:
        """Condition on a component's values (V, N'), of the first columns, allowed to be off."""
        count = value.shape[1]
        variance, edge = self.cov[:, place, place], self.edge[:, place]
        open_ = np.asarray(variance > self.nothing * edge * edge, dtype=bool)
        innovation = -self.mean[:, place]
        innovation[:, :count] += value
        left = innovation[:, :count]
        far = ~open_[:, None] & np.asarray(np.abs(left) > allowed, dtype=bool)
        divisor = np.where(open_, variance, ONE)[:, None]
        gain = np.where(open_[:, None], self.cov[:, :, place] / divisor, ZERO)
        self.mean = self.mean + gain[..., None] * innovation[:, None]
        cov = self.cov - gain[..., None] * self.cov[:, place][:, None]
        outer = self.edge[..., :, None] * self.edge[..., None, :]
        self.cov = np.where(np.abs(cov) <= self.nothing * outer, ZERO, cov)
        constant = np.array([decimals.log(s) for s in divisor[:, 0].tolist()]) + LOG_2PI
        density = -0.5 * (decimals.floats(left * left / divisor) + constant[:, None])
        deviation = decimals.sqrt(divisor)
        moved = decimals.total(np.abs(innovation[:, count:]))[:, None] / deviation
        lost = decimals.floats(moved * (1 + np.abs(left) / deviation))
        return Read(
            np.where(open_[:, None], density, 0.0),
            far,
            np.where(open_, lost.max(axis=-1, initial=0.0), 0.0),
        )

    def forget(self, places: Integers) -> None:
        """Marginalise components out; their slots become free."""
        self.mean[:, places] = ZERO
        self.cov[:, places] = ZERO
        self.cov[:, :, places] = ZERO
