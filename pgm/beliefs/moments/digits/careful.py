"""The forward pass in twice the digits, where standard deviations lie too far apart for float64.

Numbers are pairs of float64 (`Twofold`). The measurements of a step are decorrelated to scalars
z = h x + e, e ~ N(0, r), of the slice x (n components), h being a row. The belief N(m, P) over the
slice is conditioned on them one by one. Each has an innovation v, of variance S, and a gain G:

    S = h P hᵀ + r,   G = P hᵀ/S,   v = z − h m,
    m ← m + G v,   P ← (1 − G h) P (1 − G h)ᵀ + G r Gᵀ.

A scalar whose S is no more than rounding was determined before, and is left out.

A *flat* prior has infinite variances. A component of infinite prior variance is taken for the sum
of an unknown number and a variable of unit variance. These unknown numbers are a vector δ of q
components. Covariances P given δ are then those of an ordinary model, and means are functions
m + D δ, where the matrix [m D] goes through the pass as one mean does. Each scalar has an
innovation v + V δ, kept as the row [v V], and so δ is estimated from Σ VᵀV / S and Σ Vᵀv / S, sums
over the scalars (de Jong, 1991; Durbin & Koopman, 2012, 5.7 and 6.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.digits.careful_belief import (
    ROUNDING,
    Belief,
    Component,
    Move,
    Solved,
    decorrelated,
    predicted,
    rounded_belief,
    solved,
    take,
)
from pgm.beliefs.moments.digits.certificate import is_flat
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.passes.likelihoods import shortened
from pgm.beliefs.moments.steps import gate, refusals
from pgm.beliefs.moments.steps.chain import MomentChain, largest
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.iterated_update import IteratedUpdate, UpdateProblem, iterated
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.readings import Moments, Reading
from pgm.errors import LinearisationError
from pgm.kernels import extended
from pgm.kernels.arrays import LOG_2PI, Array, Mask, quiet, variances
from pgm.kernels.extended import Twofold
from pgm.kernels.roots import NEGLIGIBLE
from pgm.linearisation.family import Family
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.schedules.iteration import Anchor, Point
from pgm.schedules.schedule import ONCE, Filtering


class Step(NamedTuple):
    """A step of the pass: the transition to it, and its belief before and after measurements.

    `move` is None at the first step; `taken` has the belief and the estimate of δ given the
    measurements up to the step.
    """

    move: Move | None
    predicted: Belief
    taken: CarefulUpdate


@dataclass(frozen=True, eq=False)
class Careful:
    """A forward pass: its `steps` in twice the digits, and `forward`, their moments in float64."""

    forward: Forward
    steps: list[Step]

    @property
    def error(self) -> Array:
        """The largest rounding error of a filtered mean, at any step, (runs,).

        An error is divided by the standard deviation of its component, or, if larger, by 10⁻⁹ of
        the largest standard deviation that was predicted for the component up to that step.
        """
        largest: Array = np.max([step.taken.belief.error() for step in self.steps], axis=0)
        return largest


class Begin(NamedTuple):
    """The belief at the first step of a window, given the measurements up to that step.

    A window is a run of consecutive steps of a longer chain, with a plan of its own
    (`ChainPlan.window`), which then lacks the prior and the measurements of its first step.
    `information` (runs, 1 + q, 1 + q) is Σ [v V]ᵀ[v V] / S over all measurements that the belief
    knows: [v V] is the row of one scalar's innovation, S its variance.
    """

    belief: Belief
    information: Twofold


def sweep(
    plan: ChainPlan,
    schedule: Filtering | None = None,
    anchor: Anchor | None = None,
    begin: Begin | None = None,
    gated: gate.Asked | None = None,
) -> tuple[Careful, Status]:
    """The forward pass over all steps of a plan, and whether its linearisations settled.

    With a schedule each CPD is linearised at its incoming belief, the plan stores the
    linearisation, and the schedule's gates reject sightings; `anchor` and `gated` are then not
    used. Without a schedule the plan's linearisations are used, the gates `gated` reject sightings,
    and `anchor` holds all slices near a point, for a step control (Levenberg–Marquardt); None for
    no gates and no anchor. `begin` takes the prior's place in the plan of a window. Beliefs that
    are indefinite or not finite, and measurements that contradict a certain belief, are refused
    with a NumericalError.
    """
    out = Forward.empty(plan)
    steps: list[Step] = []
    ahead: list[Diffuse] = []
    record: list[Array] = []
    converged = np.ones(plan.runs, dtype=bool)
    if begin is None:
        belief = start(plan, linearise=schedule is not None)
        information = Twofold.zeros((plan.runs, *(belief.columns.shape[-1:] * 2)))
    else:
        belief, information = begin
        belief = belief._replace(largest=variances(belief.cov.hi))  # as far back as the window goes
    unknown = solved(information)
    move: Move | None = None
    settled = schedule is None or all(link.family.exact for link in plan.transition)
    every = transition(plan, slice(None)) if settled else None
    for step in counted(range(plan.steps + 1), "forward, in twice the digits"):
        if step:
            if every is None:
                move = moving(plan, step, out.mean[step - 1], out.cov[step - 1])
            else:
                move = every.at(step - 1 if len(every.matrix.hi) > 1 else 0)
            belief = predicted(belief, move)
        before = belief
        mean, spread = rounded_belief(belief, unknown)
        out.predicted_mean[step], out.predicted_cov[step] = mean, spread.shown
        if spread.open.shape[-1]:
            ahead.append(spread)
        reading = CarefulReading.of(
            plan, step, mean, spread, belief, information, schedule, gated=gated
        )
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
        steps.append(Step(move, before, found))
        refusals.belief(plan, plan.first + step, before[:2], belief[:2])
    if any(spread.open.any() for spread in ahead):
        out = replace(out, diffuse=Diffuse(*map(np.stack, zip(*ahead, strict=True))))
    return Careful(out, steps), Status.of(record, converged, plan.lead)


def predict(plan: ChainPlan, step: int, known: Belief) -> Belief:
    """The belief of an online filter predicted to `step`, by the only transition of the plan.

    `known` is the belief after the measurements of the step before, without δ (q = 0); `step` is
    the number in the chain, for the texts of errors. A belief that is indefinite or not finite is
    refused with a NumericalError.
    """
    found = predicted(known, moving(plan, 1, *known.moments))
    refusals.belief(plan, step, found[:2])
    return found


def update(
    plan: ChainPlan, step: int, known: Belief, schedule: Filtering
) -> tuple[Belief, IteratedUpdate[CarefulUpdate], Sequence[Reading]]:
    """The belief of an online filter given the measurements of its step, the only ones of the plan.

    `step` is the step's number in the chain, and `known` the belief predicted to that step, without
    δ (q = 0). Returns the belief, the iterated update that led to it, and the readings as
    linearised last. A NumericalError refuses beliefs that are indefinite or not finite, and
    measurements that contradict a certain belief.
    """
    nothing = Twofold.zeros((plan.runs, 1, 1))
    mean, spread = rounded_belief(known, solved(nothing))
    reading = CarefulReading.of(plan, 0, mean, spread, known, nothing, schedule)
    taken = iterated(reading, schedule)
    found = taken.solution.at(taken.mean).belief
    refusals.belief(plan, step, found[:2])
    return found, taken, reading.parts


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
            belief, component, predictive, indefinite = take(
                belief, rows[:, k, :-1], rows[:, k, -1], noises[:, k], seen[:, k]
            )
            if indefinite:
                refusals.indefinite(parts, self.step)
            components.append(component)
            innovation, weight = component.innovation[:, 0], component.weight
            read = weight.hi > 0.0
            left[:, k] = np.where(seen[:, k] & ~read, np.abs(innovation.hi), 0.0)
            level = (innovation * innovation * weight).hi + np.log(np.where(read, predictive, 1.0))
            log_density -= np.where(read, 0.5 * (level + LOG_2PI), 0.0)
        if not np.isfinite(log_density).all():
            refusals.indefinite(parts, self.step)
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
            row = component.innovation[:, None, :]
            information = information + row.mT @ (row * component.weight[:, None, None])
        unknown = solved(information)
        log_density = log_density + unknown.log_weight - solved(self.information).log_weight
        found = rounded_belief(belief, unknown)
        return CarefulUpdate(*found, log_density, belief, components, information, unknown)


def prior_mean(plan: ChainPlan) -> Array:
    """The prior means of the states' m components, (runs, m).

    A component of infinite variance has the mean that the prior declares. Nonlinear CPDs of the
    prior are linearised in the plan; beside a flat prior a LinearisationError refuses them.
    """
    states = plan.layout.state_places
    if not is_flat(plan):
        return MomentChain(plan, ONCE).start().by_run[0][:, states]
    return start(plan, linearise=True).columns.hi[:, states, 0]


def start(plan: ChainPlan, *, linearise: bool) -> Belief:
    """The belief over the slice at step 0 before its measurements; controls there are zero.

    With `linearise` the nonlinear CPDs of the prior are linearised in the plan; beside a flat prior
    they are refused with a LinearisationError. Without it the plan's linearisations are used.
    """
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
    first = _conditional(plan.prior, slice(None), 0, plan.layout.state_size).at(0)
    size, states = plan.layout.slice_size, plan.layout.state_places
    where = np.arange(size)[states]
    columns = Twofold.zeros((plan.runs, size, 1 + first.columns.shape[-1]))
    cov = Twofold.zeros((plan.runs, size, size))
    columns[:, states, 0] = first.offset
    columns[:, states, 1:] = first.columns
    cov[:, where[:, None], where] = first.cov
    return Belief.first(columns, cov, ROUNDING, ROUNDING)


def transition(plan: ChainPlan, rows: slice) -> Move:
    """The transition of a plan, linearised: affine conditionals of slices given the slices before.

    `rows` picks steps, row t − 1 being of step t. The result's arrays are (rows or 1, runs or 1,
    ...); its columns of the earlier slice's controls, which do not act on the next, are zero.
    """
    layout = plan.layout
    found = _conditional(plan.transition, rows, layout.state_size, layout.slice_size)
    matrix = Twofold.zeros((*found.matrix.shape[:-1], layout.slice_size))
    matrix[..., layout.state_places] = found.matrix
    return found._replace(matrix=matrix)


def _conditional(links: list[Link], rows: slice, front: int, size: int) -> Move:
    """All CPDs of the links as one affine conditional, of a vector's end given its beginning.

    A link is a CPD at all its steps, with the places of its parents and its child in a vector of
    `front` + `size` components. Each child stands after its parents; the first `front` components
    are given, the rest are the children's. `rows` picks steps; the result's arrays are (rows or 1,
    runs or 1, ...). Each component of infinite noise variance becomes one of δ, with noise of unit
    variance.
    """
    families = [link.family for link in links]
    parts = [[shortened(part[rows]) for part in (f.matrix, f.offset, f.noise)] for f in families]
    flat = [np.asarray(np.isinf(variances(each[2])).any(axis=(0, 1))) for each in parts]
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


def _regular(noise: Array, flat: Mask) -> Twofold:
    """A noise covariance (..., d, d) in twice the digits, made exactly singular where it should be.

    That is where it is singular but for its rounding in float64: pivots of its elimination that are
    no more than this rounding become zero. The components that the mask `flat` (d,) marks, of
    infinite variance, get unit variance and no correlation.
    """
    if flat.any():
        noise = np.where(flat[:, None] | flat, np.eye(flat.size) * flat, noise)
    unit, pivots = extended.eliminated(noise, NEGLIGIBLE)
    if not (pivots.hi == 0.0).any():
        return Twofold(noise)
    return unit * pivots[..., None, :] @ unit.mT


def moving(plan: ChainPlan, step: int, mean: Array, cov: Array) -> Move:
    """The transition to a step, linearised at the belief over the slice before.

    The plan keeps the linearisation. `step` counts from the plan's first, which is 0. The belief
    has the moments `mean` (runs, n) and `cov` (runs, n, n). If entries of `cov` are infinite, a
    LinearisationError refuses nonlinear CPDs, except with `Taylor`, whose formula does not use the
    covariance.
    """
    if not all(link.family.exact for link in plan.transition):
        for link in plan.transition:
            proper(link.family, plan.first + step, cov)
        cov = np.where(np.isfinite(cov), cov, 0.0)
        MomentChain(plan, ONCE, check=True).predict(step, Moments.of(plan, mean, cov))
    return transition(plan, slice(step - 1, step)).at(0)


def proper(family: Family, step: int, cov: Array) -> Array:
    """The covariance at which a CPD is linearised, from `cov`, which may have infinite entries.

    `cov` is over the slice or the CPD's parents. It is returned as it is for a linear CPD, and if
    all entries are finite. For `Taylor`, whose formula does not use the covariance, infinite
    entries become zero. Any other lineariser is refused with a LinearisationError, whose text names
    the `step`.
    """
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
