"""A dynamic network with its evidence, and the laws of its CPDs, as particles ask for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD
from pgm.cpds.base import Known
from pgm.cpds.mixture import UnidentifiedCPD, by_run, chosen, log_mixed
from pgm.errors import LinearisationError, ModelError
from pgm.evidence import BoundEvidence, Reading
from pgm.factors.scope import distinct_labels
from pgm.inference.options import require_density, require_whole
from pgm.inference.particles.laws import Drawing, GaussianLaw, Law, Some, States, by_pattern
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable


class ParticleModel:
    """A model with its evidence, CPD by CPD.

    first: The step before the first of the evidence for the transition.

    places: The components of each state and hidden control, in this order.
    """

    def __init__(
        self, model: DynamicBayesianNetwork, bound: BoundEvidence, dtype: Any, first: int = 0
    ) -> None:
        self.model, self.bound, self.dtype, self.first = model, bound, dtype, first
        self.places: dict[Variable, slice] = {}
        end = 0
        for variable in (*model.states, *model.controls):
            self.places[variable] = slice(end, end + variable.dimension)
            end += variable.dimension
        self.size = end

    @cached_property
    def angles(self) -> Mask:
        """Which components are angles, (d,)."""
        masks = [variable.angle_mask for variable in self.places]
        return np.concatenate(masks) if masks else np.zeros(0, dtype=bool)

    @cached_property
    def parts(self) -> list[Part]:
        """The components of the slice, by name."""
        return parts([(variable, place.start) for variable, place in self.places.items()])

    @cached_property
    def prior(self) -> list[Law]:
        """The prior of each state."""
        return [self._law(by_run(cpd, self.bound.lead), {}) for cpd in self.model.prior]

    @cached_property
    def transition(self) -> list[Law]:
        """The transition of each state and hidden control, row k of step first + k + 1."""
        pairs = zip(self.model.transition, self.bound.transition, strict=True)
        return [self._law(cpd, inputs) for cpd, inputs in pairs]

    @cached_property
    def sensors(self) -> list[Sensor]:
        """The sensors that have evidence."""
        found = []
        for reading in self.bound.readings:
            cpd = by_run(reading.cpd, self.bound.lead)
            found.append(Sensor(self._law(cpd, reading.inputs), replace(reading, cpd=cpd)))
        return found

    def _law(self, cpd: CPD, inputs: Mapping[Variable, Any]) -> Law:
        return law(cpd, inputs, self.places, self.dtype, self.bound.first_run)

    def row(self, step: int) -> int:
        """The row of the transition to a step."""
        return step - self.first - 1

    def read(self, step: int) -> list[Variable]:
        """The sensors with measurements at a step."""
        return [s.reading.cpd.child for s in self.sensors if len(s.rows(step))]

    def measured(self, step: int) -> Array:
        """The number of components that a step's measurements have, (runs,), as densities weigh."""
        found = np.zeros(self.bound.runs)
        for sensor in self.sensors:
            for row in sensor.rows(step):
                found += sensor.reading.cpd._counted(sensor.reading.taken[row])
        return found

    def log_peak(self, step: int) -> Array:
        """The largest log-density that a step's measurements could have, (runs,)."""
        found = np.zeros(self.bound.runs)
        for sensor in self.sensors:
            for row in sensor.rows(step):
                found += sensor.log_peak(row, step, self.bound.runs)
        return found

    def log_likelihood(self, some: Some) -> Array:
        """The log-density of a step's measurements at particles, (m,)."""
        found = np.zeros(some.size)
        for sensor in self.sensors:
            for row in sensor.rows(some.step):
                sensor.add(row, some, found)
        return found


class Sensor:
    """A sensor with its measurements."""

    def __init__(self, law: Law, reading: Reading) -> None:
        self.law, self.reading = law, reading
        with np.errstate(over="ignore"):  # what float32 does not hold is infinitely far
            self.values = np.asarray(reading.values, dtype=law.dtype)
        law.require_noise(reading.step)

    def rows(self, step: int) -> range:
        """The measurements of a step."""
        steps = self.reading.step
        first, last = np.searchsorted(steps, [step, step + 1]).tolist()
        return range(first, last)

    def add(self, row: int, some: Some, total: Array) -> None:
        """Add the log-density of one measurement at particles."""
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
        """The probabilities of what an open sighting may be of, (k + 2, m), at particles."""
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
        """The largest log-density that one measurement could have, (runs,)."""
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


class Part(NamedTuple):
    """One component of a belief."""

    variable: Variable
    component: int
    label: str
    row: int

    @property
    def angle(self) -> bool:
        """Whether it is an angle."""
        return bool(self.variable.angle_mask[self.component])


def parts(places: Sequence[tuple[Variable, int]]) -> list[Part]:
    """The components of variables whose first rows are given, with a name for each."""
    label = iter(distinct_labels(variable for variable, _ in places))
    return [
        Part(variable, k, next(label), first + k)
        for variable, first in places
        for k in range(variable.dimension)
    ]


@dataclass(frozen=True, eq=False)
class MixtureLaw(Law):
    """A mixture at its rows."""

    cpd: MixtureCPD
    parts: tuple[Law, ...]

    def draw(self, row: int, some: Some, drawing: Drawing) -> States:
        """See `Law`; each draw is of one part."""
        which = np.empty(some.size, dtype=np.intp)
        for place, rng in drawing.pieces:
            which[place] = chosen(self.cpd.weights, (place.stop - place.start,), rng)
        found = np.empty((self.cpd.child.dimension, some.size), dtype=self.dtype)
        for k, part in enumerate(self.parts):
            own = which == k
            if own.any():
                found[:, own] = part.draw(row, some.chosen(own), drawing.chosen(own))
        return found

    def log_density(self, row: int, some: Some, child: States, taken: Mask | None = None) -> Array:
        """See `Law`."""
        self.open(row, some.step)
        terms = (part.log_density(row, some, child, taken) for part in self.parts)
        return log_mixed(self.cpd.weights, terms)

    def open(self, row: int, step: int) -> Integers:
        """The number of components with noise of their own; refused where parts differ in it."""
        first, *others = (part.open(row, step) for part in self.parts)
        if any((other != first).any() for other in others):
            raise ModelError(
                f"{self.cpd!r} has parts without noise in a component and others with, at step "
                f"{step}: they have no density in common, which particles are weighed by here; "
                "give each some noise, or none",
                variable=self.cpd.child,
                cpd=self.cpd,
                step=step,
            )
        return first

    def require_noise(self, steps: Integers) -> None:
        """Refuse a part without noise."""
        for part in self.parts:
            part.require_noise(steps)


def law(
    cpd: CPD,
    inputs: Mapping[Variable, Any],
    places: Mapping[Variable, slice],
    dtype: Any,
    first_run: int,
) -> Law:
    """The law of a CPD: by its Gaussian noise, its parts, or its own sampler and density."""
    rows = {v: np.asarray(a, dtype=dtype) for v, a in inputs.items()}
    about = rows, places, dtype, first_run
    require_density([cpd] if isinstance(cpd, ConditionalGaussian) else [], "particles")
    if isinstance(cpd, ConditionalGaussian) and cpd.noise is None:
        return GaussianLaw(cpd, *about)
    if isinstance(cpd, MixtureCPD):
        return MixtureLaw(cpd, *about, tuple(law(part, *about) for part in cpd.parts))
    return Law(cpd, *about)
