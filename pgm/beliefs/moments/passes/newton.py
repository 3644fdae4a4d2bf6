"""Gauss–Newton steps: the means of a linearised chain, from its normal equations.

A step costs a fraction of a smoother's two passes. Where the variances of noises differ by many
orders, its means lose digits; the next step restores them, and after the last step the passes of a
smoother do. A *slice* is the vector of all hidden variables of a step, of n components. The
*reference* is the trajectory (T+1, runs, n) of slices at which the plan is linearised, for T steps;
means are solved for as moves from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.passes.backward import about, between_slices
from pgm.beliefs.moments.passes.likelihoods import Readings, shortened
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels import normal_density, roots, tridiagonal
from pgm.kernels.arrays import Array, apply, block, multiply, transpose
from pgm.kernels.prefixes import in_chunks
from pgm.kernels.tridiagonal import Tridiagonal
from pgm.schedules.iteration import Point


@dataclass(frozen=True, eq=False)
class Means:
    """Means (T+1, runs, n), and the `variance` (T+1, runs, n) of each component given all others.

    This variance is one over the diagonal of the information matrix, at most the marginal one. It
    is the marginal one where machine code or a smoother has found the means. `readings` are the
    measurements about the reference, None if machine code has found the means. `pair` is the number
    of components of a pair: of the states of the step before, and of the slice.
    """

    means: Array
    variance: Array
    readings: Readings | None
    pair: int

    @property
    def point(self) -> Point:
        """The means as a `Point`, with covariances of which only the diagonals, `variance`, count.

        The covariances of pairs are zero.
        """
        steps, runs, size = self.means.shape
        joint = np.broadcast_to(0.0, (steps - 1, runs, self.pair, self.pair))
        cov = np.broadcast_to(self.variance[..., None], (steps, runs, size, size))
        return Point(self.means, cov, joint)


def step(plan: ChainPlan, reference: Array) -> Means | None:
    """One Gauss–Newton step: the means of the plan linearised at a reference, (T+1, runs, n).

    None where a noise or the prior is singular, or errors of one sensor's measurements at a step
    are correlated, so that there are no normal equations here; and where rounding leaves the
    equations without a solution.
    """
    readings = Readings.of(plan, reference)
    if readings.stacks:
        return None
    system = _equations(plan, readings)
    if system is None:
        return None
    found = tridiagonal.solve_tridiagonal(system)
    if not np.isfinite(found.sum()):
        return None
    variance = 1.0 / np.diagonal(system.diagonal, axis1=-2, axis2=-1)
    return Means(
        reference + found, variance, readings, plan.layout.state_size + plan.layout.slice_size
    )


def _equations(plan: ChainPlan, readings: Readings) -> Tridiagonal | None:
    """The normal equations A ξ = r of the means, as moves ξ from the reference of `readings`.

    Let x_t = F x_{t−1} + b + noise be the transitions between slices, with noise covariances Q; the
    measurements have slopes H and noise covariances R. A is block tridiagonal: the diagonal block
    of a step is Q⁻¹ + HᵀR⁻¹H, with the Q of the transition to it (the prior's covariance at step
    0), plus Fᵀ Q⁻¹ F of the transition from it; the block to its right is −Fᵀ Q⁻¹ of the latter.
    None where the prior's covariance or some Q is singular.
    """
    layout = plan.layout
    states = layout.state_places
    mean, cov = MomentChain(plan, None).start().by_run
    mean, cov = mean[:, states], block(cov, states, states)
    matrix, offset, noise = about(between_slices(plan), readings.reference)
    first, weight = precision(cov), precision(shortened(noise))
    if first is None or weight is None:
        return None
    diagonal, right = readings.likelihood.K.copy("K"), readings.likelihood.h.copy("K")
    # There are no controls at step 0: they are held where they are.
    diagonal[0, :, layout.control_places, layout.control_places] += 1.0
    rows = states if isinstance(states, slice) else states[:, None]
    diagonal[0][:, rows, states] += first
    right[0][:, states] += apply(first, mean - readings.reference[0][:, states])
    if not plan.steps:
        return Tridiagonal(diagonal, diagonal[:0], right)
    move = _Move(matrix, offset)
    if len(weight) > 1:
        terms = in_chunks(_terms, move, _Precision(np.broadcast_to(weight, noise.shape)))
    else:
        terms = in_chunks(lambda move: _terms(move, _Precision(weight)), move)
    diagonal[1:] += weight
    right[1:] += terms.right_after
    diagonal[:-1] += terms.before
    right[:-1] -= terms.right_before
    return Tridiagonal(diagonal, -transpose(terms.across), right)


class _Move(NamedTuple):
    """Linearised transitions between slices, x[t] = F x[t − 1] + b + noise.

    `matrix` is F (steps, runs, n, n) and `offset` is b (steps, runs, n).
    """

    matrix: Array
    offset: Array


class _Precision(NamedTuple):
    """The information matrices W = Q⁻¹ of transitions' noise, (steps or 1, runs or 1, n, n)."""

    matrix: Array


class _Terms(NamedTuple):
    """The terms of transitions x[t] = F x[t − 1] + b + noise in the normal equations.

    W is the inverse covariance of the noise. `before` is Fᵀ W F and `across` is W F, both
    (steps, runs, n, n); `right_before` is Fᵀ W b and `right_after` is W b, both (steps, runs, n).
    W itself, which the equations of the later slice get too, is not among them.
    """

    before: Array
    across: Array
    right_before: Array
    right_after: Array


def _terms(move: _Move, precision: _Precision) -> _Terms:
    """The products Fᵀ W F, W F, Fᵀ W b and W b of transitions x[t] = F x[t − 1] + b + noise.

    `move` has F (steps, runs, n, n) and b (steps, runs, n); `precision` has the inverse covariances
    W of the noise, (steps or 1, runs or 1, n, n). The first two products are (steps, runs, n, n),
    the last two (steps, runs, n).
    """
    across = multiply(precision.matrix, move.matrix)
    after = apply(precision.matrix, move.offset)
    back = transpose(move.matrix)
    return _Terms(multiply(back, across), across, apply(back, after), after)


def precision(cov: Array) -> Array | None:
    """The inverses of covariances (..., n, n); None where one is singular or indefinite."""
    lower = roots.root(cov)
    white = normal_density.whitener(lower) if roots.is_proper(lower) else None
    return None if white is None else multiply(transpose(white), white)
