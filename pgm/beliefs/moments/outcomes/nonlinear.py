"""How nonlinear the CPDs of a chain are over the beliefs where they were linearised.

A *slice* is the vector of all hidden variables of a step, a *pair* the states of a step followed by
the next slice. A row is a step of a transition, or a reading of a sensor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgm.beliefs.moments.passes import backward
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.steps.plan import Link
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.kernels.arrays import Array, Index, block
from pgm.linearisation.nonlinearity import nonlinearity
from pgm.posteriors.belief_kind import FILTERED
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.moments.outcomes.outcome import ChainOutcome


def nonlinearities(posterior: ChainOutcome) -> dict[Variable, Array]:
    """The nonlinearity of each nonlinear CPD's rows, by its child: (*runs, rows) each.

    The rows of a sensor are in the order of the evidence, NaN where nothing was read.
    """
    plan, forward = posterior._plan, posterior._forward
    once = posterior.status.iterations == 1
    ahead = Beliefs(forward.predicted_mean, forward.predicted_cov)
    found: dict[Variable, Array] = {}
    for sensor in plan.read:
        if not sensor.family.exact:
            found[sensor.variable] = _of_sensor(sensor, ahead if once else posterior._beliefs)
    filters = once or posterior.kind == FILTERED
    before = Beliefs(forward.mean, forward.cov) if filters else posterior._beliefs
    for link in plan.transition if plan.steps else ():
        if not link.family.exact:
            after = ahead if filters else posterior._beliefs
            found[link.family.cpd.child] = _of_motion(posterior, link, before, after)
    return {
        variable: figures.T.reshape(*plan.lead, len(figures)) for variable, figures in found.items()
    }


def _of_sensor(sensor: Sensor, slices: Beliefs) -> Array:
    """The nonlinearity of each reading of a sensor, (M, runs)."""
    steps = sensor.family.step
    at = _part(Beliefs(slices.mean[steps], slices.cov[steps]), sensor.parents)
    figures = nonlinearity(sensor.family, at.mean, at.cov, sensor.taken)
    if sensor.taken is not None:
        figures[~np.broadcast_to(sensor.taken.any(axis=-1), figures.shape)] = np.nan
    return figures[np.argsort(sensor.order)]


def _of_motion(posterior: ChainOutcome, link: Link, before: Beliefs, after: Beliefs) -> Array:
    """The nonlinearity of a CPD of the transition at each step, (T, runs).

    `before` are the beliefs of slices from which it starts, at 0..T, and `after` those of slices to
    which it leads, given the same measurements.
    """
    layout = posterior._plan.layout
    places = np.arange(layout.state_size + layout.slice_size)[link.parents]
    if (places < layout.state_size).all():
        states = _part(before, layout.state_places)
        at = Beliefs(states.mean[:-1], states.cov[:-1])
    else:
        at = backward.pairs(after, posterior._reverse, slice(None))
    own = _part(at, places)
    return nonlinearity(link.family, own.mean, own.cov)


def _part(beliefs: Beliefs, places: Index) -> Beliefs:
    """The moments of some components."""
    chosen = np.arange(beliefs.mean.shape[-1])[places]
    return Beliefs(beliefs.mean[..., chosen], block(beliefs.cov, chosen, chosen))
