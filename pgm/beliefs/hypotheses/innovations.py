r"""The innovations of a mixed chain's measurements: those of the mixture of its Gaussians.

With the weights w_i of the Gaussians, and the predictions N(ẑ_i, S_i) of a measurement z by each,

.. math:: \nu = z - \sum_i w_i \hat z_i, \qquad
          S = \sum_i w_i \big(S_i + (\hat z_i - \hat z)(\hat z_i - \hat z)^\top\big),

and the NIS is νᵀS⁻¹ν. Its mean is the number of components, as that of a Gaussian; it has no χ²
distribution, unless one Gaussian has nearly all the weight.

Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
sections 5.4 and 11.6.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.hypotheses.cases import Given
from pgm.beliefs.hypotheses.measurements import Members, moments
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.errors import Unanswered
from pgm.evidence import Reading
from pgm.kernels.arrays import Array, independent, transpose
from pgm.kernels.dense import Stack
from pgm.kernels.semirings import log_sum
from pgm.kernels.step import innovation, turns
from pgm.posteriors.innovations import Innovations


def innovations(given: Given, regimes: Regimes, members: Members, reading: Reading) -> Innovations:
    """The innovations of one sensor, at the predicted Gaussians of all steps of the evidence.

    A row is a sighting, in the order of the evidence.
    """
    bound, size = given.bound, reading.cpd.child.dimension
    found = moments(given, regimes, members, reading)
    logs = members.logs[reading.step]
    weights = np.exp(logs - log_sum(logs, 1)[:, None])
    shape = len(reading.step), bound.runs, size
    taken = np.broadcast_to(reading.taken, shape)
    each = np.broadcast_to(reading.values, shape)[:, None] - found.mean
    for k in np.flatnonzero(reading.cpd.child.angle_mask):
        each[..., k] -= turns(each[..., k])
    # Each sighting has a component of its own of the sensor's mixture.
    shares = np.repeat(np.exp(found.logs), bound.runs, axis=1)
    away, inside = _mixed(shares, _flat(each), _flat(found.cov))
    away, inside = (part.reshape(each.shape[1:4] + part.shape[2:]) for part in (away, inside))
    matrix = np.einsum("km,khmrij->hmrij", np.exp(found.logs), found.matrix)
    residual, cov = _mixed(weights, away, inside)
    nis = np.full((bound.steps + 1, bound.runs), np.nan)
    dof = np.zeros(nis.shape, dtype=np.intp)
    for step in np.unique(reading.step).tolist():
        rows = np.flatnonzero(reading.step == step)
        if found.correlated and rows.size > 1:
            raise Unanswered(
                f"innovations[{reading.cpd.child!r}]: its sightings of a step are linearised as "
                "one vector, whose errors are correlated, and have no joint covariance here",
                variable=reading.cpd.child,
            )
        within = _jointly(inside[rows], matrix[rows], members.cov[step])
        nu, whole = _mixed(weights[rows[0]], _side_by_side(away[rows]), within)
        seen = _side_by_side(taken[rows])
        nu, whole = np.where(seen, nu, 0.0), independent(whole, seen)
        square = innovation(Stack.column(nu), Stack(whole, True)).square
        dof[step] = seen.sum(axis=-1)
        nis[step] = np.where(dof[step] > 0, square, np.nan)
    both = taken[..., None] & taken[..., None, :]
    order, lead = np.argsort(reading.order), bound.lead

    def out(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        whole = np.moveaxis(values, 0, 1)
        return whole.reshape(*lead, *whole.shape[1:])

    return Innovations(
        out(np.where(taken, residual, np.nan)[order]),
        out(np.where(both, cov, np.nan)[order]),
        reading.step[order] + given.first,
        out(nis),
        out(dof),
        np.zeros((*lead, len(order)), dtype=bool),
    )


def _mixed(weights: Array, away: Array, within: Array) -> tuple[Array, Array]:
    """The moments of mixtures (..., runs, d) of weights (..., M, runs), by those of M Gaussians."""
    mean = np.einsum("...mr,...mri->...ri", weights, away)
    apart = away - mean[..., None, :, :]
    cov = np.einsum("...mr,...mrij->...rij", weights, within)
    return mean, cov + np.einsum("...mr,...mri,...mrj->...rij", weights, apart, apart)


def _flat(parts: Array) -> Array:
    """Moments (K, rows, M, runs, ...) as (rows, K, M · runs, ...)."""
    count, rows, members, runs, *own = parts.shape
    return parts.swapaxes(0, 1).reshape(rows, count, members * runs, *own)


def _side_by_side(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The components of several rows (k, ..., d) of a step in one vector, (..., k d)."""
    return np.concatenate(list(rows), axis=-1)


def _jointly(cov: Array, matrix: Array, state: Array) -> Array:
    """The covariance of a step's k measurements of d components, (M, runs, k d, k d).

    `cov` are those of each, (k, M, runs, d, d), `matrix` lead from the slice to each, and `state`
    is the covariance of the slice.
    """
    count, size = len(cov), cov.shape[-1]
    every = np.concatenate(list(matrix), axis=-2)
    found: Array = every @ state @ transpose(every)
    for k in range(count):
        own = slice(k * size, (k + 1) * size)
        found[..., own, own] = cov[k]
    return found
