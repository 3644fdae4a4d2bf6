"""The log-density of trajectories by the model as it was declared, as they are drawn step by step.

S is the number of draws of a run, n that of the components of a slice. The *pair* of a step is the
vector of the states of the step before, then the slice.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.beliefs.moments.trajectories.density import Afresh, Peak, Term
from pgm.beliefs.moments.trajectories.law import ChainLaw
from pgm.kernels.arrays import Array

# Numbers of the draws of steps that are weighed together: they stay in cache.
BLOCK = 2**18


class Proposing(Protocol):
    """The source of slices: it proposes the next one, and is told how likely the model finds it."""

    def propose(self, given: Array) -> tuple[Array, Afresh | None]:
        """Draw the next slice (runs, S, n) given the states before, (runs, S, m).

        And the draws whose slice the model's own CPDs are to draw instead; None for no draws.
        """

    def weigh(self, given: Array, values: Array, predicted: Array) -> None:
        """Take note of the next k slices (k, runs, S, n) as they were drawn.

        They are given the states before them, (k, runs, S, m). `predicted` are their log-densities
        by the model's own CPDs, with Student's t for their noise, (k, runs, S).
        """


class Weighed(NamedTuple):
    """Draws: ln p(x, z) by the model, (runs, S), and their pairs, (T+1, runs, S, m + n).

    At step 0 the states before are zeros. The log-density is NaN where a function of the model is
    NaN or infinite.
    """

    log_density: Array
    values: Array


@dataclass(frozen=True, eq=False)
class ChainModel:
    """The CPDs of a chain and its measurements, as densities of trajectories.

    plan : ChainPlan
        The linearised chain with its evidence.
    law : ChainLaw
        Has the CPDs of prior and transition.
    sensors : list
        Pairs of a `Sensor`, which has the measurements, and its `Term`.
    """

    plan: ChainPlan
    law: ChainLaw
    sensors: list[tuple[Sensor, Term]]

    @classmethod
    def make(cls, plan: ChainPlan, *, relative: bool, near: bool = True) -> ChainModel:
        """The densities of a plan; `relative` and `near` are as of its CPDs' `Term`."""
        sensors = [
            (sensor, Term.make(sensor.family, relative=relative, near=near, taken=sensor.taken))
            for sensor in plan.sensors
        ]
        return cls(plan, ChainLaw.make(plan, relative=relative, near=near), sensors)

    @property
    def width(self) -> int:
        """The number of floats that one slice of a draw of one run occupies while it is made."""
        size = self.plan.layout.state_size + 2 * self.plan.layout.slice_size
        seen = [
            np.diff(sensor.bounds).max() * sum(sensor.family.shape[2:])
            for sensor in self.plan.sensors
        ]
        return size + int(max(seen, default=0))

    def draw(self, source: Proposing, shape: tuple[int, int], *, strict: bool) -> Weighed:
        """Draw trajectories that a source proposes, for a `shape` of (runs, S).

        Where a function of the model is NaN or infinite, a LinearisationError is raised if
        `strict`.
        """
        layout, steps = self.plan.layout, self.plan.steps
        places, front = layout.state_places, layout.state_size
        values = np.zeros((steps + 1, *shape, front + layout.slice_size))
        total, states = np.zeros(shape), np.zeros((*shape, 0))
        many = max(1, BLOCK // max(1, shape[0] * shape[1] * self.width))
        edges = [0, *range(1, steps + 1, many), steps + 1]
        for first, last in pairwise(edges):
            for step in range(first, last):
                fresh, afresh = source.propose(states)
                vector = np.concatenate([states, fresh], axis=-1)
                self.make_children(step, vector, afresh)
                slices = values[step][..., front:]
                if step:
                    values[step] = vector
                else:
                    slices[..., places] = vector
                states = slices[..., places]
            total += self._weighed(source, first, values[first:last], strict=strict)
        return Weighed(total, values)

    @property
    def peak(self) -> Peak:
        """The peak of the density of all trajectories."""
        steps = slice(0, self.plan.steps)
        parts = [term.peak(slice(0, 1)) for _, term in self.law.prior]
        parts += [term.peak(steps) for _, term in self.law.transition]
        parts += [term.peak(slice(0, len(sensor.values))) for sensor, term in self.sensors]
        return Peak.of(self.plan.runs, parts)

    def make_children(self, step: int, vector: Array, afresh: Afresh | None) -> None:
        """Make the children of draws at a step in place, in pairs, or states at step 0.

        `vector` is (runs, S, m + n) or (runs, S, m), with the proposed children; see `Term.made`.
        """
        for link, term in self.law.transition if step else self.law.prior:
            parents, child = vector[..., link.parents], vector[..., link.child]
            vector[..., link.child] = term.made(max(step - 1, 0), parents, child, afresh)

    def moved(self, first: int, vector: Array, *, strict: bool) -> tuple[Array, Array]:
        """The log-densities (k, runs, S) of k slices from step `first` on, given the states before.

        And those with Student's t for the noise of all CPDs. `vector` has pairs (k, runs, S, m + n)
        or, at step 0, the states alone.
        """
        links, rows = self.law.prior, slice(0, 1)
        if first:
            links, rows = self.law.transition, slice(first - 1, first - 1 + len(vector))
        own, tails = np.zeros(vector.shape[:3]), np.zeros(vector.shape[:3])
        for link, term in links:
            parents, child = vector[..., link.parents], vector[..., link.child]
            drawn = term.weighed(rows, parents, child, strict=strict)
            own += np.where(drawn.lost, np.nan, drawn.log_density)
            tails += drawn.log_tails
        return own, tails

    def read(self, first: int, slices: Array, *, strict: bool) -> Array:
        """The log-density (runs, S) of measurements at k steps, given slices (k, runs, S, n)."""
        total = np.zeros(slices.shape[1:3])
        for sensor, term in self.sensors:
            rows = slice(sensor.rows(first).start, sensor.rows(first + len(slices) - 1).stop)
            if rows.start == rows.stop:
                continue
            at = sensor.family.step[rows] - self.plan.first - first
            total += term.readings(
                rows,
                slices[at][..., sensor.parents],
                sensor.values[rows],
                sensor.moved[rows],
                strict=strict,
            )
        return total

    def _weighed(self, source: Proposing, first: int, pairs: Array, *, strict: bool) -> Array:
        """The log-density (runs, S) of k steps, by their pairs (k, runs, S, m + n).

        The source is told of them. Step 0, which has no states before, is weighed alone.
        """
        layout = self.plan.layout
        slices, vector, start = pairs[..., layout.state_size :], pairs, layout.state_size
        if not first:
            vector, start = slices[..., layout.state_places], 0
        own, tails = self.moved(first, vector, strict=strict)
        source.weigh(vector[..., :start], vector[..., start:], tails)
        total: Array = own.sum(axis=0) + self.read(first, slices, strict=strict)
        return total
