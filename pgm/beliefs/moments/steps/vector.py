"""The measurements of a step, or of each of all steps, as one vector.

A *slice* is the vector of all hidden variables of a step, of n components; a *sighting* is one
measurement by a sensor, of which a step may have several. The k sightings of a sensor at a step, of
d components each, are stacked to D = k d components. At one step arrays have their components first
and the runs last, (D, *batch), `batch` being () for one run and (runs,) for several; of many steps
they are (steps, runs, D). The *branch* of an angle is its value among those that differ by whole
turns. A sensor is *grouped* if the sightings of a step are linearised as one vector; their errors
are then correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.kernels import step
from pgm.kernels.arrays import Array, Integers, Mask, apply, times
from pgm.kernels.dense import first


class Measured(NamedTuple):
    """Linearised sightings of one sensor at a step: z = value + H (x − point) + noise.

    x are the sensor's parents, of m components. `matrix` is H (D, m, *batch), `noise`
    (D, D, *batch) a covariance; the batch may be of length one, for all runs. `point` (m, *batch)
    is the mean at which the sensor's function h was linearised, and `value` (D, *batch) is h there,
    or E[h] by rules that take expectations. `reading` (D, *batch) is z, its angles on the branch
    nearest the value. `taken` (D, *batch) marks the components measured, None for all. `offset`
    (D, *batch) is the constant b of an affine CPD z = H x + b + noise, else None.
    """

    sensor: Sensor
    matrix: Array
    value: Array
    noise: Array
    point: Array
    reading: Array
    taken: Mask | None
    offset: Array | None

    @property
    def constant(self) -> Array:
        """The constant b (D, *batch) of the linearisation E[z] = H x + b."""
        if self.offset is not None:
            return self.offset
        return self.value - times(self.matrix, self.point)

    def residual(self, mean: Array) -> Array:
        """The residual z − E[z], (D, *batch), for a belief of mean (m, *batch) over the parents."""
        if mean is self.point:
            return self.reading - self.value
        return self.reading - (self.value + times(self.matrix, mean - self.point))

    def where(self, mask: Mask, other: Measured) -> Measured:
        """The linearisation in the runs of a mask (runs,), and that of `other` in the rest."""
        return self._replace(
            matrix=np.where(mask, self.matrix, other.matrix),
            value=np.where(mask, self.value, other.value),
            noise=np.where(mask, self.noise, other.noise),
            point=np.where(mask, self.point, other.point),
            reading=np.where(mask, self.reading, other.reading),
        )

    def each(self) -> list[Measured]:
        """The sightings one by one, or, if the sensor is grouped, all of them as they are."""
        height = self.sensor.height
        count = len(self.value) // height
        if count == 1 or self.sensor.family.grouped:
            return [self]
        rows = [slice(k * height, (k + 1) * height) for k in range(count)]
        return [
            self._replace(
                matrix=self.matrix[own],
                value=self.value[own],
                noise=self.noise[own, own],
                reading=self.reading[own],
                taken=None if self.taken is None else self.taken[own],
                offset=None if self.offset is None else self.offset[own],
            )
            for own in rows
        ]


class Vector(NamedTuple):
    """Measurements as one vector z = H x + b + noise over the slice: H (D, n, *batch).

    `residual` (D, *batch) is z − E[z] at the slice's mean; `noise` (D, D, *batch) is a covariance.
    A missing component has H = 0, no residual, and unit variance, so that it says nothing;
    `missing` (*batch) counts them, None if there are none.
    """

    matrix: Array
    residual: Array
    noise: Array
    missing: Array | None


def vector(parts: Sequence[Measured], mean: Array) -> Vector:
    """Sightings of some sensors as one `Vector`, of residuals at a slice's mean (n, *batch)."""
    if len(parts) == 1:
        only, sensor = masked(parts[0], mean), parts[0].sensor
        if sensor.whole:
            return only
        wide = np.zeros((len(only.residual), len(mean), *only.matrix.shape[2:]))
        wide[:, sensor.parents] = only.matrix
        return Vector(wide, only.residual, only.noise, only.missing)
    size, batch = len(mean), mean.shape[1:]
    found = [masked(seen, mean) for seen in parts]
    lost = [each.missing for each in found if each.missing is not None]
    missing = sum(lost[1:], lost[0]) if lost else None
    height = sum(len(each.residual) for each in found)
    matrix, noise = np.zeros((height, size, *batch)), np.zeros((height, height, *batch))
    residual, top = np.empty((height, *batch)), 0
    for seen, each in zip(parts, found, strict=True):
        rows = slice(top, top := top + len(each.residual))
        matrix[rows, seen.sensor.parents] = each.matrix
        residual[rows], noise[rows, rows] = each.residual, each.noise
    return Vector(matrix, residual, noise, missing)


