"""The smoothed beliefs of each CPD's family, of all its rows at once.

A family is a CPD with its hidden parents and its child. A transition has a row for each step, a
sensor for each of its sightings (measurements at a step), and a prior has one row. A *slice* is the
vector of a step's states and hidden controls; only the states act on the next slice.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.digits.adjoint import CarefulSmoothed
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes import backward
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.kernels.arrays import Index, block, quiet
from pgm.linearisation.family import Family
from pgm.posteriors.expectations import (
    OBSERVATION,
    PRIOR,
    TRANSITION,
    Expectations,
    FamilyBelief,
    Learnable,
)


@quiet()
def family_beliefs(posterior: ChainOutcome) -> Expectations:
    """The belief of each family that has rows, from a smoothed posterior."""
    plan, beliefs = posterior._plan, posterior._beliefs
    layout, places = plan.layout, plan.layout.state_places
    found: dict[Learnable, FamilyBelief] = {}
    first = Beliefs(beliefs.mean[:1][..., places], block(beliefs.cov[:1], places, places))
    groups = [(PRIOR, plan.prior, first)]
    if plan.steps:
        groups.append((TRANSITION, plan.transition, _pairs(posterior)))
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
            values=sensor.values, taken=sensor.taken
        )
    return Expectations({}, found)


def _belief(family: Family, moments: Beliefs, chosen: Index) -> FamilyBelief:
    """The belief of a family, read from the moments of larger vectors that hold its components.

    `moments` are those of one vector for each row, such as its slice; `chosen` are the places of
    the family's components in it. The result's `values` and `taken` are None.
    """
    mean, cov = moments.mean[..., chosen], block(moments.cov, chosen, chosen)
    return FamilyBelief(family, mean, cov, None, None)


def _pairs(posterior: ChainOutcome) -> Beliefs:
    """The smoothed moments of the pairs (states at t − 1, slice at t), t = 1..T: (T, runs, ...)."""
    beliefs, careful = posterior._beliefs, posterior._careful
    if careful is None:
        return backward.pairs(beliefs, posterior._reverse, slice(None))
    states = posterior._plan.layout.state_places
    mean = np.concatenate([beliefs.mean[:-1][..., states], beliefs.mean[1:]], axis=-1)
    return Beliefs(mean, CarefulSmoothed.of(posterior._plan, careful).pairs())
