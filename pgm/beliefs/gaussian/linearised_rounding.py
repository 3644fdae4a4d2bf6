"""The rounding of linearised CPDs of a network, and by how much it shifts its variables.

A linearised CPD has the mean F x + b, (d,), given its hidden parents x. Where it was linearised the
parents have the means μ and the standard deviations σ. Its value there, F μ + b, may be a small
difference of large numbers, and is rounded as these are. With sigma points F and b are sums of the
function's values at the points, times weights. Where the points lie close together the weights are
large, and of both signs, so that rounding grows. A *group* is made of copies of one CPD, which are
linearised together.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.gaussian.model import Model
from pgm.kernels import differences
from pgm.kernels.arrays import Array, apply, deviation
from pgm.linearisation.family import cancellation
from pgm.linearisers import Taylor
from pgm.linearisers.regression import StatisticalRegression

# Rounding of a linearised value, as a part of its summands.
ROUNDING = 2.0**-52


def rounding(model: Model, g: int) -> Array:
    """A bound on the rounding of F x + b of the nonlinear CPDs of group g, (CPDs, runs, d).

    |F| has the absolute values of the entries of F. In units of 2⁻⁵² the bound is

    - with sigma points: w (|F| (|μ| + σ) + |b|), w being the sum of the points' absolute weights in
      the mean and in the slope;
    - with `Taylor` and numerical derivatives: k (|F| |μ| + |b|) + |F| σ, k being 1 plus the ratio
      of σ to the step of the difference, summed over the components that are differentiated
      numerically;
    - with `Taylor` and no numerical derivatives: |F| |μ| + |b|;
    - with other linearisers: |F| |μ| + |b| + |F| σ;
    - where no parent is hidden: |b|.
    """
    family = model.families[g]
    rule, template = family.lineariser, family.template
    assert template is not None
    at, spread, lengths = model.points[g]
    here: Array = apply(np.abs(family.matrix), np.abs(at)) + np.abs(family.offset)
    away: Array = apply(np.abs(family.matrix), spread)
    if not family.hidden:
        return ROUNDING * here
    if isinstance(rule, StatisticalRegression):
        # The slope is a sum of values at all points, and so is the offset.
        points = rule.points(at.shape[-1], template.child.name, 0)
        slope = float(np.abs(points.cov_weights[:, None] * points.points).sum(axis=-2).max())
        return ROUNDING * (float(np.abs(points.mean_weights).sum()) + slope) * (here + away)
    share = np.ones((*at.shape[:-1], 1))
    if isinstance(rule, Taylor):
        some = list(template.numerical)
        reach = spread / differences.steps(at, lengths)
        share += reach[..., some].sum(axis=-1, keepdims=True)
        away = away if some else np.zeros_like(away)
    return ROUNDING * (here * share + away)


def shift(model: Model) -> float:
    """The largest rounding of a component of F x + b, beside its standard deviation, in any run.

    The rounding, as `rounding` bounds it, is counted in units of 2⁻⁵² standard deviations of the
    component's noise; where there is no noise, of the component of F x (|F| σ, a bound on them).
    Only CPDs count whose sigma points lie so close together that rounding grows more than tenfold;
    if there are none, the result is zero.
    """
    most = 0.0
    for g, family in enumerate(model.families):
        if cancellation(family):
            noise = deviation(family.noise)
            prior = apply(np.abs(family.matrix), model.points[g].std)
            unit = np.where(noise > 0.0, noise, prior)
            lost = rounding(model, g) / np.where(unit > 0.0, unit, np.inf)
            most = max(most, float(lost.max(initial=0.0)) / ROUNDING)
    return most
