"""Whether float64 has digits enough for a chain: how far apart its deviations lie.

A covariance in float64 keeps what is small in it to about 10⁻¹⁶ of what is large. Where every
belief is regular, no variance along any direction is much smaller than its parts, and neither what
a transition nor what a reading sums up loses digits. These ratios bound what is lost:

- of a belief, before and after readings: a variance over the share of it that is left open by the
  components before it;
- of a component: its variance before readings, at the step or later ones, over that after them;
- of readings without noise: (Σ_j |h_j| σ_j)² over the share of the variance of an innovation that
  is left open by those before it.

Where all ratios are moderate, the passes in float64 are right; where one is not, they are made in
twice the digits.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.forward import Forward
from pgm.inference.chain.many import Filtered
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.stacks import stacks
from pgm.kernels import along_runs, roots
from pgm.kernels.arrays import Array, apply, sandwich

# The largest ratio at which float64 leaves all the digits that are promised.
_MODERATE = 2e7


def is_flat(plan: ChainPlan) -> bool:
    """Whether the prior has an infinite variance."""
    return any(np.isinf(link.family.own_noise).any() for link in plan.prior)


def suffices(plan: ChainPlan, swept: Forward | Filtered, smoothed: Array | None = None) -> bool:
    """Whether a forward pass, and the covariances that a smoother made of it, kept their digits."""
    with np.errstate(all="ignore"):  # a ratio of what is not finite is no moderate one
        return worst(plan, swept, smoothed) < _MODERATE


def worst(plan: ChainPlan, swept: Forward | Filtered, smoothed: Array | None = None) -> float:
    """The largest of the ratios."""
    if isinstance(swept, Filtered):
        return _inverse(swept.closest)
    predicted, known = swept.predicted_cov, swept.cov
    return max(
        _closeness(predicted),
        _closeness(known),
        _fallen(predicted, known),
        0.0 if smoothed is None else _fallen(known, smoothed),
        _exact(plan, swept),
    )


def _closeness(cov: Array) -> float:
    """Of beliefs (T+1, runs, n, n)."""
    size = cov.shape[-1]
    last = np.moveaxis(cov, (-2, -1), (0, 1)).reshape(size, size, -1)
    return _inverse(along_runs.open_share(last))


def _inverse(share: float) -> float:
    return 1.0 / share if share > 0.0 else np.inf  # NaN too


def _fallen(before: Array, after: Array) -> float:
    """Of components; a variance of zero is known, and a negative one is rounding."""
    left = _variances(after)
    return _ratio(_variances(before), np.where(left == 0.0, np.inf, np.maximum(left, 0.0)))


def _exact(plan: ChainPlan, swept: Forward) -> float:
    """Of readings without noise."""
    exact = [s for s in plan.sensors if s.exact and s.family.step.size]
    found = 0.0
    for steps, matrix, _, noise, _ in stacks(plan, exact, swept.predicted_mean) if exact else []:
        cov = swept.predicted_cov[steps]
        pivots = _variances(roots.root(sandwich(matrix, cov) + noise)) ** 2
        size = apply(np.abs(matrix), np.sqrt(np.maximum(_variances(cov), 0.0))) ** 2
        found = max(found, _ratio(size + _variances(noise), pivots))
    return found


def _ratio(size: Array, left: Array) -> float:
    """The largest ratio; zero where there is nothing, and NaN and infinity are infinite."""
    ratio = np.where(size > 0.0, size / left, 0.0)
    found = float(ratio.max(initial=0.0))
    return found if np.isfinite(found) else np.inf


def _variances(cov: Array) -> Array:
    found: Array = np.diagonal(cov, axis1=-2, axis2=-1)
    return found
