"""The rounding of linearised CPDs of a network, and by how much it shifts its variables.

The linearised mean of a CPD is F x + b, (d,), x being its hidden parents, whose mean is μ. It is a
difference of numbers as large as F μ. With sigma points it is made of weighted values of the
function; where the points lie close together the weights are large, and of both signs
(`Points.cancellation`). A *group* is made of copies of one CPD, which are linearised together.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.family import cancellation
from pgm.inference.gaussian.model import Model
from pgm.kernels import differences
from pgm.kernels.arrays import Array, apply, deviation
from pgm.linearisers import Taylor
from pgm.linearisers.regression import StatisticalRegression

# Rounding of a linearised value, as a part of its summands.
ROUNDING = 2.0**-52


def rounding(model: Model, g: int) -> Array:
    """A bound on the rounding of F x + b of the nonlinear CPDs of group g, (CPDs, runs, d).

    The CPDs were linearised where the parents have the means μ and the standard deviations σ. With
    sigma points the bound is 2⁻⁵² w (|F| (|μ| + σ) + |b|), w being the sum of their absolute
    weights in the mean and in the slope. With other rules it is 2⁻⁵² (k (|F| |μ| + |b|) + |F| σ):
    k is 1, plus for each numerical derivative of `Taylor` the ratio of σ to the step of the
    difference. The term |F| σ is absent if `Taylor` needs no numerical derivative. Where no parent
    is hidden the bound is 2⁻⁵² |b|.
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
    """The largest shift of a linearised value F x + b by its rounding, of all components and runs.

    It is in units of 2⁻⁵² standard deviations of the component's noise, or, where it has none, of
    F x. Only CPDs count whose sigma points lie so close together that rounding grows more than
    tenfold: without any the shift is zero.
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
