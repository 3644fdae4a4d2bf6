"""The log-density of trajectories by the model as it was declared, as they are drawn step by step.

S is the number of draws of a run, n that of the components of a slice. The *pair* of a step is the
vector of the states of the step before, then the slice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.beliefs.moments.trajectories.density import Afresh, Term
from pgm.beliefs.moments.trajectories.law import ChainLaw
from pgm.kernels.arrays import Array


class Proposing(Protocol):
    """The source of slices: it proposes the next one, and is told how likely the model finds it."""

    def propose(self, given: Array) -> tuple[Array, Afresh | None]:
        """Draw the next slice (runs, S, n) given the states before, (runs, S, m).

        And the draws whose slice the model's own CPDs are to draw instead; None for no draws.
        """

    def weigh(self, given: Array, values: Array, predicted: Array) -> None:
        """Take note of a slice (runs, S, n) as it was drawn, given the states before.

        `predicted` is its log-density by the model's own CPDs, with Student's t for their noise.
        """


class Weighed(NamedTuple):
    """Draws: ln p(x, z) by the model, (runs, S), and by step their pairs, (runs, S, m + n).

    At step 0 the states before are zeros. The log-density is NaN where a function of the model is
    NaN or infinite.
    """

    log_density: Array
    values: list[Array]


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

    def draw(self, source: Proposing, shape: tuple[int, int], *, strict: bool) -> Weighed:
        """Draw trajectories that a source proposes, for a `shape` of (runs, S).

        Where a function of the model is NaN or infinite, a LinearisationError is raised if
        `strict`.
        """
        plan, layout = self.plan, self.plan.layout
        places, front = layout.state_places, layout.state_size
        total = np.zeros(shape)
        states, values = np.zeros((*shape, 0)), []
        for step in range(plan.steps + 1):
            links = self.law.transition if step else self.law.prior
            row = max(step - 1, 0)
            fresh, afresh = source.propose(states)
            vector = np.concatenate([states, fresh], axis=-1)
            start = states.shape[-1]
            predicted = np.zeros(shape)
            for link, term in links:
                drawn = term.child(
                    row,
                    vector[..., link.parents],
                    vector[..., link.child],
                    afresh,
                    strict=strict,
                )
                vector[..., link.child] = drawn.values
                predicted += drawn.log_tails
                total += np.where(drawn.lost, np.nan, drawn.log_density)
            source.weigh(states, vector[..., start:], predicted)
            if step:
                pair = vector
            else:
                pair = np.zeros((*shape, front + layout.slice_size))
                pair[..., front:][..., places] = vector
            slices = pair[..., front:]
            total += self._readings(step, slices, strict=strict)
            values.append(pair)
            states = slices[..., places]
        return Weighed(total, values)

    def _readings(self, step: int, slices: Array, *, strict: bool) -> Array:
        """The log-density (runs, S) of a step's measurements at draws of its slice (runs, S, n)."""
        total = np.zeros(slices.shape[:2])
        for sensor, term in self.sensors:
            rows = sensor.rows(step)
            if rows.start == rows.stop:
                continue
            parents = slices[..., sensor.parents]
            total += term.readings(
                rows,
                np.broadcast_to(parents, (rows.stop - rows.start, *parents.shape)),
                sensor.values[rows],
                sensor.moved[rows],
                strict=strict,
            )
        return total
