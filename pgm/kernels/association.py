r"""Associating sightings with candidates: likelihoods, gates, and the likeliest of all.

A *sighting* is one measurement by a sensor, of d components; its k *candidates* are the things,
such as landmarks, that it may be of. It may also be *spurious*, or of a *new* thing. With the
belief N(μ, P) over a slice x of n components it is linearised with candidate j as
z = ẑ_j + H_j (x − μ) + e, e ~ N(0, R_j), so that its innovation ν_j = z − ẑ_j has the covariance
S_j = H_j P H_jᵀ + R_j. The probability of candidate j is ∝ w_j N(ν_j; 0, S_j), and zero where
ν_jᵀ S_j⁻¹ ν_j is beyond the gate, the χ² quantile of as many degrees of freedom as components were
measured; that of being spurious, or new, is ∝ its prior probability times its uniform density.

Arrays have the axes (sightings, runs, candidates, ...). Terms (..., k + 2) are logarithms of
unnormalised probabilities: of the candidates, of being spurious, and of being new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import joint_compatibility, mahalanobis
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask
from pgm.kernels.dense import Stack
from pgm.kernels.semirings import log_sum
from pgm.kernels.step import innovation


class Pairs(NamedTuple):
    """The innovation ν of each sighting with each candidate.

    `density` is ln N(ν; 0, S), `square` νᵀS⁻¹ν, `size` the number of components measured. `matrix`
    is H (..., d, n), `residual` ν (..., d), `noise` R (..., d, d); a component that was not
    measured has H = 0, ν = 0 and, in R, unit variance without correlation. `share` is the least
    part of a component's variance in S that those before it leave open, at most 0 where S is not
    positive definite.
    """

    density: Array
    square: Array
    size: Integers
    matrix: Array
    residual: Array
    noise: Array
    share: Array

    def of(self, some: Integers) -> Pairs:
        """The pairs with some of the candidates."""
        return Pairs._make(part[:, :, some] for part in self)


def paired(matrix: Array, residual: Array, noise: Array, spread: Array, size: Integers) -> Pairs:
    """The pairs of H, ν, R and S = `spread` (..., d, d), with their densities."""
    found = innovation(Stack.column(residual), Stack(spread, True))
    # A missing component is one of unit variance without a residual.
    density = -0.5 * (found.square + size * LOG_2PI) - found.volume
    return Pairs(density, found.square, size, matrix, residual, noise, np.asarray(found.share))


def terms(pairs: Pairs, log_weight: Array, log_outliers: Array, gate: float | None) -> Array:
    """The terms (..., k + 2), −∞ of candidates beyond the gate, a probability; None is no gate.

    `log_weight` is ln w, (k,); `log_outliers` (2,) are those of being spurious, and of being new.
    """
    known = pairs.density + log_weight
    if gate is not None:
        limit = mahalanobis.square_within(gate, np.maximum(pairs.size, 1))
        known = np.where(pairs.square > limit, -np.inf, known)
    return with_outliers(known, log_outliers)


def with_outliers(known: Array, log_outliers: Array) -> Array:
    """The terms (..., k + 2) by those of candidates, (..., k), −∞ outside their gate."""
    others = np.broadcast_to(log_outliers, (*known.shape[:-1], 2))
    found = np.concatenate([known, others], axis=-1)
    # A sighting that no candidate explains is spurious, even where none was declared to be.
    found[np.isneginf(found).all(axis=-1), -2] = 0.0
    return found


def jointly(pairs: Pairs, terms: Array, cov: Array, log_weight: Array, gate: float) -> Array:
    """Decide about sightings together: terms of 0 for the choice and −∞ for all else.

    `cov` is P (runs, n, n), and `terms` are as of the function `terms`, with the same gate. A
    sighting to which the search gives no candidate is taken for spurious or new, whichever is
    likelier. A `joint_compatibility.TooManyError` tells of a run with too many hypotheses.
    """
    compatible = np.isfinite(terms[..., :-2]) & (pairs.size > 0)
    parts = pairs.matrix, pairs.residual, pairs.noise, pairs.size[..., 0], compatible
    weighed = joint_compatibility.Pairs(*parts, log_weight)
    found = joint_compatibility.decide(weighed, cov, gate)
    others = terms.shape[-1] - 2 + np.argmax(terms[..., -2:], axis=-1)
    taken = np.where(found == joint_compatibility.NOTHING, others, found)
    decided: Array = np.where(taken[..., None] == np.arange(terms.shape[-1]), 0.0, -np.inf)
    return decided


def probabilities(terms: Array, measured: Mask) -> Array:
    """The probabilities (..., k + 2) of terms, NaN of a sighting that was not `measured`, (...)."""
    found: Array = np.exp(terms - log_sum(terms, -1)[..., None])
    found[~np.broadcast_to(measured, terms.shape[:-1])] = np.nan
    return found


def likeliest(probability: Array) -> Integers:
    """The place of the largest of probabilities (..., k + 2); 0 where they are NaN."""
    found: Integers = np.argmax(np.nan_to_num(probability, nan=-1.0), axis=-1)
    return found
