"""A dynamic network with its evidence, whose CPDs draw particles and are evaluated at them.

The slice has the states and then the hidden controls: its components are the rows of arrays of
states, (d, particles). A *law* is a CPD with the values of its observed parents, its *inputs*,
which have a row for each step of the transition, or for each measurement of a sensor. A measurement
is given by its row in the sensor's `Reading`, where rows are sorted by step. `Some` holds the m
particles at which CPDs are evaluated: their states at a step and at the step before, and their
runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from pgm.beliefs.points.components import Part, parts
from pgm.beliefs.points.laws import GaussianLaw, Law, Some, by_pattern
from pgm.beliefs.points.mixture_law import law
from pgm.cpds import CPD
from pgm.cpds.base import Known
from pgm.cpds.mixture import UnidentifiedCPD, by_run
from pgm.errors import LinearisationError
from pgm.evidence import BoundEvidence, Reading
from pgm.kernels.arrays import Array, Mask
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules.argument_checks import require_whole
from pgm.variables import Variable


class ParticleModel:
    """A network with its evidence, as the laws of its CPDs.

    model, bound: The network, and its evidence.
    dtype: The type of the states, float64 or float32.
    first: The step before that of the first row of the transition's inputs.
    weighed: Whether points are weighed by the densities of sensors, which all have to have one. A
        family of one's own may do without, and is refused where it asks for one that there is not.

    places: For each state and hidden control, the slice of its rows in arrays of states.
    size: The number of components of the slice, d.
    """

    def __init__(
        self,
        model: DynamicBayesianNetwork,
        bound: BoundEvidence,
        dtype: Any,
        first: int = 0,
        weighed: bool = True,
    ) -> None:
        self.model, self.bound, self.dtype, self.first = model, bound, dtype, first
        self.weighed = weighed
        self.places: dict[Variable, slice] = {}
        end = 0
        for variable in (*model.states, *model.controls):
            self.places[variable] = slice(end, end + variable.dimension)
            end += variable.dimension
        self.size = end

    @cached_property
    def angles(self) -> Mask:
        """The mask of the components that are angles, (d,)."""
        masks = [variable.angle_mask for variable in self.places]
        return np.concatenate(masks) if masks else np.zeros(0, dtype=bool)

    @cached_property
    def parts(self) -> list[Part]:
        """The components of the slice, with their names and rows."""
        return parts([(variable, place.start) for variable, place in self.places.items()])

    @cached_property
    def prior(self) -> list[Law]:
        """The laws of the states' priors."""
        return [self.law(cpd, {}) for cpd in self.model.prior]

    @cached_property
    def transition(self) -> list[Law]:
        """The laws of the transition's CPDs; row k of their inputs is of step first + k + 1."""
        pairs = zip(self.model.transition, self.bound.transition, strict=True)
        return [self.law(cpd, inputs) for cpd, inputs in pairs]

    @cached_property
    def sensors(self) -> list[Sensor]:
        """The sensors that have evidence, each with its measurements."""
        found = []
        for reading in self.bound.readings:
            cpd = by_run(reading.cpd, self.bound.lead)
            found.append(Sensor(self.law(cpd, reading.inputs), replace(reading, cpd=cpd)))
            if self.weighed:
                found[-1].require_noise()
        return found

    def law(self, cpd: CPD, inputs: Mapping[Variable, Any]) -> Law:
        """The law of a CPD; `inputs` are its observed parents' values (rows, runs or 1, d)."""
        cpd = by_run(cpd, self.bound.lead)
        return law(cpd, inputs, self.places, self.dtype, self.bound.first_run, self.weighed)

    def row(self, step: int) -> int:
        """The row of a step in the transition's inputs."""
        return step - self.first - 1

    def read(self, step: int) -> list[Variable]:
        """The variables of the sensors with measurements at a step."""
        return [s.reading.cpd.child for s in self.sensors if len(s.rows(step))]

    def measured(self, step: int) -> Array:
        """The number of components measured at a step, (runs,), over all sensors.

        A range scan counts as the number of beams that its density uses, times a beam's weight, so
        that the number need not be whole.
        """
        found = np.zeros(self.bound.runs)
        for sensor in self.sensors:
            for row in sensor.rows(step):
                found += sensor.reading.cpd._counted(sensor.reading.taken[row])
        return found

    def log_peak(self, step: int) -> Array:
        """The largest log-density that a step's measurements could have at any state, (runs,).

        A CPD that does not know the largest value of its density is refused by a ModelError.
        """
        found = np.zeros(self.bound.runs)
        for sensor in self.sensors:
            for row in sensor.rows(step):
                found += sensor.log_peak(row, step, self.bound.runs)
        return found

    def log_likelihood(self, some: Some) -> Array:
        """The log-density of a step's measurements at each of some particles, (m,)."""
        found = np.zeros(some.size)
        for sensor in self.sensors:
            for row in sensor.rows(some.step):
                sensor.add(row, some, found)
        return found


