"""A dynamic network at one step, with its evidence, as a family of beliefs of one's own sees it.

Points are arrays (runs, n, d): n of them in each run, with the d components of the slice, which are
those of the states and then of the hidden controls, in the order of `Slice.places`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from pgm.cpds import CPD
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.inference.particles.laws import Drawing, GaussianLaw, Law, Some
from pgm.inference.particles.model import ParticleModel, Sensor
from pgm.inference.particles.streams import stream
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask
from pgm.variables import Variable

Generators = Sequence[np.random.Generator]
# The purposes of a slice's random numbers, beside that of a prediction; see `streams`.
TAKEN, BACK = 101, 102


class Slice(InCode):
    """One step of a dynamic network with its evidence, of all runs at once.

    It is handed to the methods of a `BeliefFamily`. Points are arrays (runs, n, d), of n points in
    each run and the d components of the hidden variables.

    Attributes
    ----------
    step : int
        The number of the step, from 0 to T.
    runs : int
        How many runs the evidence has.
    places : mapping of Variable to slice
        By state and hidden control, its components among the d of a point.
    angles : ndarray of bool
        (d,): which components are angles.

    Examples
    --------
    See `BeliefFamily`.
    """

    def __init__(self, model: ParticleModel, step: int, purpose: int = 0) -> None:
        self._model, self._purpose = model, purpose
        self.step, self.runs = step, model.bound.runs
        self.places: Mapping[Variable, slice] = model.places
        self.angles = model.angles

    def __repr__(self) -> str:
        return f"Slice(step {self.step}, over {list(self.places)}, {self.runs} runs)"

    def generators(self, seed: int) -> list[np.random.Generator]:
        """Random generators, one for each run, of this step and method alone.

        They depend on the seed, the number of the run and the step, so that a run's draws are the
        same whichever runs it is worked with.

        Parameters
        ----------
        seed : int

        Returns
        -------
        list of numpy.random.Generator
        """
        first = self._model.bound.first_run
        return [stream(seed, first + run, self.step, self._purpose) for run in range(self.runs)]

    def prior(self, count: int, generators: Generators) -> Array:
        """Draws from the prior of the states; hidden controls, which begin at step 1, are zero.

        Parameters
        ----------
        count : int
            The number of points in each run, n.
        generators : sequence of numpy.random.Generator
            One for each run, as of `generators`.

        Returns
        -------
        ndarray
            (runs, n, d).
        """
        before = np.zeros((self.runs, count, self._model.size))
        return self._drawn(self._model.prior, 0, before, generators)

    def moved(self, points: Array, generators: Generators) -> Array:
        """Draws from the transition, one from each point of the step before.

        Parameters
        ----------
        points : ndarray
            (runs, n, d).
        generators : sequence of numpy.random.Generator
            One for each run, as of `generators`.

        Returns
        -------
        ndarray
            (runs, n, d).
        """
        return self._drawn(self._model.transition, self._model.row(self.step), points, generators)

    @cached_property
    def measurements(self) -> tuple[Measurement, ...]:
        """The measurements of the step, of each sensor in turn, of which some run took any."""
        return tuple(
            Measurement(sensor, row, self)
            for sensor in self._model.sensors
            for row in sensor.rows(self.step)
            if sensor.reading.taken[row].any()
        )

    def _drawn(self, laws: Sequence[Law], row: int, points: Array, generators: Generators) -> Array:
        """Draws (runs, n, d) of the children of laws at a row of inputs, given points before."""
        some = self._some(points, now=np.zeros((self._model.size, points[..., 0].size)))
        drawing = _drawing(points, generators)
        for law in laws:
            some.now[self.places[law.cpd.child]] = law.draw(row, some, drawing)
        return _apart(some.now, points)

    def _some(self, points: Array, now: Array | None = None) -> Some:
        """Points (runs, n, d) as `Some` particles of this step; with `now`, of the one before."""
        flat = np.asarray(points, dtype=np.float64)
        if flat.ndim != 3 or flat.shape[0] != self.runs or flat.shape[2] != self._model.size:
            raise ModelError(
                f"points at step {self.step} have shape {flat.shape}; ({self.runs}, n, "
                f"{self._model.size}) was due: runs, points, components"
            )
        flat = np.ascontiguousarray(flat.reshape(-1, flat.shape[2]).T)
        owner = None if self.runs == 1 else np.repeat(np.arange(self.runs), points.shape[1])
        return Some(self.step, flat if now is None else now, flat, owner)


class Measurement(InCode):
    """One measurement of a sensor, of all runs at once, and its law given the hidden variables.

    Attributes
    ----------
    variable : Variable
        The sensor's variable, of k components.
    cpd : CPD
        The sensor's CPD.
    value : ndarray
        (runs, k), NaN where nothing was measured.
    inputs : mapping of Variable to ndarray
        By observed parent of the sensor, its value, (runs or 1, d) each.

    Examples
    --------
    See `BeliefFamily`.
    """

    def __init__(self, sensor: Sensor, row: int, at: Slice) -> None:
        self._sensor, self._row, self._at = sensor, row, at
        reading = sensor.reading
        self.cpd: CPD = reading.cpd
        self.variable: Variable = reading.cpd.child
        taken = np.where(reading.taken[row], reading.values[row], np.nan)
        self.value: Array = np.broadcast_to(taken, (at.runs, taken.shape[-1]))
        self.inputs: Mapping[Variable, Any] = {
            parent: values[row] for parent, values in sensor.law.inputs.items()
        }

    def __repr__(self) -> str:
        return f"Measurement({self.variable!r}, step {self._at.step}, {self._at.runs} runs)"

    @property
    def angles(self) -> Mask:
        """The mask of components that are angles, (k,)."""
        return self.variable.angle_mask

    def mean(self, points: Array) -> Array:
        """The measurement expected at points, without noise.

        Parameters
        ----------
        points : ndarray
            (runs, n, d).

        Returns
        -------
        ndarray
            (runs, n, k).

        Raises
        ------
        ModelError
            If the sensor's CPD is not Gaussian, so that its mean is not known.
        LinearisationError
            If the sensor's function is not finite there.
        """
        law = self._sensor.law
        if not isinstance(law, GaussianLaw):
            raise ModelError(
                f"{self.cpd!r} does not tell its mean; draw(...) and log_density(...) are there",
                variable=self.variable,
                cpd=self.cpd,
            )
        some = self._at._some(points)
        found = np.broadcast_to(law.mean(self._row, some), (len(self.angles), some.size))
        return _apart(found, points)

    def draw(self, points: Array, generators: Generators) -> Array:
        """Draws of the measurement, with its noise, one at each point.

        Parameters
        ----------
        points : ndarray
            (runs, n, d).
        generators : sequence of numpy.random.Generator
            One for each run, as of `Slice.generators`.

        Returns
        -------
        ndarray
            (runs, n, k).
        """
        some = self._at._some(points)
        return _apart(self._sensor.law.draw(self._row, some, _drawing(points, generators)), points)

    def log_density(self, points: Array) -> Array:
        """The log-density of the measurement at points; components not measured are left out.

        Parameters
        ----------
        points : ndarray
            (runs, n, d).

        Returns
        -------
        ndarray
            (runs, n).
        """
        some = self._at._some(points)
        found = np.zeros(some.size)
        self._sensor.add(self._row, some, found)
        return found.reshape(points.shape[:2])

    def residual(self, a: Array, b: Array) -> Array:
        """The difference a − b of measurements (..., k), angles wrapped to [−π, π)."""
        return difference(np.asarray(a, dtype=np.float64), np.asarray(b), self.angles)


def _drawing(points: Array, generators: Generators) -> Drawing:
    """The drawing for points (runs, n, d) laid out run by run, from a generator for each run."""
    runs, count = points.shape[:2]
    if len(generators) != runs:
        raise ModelError(
            f"{len(generators)} generators for {runs} runs; Slice.generators(seed) makes one each"
        )
    return Drawing([(slice(k * count, (k + 1) * count), rng) for k, rng in enumerate(generators)])


def _apart(flat: Array, points: Array) -> Array:
    """Values (k, runs · n) at points (runs, n, d), as (runs, n, k)."""
    return np.ascontiguousarray(flat.T.reshape(*points.shape[:2], len(flat)))
