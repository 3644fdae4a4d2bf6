"""Readings of which each step's are taken as one vector: exact ones, or with errors in common."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.sensor import Sensor
from pgm.kernels.arrays import Array, Integers, apply


class Stack(NamedTuple):
    """The readings of some steps with equally many, each step's as one vector: z = H x + n.

    Attributes
    ----------
    steps : ndarray of int
        (G,).
    matrix, residual, noise : ndarray
        (G, runs, D, n), (G, runs, D) and (G, runs, D, D).
    missing : ndarray
        (G, runs): components that were not taken, which say nothing with unit variance.
    """

    steps: Integers
    matrix: Array
    residual: Array
    noise: Array
    missing: Array


def stacks(plan: ChainPlan, sensors: list[Sensor], reference: Array) -> list[Stack]:
    """Steps with equally many readings of each sensor, a stack each."""
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
    heights = [int(count) * s.moved.shape[-1] for s, count in zip(sensors, counts, strict=True)]
    size, shape = plan.layout.slice_size, (steps.size, plan.runs)
    matrix = np.zeros((*shape, sum(heights), size))
    residual = np.zeros((*shape, sum(heights)))
    noise = np.zeros((*shape, sum(heights), sum(heights)))
    missing = np.zeros(shape)
    top = 0
    for sensor, height, count in zip(sensors, heights, counts, strict=True):
        own = slice(top, top + height)
        for group, step in enumerate(steps.tolist()):
            between = sensor.between(step)
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
