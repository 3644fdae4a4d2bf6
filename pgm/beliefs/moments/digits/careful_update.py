"""The measurements of a step taken into a belief in twice the digits; see `careful`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pgm.beliefs.moments.digits.careful_belief import (
    Belief,
    Component,
    Solved,
    decorrelated,
    informed,
    rounded_belief,
    solved,
    take,
)
from pgm.beliefs.moments.digits.careful_chain import proper
from pgm.beliefs.moments.steps import gate, refusals
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.iterated_update import UpdateProblem
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments, Reading
from pgm.kernels import extended
from pgm.kernels.arrays import LOG_2PI, Array, Mask, quiet
from pgm.kernels.extended import Twofold
from pgm.schedules.iteration import Anchor, Point
from pgm.schedules.schedule import Filtering


@dataclass(frozen=True, eq=False)
class CarefulUpdate:
    """The belief after a step's measurements, and the estimate of δ given all measurements so far.

    `belief` is a function of δ, and `unknown` the estimate of δ. With that estimate the belief has
    in float64 the mean `mean` (runs, n) and the covariance `spread`, which is infinite along
    directions still unknown. `log_density` (runs,) is ln p(measurements | earlier ones).
    `components` are the scalar measurements in the order in which they were taken in; `information`
    (runs, 1 + q, 1 + q) is Σ [v V]ᵀ[v V] / S over these and all earlier ones.
    """

    mean: Array
    spread: Diffuse
    log_density: Array
    belief: Belief
    components: list[Component]
    information: Twofold
    unknown: Solved

    @property
    def means(self) -> Array:
        """The mean (1, runs, n), with an axis of one step in front."""
        return self.mean[None]

    @property
    def cov(self) -> Array:
        """The covariance (runs, n, n), with infinite variances of components still unknown."""
        return self.spread.shown

    @property
    def point(self) -> Point:
        """The moments, as a point of linearisation."""
        return Point(self.mean[None], self.cov[None], None, self.spread.cov[None])

    def at(self, mean: Array) -> CarefulUpdate:
        """A copy of the update whose mean is `mean` (runs, n).

        A step control (Levenberg–Marquardt) may keep another mean than the solution's.
        """
        if np.array_equal(mean, self.mean):
            return self
        return replace(self, mean=mean, belief=self.belief.shifted(mean - self.mean))


class CarefulReading(UpdateProblem[CarefulUpdate]):
    """The measurements of a step as an iterated update of a belief in twice the digits.

    `belief` is the predicted one; `information` (runs, 1 + q, 1 + q) is Σ [v V]ᵀ[v V] / S over all
    scalar measurements of the steps before, [v V] being the row of one's innovation.
    """

    belief: Belief
    information: Twofold

    @classmethod
    def of(
        cls,
        plan: ChainPlan,
        step: int,
        mean: Array,
        spread: Diffuse,
        belief: Belief,
        information: Twofold,
        schedule: Filtering | None,
        *,
        gated: gate.Asked | None = None,
    ) -> CarefulReading:
        """The update of a predicted belief by the measurements at `step`.

        `step` counts from the plan's first, which is 0. `mean` (runs, n) and `spread` are the mean
        and the covariance of `belief` in float64, δ being estimated from `information`; `spread` is
        infinite along directions still unknown. With a schedule the schedule's gates reject
        sightings, and `gated` is not used. Without one the plan's linearisations are used, and the
        gates `gated` reject sightings, None for no gates. Gates decide in this call alone, at the
        predicted belief, not again at later linearisations.
        """
        chain, at = MomentChain(plan, schedule, gated=gated), Moments.of(plan, mean, spread.shown)
        parts = chain.readings(step)
        made = cls(parts, plan.first + step, at.mean, at.cov)
        made.belief, made.information = belief, information
        for part in parts if schedule is None else ():
            part.linearise(at.mean, at.cov)
        if chain.gate is not None:
            if schedule is not None:
                made.linearise(made.predicted, None)
            unknown = spread if spread.open.any() else None
            gate.decide(chain.gate, parts, made.measured, at.mean, at.cov, unknown)
        return made

    def move(self, part: Reading, mean: Array, cov: Array, active: Mask | None) -> None:
        """Linearise the sensor of the reading `part` at a belief; `part` keeps the result.

        The belief over the slice has the moments (n, *batch) and (n, n, *batch), `batch` being ()
        for one run and (runs,) for several. Where variances are infinite, a LinearisationError
        refuses a nonlinear sensor, except with `Taylor`, which does not use them. Runs that are not
        `active` (runs,) keep their linearisation; None means that all are active.
        """
        part.linearise(mean, proper(part.sensor.family, self.step, cov), active)

    def raised(self, found: CarefulUpdate, surplus: Array | float) -> CarefulUpdate:
        """The update `found`, with `surplus` (runs,) or one number added to its log-density.

        Robust noise is N(0, R/w) with a weight w in an update; the surplus is the log-density of
        the robust noise itself less that of N(0, R/w).
        """
        return replace(found, log_density=found.log_density + surplus)

    @quiet()
    def taken_in(self, anchor: Anchor | None) -> CarefulUpdate:
        """The belief given the measurements as they are linearised at present.

        An anchor, by which a step control holds a solution near a point, is a measurement of all
        components of the slice. The belief is conditioned on it last, and the log-density leaves it
        out; None for no anchor. An indefinite predictive covariance, a log-density that is not
        finite, and a measurement that contradicts a certain belief are refused with a
        NumericalError.
        """
        belief, information, parts = self.belief, self.information, self.measured
        runs, size = belief.largest.shape
        rows, noises, seen = decorrelated(parts, runs, size)
        components: list[Component] = []
        log_density, left = np.zeros(runs), np.zeros(seen.shape)
        for k in range(seen.shape[-1]):
            belief, component, predictive, improper = take(
                belief, rows[:, k, :-1], rows[:, k, -1], noises[:, k], seen[:, k]
            )
            if improper.any():
                refusals.indefinite(parts, self.step, improper)
            components.append(component)
            innovation, weight = component.innovation[:, 0], component.weight
            read = weight.hi > 0.0
            left[:, k] = np.where(seen[:, k] & ~read, np.abs(innovation.hi), 0.0)
            level = (innovation * innovation * weight).hi + np.log(np.where(read, predictive, 1.0))
            log_density -= np.where(read, 0.5 * (level + LOG_2PI), 0.0)
        if not np.isfinite(log_density).all():
            refusals.indefinite(parts, self.step, ~np.isfinite(log_density))
        if left.any():
            off = left.T if self.mean.ndim > 1 else left[0]
            refusals.contradiction(parts, self.step, self.mean, off)
        if anchor is not None:  # a measurement of all components, which is no evidence
            held = (anchor.std[0] > 0.0) & (anchor.weight > 0.0)[:, None]
            share = np.where(anchor.weight > 0.0, anchor.weight, 1.0)[:, None]
            noises, values = Twofold(anchor.std[0] ** 2 / share), Twofold(anchor.mean[0])
            rows = extended.eye((runs, size, size))
            for k in range(size):
                belief, component, *_ = take(
                    belief, rows[:, k], values[:, k], noises[:, k], held[:, k]
                )
                components.append(component)
        for component in components:
            information = informed(information, component)
        unknown = solved(information)
        log_density = log_density + unknown.log_weight - solved(self.information).log_weight
        found = rounded_belief(belief, unknown)
        return CarefulUpdate(*found, log_density, belief, components, information, unknown)
