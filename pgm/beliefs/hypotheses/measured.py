"""Measurements of a step as hypotheses have taken them in, and what of them flows back.

A hypothesis that makes a measurement certain outweighs all that give it a density, whatever that
is, unless these make others certain. So hypotheses have *counts*, of the measured components that
they made certain so far, and those of the highest count alone have a probability. Where none makes
anything certain, as without exact CPDs, all counts are the number 0, and cost nothing. Hypotheses
of log-weight −∞ are *dead*.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.readings import Moments, Reading
from pgm.beliefs.moments.steps.vector import vector
from pgm.kernels.arrays import (
    Array,
    Integers,
    apply,
    components_last,
    sandwich,
    symmetric,
    transpose,
)
from pgm.kernels.solving import regression

Counts = Integers | int


def leading(logs: Array, counts: Counts, axes: int | tuple[int, ...]) -> Array:
    """The log-weights of the hypotheses of the highest count along axes; −∞ of the others."""
    if not isinstance(counts, np.ndarray):
        return logs
    counts = np.where(logs > -np.inf, counts, -1)
    return np.where(counts == counts.max(axis=axes, keepdims=True), logs, -np.inf)


def best_of(logs: Array, counts: Counts, owner: Integers, count: int) -> tuple[Array, Counts]:
    """The log-weights of the members of the highest count of each component; −∞ of the others.

    And the counts of the components, (count, *batch). `owner` is as of `kernels.merging`.
    """
    if not isinstance(counts, np.ndarray):
        return logs, counts
    counts = np.where(logs > -np.inf, counts, -1)
    own = owner == np.arange(count).reshape(count, *(1,) * owner.ndim)
    most = np.where(own, counts, -1).max(axis=1)
    return np.where(counts == np.take_along_axis(most, owner, axis=0), logs, -np.inf), most


class Seen(NamedTuple):
    """The measurements of a step as what flows back needs them, of hypotheses (..., runs, ·).

    With H, the residual ν and its covariance S they are u = Hᵀ S⁻¹ ν (..., n), U = Hᵀ S⁻¹ H
    (..., n, n), and I − P U, P being the covariance of the prediction.
    """

    vector: Array
    information: Array
    matrix: Array


def nothing(size: int, shape: tuple[int, ...]) -> Seen:
    """No measurements, of hypotheses of some shape."""
    every = np.tile(np.eye(size), (*shape, 1, 1))
    return Seen(np.zeros((*shape, size)), np.zeros((*shape, size, size)), every)


def flowing(parts: Sequence[Reading], before: Moments, shape: tuple[int, ...]) -> Seen:
    """What a step's measurements let flow back, by their last linearisation.

    `before` is the prediction (n, *batch), whose batch has the hypotheses of the `shape`.
    """
    matrix, residual, noise, _ = vector([part.seen for part in parts], before.mean)
    batch = before.mean.shape[1:]
    h = components_last(np.broadcast_to(matrix, (*matrix.shape[:2], *batch)), 2)
    error = components_last(np.broadcast_to(noise, (*noise.shape[:2], *batch)), 2)
    nu, cov = components_last(residual, 1), components_last(before.cov, 2)
    gain = regression(transpose(h), sandwich(h, cov) + error)
    size = cov.shape[-1]
    information = symmetric(gain @ h)
    return Seen(
        apply(gain, nu).reshape(*shape, size),
        information.reshape(*shape, size, size),
        (np.eye(size) - cov @ information).reshape(*shape, size, size),
    )
