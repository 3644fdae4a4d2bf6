"""The smoothed beliefs of each CPD's family, of all its rows at once.

A family is a CPD with its hidden parents and its child. A transition has a row for each step, a
sensor for each of its sightings (measurements at a step), and a prior has one row. A *slice* is the
vector of a step's states and hidden controls; only the states act on the next slice.

A measurement of robust noise counts in the smoother with its weight w, as N(r; 0, R / w). In a
covariance that is too much: w R⁻¹ is the precision of one whose scale is known, and what is left
open of the states comes out too small. Covariances may be *by score*, of a pass in which each
measurement of a sensor counts with the same share of R⁻¹, its `Weights.information`: of noise that
is meant as a distribution, such as Student's t.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.digits.adjoint import CarefulSmoothed
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes import backward
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.smoothers import smoother
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.kernels.arrays import Array, Index, block, independent, quiet
from pgm.kernels.mahalanobis import square_within
from pgm.kernels.solving import regression
from pgm.linearisation.family import Family
from pgm.posteriors.expectations import (
    OBSERVATION,
    PRIOR,
    TRANSITION,
    Expectations,
    FamilyBelief,
    Learnable,
    RobustWeights,
)

# Of a smaller weight w, R / w has no digits left for the error of a linearisation beside it.
_FAINT = 1e-6


class _Smoothed(NamedTuple):
    """The moments of slices (T+1, runs, ...), and of pairs (T, runs, ...)."""

    slices: Beliefs
    pairs: Beliefs


@quiet()
def family_beliefs(posterior: ChainOutcome, *, by_score: bool = False) -> Expectations:
    """The belief of each family that has rows, from a smoothed posterior.

    Its covariances may be `by_score`, beside robust noise that is meant as a distribution.
    """
    plan, told = posterior._plan, dict[int, float]()
    for sensor in plan.robust if by_score else ():
        if sensor.weights.noise.distribution:
            told[id(sensor)] = sensor.weights.information
    beliefs, pairs = _by_score(posterior, told) if told else _of(posterior)
    layout, places = plan.layout, plan.layout.state_places
    found: dict[Learnable, FamilyBelief] = {}
    first = Beliefs(beliefs.mean[:1][..., places], block(beliefs.cov[:1], places, places))
    groups = [(PRIOR, plan.prior, first)]
    if plan.steps:
        groups.append((TRANSITION, plan.transition, pairs))
    for role, links, moments in groups:
        everywhere = np.arange(moments.mean.shape[-1])
        for link in links:
            chosen = np.concatenate([everywhere[link.parents], everywhere[link.child]])
            found[Learnable(link.family.cpd, role)] = _belief(link.family, moments, chosen)
    everywhere = np.arange(layout.slice_size)
    for sensor in plan.sensors:
        if not sensor.family.step.size:
            continue
        rows = sensor.family.step - plan.first
        at = Beliefs(beliefs.mean[rows], beliefs.cov[rows])
        own = _belief(sensor.family, at, everywhere[sensor.parents])
        found[Learnable(sensor.family.cpd, OBSERVATION)] = own._replace(
            values=sensor.values,
            taken=sensor.taken,
            robust=_robust(sensor, told.get(id(sensor))) if sensor.robust else None,
            cut=None if sensor.gated is None else _cut(posterior, sensor),
        )
    return Expectations({}, found)


def _robust(sensor: Sensor, information: float | None) -> RobustWeights:
    """The weights that a smoother found for a sensor's measurements."""
    weights = sensor.weights
    return RobustWeights(weights.weight, weights.square, weights.count, information)


def _cut(posterior: ChainOutcome, sensor: Sensor) -> Array:
    """The parts of E[r rᵀ] of residuals that a sensor's gate has cut off, (M, runs, d, d).

    Innovations within a gate, νᵀS⁻¹ν ≤ q, have the covariance κ S, with κ = P(χ²_{d+2} ≤ q) over
    P(χ²_d ≤ q), and the second moments of residuals that they tell are less by (1 − κ) R S⁻¹ R.
    """
    from scipy.special import chdtr  # here, since it is slow to import

    assert sensor.gated is not None
    assert sensor.taken is not None
    innovations = posterior.innovations[sensor.variable]
    rows, runs, height, _ = sensor.family.shape
    shape = runs, rows, height, height
    cov = innovations.cov.reshape(shape).swapaxes(0, 1)[sensor.order]
    taken = sensor.taken & np.isfinite(np.diagonal(cov, axis1=-2, axis2=-1))
    both = taken[..., :, None] & taken[..., None, :]
    noise = np.where(both, sensor.family.own_noise, 0.0)
    whole = independent(np.where(both, cov, 0.0), taken)
    count = taken.sum(axis=-1)
    limit = square_within(sensor.gated.gate, count)
    kept = chdtr(count + 2.0, limit) / sensor.gated.gate
    share = np.where(count > 0, 1.0 - kept, 0.0)
    cut: Array = share[..., None, None] * (regression(noise, whole) @ noise)
    return cut


def _belief(family: Family, moments: Beliefs, chosen: Index) -> FamilyBelief:
    """The belief of a family, read from the moments of larger vectors that hold its components.

    `moments` are those of one vector for each row, such as its slice; `chosen` are the places of
    the family's components in it. The result's `values` and `taken` are None.
    """
    mean, cov = moments.mean[..., chosen], block(moments.cov, chosen, chosen)
    return FamilyBelief(family, mean, cov, None, None)


def _of(posterior: ChainOutcome) -> _Smoothed:
    """The smoothed moments."""
    beliefs, careful = posterior._beliefs, posterior._careful
    if careful is None:
        return _Smoothed(beliefs, backward.pairs(beliefs, posterior._reverse, slice(None)))
    cov = CarefulSmoothed.of(posterior._plan, careful).pairs()
    return _Smoothed(beliefs, _pairs(posterior._plan, beliefs.mean, cov))


def _by_score(posterior: ChainOutcome, told: dict[int, float]) -> _Smoothed:
    """The smoothed means, with covariances by score.

    `told` has the information of the sensors of robust noise, by their identity.
    """
    plan, again = posterior._plan, posterior._plan.copies(1)
    for sensor, other in zip(plan.sensors, again.sensors, strict=True):
        if id(sensor) in told:
            weights, own, noise = sensor.weights, sensor.family.own_noise, other.family.noise
            error = noise - weights.scaled(own)
            if sensor.family.taylor:
                error = np.zeros_like(noise)
            error = np.where(weights.weight[..., None, None] > _FAINT, error, 0.0)
            alike = np.full_like(weights.weight, told[id(sensor)])
            noise[...] = replace(weights, weight=alike).scaled(own) + error
    mean = posterior._beliefs.mean
    slices, pairs = smoother.covariances(again, mean, careful=posterior._careful is not None)
    return _Smoothed(Beliefs(mean, slices), _pairs(plan, mean, pairs))


def _pairs(plan: ChainPlan, mean: Array, cov: Array) -> Beliefs:
    """The moments of pairs (states at t − 1, slice at t), t = 1..T, of covariances (T, runs, ...).

    `mean` (T+1, runs, n) is that of the slices.
    """
    states = plan.layout.state_places
    return Beliefs(np.concatenate([mean[:-1][..., states], mean[1:]], axis=-1), cov)
