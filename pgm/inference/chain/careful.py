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

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.errors import LinearisationError
from pgm.inference.chain import forward
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.chain.update import (
    Due,
    linearise_sensor,
    refuse_contradiction,
    refuse_indefinite,
    sensors_due,
)
from pgm.inference.chain.whitened import distinct
from pgm.inference.family import Family
from pgm.inference.schedule import Filtering
from pgm.inference.status import Status
from pgm.kernels import twofold
from pgm.kernels.arrays import LOG_2PI, Array, Mask, block, sandwich
from pgm.kernels.roots import NEGLIGIBLE
from pgm.kernels.twofold import Twofold

# The part of what is summed up to a variance that rounding may change.
ROUNDING = 1e-31
# By so much a variance has to exceed what rounding may have made of a zero.
_CLEAR = 100.0


class Component(NamedTuple):
    """A component of a reading, taken in.

    Attributes
    ----------
    row, gain : Twofold
        (runs, n): h and G; the gain is zero where nothing was learnt.
    innovation : Twofold
        (runs, 1 + q): v and V.
    weight : Twofold
        (runs,): 1 / S, zero where nothing was learnt.
    """

    row: Twofold
    gain: Twofold
    innovation: Twofold
    weight: Twofold


class Belief(NamedTuple):
    """Moments as functions of δ.

    Attributes
    ----------
    columns : Twofold
        (runs, n, 1 + q): [m D].
    cov : Twofold
        (runs, n, n): P.
    rounding : ndarray
        (runs, n, n): a bound, as a covariance, of what rounding has changed P by so far. It goes
        through transitions and readings as an error does.
    """

    columns: Twofold
    cov: Twofold
    rounding: Array

    def certain(self) -> Belief:
        """With zeros where a variance may be rounding alone."""
        floor = _CLEAR * _variances(self.rounding)
        open_ = _variances(self.cov.hi) > floor
        if open_.all():
            return self
        both = open_[..., None] & open_[..., None, :]
        return self._replace(
            cov=twofold.where(both, self.cov, 0.0), rounding=np.where(both, self.rounding, 0.0)
        )


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


class Solved(NamedTuple):
    """An estimate of δ.

    Attributes
    ----------
    weights : Twofold
        (runs, 1 + q, 1): [1 δ] for its mean δ; zero where nothing is known of a component.
    cov : Twofold
        (runs, q, q): of what is known of it.
    open : ndarray
        (runs, q, q): directions in which nothing is known, as columns, or zeros.
    log_weight : ndarray
        (runs,): what integrating δ out adds to the log-density of the readings.
    """

    weights: Twofold
    cov: Twofold
    open: Array
    log_weight: Array

    def between(self, first: Belief, second: Belief) -> Twofold:
        """The share of δ in the covariance of two slices, (runs, n, n)."""
        return first.columns[..., 1:] @ self.cov @ second.columns[..., 1:].mT


def solved(whole: Twofold) -> Solved:
    """The estimate of δ from W = Σ [v V]ᵀ[v V] / S, (runs, 1 + q, 1 + q).

    With M = Σ VᵀV / S and y = Σ Vᵀv / S it is δ = −M⁻¹y; its covariance M⁻¹.
    """
    runs, size = whole.shape[0], whole.shape[-1] - 1
    weights = Twofold(np.zeros((runs, size + 1, 1)))
    weights.hi[:, 0] = 1.0
    if not size:
        nothing = np.zeros((runs, 0, 0))
        return Solved(weights, Twofold(nothing), nothing, np.zeros(runs))
    unit, pivots = twofold.eliminated(whole[:, 1:, 1:], _CLEAR * ROUNDING)
    known = pivots.hi > 0.0
    cov = twofold.inverse(unit, pivots)
    one = Twofold(np.broadcast_to(np.eye(size), unit.shape).copy())
    mean = -(cov @ whole[:, 1:, :1])
    weights[:, 1:] = mean
    level = -(whole[:, :1, 1:] @ mean).hi[:, 0, 0]
    log_det = np.log(np.where(known, pivots.hi, 1.0)).sum(axis=-1)
    open_ = np.where(known[:, None, :], 0.0, twofold.solve_unit(unit, one).mT.hi)
    return Solved(weights, cov, open_, 0.5 * (level - log_det))


