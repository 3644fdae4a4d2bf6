"""Whether float64 has digits enough for a chain: how far apart its deviations lie.

A covariance in float64 keeps what is small in it to about 10⁻¹⁶ of what is, or was, large. Three
ratios bound what is lost, each a variance over one that is found from it by subtraction:

- of a reading: Σ_j (HᵀR⁻¹H)_jj σ_j², by how much it may sharpen the prediction; without noise,
  (Σ_j |h_j| σ_j)² / S, what is added up to the variance of an innovation over that variance;
- of a component: its largest predicted variance so far over the one that readings leave;
- of a transition: (Σ_j |A_ij| σ_j)² over the predicted variance.

σ are the largest predicted deviations so far. Where all ratios are moderate, the passes in float64
are right; where one is not, they are made in twice the digits.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.backward import transition
from pgm.inference.chain.forward import Forward, rough
from pgm.inference.chain.likelihoods import Readings
from pgm.inference.chain.many import Filtered
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.whitened import distinct
from pgm.kernels import roots
from pgm.kernels.arrays import Array, apply, sandwich

ALWAYS = False
# The largest ratio at which float64 leaves all the digits that are promised.
_MODERATE = 1e8


def is_flat(plan: ChainPlan) -> bool:
    """Whether the prior has an infinite variance."""
    return ALWAYS or any(np.isinf(link.family.own_noise).any() for link in plan.prior)


def suffices(plan: ChainPlan, swept: Forward | Filtered) -> bool:
    """Whether a forward pass has kept its digits, and no lineariser has made it indefinite."""
    proper = not rough(plan) or roots.is_proper(roots.root(swept.cov))
    return proper and worst(plan, swept) < _MODERATE


def worst(plan: ChainPlan, swept: Forward | Filtered) -> float:
    """The largest of the ratios."""
    if isinstance(swept, Filtered):
        known = _variances(swept.cov)
        return max(_fallen(np.maximum.accumulate(known, axis=0), known), swept.sharpest)
    predicted = np.maximum(_variances(swept.predicted_cov), 0.0)
    largest = np.maximum.accumulate(predicted, axis=0)
    return max(
        _fallen(largest, _variances(swept.cov)),
        _read(plan, swept, largest),
        _moved(plan, predicted),
    )


def _fallen(largest: Array, known: Array) -> float:
    """Of components; those that are certain do not count."""
    return _ratio(largest, np.where(known > 0.0, known, np.inf))


def _read(plan: ChainPlan, swept: Forward, largest: Array) -> float:
    """Of readings."""
    said = Readings.of(plan, swept.predicted_mean)
    found = float((_variances(said.likelihood.K) * largest).sum(axis=-1).max(initial=0.0))
    for steps, matrix, _, noise, _ in said.stacks:
        predictive = sandwich(matrix, swept.predicted_cov[steps]) + noise
        pivots = _variances(roots.root(predictive)) ** 2
        size = apply(np.abs(matrix), np.sqrt(largest[steps])) ** 2 + _variances(noise)
        found = max(found, _ratio(size, pivots))
    return found


def _moved(plan: ChainPlan, predicted: Array) -> float:
    """Of transitions."""
    if not plan.steps:
        return 0.0
    states = plan.layout.state_places
    matrix = np.abs(distinct(transition(plan).matrix))
    size = apply(matrix, np.sqrt(predicted[:-1][..., states])) ** 2
    return _ratio(size, predicted[1:])


def _ratio(size: Array, left: Array) -> float:
    """The largest ratio; zero where there is nothing, and NaN and infinity are infinite."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.where(size > 0.0, size / left, 0.0)
    found = float(ratio.max(initial=0.0))
    return found if np.isfinite(found) else np.inf


def _variances(cov: Array) -> Array:
    found: Array = np.diagonal(cov, axis1=-2, axis2=-1)
    return found
