"""How nonlinear the CPDs of a chain are over the beliefs where they were linearised.

A *slice* is the vector of all hidden variables of a step, a *pair* the states of a step followed by
the next slice. A row is a step of a transition, or a reading of a sensor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pgm.beliefs.moments.passes import backward
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.steps.plan import Link
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.kernels.arrays import Array, Index, Integers, Mask, block, variances
from pgm.linearisation.family import Family
from pgm.linearisation.nonlinearity import nonlinearity
from pgm.posteriors.belief_kind import FILTERED
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.moments.outcomes.outcome import ChainOutcome


class Linearised(NamedTuple):
    """A nonlinear CPD, and the beliefs of its parents over which its rows were linearised.

    mean, cov: Of the hidden parents, (rows, runs, n) and (rows, runs, n, n).
    taken: Of a sensor the components that were read, (rows, runs or 1, d); None for all.
    order: Of a sensor the place of each row in the evidence; None of a transition.
    """

    family: Family
    mean: Array
    cov: Array
    taken: Mask | None = None
    order: Integers | None = None

    def figures(self, rows: Integers) -> Array:
        """The nonlinearity of some rows, (rows, runs): NaN of a sensor where nothing was read."""
        taken = None if self.taken is None else self.taken[rows]
        found = nonlinearity(self.family, rows, self.mean[rows], self.cov[rows], taken)
        if taken is not None:
            found[~np.broadcast_to(taken.any(axis=-1), found.shape)] = np.nan
        return found

    def widest(self, most: int) -> Integers:
        """The rows with the widest beliefs, so many at the most, in their order.

        A row is as wide as the largest of its variances, each divided by its mean over all rows, in
        any run. Rows that were not read or whose beliefs are not finite count last.
        """
        width = np.maximum(variances(self.cov), 0.0)
        width = np.where(np.isfinite(width), width, 0.0)
        if self.taken is not None:
            width = width * self.taken.any(axis=-1, keepdims=True)
        mean = width.mean(axis=0)
        relative = width / np.where(mean > 0.0, mean, 1.0)
        order = np.argsort(-relative.max(axis=(1, 2), initial=0.0), kind="stable")
        return np.sort(order[:most])


def nonlinearities(posterior: ChainOutcome) -> dict[Variable, Array]:
    """The nonlinearity of each nonlinear CPD's rows, by its child: (*runs, rows) each.

    The rows of a sensor are in the order of the evidence, NaN where nothing was read.
    """
    found = {}
    for variable, each in linearised(posterior).items():
        rows = np.arange(len(each.mean))
        figures = each.figures(rows)[rows if each.order is None else np.argsort(each.order)]
        found[variable] = figures.T.reshape(*posterior._lead, len(rows))
    return found


def linearised(posterior: ChainOutcome) -> dict[Variable, Linearised]:
    """The nonlinear CPDs of a chain, by child, with the beliefs where they were linearised."""
    plan, forward = posterior._plan, posterior._forward
    once = posterior.status.iterations == 1
    ahead = Beliefs(forward.predicted_mean, forward.predicted_cov)
    found: dict[Variable, Linearised] = {}
    for sensor in plan.read:
        if not sensor.family.exact:
            found[sensor.variable] = _sensor(sensor, ahead if once else posterior._beliefs)
    filters = once or posterior.kind == FILTERED
    before = Beliefs(forward.mean, forward.cov) if filters else posterior._beliefs
    for link in plan.transition if plan.steps else ():
        if not link.family.exact:
            after = ahead if filters else posterior._beliefs
            found[link.family.cpd.child] = _motion(posterior, link, before, after)
    return found


def _sensor(sensor: Sensor, slices: Beliefs) -> Linearised:
    """A sensor at the beliefs of its slices."""
    steps = sensor.family.step
    at = _part(Beliefs(slices.mean[steps], slices.cov[steps]), sensor.parents)
    return Linearised(sensor.family, at.mean, at.cov, sensor.taken, sensor.order)


def _motion(posterior: ChainOutcome, link: Link, before: Beliefs, after: Beliefs) -> Linearised:
    """A CPD of the transition, of which each step is a row.

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
    return Linearised(link.family, own.mean, own.cov)


def _part(beliefs: Beliefs, places: Index) -> Beliefs:
    """The moments of some components."""
    chosen = np.arange(beliefs.mean.shape[-1])[places]
    return Beliefs(beliefs.mean[..., chosen], block(beliefs.cov, chosen, chosen))
