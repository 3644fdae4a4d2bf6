"""The steps of one robot online: its transition, and the sensors that read together."""

from __future__ import annotations

from math import inf

import numpy as np

from pgm.inference.chain.online_law import Law, Now
from pgm.inference.chain.plan import ChainPlan, Link, Sensor
from pgm.inference.chain.single_motion import Motion, Move
from pgm.inference.chain.single_sight import Stacked, joined
from pgm.inference.chain.update import NEARLY_SINGULAR
from pgm.kernels import moments, roots, single
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, block
from pgm.linearisers.single import Special
from pgm.variables import Variable

_HALF_TURN = 0.5 * TURN
# Which of the rows given are of which variable, by the sensor whose sightings they came with.
Places = dict[tuple[Variable | None, Variable], int]


class Drive(Law, Move[Now]):
    """A CPD of the transition."""

    def __init__(self, link: Link, places: Places) -> None:
        Law.__init__(self, link.family, {v: places[None, v] for v in link.family.inputs})
        Move.__init__(self, link)

    def unwrap(self, at: Now, before: Array, child: Array) -> None:
        """Turns are undone the general way."""
        raise Special


class Predict(Motion[Now]):
    """A transition."""

    def __init__(self, plan: ChainPlan, places: Places) -> None:
        self.places = places  # keeps the variables that a kind of input tells by identity
        super().__init__(plan.layout, [Drive(link, places) for link in plan.transition])


class Read(Law):
    """A sensor."""

    def __init__(self, sensor: Sensor, width: int, places: Places) -> None:
        own, inputs, count = sensor.variable, sensor.family.inputs, len(sensor.values)
        given = {v: places[(own if (own, v) in places else None), v] for v in inputs}
        super().__init__(sensor.family, given, count, grouped=sensor.grouped)
        # What is given beside several sightings holds for each of them.
        shared = [k for v, k in given.items() if (own, v) not in places]
        self.shared = shared if count > 1 else []
        self.reading = places[None, own]
        whole = isinstance(sensor.parents, slice) and sensor.parents == slice(0, width)
        self.parents, self.width = None if whole else sensor.parents, width
        angles = np.flatnonzero(np.tile(own.angle_mask, self.count))
        self.angles = angles.tolist()
        # Where noise depends on inputs, it is found out at each step.
        self.exact = self.noise is not None and sensor.exact

    def _noise(self, step: int, rows: list[Array]) -> Array:
        noise = super()._noise(step, rows)
        if single.root(noise) is None:
            raise Special
        return noise

    def read(self, at: Now, mean: Array, cov: Array, *, keep: bool = False) -> Stacked:
        """The readings, linearised at a belief over the slice.

        To be kept, H is copied, since a function may return an array that it uses again.
        """
        if self.shared:
            step, rows = at
            rows = rows.copy()
            for k in self.shared:
                rows[k] = np.tile(rows[k], (self.count, 1))
            at = step, rows
        places = self.parents
        if places is None:
            matrix, expected, noise = self.conditional(at, mean, cov)
            matrix = matrix.copy() if keep else matrix
        else:
            narrow, expected, noise = self.conditional(at, mean[places], block(cov, places, places))
            matrix = np.zeros((expected.size, self.width))
            matrix[:, places] = narrow
        reading = at[1][self.reading]
        residual = (reading if self.count == 1 else reading.ravel()) - expected
        for angle in self.angles:
            turned = residual.item(angle)
            if _HALF_TURN < abs(turned) < inf:
                residual[angle] = turned - TURN * round(turned / TURN)
        return matrix, residual, noise


class Update:
    """Sensors that read together."""

    def __init__(self, plan: ChainPlan, places: Places) -> None:
        self.places = places  # as of `Predict`
        sensors = [sensor for sensor in plan.sensors if len(sensor.values)]
        self.reads = [Read(sensor, plan.layout.slice_size, places) for sensor in sensors]
        self.linear = all(sensor.family.exact for sensor in sensors)
        self.exact = any(read.exact for read in self.reads)
        self.several = sum(read.count for read in self.reads) > 1

    def take(self, at: Now, mean: Array, cov: Array) -> tuple[Array, Array, float] | None:
        """Moments given the readings, and their log-density; None if the general way is due."""
        if not self.reads:
            return mean, cov, 0.0
        if len(self.reads) == 1:
            stacked = self.reads[0].read(at, mean, cov)
        else:
            found = [read.read(at, mean, cov, keep=True) for read in self.reads]
            stacked = joined(found)
        result = None if self.exact else single.update(mean, cov, *stacked)
        return result or self._closely(mean, cov, *stacked)

    def _closely(
        self, mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array
    ) -> tuple[Array, Array, float] | None:
        """Of a nearly singular predictive covariance, where nothing was certain before."""
        result = moments.update(mean, cov, matrix, residual, noise, exact=self.exact)
        if result.left is not None:
            return None
        if self.several and not roots.smallest_pivot(result.lower) >= NEARLY_SINGULAR:
            return None
        return result.mean, result.cov, float(result.log_density)
