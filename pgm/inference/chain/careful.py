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

from pgm.errors import LinearisationError, NumericalError
from pgm.inference.chain.certificate import is_flat
from pgm.inference.chain.flat import Solved, moments, solved
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.iteration import Anchor, Point
from pgm.inference.chain.moments import MomentChain, largest
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.chain.reading import StepReading, take
from pgm.inference.chain.readings import Moments, Reading
from pgm.inference.chain.taking import (
    ROUNDING,
    Belief,
    Component,
    Taken,
    cancelled,
    hold,
    rounded,
    through,
    update,
    variances,
)
from pgm.inference.chain.whitened import distinct
from pgm.inference.family import Family
from pgm.inference.schedule import ONCE, Filtering
from pgm.inference.status import Status
from pgm.kernels import roots, twofold
from pgm.kernels.arrays import Array, Mask, quiet
from pgm.kernels.roots import NEGLIGIBLE
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
    """A forward pass.

    Attributes
    ----------
    forward : Forward
        Rounded.
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
        """Of the means, (runs,); see `Belief.error`."""
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
        How CPDs are linearised at the incoming beliefs; without, they are as laid out.
    anchor : Anchor, optional
        What holds the beliefs.
    begin : Begin, optional
        Where a window begins; without, the prior.
    """
    out = Forward.empty(plan)
    steps: list[Step] = []
    record: list[Array] = []
    converged = np.ones(plan.runs, dtype=bool)
    if begin is None:
        belief = start(plan, linearise=schedule is not None)
        information = Twofold.zeros((plan.runs, *(belief.columns.shape[-1:] * 2)))
    else:
        belief, information = begin
    unknown = solved(information)
    matrix: Twofold | None = None
    noise: Twofold | None = None
    settled = schedule is None or all(link.family.exact for link in plan.transition)
    every = _transition(plan, slice(None)) if settled else None
    for step in range(plan.steps + 1):
        if step:
            if every is None:
                move = moving(plan, step, out.mean[step - 1], out.cov[step - 1])
            else:
                move = every.at(step - 1 if len(every.matrix.hi) > 1 else 0)
            matrix, noise, belief = move.matrix, move.cov, predict(belief, move)
        predicted = belief
        mean, cov = out.predicted_mean[step], out.predicted_cov[step]
        mean[...], cov[...] = moments(belief, unknown)
        reading = CarefulReading.of(plan, step, (mean, cov), belief, information, schedule)
        if schedule is None:
            found = reading.solve(None if anchor is None else anchor.at(step))
        else:
            taken = take(reading, schedule)
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
    taken: Taken
    information: Twofold
    unknown: Solved

    @property
    def means(self) -> Array:
        """The mean, (1, runs, n)."""
        return self.mean[None]

    @property
    def point(self) -> Point:
        """Its moments."""
        return Point(self.mean[None], self.cov[None])

    @property
    def components(self) -> list[Component]:
        """In the order in which they were taken in."""
        return self.taken.components

    @property
    def belief(self) -> Belief:
        """Given the readings."""
        return self.taken.belief

    def at(self, mean: Array) -> CarefulUpdate:
        """The same with the mean that a step control kept."""
        if np.array_equal(mean, self.mean):
            return self
        taken = self.taken._replace(belief=self.belief.shifted(mean - self.mean))
        return replace(self, mean=mean, taken=taken)


class CarefulReading(StepReading[CarefulUpdate]):
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
        """Of a plan's step, at a belief of these moments, (runs, n) and (runs, n, n)."""
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
        cov = _proper(part.sensor.family, self.step, cov)
        part.linearise(mean, cov, active)

    def taken_in(self, anchor: Anchor | None) -> CarefulUpdate:
        """The belief given the readings."""
        taken = Taken(self.belief, [], np.zeros(len(self.belief.cov.hi)))
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


class Move(NamedTuple):
    """An affine conditional A x + b + n: (..., n, n), (..., n) and the covariance (..., n, n).

    `columns` are how it depends on δ, (..., n, q): not at all, but for a prior.
    """

    matrix: Twofold
    offset: Twofold
    cov: Twofold
    columns: Twofold

    def at(self, row: int) -> Move:
        """One row of many."""
        return Move(*(part[row] for part in self))


def prior_mean(plan: ChainPlan) -> Array:
    """The means of the states at step 0, (runs, n); those of flat components are as declared."""
    states = plan.layout.state_places
    if not is_flat(plan):
        return MomentChain(plan, ONCE).start().by_run[0][:, states]
    return start(plan, linearise=True).columns.hi[:, states, 0]


def start(plan: ChainPlan, *, linearise: bool) -> Belief:
    """The slice at step 0 before its readings; there are no controls."""
    nonlinear = next((link.family for link in plan.prior if not link.family.exact), None)
    if linearise and nonlinear is not None:
        if is_flat(plan):
            raise LinearisationError(
                f"{nonlinear.cpd!r}: beside a prior of infinite variance only linear CPDs can "
                "stand at step 0; make it linear, or give the prior a finite variance",
                variable=nonlinear.cpd.child,
                cpd=nonlinear.cpd,
                step=0,
            )
        MomentChain(plan, ONCE).start()
    first = _conditional(plan.prior, slice(None), 0, plan.layout.state_size, plan.runs).at(0)
    size, states = plan.layout.slice_size, plan.layout.state_places
    columns = Twofold.zeros((plan.runs, size, 1 + first.columns.shape[-1]))
    columns[:, states, 0] = first.offset
    columns[:, states, 1:] = first.columns
    cov = Twofold.zeros((plan.runs, size, size))
    where = np.arange(size)[states]
    for whole, part in ((cov.hi, first.cov.hi), (cov.lo, first.cov.lo)):
        whole[:, where[:, None], where] = part
    eye = np.eye(size)
    drift = (ROUNDING * columns.hi[..., 0]) ** 2
    rounding = rounded(eye, cov.hi, np.zeros_like(cov.hi))
    return Belief(columns, cov, rounding, drift[..., None] * eye)


