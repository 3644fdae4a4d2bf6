"""The cost of a point of a network, −2 ln p less constants, by which a step control judges steps.

It sums rᵀ Q⁺ r over the residuals r of all CPDs, Q being their noise covariances as they were
linearised; of robust readings twice their losses, 2 ρ. A residual is the child less the value that
its CPD expects at the parents' belief. What CPDs without noise determine adds nothing: points that
are compared obey them (`Relations`).
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.gaussian.beliefs import TreePoint
from pgm.beliefs.gaussian.model import Model
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, independent
from pgm.linearisation import costs


def cost(model: Model, at: TreePoint) -> Array:
    """The cost of the means of a point, (runs,); NaN where a function is not defined there.

    Linearisers that take expectations over a belief take them with the point's covariances. A noise
    that is indefinite is refused with a NumericalError.
    """
    total = np.zeros(model.runs)
    for g, (group, family) in enumerate(zip(model.layout.groups, model.families, strict=True)):
        mean, cov = at.of_parents(model.layout, g)
        reading, taken, weights = model.readings[g], model.taken[g], model.weights[g]
        if reading is None:
            child, angles = at.mean[0][:, group.child].swapaxes(0, 1), family.turned
        else:
            child, angles = reading, family.cpd.child.angle_mask
        expected = costs.expected(family, slice(None), mean, cov)
        left, noise = difference(child, expected, angles), family.noise
        if taken is not None:
            left, noise = np.where(taken, left, 0.0), independent(noise, taken)
        if weights is None:
            total += costs.weighted(family, left, noise)
        else:
            seen = (family.matrix, cov) if family.expects else ()
            total += weights.loss(weights.squares(left, *seen)).sum(axis=0)
    return total
