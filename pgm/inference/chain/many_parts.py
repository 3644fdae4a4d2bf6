"""The CPDs of many runs, prepared for one step after another; arrays have the runs last."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pgm.inference.chain.forward import is_semidefinite, keep_chart
from pgm.inference.chain.plan import Link, Sensor
from pgm.inference.family import Family
from pgm.kernels import along_runs
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array
from pgm.linearisers.many import Linearised, prepare

Line = tuple[Array, Array, Array]
Reading = tuple[Array, Array, Array, Array | None]


def runs_last(array: Array) -> Array:
    """Rows of runs, (rows, runs, ...), with the runs last; one run where it stands for all."""
    if array.strides[1] == 0:
        array = array[:, :1]
    return array.transpose(0, *range(2, array.ndim), 1)


class Unusual(Exception):
    """What cannot be done without all that a family keeps."""


class Prepared:
    """A family with its arrays, and the lean form of its lineariser.

    Where only beliefs are wanted, the room for a step serves all steps and stays in the cache.
    """

    @staticmethod
    def ordinary(family: Family) -> bool:
        """Whether the noise leaves no component out, and any function has hidden parents."""
        variances = np.diagonal(family.own_noise, axis1=-2, axis2=-1)
        return bool((variances > 0.0).all()) and bool(family.exact or family.hidden)

    def __init__(self, family: Family, *, store: bool, most: int = 1) -> None:
        self.family, template, self.store = family, family.template, store
        self.own = runs_last(family.own_noise)
        if not family.taylor and store:
            family.keep_errors()
        self.noise = runs_last(family.noise)
        if store or family.exact:
            self.matrix, self.offset = runs_last(family.matrix), runs_last(family.offset)
        else:
            _, runs, height, width = family.shape
            self.matrix = np.empty((most, height, width, runs))
            self.noise = np.empty((most, height, height, runs))
        self.steps = family.step.tolist()
        self.lineariser = None
        if template is not None:
            known = [family.inputs.get(parent) for parent in template.given]
            self.lineariser = prepare(template, family.lineariser, known, family.shape[1])

    def line(self, row: int, mean: Array, cov: Array, place: int = 0) -> Line:
        """Linearise a row at beliefs (n, runs): F, F μ + b and the noise, (d, d, runs or 1).

        `place` is that of the row among those of its step.
        """
        line = self._line(row, mean, cov)
        if line is None:
            if not self.family.exact:
                if not self.store:
                    raise Unusual
                self.family.linearise(row, mean.T, np.moveaxis(cov, -1, 0))
            value: Array = np.einsum("ijr,jr->ir", self.matrix[row], mean)
            value += self.offset[row]
            return self.matrix[row], value, self.noise[row]
        found, value, error = line
        place = row if self.store else place
        matrix = self.matrix[place]
        matrix[...] = found
        if self.store:
            offset = self.offset[row]
            np.einsum("ijr,jr->ir", matrix, mean, out=offset)
            np.subtract(value, offset, out=offset)
        own = self.own[row if len(self.own) > 1 else 0]
        if error is None:
            return matrix, value, own
        noise = self.noise[place]
        np.add(error, own, out=noise)
        return matrix, value, noise

    def _line(self, row: int, mean: Array, cov: Array) -> Linearised | None:
        if self.lineariser is None:
            return None
        try:
            return self.lineariser(row, self.steps[row], mean, cov)
        except Exception:
            raise Unusual from None  # the general sweep tells which run fails

    def settle(self, *, lost: bool) -> None:
        """Have no room for errors that there are not."""
        if self.store and not self.family.taylor and (lost or not self.family.erroneous):
            self.family.forget_errors()


class Move(Prepared):
    """The transition."""

    @staticmethod
    def suits(link: Link) -> bool:
        """Whether it can be prepared: its errors make no prediction indefinite."""
        family = link.family
        return Prepared.ordinary(family) and (family.taylor or is_semidefinite(family))

    def __init__(self, link: Link, *, store: bool) -> None:
        super().__init__(link.family, store=store)
        self.link = link
        self.turning = list(zip(link.angles.tolist(), link.before.tolist(), strict=True))

    def predict(self, row: int, mean: Array, cov: Array, out: tuple[Array, Array]) -> None:
        """Put the moments of the step after into `out`."""
        new_mean, new_cov = out
        matrix, new_mean[...], noise = self.line(row, mean, cov)
        along_runs.push(cov, matrix, noise, new_cov)
        for new, old in self.turning:
            if np.abs(new_mean[new] - mean[old]).max() > np.pi:
                keep_chart(self.link, row, mean.T, new_mean.T)
                return


class Read(Prepared):
    """A sensor."""

    @staticmethod
    def suits(sensor: Sensor, width: int) -> bool:
        """Whether it can be prepared: all is read, with some noise, of the whole state.

        A rule that draws for each run draws at once for all sightings of a step, which are
        linearised one by one here.
        """
        family = sensor.family
        fresh = getattr(family.lineariser, "fresh_per_run", False) and not family.exact
        return (
            Prepared.ordinary(family)
            and not (fresh and max(b - a for a, b in pairwise(sensor.bounds)) > 1)
            and sensor.taken is None
            and not sensor.grouped
            and not sensor.exact
            and isinstance(sensor.parents, slice)
            and sensor.parents == slice(0, width)
        )

    def __init__(self, sensor: Sensor, *, store: bool) -> None:
        most = max(b - a for a, b in pairwise(sensor.bounds))
        super().__init__(sensor.family, store=store, most=most)
        self.bounds = sensor.bounds
        self.values = runs_last(sensor.values)
        self.moved = runs_last(sensor.moved) if store else self.values
        self.angles = np.flatnonzero(sensor.variable.angle_mask).tolist()
        # Of readings alone at their step, whose noise is always the same.
        constant = len(self.own) == 1 and sensor.family.taylor
        self.sharp = along_runs.sharpness(self.own[0]) if constant else None

    def read(self, step: int, row: int, mean: Array, cov: Array) -> Reading:
        """A reading of a step linearised at a belief: H, residual, noise and its sharpness."""
        matrix, value, noise = self.line(row, mean, cov, row - self.bounds[step])
        residual: Array = self.values[row] - value
        for k in self.angles:
            if np.abs(residual[k]).max() > np.pi:
                turns = TURN * np.round(residual[k] / TURN)
                residual[k] -= turns
                if self.store:
                    np.subtract(self.values[row, k], turns, out=self.moved[row, k])
        return matrix, residual, noise, self.sharp
