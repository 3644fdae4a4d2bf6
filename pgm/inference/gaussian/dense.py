"""The dense joint Gaussian of a network's components, made of linearised CPDs in decimals.

Nothing is rounded but the last decimal. A child y = F p + b + n, n ~ N(0, Σ), joins the components
before it, whose covariance is P; p are some of these. The child's covariance is F P_pp Fᵀ + Σ, and
its covariance with the components before it F P_p·. An observed child joins, the joint is
conditioned on one of its components k after another,

    G = P eₖ / s,   m ← m + G (z − mₖ),   P ← P − G eₖᵀ P,   s = eₖᵀ P eₖ,

for the component's value z and the joint's mean m, and the child leaves again. A component with
s = 0 is determined by the values read before: its own value agrees with them, or contradicts the
model.

V is the number of joint covariances: 1 where all runs share them, else the number of runs. N is the
number of columns of means, and of errors of means, that go with each covariance.
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
    """The result of conditioning a joint on the values z of one component, (V, N').

    `log_density` (V, N') is ln p(z) given the values read before; it is zero where these determine
    the component, and there `contradiction` (V, N') tells whether z misses the determined value.
    The first N' columns of `Joint.mean` are means, the others errors: `moved` (V,) is about how
    much these errors together may shift ln p(z).
    """

    log_density: Array
    contradiction: Mask
    moved: Array


@dataclass(eq=False)
class Joint:
    """The joint of the components so far: V covariances (V, size, size), and means (V, size, N).

    Each column of `mean` goes through the operations that a mean goes through. `edge` (V, size) are
    upper bounds on the components' prior standard deviations: in them the summands of F p count as
    positive, so that nothing cancels. The covariance of two components counts as zero if it is
    below `nothing` times the product of their bounds: it is then rounding of the decimals.
    """

    mean: Decimals
    cov: Decimals
    edge: Decimals
    nothing: Decimal

    @classmethod
    def empty(cls, stacked: int, size: int, columns: int, nothing: Decimal) -> Joint:
        """A joint without components yet, for V = `stacked` and N = `columns`: its arrays are zero.

        `size` is the most components that it can have at a time, `nothing` the field of the class.
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
        """Add a child y = F p + b + n at `places` (d,) of the joint, p being at `parents` (n,).

        `matrix` is F (V, d, n), `offset` b (V, d, N), and `noise` the covariance Σ (V, d, d). A
        component of F p whose variance is no more than rounding of its summands counts as constant.
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
        """Condition the joint on the component at `place` having the values z = `value`, (V, N').

        These are its values in the first N' columns of `mean`; in the other columns, which hold
        errors, its value is zero. Where the component is determined already, z contradicts the
        model if it misses the determined value by more than `allowed` (V, N').
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
