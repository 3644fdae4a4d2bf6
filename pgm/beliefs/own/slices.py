"""A dynamic network at one step, with its evidence, as a family of beliefs of one's own sees it.

Points are arrays (runs, n, d): n of them in each run, with the d components of the slice, which are
those of the states and then of the hidden controls, in the order of `Slice.places`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from pgm.beliefs.points.laws import Drawing, GaussianLaw, Law, Some
from pgm.beliefs.points.model import ParticleModel, Sensor
from pgm.beliefs.points.streams import stream
from pgm.cpds import CPD, ConditionalGaussian
from pgm.display import InCode, titled
from pgm.errors import ModelError
from pgm.factors.scope import listed
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask
from pgm.variables import Variable

Generators = Sequence[np.random.Generator]
# What a slice is handed out for, which are the purposes of its random numbers, too; see `streams`.
MOVED, TAKEN, BACK, NEXT = 0, 101, 102, 103


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
    cpds : tuple of ConditionalAt
        The CPDs that lead to the slice, parents first: the priors at step 0, the transition from
        the step before at others.
    inputs : mapping of Variable to ndarray
        The values of the inputs of `cpds`, (runs or 1, k) each.
    measurements : tuple of Measurement
        The measurements of the step, of each sensor in turn, of which some run took any; not of a
        prediction, which knows none.
    next : Slice
        On the way back the step after, whose `cpds`, `inputs`, `mean` and `log_density` are of the
        transition from this step to that one.

    Examples
    --------
    See `BeliefFamily`.
    """

    def __init__(
        self, model: ParticleModel, step: int, purpose: int = MOVED, update: int = 0
    ) -> None:
        self._model, self._purpose, self._update, self._asked = model, purpose, update, 0
        self.step, self.runs = step, model.bound.runs
        self.places: Mapping[Variable, slice] = MappingProxyType(model.places)
        self.angles = model.angles

    def __repr__(self) -> str:
        return f"Slice(step {self.step}, over {list(self.places)}, {self.runs} runs)"

    def generators(self, seed: int) -> list[np.random.Generator]:
        """Random generators, one for each run, of this step, method and call alone.

        They depend on the seed, the number of the run and the step, so that a run's draws are the
        same whichever runs it is worked with. Another call gives others, and so does a further
        update of one step online.

        Parameters
        ----------
        seed : int

        Returns
        -------
        list of numpy.random.Generator
        """
        first, call = self._model.bound.first_run, (self._purpose, self._update, self._asked)
        self._asked += 1
        return [stream(seed, first + run, self.step, *call) for run in range(self.runs)]

    @cached_property
    def cpds(self) -> tuple[ConditionalAt, ...]:
        """The CPDs that lead to the slice, parents first."""
        if self.step and len(self._model.bound.transition) < len(self._model.model.transition):
            raise ModelError(
                f"{self!r}: an update has no inputs of the transition that led to its step, nor "
                "what depends on them (cpds, inputs, moved, mean, log_density); ask for these in "
                "predict, and keep in the belief what the update needs"
            )
        laws = self._model.transition if self.step else self._model.prior
        row = self._model.row(self.step) if self.step else 0
        return tuple(ConditionalAt(law, row, self) for law in laws)

    @property
    def inputs(self) -> Mapping[Variable, Any]:
        """The values of the inputs of `cpds`, (runs or 1, k) each."""
        return MappingProxyType({v: each for cpd in self.cpds for v, each in cpd.inputs.items()})

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
        if self.step:
            raise ModelError(f"{self!r}: the prior is of step 0; moved(points) leads to others")
        return self._drawn(np.zeros((self.runs, count, self._model.size)), generators)

    def moved(self, before: Array, generators: Generators) -> Array:
        """Draws from the transition, one from each point of the step before.

        Parameters
        ----------
        before : ndarray
            (runs, n, d).
        generators : sequence of numpy.random.Generator
            One for each run, as of `generators`.

        Returns
        -------
        ndarray
            (runs, n, d).
        """
        if not self.step:
            raise ModelError(
                f"{self!r}: no transition leads to step 0; prior(n, generators) draws its points"
            )
        return self._drawn(before, generators)

    def _drawn(self, before: Array, generators: Generators) -> Array:
        """Draws of the slice, (runs, n, d), one from each point of the step before."""
        now = self._none(before)
        drawing, some = _drawing(now, generators), self._some(now, before)
        for cpd in self.cpds:
            some.now[self.places[cpd.variable]] = cpd._law.draw(cpd._row, some, drawing)
        return _apart(some.now, now)

    def mean(self, before: Array) -> Array:
        """The points expected after points of the step before, without noise.

        Parameters
        ----------
        before : ndarray
            (runs, n, d).

        Returns
        -------
        ndarray
            (runs, n, d). At step 0 it is the prior's mean.

        Raises
        ------
        ModelError
            If a CPD is not Gaussian, so that its mean is not known.
        """
        now = self._none(before)
        for cpd in self.cpds:
            now[..., self.places[cpd.variable]] = cpd.mean(now, before)
        return now

    def log_density(self, now: Array, before: Array) -> Array:
        """The log-density of points, given those of the step before.

        Parameters
        ----------
        now, before : ndarray
            (runs, n, d) each.

        Returns
        -------
        ndarray
            (runs, n). At step 0 it is the prior's, whatever `before`.
        """
        now = np.asarray(now)
        found: Array = np.zeros(self._none(now).shape[:2])
        for cpd in self.cpds:
            found = found + cpd.log_density(now[..., self.places[cpd.variable]], now, before)
        return found

    @cached_property
    def measurements(self) -> tuple[Measurement, ...]:
        """The measurements of the step, of each sensor in turn, of which some run took any."""
        if self._purpose == MOVED:
            raise ModelError(
                f"{self!r}: begin and predict come before the measurements of their step, which "
                "online are not known yet: take them in take(at, belief)"
            )
        return tuple(
            Measurement(sensor, row, self)
            for sensor in self._model.sensors
            for row in sensor.rows(self.step)
            if sensor.reading.taken[row].any()
        )

    @cached_property
    def next(self) -> Slice:
        """The step after, to which the transition from this one leads."""
        if self._purpose != BACK:
            raise ModelError(
                f"{self!r}: the step after is known on the way back alone, in back(at, known, "
                "predicted, later)"
            )
        return Slice(self._model, self.step + 1, NEXT)

    def _none(self, points: Array) -> Array:
        """Zeros of the shape of points (runs, n, d), which is checked."""
        shape = np.shape(points)
        if len(shape) != 3 or shape[0] != self.runs or shape[2] != self._model.size:
            raise ModelError(
                f"points at step {self.step} have shape {shape}; ({self.runs}, n, "
                f"{self._model.size}) was due: runs, points, components"
            )
        return np.zeros(shape)

    def _some(self, now: Array, before: Array | None = None) -> Some:
        """Points (runs, n, d) of this step, and of the one before, as `Some` particles."""
        self._none(now)
        each = [now, now if before is None else before]
        here, past = (np.array(np.reshape(p, (-1, now.shape[2])).T, dtype=float) for p in each)
        owner = None if self.runs == 1 else np.repeat(np.arange(self.runs), now.shape[1])
        return Some(self.step, here, past, owner)


