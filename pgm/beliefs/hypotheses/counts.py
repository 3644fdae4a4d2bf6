"""Counts of what hypotheses make certain.

A hypothesis that makes a measurement certain outweighs all that give it a density, whatever that
is, unless these make others certain. So hypotheses have *counts*, of the measured components that
they made certain so far, and those of the highest count alone have a probability. Where none makes
anything certain, as without exact CPDs, all counts are the number 0, and cost nothing. Hypotheses
of log-weight −∞ are *dead*.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array, Integers

Counts = Integers | int


def leading(logs: Array, counts: Counts, axes: int | tuple[int, ...]) -> Array:
    """The log-weights of the hypotheses of the highest count along axes; −∞ of the others."""
    if not isinstance(counts, np.ndarray):
        return logs
    counts = np.where(logs > -np.inf, counts, -1)
    return np.where(counts == counts.max(axis=axes, keepdims=True), logs, -np.inf)


def best_of(
    logs: Array, counts: Counts, owner: Integers | None, count: int
) -> tuple[Array, Counts]:
    """The log-weights of the members of the highest count of each component; −∞ of the others.

    And the counts of the components, (count, *batch). `owner` is as of `kernels.merging`.
    """
    if not isinstance(counts, np.ndarray):
        return logs, counts
    counts = np.where(logs > -np.inf, counts, -1)
    if owner is None:
        most = counts.max(axis=0, keepdims=True)
        return np.where(counts == most, logs, -np.inf), most
    own = owner == np.arange(count).reshape(count, *(1,) * owner.ndim)
    most = np.where(own, counts, -1).max(axis=1)
    return np.where(counts == np.take_along_axis(most, owner, axis=0), logs, -np.inf), most
