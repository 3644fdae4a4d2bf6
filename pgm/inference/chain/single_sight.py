"""The sensors of a single run: their readings taken into one belief after another."""

from __future__ import annotations

from math import inf

import numpy as np

from pgm.inference.chain.plan import ChainPlan, Sensor
from pgm.inference.chain.single_rows import Rows
from pgm.inference.chain.update import linearise_sensor, update
from pgm.kernels import single
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, block

_HALF_TURN = 0.5 * TURN
# What is read of a step: H over the slice, residual, noise.
Stacked = tuple[Array, Array, Array]


class Read(Rows):
    """A sensor."""

    def __init__(self, sensor: Sensor, width: int) -> None:
        self.values, self.moved = sensor.values[:, 0], sensor.moved[:, 0]
        super().__init__(sensor.family, joint=sensor.grouped)
        self.sensor, self.variable, self.bounds = sensor, sensor.variable, sensor.bounds
        whole = isinstance(sensor.parents, slice) and sensor.parents == slice(0, width)
        self.parents = None if whole else sensor.parents
        self.width = width
        self.taken = None if sensor.taken is None else sensor.taken[:, 0]
        self.angles = np.flatnonzero(sensor.variable.angle_mask).tolist()
        self.height = sensor.variable.dimension

    def read(self, step: int, first: int, last: int, mean: Array, cov: Array) -> Stacked | None:
        """The readings of a step, linearised at a belief over the slice; None if none is taken."""
        places = self.parents
        at, spread = mean, cov
        if places is not None:
            at, spread = mean[places], block(cov, places, places)
        line = self.line(first, last, at, spread)
        if line is None:
            if not self.exact:
                linearise_sensor(self.sensor, step, mean[None], cov[None])
                self.see()
            matrix = self.matrix[first:last].reshape((last - first) * self.height, at.size)
            predicted = matrix.dot(at) + self.offset[first:last].reshape(-1)
        else:
            matrix, predicted, error = line
            offset = predicted - matrix.dot(at)
            if last - first > 1:
                self._store(step, first, last, matrix, offset, error)
            else:
                self.matrix[first], self.offset[first] = matrix, offset
                if error is not None:
                    self.noise[first] = self.own[first] + error
        if self.angles:
            self._move(first, last, predicted)
        if last - first > 1:
            residual = self.moved[first:last].reshape(-1) - predicted
            noise = self._noise(step, first, last)
        else:
            residual, noise = self.moved[first] - predicted, self.noise[first]
        if places is not None:
            narrow, matrix = matrix, np.zeros((residual.size, self.width))
            matrix[:, places] = narrow
        if self.taken is None or self.taken[first:last].all():
            return matrix, residual, noise
        seen = np.flatnonzero(self.taken[first:last])
        return (matrix[seen], residual[seen], block(noise, seen, seen)) if seen.size else None

    def _store(
        self, step: int, first: int, last: int, matrix: Array, offset: Array, error: Array | None
    ) -> None:
        """Keep what several sightings were linearised to, one a row."""
        count, rows = last - first, slice(first, last)
        shape = (count, self.height)
        self.matrix[rows] = matrix.reshape(*shape, -1)
        self.offset[rows] = offset.reshape(shape)
        if error is None:
            return
        blocks = error.reshape(*shape, *shape)
        each = np.arange(count)
        self.noise[rows] = self.own[rows] + blocks[each, :, each]
        if self.sensor.grouped:
            between = blocks.copy()
            between[each, :, each] = 0.0
            self.sensor.cross[step] = between.reshape(1, *error.shape)

    def _noise(self, step: int, first: int, last: int) -> Array:
        """The noise of several sightings as one."""
        count, height = last - first, self.height
        noise = np.zeros((count, height, count, height))
        each = np.arange(count)
        noise[each, :, each] = self.noise[first:last]
        joint = noise.reshape(count * height, count * height)
        cross = self.sensor.cross.get(step)
        return joint if cross is None else joint + cross[0]

    def _move(self, first: int, last: int, predicted: Array) -> None:
        """Move angles to the branch nearest the value at the point of linearisation."""
        for row in range(first, last):
            for angle in self.angles:
                value = self.values.item(row, angle)
                expected = predicted.item((row - first) * self.height + angle)
                if _HALF_TURN < abs(expected - value) < inf:
                    self.moved[row, angle] = value + TURN * round((expected - value) / TURN)


class Sight:
    """The sensors of a plan of a single run."""

    def __init__(self, plan: ChainPlan) -> None:
        self.reads = [Read(sensor, plan.layout.slice_size) for sensor in plan.sensors]
        # Whether no sensor that is read needs a linearisation.
        self.linear = all(read.exact for read in self.reads if read.steps)
        self.exact = any(sensor.exact for sensor in plan.sensors)

    def update(self, step: int, mean: Array, cov: Array) -> tuple[Array, Array, float] | None:
        """Take the readings of a step into a belief over the slice; None if it is not finite."""
        found, several = [], len(self.reads) > 1
        for read in self.reads:
            first, last = read.bounds[step], read.bounds[step + 1]
            if first < last:
                stacked = read.read(step, first, last, mean, cov)
                if stacked is not None:
                    matrix, residual, noise = stacked
                    # A function may return an array that it uses again, for another sensor.
                    found.append((matrix.copy() if several else matrix, residual, noise))
        if not found:
            return mean, cov, 0.0
        if not self.exact:
            result = single.update(mean, cov, *(found[0] if len(found) == 1 else joined(found)))
            if result is not None:
                return result
        if not all(np.isfinite(part).all() for parts in ((mean, cov), *found) for part in parts):
            return None
        due = [
            (read.sensor, read.sensor.rows(step))
            for read in self.reads
            if read.bounds[step] < read.bounds[step + 1]
        ]
        many_mean, many_cov, log_density = update(due, step, mean[None], cov[None])
        return many_mean[0], many_cov[0], float(log_density[0])


def joined(parts: list[Stacked]) -> Stacked:
    """Several sensors' readings as one."""
    matrices, residuals, noises = zip(*parts, strict=True)
    size = sum(residual.size for residual in residuals)
    joint, top = np.zeros((size, size)), 0
    for noise in noises:
        rows = slice(top, top := top + len(noise))
        joint[rows, rows] = noise
    return np.concatenate(matrices), np.concatenate(residuals), joint