def moments(belief: Belief, unknown: Solved) -> tuple[Array, Array]:
    """Mean and covariance; the variance of a component of which nothing is known is infinite."""
    columns, cov, _ = belief
    mean = (columns @ unknown.weights).hi[..., 0]
    if not unknown.open.shape[-1]:
        return mean, cov.hi
    total = (cov + unknown.between(belief, belief)).hi
    slope = columns.hi[..., 1:]
    reach, size = np.abs(slope @ unknown.open), np.abs(slope) @ np.abs(unknown.open)
    lost = np.any(reach > NEGLIGIBLE * size, axis=-1)
    if lost.any():
        total = np.where(lost[..., None] | lost[..., None, :], 0.0, total)
        diagonal = np.einsum("...ii->...i", total)
        diagonal[lost] = np.inf
    return mean, total


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

    def to(self, step: int) -> Solved:
        """δ given the readings up to a step."""
        return solved(self.steps[step].information)


def sweep(plan: ChainPlan, *, linearise: bool) -> Careful:
    """The forward pass, with every CPD as it is laid out or linearised at its incoming belief."""
    out = Forward.empty(plan)
    steps: list[Step] = []
    belief = _start(plan, linearise=linearise)
    information = Twofold.zeros((plan.runs, *(belief.columns.shape[-1:] * 2)))
    unknown = solved(information)
    matrix: Twofold | None = None
    noise: Twofold | None = None
    every = None if linearise else _transition(plan, slice(None))
    for step in range(plan.steps + 1):
        if step:
            if linearise:
                _linearise_motion(plan, step, out.mean[step - 1], out.cov[step - 1])
            moves = every or _transition(plan, slice(step - 1, step))
            move = moves.at(step - 1 if len(moves.matrix.hi) > 1 else 0)
            matrix, noise, belief = move.matrix, move.cov, _predict(belief, move)
        predicted = belief
        mean, cov = moments(belief, unknown)
        out.predicted_mean[step], out.predicted_cov[step] = mean, cov
        due = sensors_due(plan.sensors, step)
        for sensor, _ in due if linearise else ():
            linearise_sensor(sensor, step, mean, _proper(sensor.family, step, cov))
        components: list[Component] = []
        density = -unknown.log_weight
        if due:
            belief, components, own = _update(due, belief, mean)
            density = density + own
        for component in components:
            row = component.innovation[:, None, :]
            information = information + row.mT @ (row * component.weight[:, None, None])
        unknown = solved(information)
        out.log_density[step] = density + unknown.log_weight
        out.mean[step], out.cov[step] = moments(belief, unknown)
        steps.append(Step(matrix, noise, predicted, belief, components, information))
    return Careful(out, steps, unknown)


def run(plan: ChainPlan, schedule: Filtering) -> tuple[Careful, Status]:
    """Run a filtering schedule."""
    swept = sweep(plan, linearise=True)
    return swept, forward.once_status(plan)


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


def _start(plan: ChainPlan, *, linearise: bool) -> Belief:
    """The slice at step 0 before its readings; there are no controls."""
    if linearise and not all(link.family.exact for link in plan.prior):
        forward.start(plan, linearise=True)
    first = _conditional(plan.prior, slice(None), 0, plan.layout.state_size, plan.runs).at(0)
    size, states = plan.layout.slice_size, plan.layout.state_places
    columns = Twofold.zeros((plan.runs, size, 1 + first.columns.shape[-1]))
    columns[:, states, 0] = first.offset
    columns[:, states, 1:] = first.columns
    cov = Twofold.zeros((plan.runs, size, size))
    forward.put(cov.hi, states, np.broadcast_to(first.cov.hi, (plan.runs, *first.cov.shape[1:])))
    forward.put(cov.lo, states, np.broadcast_to(first.cov.lo, (plan.runs, *first.cov.shape[1:])))
    eye = np.eye(size)
    return Belief(columns, cov, _rounded(eye, cov.hi, np.zeros_like(cov.hi)))


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


def _predict(belief: Belief, move: Move) -> Belief:
    columns = move.matrix @ belief.columns
    columns[..., 0] = columns[..., 0] + move.offset
    cov = move.matrix @ belief.cov @ move.matrix.mT + move.cov
    rounding = sandwich(move.matrix.hi, belief.rounding)
    rounding = rounding + _rounded(move.matrix.hi, belief.cov.hi, move.cov.hi)
    return Belief(columns, cov, rounding).certain()