class Sensor:
    """A sensor's law with its measurements.

    law: The sensor's CPD with the values of its observed parents.
    reading: The measurements and their steps, a row for each measurement.

    values: The measurements in the type of the states, (rows, runs or 1, components).
    """

    def __init__(self, law: Law, reading: Reading) -> None:
        self.law, self.reading = law, reading
        with np.errstate(over="ignore"):  # what float32 does not hold is infinitely far
            self.values = np.asarray(reading.values, dtype=law.dtype)

    def require_noise(self) -> None:
        """Refuse singular noise by a ModelError, where points are weighed by its density."""
        self.law.require_noise(self.reading.step)

    def rows(self, step: int) -> range:
        """The rows of the measurements of a step."""
        steps = self.reading.step
        first, last = np.searchsorted(steps, [step, step + 1]).tolist()
        return range(first, last)

    def add(self, row: int, some: Some, total: Array) -> None:
        """Add the log-density of one measurement at particles to their totals, in place.

        Runs that differ in which components were measured are evaluated apart. An EvidenceError is
        raised for a missing component that the density cannot leave out, a LinearisationError for a
        log-density that is NaN or plus infinity.

        total: The sums so far of log-densities at the particles, (m,).
        """
        rows, taken = self.values[row], self.reading.taken[row]
        patterns = by_pattern(taken, some.owner)
        if type(self.law) is Law and self.reading.cpd.partial and taken.any():
            # A density that is told by NaN what was not measured takes all runs at once.
            rows, patterns = np.where(taken, rows, np.nan), iter([(np.ones_like(taken[0]), None)])
        for pattern, which in patterns:
            require_whole(self.reading.cpd, pattern, some.step)
            part = some if which is None else some.chosen(which)
            child = rows[:1].T if len(rows) == 1 or part.owner is None else rows[part.owner].T
            found = self.law.log_density(row, part, child, pattern)
            self._require_density(found, part)
            if which is None:
                total += found
            else:
                total[which] += found

    def responsibilities(self, row: int, some: Some) -> Array:
        """The association probabilities (k + 2, m) of a sighting of an unknown thing, by particle.

        A sighting is a measurement of one of k candidates, such as landmarks; the evidence does not
        say of which. For each particle, the probabilities are those of the k candidates, then that
        of a spurious sighting, and that of a new thing; NaN where nothing was measured. `row` is
        the row of the sighting.
        """
        cpd, reading = self.law.cpd, self.reading
        assert isinstance(cpd, UnidentifiedCPD)
        values = np.where(reading.taken[row], reading.values[row], np.nan)
        owner = 0 if len(values) == 1 or some.owner is None else some.owner
        child = np.broadcast_to(values[owner], (some.size, values.shape[-1]))
        known = Known(self.law.given(row, some), (some.size,), (some.size,), some.step)
        found = cpd.responsibilities(child, known)
        found[:, np.isnan(child).all(axis=-1)] = np.nan
        return found

    def log_peak(self, row: int, step: int, runs: int) -> Array:
        """The largest log-density that one measurement could have at any state, (runs,).

        Of normal noise that is the log-density at zero residual; it is 0 where nothing was
        measured. A CPD that does not know the largest value of its density is refused by a
        ModelError. `step` is that of the row, `runs` the number of runs.
        """
        found, owner, taken = np.zeros(runs), np.arange(runs), self.reading.taken[row]
        if not isinstance(self.law, GaussianLaw):
            peaks = self.reading.cpd._log_peak(np.where(taken, self.reading.values[row], np.nan))
            return np.where(taken.any(axis=-1), peaks, 0.0) + found
        root = self.law.root(row, step)
        for pattern, which in by_pattern(taken, owner):
            part = root if pattern.all() else root.marginal(pattern)
            chosen = np.ones(runs, dtype=bool) if which is None else which
            found[chosen] = np.broadcast_to(part.constant, runs)[chosen]
        return found

    def _require_density(self, found: Array, some: Some) -> None:
        """Refuse log-densities (m,) that are NaN or plus infinity, by a LinearisationError."""
        total = found.sum()
        if np.isfinite(total) or not (np.isnan(found) | (found == np.inf)).any():
            return
        index = int(np.flatnonzero(np.isnan(found) | (found == np.inf))[0])
        run = self.law.first_run + (0 if some.owner is None else int(some.owner[index]))
        cpd = self.reading.cpd
        raise LinearisationError(
            f"{cpd!r}: at step {some.step}, run {run}, its log-density is {found[index]} at a "
            "particle; it must be a number, or minus infinity where it is impossible",
            variable=cpd.child,
            cpd=cpd,
            step=some.step,
            run=run,
        )