class ConditionalAt(InCode):
    """A CPD at a step, of all runs at once, with the values of its inputs.

    Attributes
    ----------
    variable : Variable
        The child, of k components.
    cpd : CPD
    inputs : mapping of Variable to ndarray
        By observed parent, its value, (runs or 1, ...).

    Examples
    --------
    See `BeliefFamily`.
    """

    def __init__(self, law: Law, row: int, at: Slice) -> None:
        self._law, self._row, self._at = law, row, at
        self.cpd: CPD = law.cpd
        self.variable: Variable = law.cpd.child
        self.inputs: Mapping[Variable, Any] = {v: values[row] for v, values in law.inputs.items()}

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.variable!r}, step {self._at.step}, {self._at.runs} runs)"
        )

    @property
    def angles(self) -> Mask:
        """The mask of components that are angles, (k,)."""
        return self.variable.angle_mask

    @property
    def cov(self) -> Array:
        """The covariance of the noise, (runs or 1, k, k).

        Raises
        ------
        ModelError
            If the CPD is not Gaussian, or its noise robust.
        """
        if isinstance(self.cpd, ConditionalGaussian) and self.cpd.noise is not None:
            raise ModelError(
                f"{self.cpd!r} has robust noise, {self.cpd.noise!r}, whose covariance is another "
                "than its cov=; draw(...), log_density(...), and the noise itself, .cpd.noise, are "
                "there",
                variable=self.variable,
                cpd=self.cpd,
            )
        lower = self._gaussian().root(self._row, self._at.step).lower
        found: Array = lower @ lower.swapaxes(-1, -2)
        return found

    def mean(self, points: Array, before: Array | None = None) -> Array:
        """The child expected at points, without noise; of robust noise, its centre.

        Parameters
        ----------
        points : ndarray
            (runs, n, d), of the step.
        before : ndarray, optional
            (runs, n, d), of the step before; needed where the CPD has parents there.

        Returns
        -------
        ndarray
            (runs, n, k).

        Raises
        ------
        ModelError
            If the CPD is not Gaussian, so that its mean is not known.
        LinearisationError
            If the CPD's function is not finite there.
        """
        points = np.asarray(points)
        some = self._some(points, before)
        found = self._gaussian().mean(self._row, some)
        return _apart(np.broadcast_to(found, (len(self.angles), some.size)), points)

    def draw(self, points: Array, generators: Generators, before: Array | None = None) -> Array:
        """Draws of the child, with its noise, one at each point.

        Parameters
        ----------
        points : ndarray
            (runs, n, d), of the step.
        generators : sequence of numpy.random.Generator
            One for each run, as of `Slice.generators`.
        before : ndarray, optional
            (runs, n, d), of the step before; needed where the CPD has parents there.

        Returns
        -------
        ndarray
            (runs, n, k).
        """
        points = np.asarray(points)
        some = self._some(points, before)
        return _apart(self._law.draw(self._row, some, _drawing(points, generators)), points)

    def log_density(self, value: Array, points: Array, before: Array | None = None) -> Array:
        """The log-density of values of the child at points.

        Parameters
        ----------
        value : ndarray
            (runs, n, k).
        points : ndarray
            (runs, n, d), of the step.
        before : ndarray, optional
            (runs, n, d), of the step before; needed where the CPD has parents there.

        Returns
        -------
        ndarray
            (runs, n).
        """
        points = np.asarray(points)
        some = self._some(points, before)
        child = np.ascontiguousarray(np.reshape(value, (-1, len(self.angles))).T, dtype=float)
        return self._law.log_density(self._row, some, child).reshape(points.shape[:2])

    def residual(self, a: Array, b: Array) -> Array:
        """The difference a − b of values of the child (..., k), angles wrapped to [−π, π)."""
        return difference(np.asarray(a, dtype=np.float64), np.asarray(b), self.angles)

    def _some(self, points: Array, before: Array | None) -> Some:
        """Points (runs, n, d) as `Some` particles, with those before where they are needed."""
        past = [parent for parent in self.cpd.parents if parent.lag]
        if past and before is None:
            raise ModelError(
                f"{self!r} is given {listed(past)}: give points of the step before, too, before="
            )
        return self._at._some(points, before)

    def _gaussian(self) -> GaussianLaw:
        """The law of a Gaussian CPD, of robust noise as of any; others are refused."""
        law = self._law
        if isinstance(self.cpd, ConditionalGaussian) and not isinstance(law, GaussianLaw):
            law = GaussianLaw(self.cpd, law.inputs, law.places, law.dtype, law.first_run)
        if not isinstance(law, GaussianLaw):
            raise ModelError(
                f"{self.cpd!r} is no Gaussian CPD, whose mean and covariance are known; draw(...) "
                "and log_density(...) are there",
                variable=self.variable,
                cpd=self.cpd,
            )
        return law


