"""Readings in units of their noise, and what those of a step say together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgm.inference.chain.sensor import Sensor
from pgm.kernels import roots
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Integers,
    apply,
    independent,
    inner,
    multiply,
    room,
    transpose,
)
from pgm.kernels.elements import Likelihood
from pgm.kernels.scan import gather

# Readings, times runs, that are worked on at once: what stays near the processor.
_CHUNK = 8192


@dataclass(frozen=True, eq=False)
class Whitened:
    """A sensor's readings about a reference, in units of their noise: v = W x + n, n ~ N(0, I).

    Attributes
    ----------
    sensor : Sensor
    reference : ndarray
        (T+1, runs, n).
    white, scale : ndarray
        L⁻¹ and ln N(0; 0, L Lᵀ) of the noise L Lᵀ of each reading, or of all: (M or 1, runs or 1,
        ...). Of a reading of some components alone they are those of its part of the noise.
    """

    sensor: Sensor
    reference: Array
    white: Array
    scale: Array

    @classmethod
    def of(cls, sensor: Sensor, reference: Array) -> Whitened | None:
        """None where the noise has no inverse, or readings have errors in common."""
        if sensor.exact or sensor.cross:
            return None
        noise, taken = distinct(sensor.family.noise), sensor.taken
        size: int | Integers = noise.shape[-1]
        if taken is not None and (taken.any(axis=-1) != taken.all(axis=-1)).any():
            noise, size = independent(noise, taken), taken.sum(axis=-1)
        lower = roots.root(noise)
        if not roots.is_proper(lower) or roots.determined(lower).any():
            return None
        white = roots.solve_lower(lower, np.broadcast_to(np.eye(noise.shape[-1]), noise.shape))
        return cls(sensor, reference, white, -0.5 * (roots.log_determinant(lower) + size * LOG_2PI))

    def likelihood(self) -> Likelihood:
        """The likelihood of all readings of each step, (T+1, runs, ...)."""

        def said(rows: slice, counts: Integers) -> tuple[Array, Array]:
            matrix = self.sensor.family.matrix[rows]
            if self.sensor.taken is not None:
                matrix = np.where(self.sensor.taken[rows][..., None], matrix, 0.0)
            matrix = multiply(self._white(rows), matrix)
            residual = self._residual(rows, self.reference)
            alike = counts.size > 0 and bool((counts == counts[0]).all())
            if alike:
                # The readings of a step as one: their sum is that of the product.
                matrix, residual = (_one_a_step(part, counts.size) for part in (matrix, residual))
            back = transpose(matrix)
            parts = multiply(back, matrix), apply(back, residual)
            return parts if alike else (_added(parts[0], counts), _added(parts[1], counts))

        precision, h = _by_step(self.sensor, said)
        return Likelihood(precision, h)

    def log_density(self, mean: Array) -> Array:
        """Of each step's readings at the means of the slices, but for their joint part."""
        taken = self.sensor.taken

        def density(rows: slice, counts: Integers) -> tuple[Array]:
            left = self._residual(rows, mean)
            scale = self.scale if len(self.scale) == 1 else self.scale[rows]
            if taken is not None:
                scale = np.where(taken[rows].any(axis=-1), scale, 0.0)
            return (_added(scale - 0.5 * inner(left, left), counts),)

        return _by_step(self.sensor, density)[0]

    def _white(self, rows: slice) -> Array:
        return self.white if len(self.white) == 1 else self.white[rows]

    def _residual(self, rows: slice, mean: Array) -> Array:
        """Of some readings at given means, in units of their noise; zero where they are missing."""
        sensor, family = self.sensor, self.sensor.family
        at = gather(mean, family.step[rows])[..., sensor.parents]
        left = sensor.moved[rows] - family.offset[rows] - apply(family.matrix[rows], at)
        if sensor.taken is not None:
            left = np.where(sensor.taken[rows], left, 0.0)
        return apply(self._white(rows), left)


def distinct(array: Array) -> Array:
    """A broadcast stack with each leading axis along which all is the same of length one."""
    for axis in (0, 1):
        if array.strides[axis] == 0 and array.shape[axis] > 1:
            array = array.take([0], axis=axis)
    return array


def _by_step(
    sensor: Sensor, part: Callable[[slice, Integers], tuple[Array, ...]]
) -> tuple[Array, ...]:
    """Arrays made of the readings of each step, (T+1, ...), a chunk of steps at a time.

    `part` takes rows of readings, and how many are of each step.
    """
    bounds = np.asarray(sensor.bounds)
    counts = np.diff(bounds)
    size = max(_CHUNK // sensor.moved.shape[1], 1)
    out: tuple[Array, ...] = ()
    # Steps before all readings are a chunk of their own: later ones are often all alike.
    first, last = 0, int(np.flatnonzero(counts)[0])
    while first < counts.size:
        if last > first:
            parts = part(slice(int(bounds[first]), int(bounds[last])), counts[first:last])
            if not out:
                out = tuple(room((counts.size, x.shape[1]), x.shape[2:]) for x in parts)
            for whole, each in zip(out, parts, strict=True):
                whole[first:last] = each
        first = last
        last = int(np.searchsorted(bounds, bounds[first] + size, side="right")) - 1
        last = min(max(last, first + 1), counts.size)
    return out


def _added(parts: Array, counts: Integers) -> Array:
    """Sums of so many rows each."""
    memory = np.moveaxis(parts, (0, 1), (-2, -1))
    out = np.zeros((*memory.shape[:-2], counts.size, memory.shape[-1]))
    some = np.flatnonzero(counts)
    starts = np.cumsum(counts) - counts
    out[..., some, :] = np.add.reduceat(memory, starts[some], axis=-2)
    return np.moveaxis(out, (-2, -1), (0, 1))


def _one_a_step(parts: Array, steps: int) -> Array:
    """Equally many rows a step, one below the other: (S k, R, d, ...) to (S, R, k d, ...)."""
    rows, runs, *shape = parts.shape
    count = rows // steps
    memory = parts.transpose(*range(2, parts.ndim), 0, 1).reshape(*shape, steps, count, runs)
    memory = np.moveaxis(memory, -2, 0).reshape(count * shape[0], *shape[1:], steps, runs)
    return np.moveaxis(memory, (-2, -1), (0, 1))
