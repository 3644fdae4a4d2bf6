"""The beliefs of measurements z = F x + b + e of a chain, noise e included.

A belief N(μ, P) over a slice x, the vector of all hidden variables of a step, has the belief
N(F μ + b, F P Fᵀ + R) of a measurement whose own value it does not know, R being the covariance of
e. Predicted beliefs give forecasts, innovations and normalised squares; filtered and smoothed ones
give measurements that were not taken. A *sighting* is one measurement by a sensor, of which a step
may have several; the *branch* of an angle is its value among those that differ by whole turns.
Arrays are (rows, runs, ...), a row being a sighting, or a step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.factors import Gaussian
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Index, Integers, Mask
from pgm.linearisation.family import Family
from pgm.posteriors.measurements import one_row, require_unread, untold
from pgm.variables import Variable


class Expected(NamedTuple):
    """The beliefs of a sensor's measurements at rows of some steps, before their values are taken.

    `step` is (rows,), `mean` (rows, runs, d), its angles on the branch of the reading where there
    is one, and `spread` has the covariances (rows, runs, d, d). Rows stand in the order of the
    evidence.
    """

    step: Integers
    mean: Array
    spread: Diffuse

    @classmethod
    def of(
        cls, family: Family, parents: Index, mean: Array, spread: Diffuse, *, first: int = 0
    ) -> Expected:
        """The beliefs at a family's rows, from those over all slices, `mean` and `spread`.

        `parents` are the places of the CPD's hidden parents in a slice; the first slice is that of
        step `first`.
        """
        rows = family.step - first
        at, own = mean[rows][..., parents], spread.at(rows).of(parents)
        value = family.value(slice(None), at)
        return cls(family.step, value, own.measured(family.matrix, family.noise))

    def at(self, rows: Index) -> Expected:
        """The beliefs at some of the rows."""
        return Expected(self.step[rows], self.mean[rows], self.spread.at(rows))

    def gaussian(self, variable: Variable, lead: tuple[int, ...]) -> Gaussian:
        """The beliefs as users see them: of ``z`` by row, of ``z.at(3)`` that of step 3 alone.

        `lead` are the axes of runs. An `EvidenceError` is raised where step 3 has not one row.
        """
        steps, mean, cov = self.step, self.mean, self.spread.shown
        if variable.step is not None:
            mean, cov = (part[one_row(steps, variable)] for part in (mean, cov))
            mean, cov = mean.reshape(*lead, -1), cov.reshape(*lead, *cov.shape[1:])
            return Gaussian._make((variable,), mean, cov)
        mean, cov = mean.swapaxes(0, 1), cov.swapaxes(0, 1)
        mean, cov = (part.reshape(*lead, *part.shape[1:]) for part in (mean, cov))
        return Gaussian._make((variable,), mean, cov, steps.copy())


def read(sensor: Sensor, mean: Array, spread: Diffuse) -> Expected:
    """The beliefs of a sensor's sightings, in the order of their steps, as they were linearised.

    `mean` (T+1, runs, n) and `spread` are the beliefs over slices. Of robust noise each sighting
    has the covariance by which it was weighed.
    """
    found = Expected.of(sensor.family, sensor.parents, mean, spread)
    return found._replace(mean=_on_branch(sensor, found.mean))


def _on_branch(sensor: Sensor, value: Array) -> Array:
    """Predicted values (M, runs, d) of sightings, their angles on the branches of the readings."""
    if not sensor.variable.angles:
        return value
    moved = sensor.moved
    if sensor.gated is not None:  # no linearisation has put what was rejected on a branch
        near = nearest_branch(sensor.values, value, sensor.variable.angle_mask)
        moved = np.where(sensor.gated.rejected[..., None], near, moved)
    found: Array = np.where(_given(sensor), value - (moved - sensor.values), value)
    return found


def _given(sensor: Sensor) -> Mask:
    """The mask (M, runs, d) of components that were read, be they rejected by a gate or not."""
    given = sensor.taken if sensor.gated is None else sensor.gated.given
    return np.broadcast_to(True if given is None else given, sensor.moved.shape)


def expected(
    plan: ChainPlan, variable: Variable, mean: Array, spread: Diffuse, *, anew: bool = False
) -> Expected:
    """The beliefs of a sensor's measurements, none of which knows the measurement's own value.

    `mean` (T+1, runs, n) and `spread` are beliefs over slices. Rows are steps, or the sightings if
    these have values of observed parents. Measurements are linearised as they were for inference,
    and at these beliefs where nothing was read, or everywhere if `anew`. Robust noise counts with
    the covariance R of its CPD, since no weight is known before the value is.
    """
    sensor = next((each for each in plan.sensors if each.variable == variable), None)
    unread = plan.unread_family(variable)
    if unread is None:
        if sensor is None:
            raise untold(plan.layout, variable)
        found = _of_sightings(sensor, mean, spread, anew=anew)
        return found.at(np.argsort(sensor.order))
    family, parents = unread
    family.trace(plan.layout.prior_means, None)
    _linearise(family, parents, mean, spread)
    found = Expected.of(family, parents, mean, spread)
    if sensor is None:
        return found
    counts, bounds = np.diff(sensor.bounds), np.asarray(sensor.bounds)
    steps = np.flatnonzero(counts)
    sightings, rows = _of_sightings(sensor, mean, spread, anew=anew), steps - family.step[0]
    own = sightings.at(bounds[steps])
    for part, new in zip((found.mean, *found.spread), (own.mean, *own.spread), strict=True):
        part[rows] = new
    if variable.angles:
        _follow(sensor, bounds[steps], found.mean, rows)
    return found


def unread(plan: ChainPlan, variable: Variable, mean: Array, spread: Diffuse) -> Gaussian:
    """The belief of a measurement that was not taken, ``z`` or ``z.at(3)``, at beliefs over slices.

    One of which any component was read, in any run, is refused by an EvidenceError.
    """
    sensor = next((each for each in plan.sensors if each.variable == variable.template), None)
    if sensor is not None:
        require_unread(variable, sensor.family.step, _given(sensor), residuals=True)
    found = expected(plan, variable.template, mean, spread, anew=True)
    return found.gaussian(variable, plan.lead)


def _of_sightings(sensor: Sensor, mean: Array, spread: Diffuse, *, anew: bool) -> Expected:
    """The beliefs of a sensor's sightings, as of `read`, with the covariance of the CPD's noise."""
    if not sensor.robust and (sensor.family.exact or not anew):
        return read(sensor, mean, spread)
    family = unweighed(sensor, mean, spread)
    found = Expected.of(family, sensor.parents, mean, spread)
    return found._replace(mean=_on_branch(sensor, found.mean))


def unweighed(sensor: Sensor, mean: Array, spread: Diffuse, *, first: int = 0) -> Family:
    """A sensor's family with the covariance of its CPD's noise, linearised at beliefs over slices.

    No weight of robust noise is in it. The first slice is that of step `first`.
    """
    family = sensor.family.unweighed()
    _linearise(family, sensor.parents, mean, spread, first)
    return family


def _linearise(
    family: Family, parents: Index, mean: Array, spread: Diffuse, first: int = 0
) -> None:
    """Linearise a CPD at all rows, unless it is affine, at the beliefs over their slices."""
    if not family.exact:
        rows = family.step - first
        at, own = mean[rows][..., parents], spread.at(rows).of(parents)
        family.linearise(slice(None), at, own.shown)


def _follow(sensor: Sensor, sightings: Integers, mean: Array, rows: Integers) -> None:
    """Move angles of `mean` (steps, runs, d) to the branch of the step before, if not read.

    `sightings` are those of the steps `rows`, whose angles are on the branch of their readings.
    """
    last = np.full(mean.shape, np.nan)
    last[rows] = np.where(_given(sensor), sensor.values, np.nan)[sightings]
    mask = sensor.variable.angle_mask
    for row in range(len(mean)):
        if row:
            near = nearest_branch(mean[row], last[row - 1], mask)
            mean[row] = np.where(np.isnan(last[row]), near, mean[row])
        last[row] = np.where(np.isnan(last[row]), mean[row], last[row])
