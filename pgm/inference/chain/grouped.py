"""Grouped sensors: the sightings of a step linearised as one vector, cross terms kept."""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.sensor import Sensor
from pgm.kernels.arrays import Array, Integers, Mask, apply, block, components_last
from pgm.linearisers import BoundFunction


def linearise(
    sensor: Sensor, steps: Integers, mean: Array, cov: Array, active: Mask | None = None
) -> None:
    """Linearise the sightings of steps that have equally many, at beliefs over the slices.

    Parameters
    ----------
    sensor : Sensor
    steps : ndarray of int
        (G,), with k sightings each.
    mean, cov : ndarray
        (G, runs, n) and (G, runs, n, n).
    active : ndarray of bool, optional
        The runs that take the new linearisation.
    """
    family, parents = sensor.family, sensor.parents
    template = family.template
    assert template is not None
    bounds = np.array(sensor.bounds)
    count = int(bounds[steps[0] + 1] - bounds[steps[0]])
    rows = bounds[steps][:, None] + np.arange(count)
    known = [
        np.moveaxis(family.inputs[parent][rows], 1, 2) if place is None else None
        for parent, place in zip(template.given, template.places, strict=True)
    ]
    at = mean[..., parents]
    numbers = family.step[rows[:, 0]]
    step = int(numbers[0]) if numbers.size == 1 else np.broadcast_to(numbers[:, None], at.shape[:2])
    function = BoundFunction(template, known, 2, step, count, True, family.source)
    line = family.checked(function, at, block(cov, parents, parents))
    value, error = components_last(line.value, 1), line.error
    groups, runs, height = len(steps), at.shape[1], template.child.dimension
    full = (groups, runs, count, height)

    def each(stacked: Array) -> Array:
        """One sighting a row: (G k, runs, ...)."""
        return np.moveaxis(stacked, 2, 1).reshape(groups * count, runs, *stacked.shape[3:])

    matrix = components_last(line.matrix, 2)
    offset = value - apply(matrix, at)
    own = None
    if error is not None:
        error = components_last(error, 2)
        own = each(np.einsum("grkikj->grkij", error.reshape(*full, count, height)))
    family.store(
        rows.reshape(-1),
        each(matrix.reshape(*full, at.shape[-1])),
        each(offset.reshape(full)),
        own,
        active,
    )
    if error is None or not error.any():
        return
    between = np.kron(1.0 - np.eye(count), np.ones((height, height)))
    for index, number in enumerate(steps.tolist()):
        new = error[index] * between
        if active is not None:
            new = np.where(active[:, None, None], new, sensor.cross.get(number, 0.0))
        sensor.cross[number] = new