def _transition(plan: ChainPlan, rows: slice) -> Move:
    """The slices of some steps given the slices before them, of which controls play no part."""
    layout = plan.layout
    found = _conditional(plan.transition, rows, layout.state_size, layout.slice_size, plan.runs)
    matrix = Twofold.zeros((*found.matrix.shape[:-1], layout.slice_size))
    matrix[..., layout.state_places] = found.matrix
    return found._replace(matrix=matrix)


def _conditional(links: list[Link], rows: slice, front: int, size: int, runs: int) -> Move:
    """The links' children given the first `front` components of the vector that all stand in."""
    families = [link.family for link in links]
    parts = [[distinct(part[rows]) for part in (f.matrix, f.offset, f.noise)] for f in families]
    flat = [_flat(noise) for *_, noise in parts]
    lead = np.broadcast_shapes(*(part.shape[:2] for each in parts for part in each))
    whole, q = front + size, int(sum(each.sum() for each in flat))
    matrix = Twofold.zeros((*lead, whole, front))
    matrix.hi[..., :front, :] = np.eye(front)
    offset, cov = Twofold.zeros((*lead, whole)), Twofold.zeros((*lead, whole, whole))
    columns = Twofold.zeros((*lead, whole, q))
    done = 0
    for link, (own, shift, noise), open_ in zip(links, parts, flat, strict=True):
        child, parents, slope = link.child, link.parents, Twofold(own)
        matrix[..., child, :] = slope @ matrix[..., parents, :]
        offset[..., child] = (slope @ offset[..., parents][..., None])[..., 0] + shift
        columns[..., child, :] = slope @ columns[..., parents, :]
        for place in np.flatnonzero(open_):
            columns.hi[..., child.start + int(place), done] = 1.0
            done += 1
        cross = slope @ cov[..., parents, :]
        cov[..., child, :] = cross
        cov[..., :, child] = cross.mT
        cov[..., child, child] = cross[..., parents] @ slope.mT + _regular(noise, open_)
    rest = slice(front, None)
    return Move(
        matrix[..., rest, :], offset[..., rest], cov[..., rest, rest], columns[..., rest, :]
    )


def _flat(noise: Array) -> Mask:
    """The components of infinite variance, (d,)."""
    found: Mask = np.isinf(np.einsum("...ii->...i", noise)).any(axis=(0, 1))
    return found


def _regular(noise: Array, flat: Mask) -> Twofold:
    """A noise of exactly the rank it was meant to have; of unit variance where it is infinite."""
    if flat.any():
        noise = np.where(flat[:, None] | flat, np.eye(flat.size) * flat, noise)
    unit, pivots = twofold.eliminated(noise, NEGLIGIBLE)
    if not (pivots.hi == 0.0).any():
        return Twofold(noise)
    return unit * pivots[..., None, :] @ unit.mT


@quiet()
def predict(belief: Belief, move: Move) -> Belief:
    """The belief over the next slice, before its readings."""
    summed = np.abs(move.matrix.hi) @ np.abs(belief.columns.hi)
    columns = cancelled(move.matrix @ belief.columns, summed)
    columns[..., 0] = columns[..., 0] + move.offset
    cov = move.matrix @ belief.cov @ move.matrix.mT + move.cov
    rounding = through(move.matrix.hi, belief.rounding)
    rounding = rounding + rounded(move.matrix.hi, belief.cov.hi, move.cov.hi)
    own = ROUNDING * (summed[..., 0] + np.abs(move.offset.hi))
    drift = through(move.matrix.hi, belief.drift) + own[..., None] ** 2 * np.eye(own.shape[-1])
    return Belief(columns, cov, rounding, drift).certain()


def moving(plan: ChainPlan, step: int, mean: Array, cov: Array) -> Move:
    """The transition to a step, linearised at the belief before it."""
    if not all(link.family.exact for link in plan.transition):
        for link in plan.transition:
            cov = _proper(link.family, step, cov)
        MomentChain(plan, ONCE, check=True).predict(step, Moments.of(plan, mean, cov))
    return _transition(plan, slice(step - 1, step)).at(0)


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


def _proper(family: Family, step: int, cov: Array) -> Array:
    """A covariance to linearise at; Taylor's formula, which does not look at it, needs none."""
    improper = ~np.isfinite(cov)
    if family.exact or not improper.any():
        return cov
    if not family.taylor:
        raise LinearisationError(
            f"{family.cpd!r}: at step {step} the belief over its parents still has an infinite "
            f"variance, at which {family.lineariser!r} cannot linearise; use pgm.Taylor(), read a "
            "linear sensor before, or give the prior a finite variance",
            variable=family.cpd.child,
            cpd=family.cpd,
            step=step,
        )
    return np.where(improper, 0.0, cov)
