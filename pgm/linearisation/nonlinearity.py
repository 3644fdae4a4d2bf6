r"""How nonlinear a CPD is over a belief, beside its own noise.

A line leaves of a function h(x), x ~ N(μ, P), the error n = h(x) − (F x + b). The best line is the
regression of h(x) on x, whose error has the covariance Σₙ. With R, the covariance of the CPD's own
noise, the *nonlinearity* is

.. math:: \operatorname{tr} \Sigma_n (\Sigma_n + R)^{-1},

between 0 and the number of components of the child: how many of these the error of the best line
governs, rather than the noise. No lineariser that linearises at this belief is exact where it is
large; where it is small all of them nearly agree.

García-Fernández, Svensson, Morelande & Särkkä, Posterior linearization filter, 2015.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from pgm.factors.scope import dimension
from pgm.kernels.arrays import Array, Integers, Mask, components_last
from pgm.kernels.solving import regression
from pgm.linearisation.family import Family
from pgm.linearisers import GaussHermite, QuasiMonteCarlo, StatisticalRegression

# The product rule has all moments that the error of a quadratic function needs; of more components
# than this it has too many points, and draws take its place.
_FEW = 4
_PRODUCT, _DRAWS = GaussHermite(3), QuasiMonteCarlo(128)
# Points that are evaluated together, at the most.
_POINTS = 200_000


def nonlinearity(
    family: Family, rows: Integers, mean: Array, cov: Array, taken: Mask | None = None
) -> Array:
    """The nonlinearity tr Σₙ(Σₙ + R)⁻¹ of a CPD at k of its rows, in each run, (k, runs).

    `rows` (k,) are their numbers, and `mean` (k, runs, n) and `cov` (k, runs, n, n) beliefs of the
    hidden parents. `taken` (k, runs or 1, d) marks the components of the child that count, those of
    a measurement that were read; None if all do. It is zero of an affine CPD, and NaN where the
    belief is not finite or the function has no finite value.
    """
    runs, height = family.shape[1:3]
    found = np.zeros((rows.size, runs))
    if family.exact or not family.hidden or not found.size:
        return found
    size = dimension(family.hidden)
    other, count = _regressed(family, size), len(_rule(size).points(size, "", 0).points)
    most = max(_POINTS // (count * runs), 1)
    own = np.broadcast_to(family.own_noise, (family.shape[0], runs, height, height))
    for first in range(0, rows.size, most):
        part = slice(first, first + most)
        error, noise = _errors(other, rows[part], mean[part], cov[part]), own[rows[part]]
        if taken is not None:
            read = np.broadcast_to(taken[part], (*error.shape[:2], height))
            both = read[..., :, None] & read[..., None, :]
            error, noise = np.where(both, error, 0.0), np.where(both, noise, 0.0)
        known: Mask = np.isfinite(error.sum(axis=(-2, -1)))
        error = np.where(known[..., None, None], error, 0.0)
        share = np.trace(regression(error, error + noise), axis1=-2, axis2=-1)
        found[part] = np.where(known, share, np.nan)
    return found


def _rule(size: int) -> StatisticalRegression:
    """The rule for a belief of so many components."""
    return _PRODUCT if size <= _FEW else _DRAWS


def _regressed(family: Family, size: int) -> Family:
    """The same CPD, to be linearised by regression, with no record of what its traces answer."""
    assert family.template is not None
    other = copy(family)
    for name in ("prepared", "source", "semidefinite"):
        other.__dict__.pop(name, None)
    other.lineariser, other.answers, other.judge = _rule(size), None, None
    other.template = replace(family.template, tracer=None)
    return other


def _errors(family: Family, rows: Integers, mean: Array, cov: Array) -> Array:
    """Σₙ of some rows, (k, runs, d, d), of a family that is linearised by regression.

    NaN where the belief or a value of the function is not finite.
    """
    known: Mask = np.isfinite(cov.sum(axis=(-2, -1)) + mean.sum(axis=-1))
    mean, cov = np.where(known[..., None], mean, 0.0), np.where(known[..., None, None], cov, 0.0)
    function = family.bound(rows, mean.ndim - 1, mean.shape[:-1])
    line = family.checked(function, mean, cov, finite=False)
    assert line.error is not None
    known &= np.isfinite(line.value.sum(axis=0))
    return np.where(known[..., None, None], components_last(line.error, 2), np.nan)