class Measurement(ConditionalAt):
    """One measurement of a sensor, of all runs at once, and its CPD given the hidden variables.

    Attributes
    ----------
    variable : Variable
        The sensor's variable, of k components.
    value : ndarray
        (runs, k), NaN where nothing was measured.

    Examples
    --------
    See `BeliefFamily`.
    """

    def __init__(self, sensor: Sensor, row: int, at: Slice) -> None:
        super().__init__(sensor.law, row, at)
        self._sensor, reading = sensor, sensor.reading
        taken = np.where(reading.taken[row], reading.values[row], np.nan)
        self.value: Array = np.broadcast_to(taken, (at.runs, taken.shape[-1]))

    def log_likelihood(self, points: Array) -> Array:
        """The log-density of the measurement at points; components not measured are left out.

        Parameters
        ----------
        points : ndarray
            (runs, n, d).

        Returns
        -------
        ndarray
            (runs, n).

        Raises
        ------
        ModelError
            If the sensor has no noise in a component, or its noise no density.
        """
        points = np.asarray(points)
        some = self._at._some(points)
        self._sensor.require_noise()
        found = np.zeros(some.size)
        self._sensor.add(self._row, some, found)
        return found.reshape(points.shape[:2])


def _drawing(points: Array, generators: Generators) -> Drawing:
    """The drawing for points (runs, n, d) laid out run by run, from a generator for each run."""
    runs, count = points.shape[:2]
    if not isinstance(generators, Sequence):
        raise ModelError(
            f"generators are a sequence of {runs}, one a run, as of Slice.generators(seed), not "
            f"{titled(generators)}"
        )
    if len(generators) != runs:
        raise ModelError(
            f"{len(generators)} generators for {runs} runs; Slice.generators(seed) makes one each"
        )
    return Drawing([(slice(k * count, (k + 1) * count), rng) for k, rng in enumerate(generators)])


def _apart(flat: Array, points: Array) -> Array:
    """Values (k, runs · n) at points (runs, n, d), as (runs, n, k)."""
    return np.ascontiguousarray(flat.T.reshape(*points.shape[:2], len(flat)))
