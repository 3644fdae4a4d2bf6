"""Draws of whole trajectories of a chain of slices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.audit.density import Term, has_exact
from pgm.inference.audit.proposal import Proposal
from pgm.inference.chain import backward
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.sensor import Sensor
from pgm.inference.kind import SMOOTHED
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Mask, block
from pgm.kernels.moments import Conditional

Links = list[tuple[Link, Term]]


@dataclass(frozen=True, eq=False)
class ChainDraws:
    """Trajectories from the smoothed Gaussian, drawn forward in time, with their log-weights.

    Attributes
    ----------
    plan : ChainPlan
    first, later : Proposal
        The states at step 0; the slice of each later step given the states before it.
    prior, transition, sensors : list
        The CPDs in place, with their densities.
    reference : ndarray
        (runs,): the log-weight that is common to all draws.
    relative : bool
        Whether weights are relative to the densities of the linearised model, whose evidence then
        is the reference.
    """

    plan: ChainPlan
    first: Proposal
    later: Proposal
    prior: Links
    transition: Links
    sensors: list[tuple[Sensor, Term]]
    reference: Array
    relative: bool

    @classmethod
    def make(cls, posterior: ChainPosterior) -> ChainDraws:
        """Prepare to draw from the smoothed joint of a posterior's linearisation."""
        plan = posterior._plan
        exact = has_exact(s.family for s in plan.sensors if s.family.step.size)
        reverse = posterior._reverse
        smoothed = posterior.kind == SMOOTHED
        beliefs = posterior._beliefs if smoothed else backward.sweep(posterior._forward, reverse)
        draws = cls._make(plan, beliefs, reverse, None)
        if not exact and draws.first.regular and draws.later.regular:
            return draws
        # The draws' support is the linearised model's: weights are relative to its densities, with
        # the means that belong to them, which step control may have held back.
        _refuse_grouped(plan)
        forward = posterior._forward
        reverse = Reverse.make(plan, forward)
        return cls._make(
            plan, backward.sweep(forward, reverse), reverse, forward.log_density.sum(axis=0)
        )

    @classmethod
    def _make(
        cls, plan: ChainPlan, beliefs: Beliefs, reverse: Reverse, reference: Array | None
    ) -> ChainDraws:
        relative = reference is not None
        prior, transition = (
            [(link, Term.make(link.family, relative=relative)) for link in links]
            for links in (plan.prior, plan.transition)
        )
        states, front = plan.layout.state_places, plan.layout.state_size
        mean = beliefs.mean[..., states]
        cov = block(beliefs.cov, states, states)
        nothing = np.zeros((1, *cov.shape[1:-1], 0))
        later = moments.reverse(
            beliefs.mean[1:],
            beliefs.cov[1:],
            reverse.states.matrix,
            reverse.states.cov,
            mean[:-1],
            cov[:-1],
        )
        free = _free(transition, (plan.steps, *beliefs.mean.shape[1:]), front)
        return cls(
            plan,
            Proposal.make(Conditional(nothing, mean[:1], cov[:1]), _free(prior, mean[:1].shape, 0)),
            Proposal.make(later, free),
            prior,
            transition,
            [
                (sensor, Term.make(sensor.family, relative=relative, taken=sensor.taken))
                for sensor in plan.sensors
            ],
            np.zeros(plan.runs) if reference is None else reference,
            relative,
        )

    @property
    def width(self) -> int:
        """Numbers that one draw of one run takes at a time."""
        size = self.plan.layout.state_size + 2 * self.plan.layout.slice_size
        seen = [
            np.diff(sensor.bounds).max() * sum(sensor.family.shape[2:])
            for sensor in self.plan.sensors
        ]
        return size + int(max(seen, default=0))

    def log_weights(self, count: int, rng: np.random.Generator) -> Array:
        """Log-weights, (runs, S), of so many new trajectories."""
        plan, layout = self.plan, self.plan.layout
        shape, places = (plan.runs, count), layout.state_places
        total = np.repeat(self.reference[:, None], count, axis=1)
        states = np.zeros((*shape, 0))
        for step in range(plan.steps + 1):
            links, proposal = (self.transition, self.later) if step else (self.prior, self.first)
            row = max(step - 1, 0)
            fresh, log_density = proposal.draw(row, states, count, rng)
            total -= 0.0 if self.relative else log_density
            vector = np.concatenate([states, fresh], axis=-1)
            for link, term in links:
                child = vector[..., link.child]
                child, weight = term.child(row, vector[..., link.parents], child)
                vector[..., link.child] = child
                total += weight
            if step:
                slices = vector[..., layout.state_size :]
            else:
                slices = np.zeros((*shape, layout.slice_size))
                slices[..., places] = vector
            total += self._readings(step, slices)
            states = slices[..., places]
        return total

    def _readings(self, step: int, slices: Array) -> Array:
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
            )
        return total


def _free(links: Links, shape: tuple[int, ...], start: int) -> Mask:
    """The mask of components that CPDs leave open, in a vector's part from `start` on."""
    free = np.zeros(shape, dtype=bool)
    for link, term in links:
        free[..., link.child.start - start : link.child.stop - start] = term.free()
    return free


def _refuse_grouped(plan: ChainPlan) -> None:
    for sensor in plan.sensors:
        if sensor.cross:
            raise NumericalError(
                f"{sensor.family.cpd!r} is grouped: the approximation errors of a step's sightings "
                "are correlated, which is not audited beside a sensor without noise or a "
                "covariance too near to singular; leave grouped=True out, or give the exact sensor "
                "some noise",
                variable=sensor.variable,
                cpd=sensor.family.cpd,
            )