def _rounded(matrix: Array, cov: Array, noise: Array) -> Array:
    """What rounding may change F P Fᵀ + noise by."""
    size = np.abs(matrix)
    summed = ((size @ np.abs(cov)) * size).sum(axis=-1) + np.abs(_variances(noise))
    rounded: Array = ROUNDING * summed[..., None] * np.eye(matrix.shape[-2])
    return rounded


def _variances(cov: Array) -> Array:
    found: Array = np.einsum("...ii->...i", cov)
    return found


def _update(due: Due, belief: Belief, mean: Array) -> tuple[Belief, list[Component], Array]:
    """Take in the readings of a step; also their log-density given δ = 0."""
    columns, cov, rounding = belief
    rows, noises, taken = _decorrelated(due, mean)
    components: list[Component] = []
    log_density = np.zeros(len(mean))
    left = np.zeros(taken.shape)
    for k in range(taken.shape[-1]):
        row, noise = rows[:, k, :-1], noises[:, k]
        cross = (cov @ row[..., None])[..., 0]
        predictive = row.dot(cross) + noise
        floor = sandwich(row.hi[:, None, :], rounding)
        floor = (floor + _rounded(row.hi[:, None, :], cov.hi, noise.hi[:, None, None]))[:, 0, 0]
        if not np.isfinite(floor).all() or (predictive.hi < -_CLEAR * floor).any():
            refuse_indefinite(due)
        read = taken[:, k] & (predictive.hi > _CLEAR * floor)
        weight = twofold.where(read, 1.0 / twofold.where(read, predictive, 1.0), 0.0)
        innovation = -(row[:, None, :] @ columns)[:, 0]
        innovation[:, 0] = innovation[:, 0] + rows[:, k, -1]
        gain = cross * weight[:, None]
        columns = columns + gain[..., None] * innovation[:, None, :]
        keep = np.eye(cov.shape[-1]) - gain[..., None] * row[:, None, :]
        own = (gain * noise[:, None])[..., None] * gain[:, None, :]
        rounding = sandwich(keep.hi, rounding) + _rounded(keep.hi, cov.hi, own.hi)
        _, cov, rounding = Belief(columns, keep @ cov @ keep.mT + own, rounding).certain()
        left[:, k] = np.where(taken[:, k] & ~read, np.abs(innovation.hi[:, 0]), 0.0)
        squared = (innovation[:, 0] * innovation[:, 0] * weight).hi
        log_density -= 0.5 * np.where(
            read, squared + np.log(np.where(read, predictive.hi, 1.0)) + LOG_2PI, 0.0
        )
        components.append(Component(row, gain, innovation, weight))
    if left.any():
        refuse_contradiction(due, mean, left)
    return Belief(columns, cov, rounding), components, log_density


def _decorrelated(due: Due, mean: Array) -> tuple[Twofold, Twofold, Mask]:
    """The components of the readings of a step, each with an error of its own.

    Returns
    -------
    rows : Twofold
        (runs, D, n + 1): h, and the reading less the CPD's offset.
    noises : Twofold
        (runs, D): variances.
    taken : ndarray of bool
        (runs, D).
    """
    runs, width = mean.shape
    parts = [(sensor, own, sensor.reading(own)) for sensor, own in due]
    height = sum(seen.value.shape[0] * seen.value.shape[2] for _, _, seen in parts)
    rows = Twofold.zeros((runs, height, width + 1))
    noise = np.zeros((runs, height, height))
    taken = np.ones((runs, height), dtype=bool)
    top = 0
    for sensor, own, seen in parts:
        count, _, size = seen.value.shape
        between = sensor.between(int(sensor.family.step[own.start]))
        if between is not None:
            every = slice(top, top + count * size)
            noise[:, every, every] = between
        for k in range(count):
            place = slice(top, top + size)
            top += size
            rows.hi[:, place, :-1][..., sensor.parents] = seen.matrix[k]
            rows[:, place, -1] = Twofold(seen.value[k]) - seen.offset[k]
            noise[:, place, place] = seen.noise[k]
            if seen.taken is not None:
                taken[:, place] = seen.taken[k]
    unit, noises = twofold.eliminated(noise, NEGLIGIBLE)
    return twofold.solve_unit(unit, rows), noises, taken


def _linearise_motion(plan: ChainPlan, step: int, mean: Array, cov: Array) -> None:
    if all(link.family.exact for link in plan.transition):
        return
    states = plan.layout.state_places
    for link in plan.transition:
        cov = _proper(link.family, step, cov)
    forward.predict(plan, step - 1, mean[:, states], block(cov, states, states), linearise=True)


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