def masked(seen: Measured, mean: Array) -> Vector:
    """The sightings of a sensor as a `Vector` over the sensor's parents alone, not the whole slice.

    `mean` (n, *batch) is the slice's. A missing component has H = 0, no residual, and unit variance
    without correlations: it says nothing.
    """
    residual = seen.residual(mean if seen.sensor.whole else mean[seen.sensor.parents])
    if seen.taken is None:
        return Vector(seen.matrix, residual, seen.noise, None)
    taken = seen.taken
    residual, matrix, noise = step.seen(
        taken, first(residual[:, None]), first(seen.matrix), first(seen.noise)
    )
    missing = np.broadcast_to((~taken).sum(axis=0), mean.shape[1:])
    return Vector(matrix.array, residual.array[:, 0], noise.array, missing)


class Stack(NamedTuple):
    """The measurements of G steps, stacked to a vector z = H x + b + noise over each step's slice.

    Each sensor has as many sightings at one of these steps as at any other. `steps` (G,) are the
    steps' numbers. `matrix` is H (G, runs, D, n), `residual` (G, runs, D) is z − E[z] at the
    slices' means, and `noise` (G, runs, D, D) a covariance. A missing component has H = 0, no
    residual, and unit variance; `missing` (G, runs) counts them.
    """

    steps: Integers
    matrix: Array
    residual: Array
    noise: Array
    missing: Array


def stacks(plan: ChainPlan, sensors: list[Sensor], reference: Array) -> list[Stack]:
    """The measurements of some sensors at all steps: one `Stack` for all steps of equal counts.

    Two steps are in the same stack if each sensor has as many sightings at the one as at the other;
    steps without any are left out. The measurements have the linearisations that are stored in the
    plan, and their residuals are at the slices' means `reference` (T+1, runs, n), for T steps.
    """
    if not sensors:
        return []
    counts = np.stack([np.diff(sensor.bounds) for sensor in sensors], axis=-1)
    kinds, which = np.unique(counts, axis=0, return_inverse=True)
    return [
        _stack(plan, sensors, np.flatnonzero(which.reshape(-1) == index), kind, reference)
        for index, kind in enumerate(kinds)
        if kind.any()
    ]


def _stack(
    plan: ChainPlan, sensors: list[Sensor], steps: Integers, counts: Integers, reference: Array
) -> Stack:
    """The stack of some steps (G,), at each of which sensors[i] has counts[i] sightings.

    In the vector of a step the sensors follow one another; the covariances between the errors of a
    grouped sensor's sightings are in `noise`. Residuals are at the slices' means `reference`
    (T+1, runs, n), for T steps.
    """
    heights = [int(count) * s.moved.shape[-1] for s, count in zip(sensors, counts, strict=True)]
    size, shape = plan.layout.slice_size, (steps.size, plan.runs)
    matrix = np.zeros((*shape, sum(heights), size))
    residual = np.zeros((*shape, sum(heights)))
    noise = np.zeros((*shape, sum(heights), sum(heights)))
    missing = np.zeros(shape)
    top = 0
    for sensor, height, count in zip(sensors, heights, counts, strict=True):
        own = slice(top, top + height)
        for group, number in enumerate(steps.tolist()):
            between = sensor.between(number)
            if between is not None:
                noise[group, :, own, own] = between
        bounds = np.asarray(sensor.bounds)[steps]
        each = sensor.moved.shape[-1]
        for k in range(int(count)):
            seen, place = sensor.reading(bounds + k), slice(top, top + each)
            top += each
            mean = reference[steps][..., sensor.parents]
            matrix[..., place, sensor.parents] = seen.matrix
            residual[..., place] = seen.value - apply(seen.matrix, mean) - seen.offset
            noise[..., place, place] = seen.noise
            missing += seen.missing
    return Stack(steps, matrix, residual, noise, missing)
