"""The forward pass in twice the digits, for models whose deviations lie too far apart for float64.

Readings are taken in one component after another, their noise decorrelated first, so that each
component is either read, with S = h P hᵀ + noise above rounding, or determined already:

    G = P hᵀ/S,   v = z − h m,   m ← m + G v,   P ← (1 − G h) P (1 − G h)ᵀ + G noise Gᵀ.

A flat prior is an unknown δ of which all means are functions m + D δ. The columns [m D] go
through the pass as one mean does, each component read leaves an innovation [v V], and δ has the
information Σ VᵀV / S of what was read. A flat component is δ and a part of unit variance, whose
sum is flat, so that covariances given δ are those of an ordinary model.

References
----------
de Jong, The diffuse Kalman filter, 1991.
Durbin & Koopman, Time series analysis by state space methods, 2012, sections 5.7 and 6.4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.chain import careful_motion as motion
from pgm.inference.chain.careful_motion import proper
from pgm.inference.chain.careful_update import (
    Belief,
    Component,
    IteratedUpdate,
    hold,
    update,
    variances,
)
from pgm.inference.chain.certificate import Solved, moments, solved
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.iterated_update import UpdateProblem, iterated
from pgm.inference.chain.iteration import Anchor, Point
from pgm.inference.chain.moments import MomentChain, largest
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments, Reading
from pgm.inference.schedule import Filtering
from pgm.inference.status import Status
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Mask
from pgm.kernels.twofold import Twofold


class Step(NamedTuple):
    """A step of the pass.

    Attributes
    ----------
    matrix, noise : Twofold or None
        (runs or 1, n, n): A and the noise of the transition that led to it.
    predicted, known : Belief
        Before and after its readings.
    components : list of Component
        In the order in which they were taken in.
    information : Twofold
        (runs, 1 + q, 1 + q): Σ [v V]ᵀ[v V] / S of all components up to the step.
    """

    matrix: Twofold | None
    noise: Twofold | None
    predicted: Belief
    known: Belief
    components: list[Component]
    information: Twofold


@dataclass(frozen=True, eq=False)
class Careful:
    """A forward pass in twice the digits.

    Attributes
    ----------
    forward : Forward
        Its beliefs, rounded.
    steps : list of Step
    unknown : Solved
        δ given all readings.
    """

    forward: Forward
    steps: list[Step]
    unknown: Solved

    @cached_property
    def largest(self) -> Array:
        """The largest predicted variances so far, (T+1, runs, n)."""
        predicted = np.array([variances(step.predicted.cov.hi) for step in self.steps])
        found: Array = np.maximum.accumulate(predicted, axis=0)
        return found

    @property
    def error(self) -> Array:
        """The error of the means, (runs,); see `Belief.error`."""
        known = [step.known for step in self.steps]
        errors = [belief.error(each) for belief, each in zip(known, self.largest, strict=True)]
        largest: Array = np.max(errors, axis=0)
        return largest

    def to(self, step: int) -> Solved:
        """δ given the readings up to a step."""
        return solved(self.steps[step].information)


class Begin(NamedTuple):
    """The belief that a window begins with, and the information Σ [v V]ᵀ[v V] / S behind it."""

    belief: Belief
    information: Twofold


def sweep(
    plan: ChainPlan,
    schedule: Filtering | None = None,
    anchor: Anchor | None = None,
    begin: Begin | None = None,
) -> tuple[Careful, Status]:
    """The forward pass.

    Parameters
    ----------
    plan : ChainPlan
    schedule : Filtering, optional
        The linearisations at incoming beliefs; without, CPDs stay as they were linearised.
    anchor : Anchor, optional
        Readings that hold the beliefs near a point.
    begin : Begin, optional
        Where a window begins; without, the prior.
    """
    out = Forward.empty(plan)
    steps: list[Step] = []
    record: list[Array] = []
    converged = np.ones(plan.runs, dtype=bool)
    if begin is None:
        belief = motion.start(plan, linearise=schedule is not None)
        information = Twofold.zeros((plan.runs, *(belief.columns.shape[-1:] * 2)))
    else:
        belief, information = begin
    unknown = solved(information)
    matrix: Twofold | None = None
    noise: Twofold | None = None
    settled = schedule is None or all(link.family.exact for link in plan.transition)
    every = motion.transition(plan, slice(None)) if settled else None
    for step in range(plan.steps + 1):
        if step:
            if every is None:
                move = motion.moving(plan, step, out.mean[step - 1], out.cov[step - 1])
            else:
                move = every.at(step - 1 if len(every.matrix.hi) > 1 else 0)
            matrix, noise, belief = move.matrix, move.cov, motion.predict(belief, move)
        predicted = belief
        mean, cov = out.predicted_mean[step], out.predicted_cov[step]
        mean[...], cov[...] = moments(belief, unknown)
        reading = CarefulReading.of(plan, step, (mean, cov), belief, information, schedule)
        if schedule is None:
            found = reading.solve(None if anchor is None else anchor.at(step))
        else:
            taken = iterated(reading, schedule)
            reading.keep()
            found = taken.solution.at(taken.mean)
            record = largest(record, taken.residuals)
            converged &= taken.converged
        belief, information, unknown = found.belief, found.information, found.unknown
        out.mean[step], out.cov[step] = found.mean, found.cov
        out.log_density[step] = found.log_density
        steps.append(Step(matrix, noise, predicted, belief, found.components, information))
        require_proper(plan, plan.first + step, predicted, belief)
    return Careful(out, steps, unknown), Status.of(record, converged, plan.lead)


@dataclass(frozen=True, eq=False)
class CarefulUpdate:
    """The belief that an update leaves, and the log-density of its readings.

    Attributes
    ----------
    mean, cov, log_density : ndarray
        (runs, n), (runs, n, n) and (runs,).
    """

    mean: Array
    cov: Array
    log_density: Array
    taken: IteratedUpdate
    information: Twofold
    unknown: Solved

    @property
    def means(self) -> Array:
        """The mean, (1, runs, n)."""
        return self.mean[None]

    @property
    def point(self) -> Point:
        """The moments, as a point of linearisation."""
        return Point(self.mean[None], self.cov[None])

    @property
    def components(self) -> list[Component]:
        """The components, in the order in which they were taken in."""
        return self.taken.components

    @property
    def belief(self) -> Belief:
        """The belief given the readings."""
        return self.taken.belief

    def at(self, mean: Array) -> CarefulUpdate:
        """The same with the mean that a step control kept."""
        if np.array_equal(mean, self.mean):
            return self
        taken = self.taken._replace(belief=self.belief.shifted(mean - self.mean))
        return replace(self, mean=mean, taken=taken)


class CarefulReading(UpdateProblem[CarefulUpdate]):
    """The readings of a step, taken in in twice the digits."""

    belief: Belief
    information: Twofold

    @classmethod
    def of(
        cls,
        plan: ChainPlan,
        step: int,
        moments: tuple[Array, Array],
        belief: Belief,
        information: Twofold,
        schedule: Filtering | None,
    ) -> CarefulReading:
        """The readings of a step, at a belief of these moments, (runs, n) and (runs, n, n)."""
        parts = MomentChain(plan, schedule).readings(step)
        at = Moments.of(plan, *moments)
        made = cls(parts, plan.first + step, at.mean, at.cov)
        made.belief, made.information = belief, information
        if schedule is None:
            for part in parts:
                part.linearise(at.mean, at.cov)
        return made

    def move(self, part: Reading, mean: Array, cov: Array, active: Mask | None) -> None:
        """Linearise a sensor's readings."""
        cov = proper(part.sensor.family, self.step, cov)
        part.linearise(mean, cov, active)

    def taken_in(self, anchor: Anchor | None) -> CarefulUpdate:
        """The belief given the readings."""
        taken = IteratedUpdate(self.belief, [], np.zeros(len(self.belief.cov.hi)))
        if self.parts:
            taken = update(self.measured, self.step, self.belief, self.mean)
        if anchor is not None:
            taken = hold(anchor, taken)
        information = self.information
        for component in taken.components:
            row = component.innovation[:, None, :]
            information = information + row.mT @ (row * component.weight[:, None, None])
        unknown = solved(information)
        log_density = taken.log_density + unknown.log_weight - solved(self.information).log_weight
        return CarefulUpdate(
            *moments(taken.belief, unknown), log_density, taken, information, unknown
        )


def require_proper(plan: ChainPlan, step: int, *beliefs: Belief) -> None:
    """Refuse beliefs that are not finite, or that a lineariser's error has made indefinite."""
    for belief in beliefs:
        for part in (belief.columns, belief.cov):
            if not np.isfinite(part.hi + part.lo).all():
                raise NumericalError(
                    f"the belief at step {step} is not finite; are its inputs, readings and noises "
                    "of a size that float64 can hold?",
                    step=step,
                )
    rough = [family for family in plan.families if not family.semidefinite]
    if not rough or all(roots.is_proper(roots.root(belief.cov.hi)) for belief in beliefs):
        return
    blamed = next((family for family in rough if step in family.step), rough[0])
    raise NumericalError(
        f"the belief at step {step} has an indefinite covariance, by the error of "
        f"{blamed.lineariser!r} for {blamed.cpd!r}; use a rule with positive weights or more "
        "samples",
        variable=blamed.cpd.child,
        cpd=blamed.cpd,
        step=step,
    )
