"""The dense joint Gaussian of a network's components, made of linearised CPDs in decimals.

Nothing is rounded but the last decimal. The joint has a mean m and a covariance P. A child is y =
F p + b + v: its parents p are components of the joint, and v is noise of covariance Σ. Let P_p be
the rows of P at the parents, and P_pp the columns of P_p at the parents. When the child joins, its
covariance is F P_pp Fᵀ + Σ, and its covariance with the components before it is F P_p.

An observed child joins too. Then the joint is conditioned on one of the child's components after
another: on component k of the joint having the value z. With the unit vector eₖ,

    s = eₖᵀ P eₖ,   G = P eₖ / s,   m ← m + G (z − mₖ),   P ← P − G eₖᵀ P.

At the end the child leaves the joint. A component with s = 0 is determined by the values read
before: its own value agrees with them, or contradicts the model.

V is the number of joint covariances: 1 where all runs share them, else the number of runs. The
means that go with them are (V, size, columns). The first N of the columns are means: of N = runs if
V is 1, else N = 1. The columns after them are errors of means.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import NamedTuple

import numpy as np

from pgm.kernels import decimals
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, transpose, variances
from pgm.kernels.decimals import ONE, ZERO, Decimals

# A standard deviation of F p below this share of its summands' is rounding of F, which is known to
# half a unit in its last place: without noise, y is determined.
ROUNDED = Decimal(2) ** -51


class Read(NamedTuple):
    """The result of conditioning a joint on the values z of one component, (V, N).

    `log_density` (V, N) is ln p(z) given the values read before. Where these determine the
    component `log_density` is zero, and the mask `contradiction` (V, N) marks values z that miss
    the determined one. `moved` (V,) is about how much all errors of means together shift ln p(z).
    """

    log_density: Array
    contradiction: Mask
    moved: Array


@dataclass(eq=False)
class Joint:
    """The joint of the components so far: `mean` (V, size, columns) and `cov` (V, size, size).

    `size` is the number of places for components; those of absent components are zero. Each column
    of `mean`, of errors too, goes through the operations that a mean goes through. `edge` (V, size)
    are upper bounds on the components' prior standard deviations: in them the summands of F p count
    as positive, so that nothing cancels. The covariance of two components counts as zero if it is
    below `nothing` times the product of their bounds: it is then rounding of the decimals.
    """

    mean: Decimals
    cov: Decimals
    edge: Decimals
    nothing: Decimal

    @classmethod
    def empty(cls, stacked: int, size: int, columns: int, nothing: Decimal) -> Joint:
        """A joint without components yet, for V = `stacked`: its arrays are zero.

        `size` is the most components that it can have at a time, `columns` counts the means and the
        errors of means together, and `nothing` is the field of the class.
        """
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
        """Add a child y = F p + b + v at `places` (d,) of the joint, p being at `parents` (n,).

        `matrix` is F (V, d, n), `offset` b (V, d, columns), and `noise` the covariance Σ (V, d, d)
        of v. A component of F p counts as constant if its variance is no more than the rounding of
        its summands.
        """
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
        """Condition the joint on the component at `place` having the values z = `value`, (V, N).

        In the columns of errors its value is zero. Where the values read before determine the
        component, z contradicts the model if it misses the determined value by more than `allowed`
        (V, N).
        """
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
        """Marginalise the components at `places` out; `add` may use these places again."""
        self.mean[:, places] = ZERO
        self.cov[:, places] = ZERO
        self.cov[:, :, places] = ZERO
