"""The forward pass over a chain as a scan: 2 log₂ T rounds, every round one batched call.

A *slice* is the vector of all hidden variables of a step, of n components. Each step is an
*element*: the Gaussian of its slice given the slice before, with the likelihood of the measurements
at the slice before (`kernels.elements`). Elements of neighbours compose to the element of a longer
segment; the belief at step 0, pushed through the segment up to step t, is the prediction at t.
Slices are counted from a *reference*, a trajectory (T+1, runs, n) near the beliefs, for T steps, so
that large coordinates cost no digits. An *anchor* is an artificial measurement of all components at
each step, by which a step control holds the solution near a point. *Stacks* are the measurements of
singular or correlated noise (`vector`). The *branch* of a measured angle is its value among those
that differ by whole turns. Where composing segments would lose digits the pass is made step by
step, by `forward`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.digits import certificate
from pgm.beliefs.moments.passes import forward, newton
from pgm.beliefs.moments.passes.backward import Ahead, about, between_slices
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.passes.likelihoods import Readings, know
from pgm.beliefs.moments.passes.messages import absorb_readings
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.vector import Stack
from pgm.errors import NumericalError
from pgm.kernels import elements, moments
from pgm.kernels.arrays import Array, apply, deviation, room
from pgm.kernels.elements import Belief, Element, Likelihood
from pgm.kernels.moments import Conditional
from pgm.kernels.prefixes import gather, in_chunks, levels, prefixes, take
from pgm.kernels.segment_maps import Map, Moments, Value, after, push_moments, send
from pgm.schedules.iteration import Anchor
from pgm.schedules.schedule import ONCE

# Beliefs so many standard deviations from the reference leave too few digits: they are solved for
# again.
_FAR = 1e4
_TRIES = 5
# Beliefs that follow from one another do so within this part of a standard deviation.
_CLOSE = 1e-7
# Predictions as large as this are of no use.
_BEYOND = 1e30


@dataclass(frozen=True, eq=False)
class Scanned:
    """The forward pass of a scan: a `Forward` whose log-densities are computed when asked for.

    `log_density` returns ln p of each step's measurements given earlier ones, (T+1, runs); it has
    to be called before the plan is linearised again. The moments before (`predicted_mean`,
    `predicted_cov`) and after measurements (`mean`, `cov`) are (T+1, runs, ...), not counted from
    the reference.

    `agrees` says that composing segments has lost no digits, and will lose none in a backward pass.
    It is true if three tests are passed:

    - Each belief is found again, to 10⁻⁷ standard deviations, when it is predicted from the one
      before it.
    - The measurements of a step leave more than 2.5·10⁻⁷ of each component's variance, or exactly
      zero.
    - Each component, given the components before it in the slice, keeps more than 2.5·10⁻⁷ of its
      variance.
    """

    predicted_mean: Array
    predicted_cov: Array
    mean: Array
    cov: Array
    log_density: Callable[[], Array]
    agrees: bool


def whole(ahead: Ahead) -> Forward:
    """The forward pass as a `Forward`: a `Scanned` one gets the log-densities that it put off.

    A `Forward` is returned as it is.
    """
    if isinstance(ahead, Scanned):
        predicted = ahead.predicted_mean, ahead.predicted_cov
        closest = 1.0 / certificate.GENTLE if ahead.agrees else 0.0
        return Forward(*predicted, ahead.mean, ahead.cov, ahead.log_density(), closest)
    assert isinstance(ahead, Forward)
    return ahead


def filtered(
    plan: ChainPlan,
    reference: Array,
    anchor: Anchor | None = None,
    readings: Readings | None = None,
) -> Ahead:
    """The forward pass with the linearisations that the plan stores, by a parallel scan.

    Elements are counted from the `reference` (T+1, runs, n), a trajectory near the beliefs.
    `readings` are the measurements about it; None has them made here. Where composing segments
    would lose digits, the result is that of a pass made step by step. NumericalError where
    a step has no element: a covariance is indefinite or not finite, or an exact measurement is of
    what is certain already.
    """
    readings = Readings.of(plan, reference) if readings is None else readings
    found = _solve(plan, between_slices(plan), _first(plan, anchor), readings, anchor)
    return found if found.agrees else forward.stored(plan, anchor)


def run(plan: ChainPlan) -> Ahead:
    """The forward pass of an affine model, by scans about a reference.

    The first reference is a guess of the means. If it is more than 10⁴ standard deviations from the
    beliefs found, or puts a measured angle on another branch than the prediction does, the scan is
    repeated about the means found. After five scans, or where composing segments would lose digits,
    the pass is made step by step instead, by `forward.run`.
    """
    moves = between_slices(plan)
    reference = _guess(plan, moves)
    first = _first(plan, None)
    for _ in range(_TRIES):
        found = _solve(plan, moves, first, Readings.of(plan, reference), None)
        std = deviation(found.cov)
        far = (np.abs(found.mean - reference) > _FAR * std) & (std > 0.0)
        if not _move(plan, found.predicted_mean) and not far.any():
            if found.agrees:
                return found
            break
        reference = found.mean
    return forward.run(plan, ONCE)[0]


def _guess(plan: ChainPlan, moves: Conditional) -> Array:
    """Means (T+1, runs, n) near the beliefs of an affine model, to serve as the reference.

    They are the smoothed means, by normal equations. Where angles are measured, or noise is
    singular or correlated, so that there are no normal equations, they are the prior's means
    propagated by the transitions `moves` (T, runs, ...), and the measured angles are moved to the
    branch nearest to their values there.
    """
    start = MomentChain(plan, None).start().by_run[0]
    if not any(sensor.variable.angle_mask.any() for sensor in plan.sensors):
        found = newton.step(plan, np.broadcast_to(start, (plan.steps + 1, *start.shape)))
        if found is not None:
            return found.means
    reference = _predicted(moves, start)
    _move(plan, reference)
    return reference


def _move(plan: ChainPlan, mean: Array) -> bool:
    """Move the plan's measured angles, in place, to the branch nearest their expected values.

    The expected values are those at the slices' means `mean` (T+1, runs, n). Returns whether any
    angle has changed its branch.
    """
    changed = False
    for sensor in plan.sensors:
        if sensor.variable.angle_mask.any() and sensor.family.step.size:
            before = sensor.moved.copy()
            at = gather(mean, sensor.family.step)[..., sensor.parents]
            sensor.move(slice(None), sensor.family.value(slice(None), at))
            changed |= not np.array_equal(before, sensor.moved, equal_nan=True)
    return changed


class _First(NamedTuple):
    """The solution of step 0: its beliefs before and after measurements, and ln p of these.

    `predicted` and `known` have moments (runs, n) and (runs, n, n); `log_density` is () for one
    run, (runs,) for several.
    """

    predicted: Belief
    known: Belief
    log_density: Array


def _first(plan: ChainPlan, anchor: Anchor | None) -> _First:
    """The beliefs at step 0 before and after its measurements, and the log-density of these.

    An anchor's measurement is taken in with those of the step, but is not in the log-density.
    """
    chain = MomentChain(plan, None, anchor=anchor)
    predicted = chain.start()
    known, log_density = chain.take(0, predicted)
    return _First(Belief(*predicted.by_run), Belief(*known.by_run), np.asarray(log_density))


def _solve(
    plan: ChainPlan, moves: Conditional, first: _First, readings: Readings, anchor: Anchor | None
) -> Scanned:
    """The forward pass by a scan, about the reference of `readings`.

    `moves` are the transitions between slices (T, runs, ...), `first` is the solution of step 0.
    The beliefs before measurements are the prefixes of the elements of all steps; conditioned on
    the measurements they give the beliefs after. The result's `agrees` tells whether the beliefs
    can be trusted. To be so, each has to be found again when it is predicted from the one before,
    which rounding in sharp elements would prevent, and no variance may be left too small by
    measurements or correlations.
    """
    reference = readings.reference
    near = about(moves, reference)
    known = _from(first.known, reference[0], plan.steps)
    predicted = _from(first.predicted, reference[0], plan.steps)
    evidence = np.zeros((plan.steps + 1, plan.runs))
    agrees = True
    if plan.steps:
        likelihood = readings.held(anchor)
        leaves = steps_as_elements(near, likelihood, readings.stacks)
        start = Belief(known.mean[:1], known.cov[:1])
        before = prefixes(start, levels(leaves, elements.compose), elements.push)
        known.mean[1:], known.cov[1:], evidence[1:] = in_chunks(
            know, before, take(likelihood, slice(1, None))
        )
        if not np.isfinite(known.mean.sum() + known.cov.sum()):
            _refuse(known)
        pushed = in_chunks(push_moments, take(known, slice(None, -1)), near)
        if readings.stacks:
            # They are in the beliefs already.
            predicted.mean[1:], predicted.cov[1:] = pushed
            agrees = _agree(_read(predicted, readings), known)
        else:
            predicted.mean[1:], predicted.cov[1:] = before[:2]
            agrees = _agree(pushed, take(predicted, slice(1, None)))
        agrees = agrees and certificate.composes(predicted.cov, known.cov)

    def log_density() -> Array:
        """Terms ln p(z_t | earlier measurements) of the log-evidence, (T+1, runs)."""
        total = evidence + readings.log_density(known.mean, predicted)
        total[0] = first.log_density
        return total

    return Scanned(
        predicted.mean + reference,
        predicted.cov,
        known.mean + reference,
        known.cov,
        log_density,
        agrees,
    )


def _read(predicted: Moments, readings: Readings) -> Moments:
    """The moments after the measurements of each step, from `predicted`, those before them.

    Both are (T+1, runs, ...), about the reference of `readings`, which are the measurements.
    """
    mean, cov, _ = in_chunks(
        know, Belief(*predicted, np.zeros(predicted.mean.shape[:2])), readings.likelihood
    )
    for steps, matrix, residual, noise, _ in readings.stacks:
        left = residual - apply(matrix, mean[steps])
        found = moments.update(mean[steps], cov[steps], matrix, left, noise)
        mean[steps], cov[steps] = found.mean, found.cov
    return Moments(mean, cov)


def _agree(found: Moments, due: Moments) -> bool:
    """Whether moments `found` are within 10⁻⁷ standard deviations of the moments `due`, everywhere.

    Means and standard deviations are compared, for all steps and runs. Where the variance in `due`
    is zero, the unit of a mean is its own size, and that of a standard deviation the largest in
    `due` for this component at any step.
    """
    std = deviation(due.cov)
    off = np.abs(found.mean - due.mean)
    far = off > _CLOSE * np.where(std > 0.0, std, np.abs(due.mean) + off.max(initial=0.0))
    unit = np.where(std > 0.0, std, std.max(axis=0))
    spread = np.abs(deviation(found.cov) - std) > _CLOSE * unit
    return not (far.any() or spread.any())


def _from(belief: Belief, reference: Array, steps: int) -> Moments:
    """Moments (steps + 1, runs, ...) about a reference: a belief in row 0, then uninitialised rows.

    `reference` (runs, n) is that of step 0, and `belief` (runs, ...) is not counted from it.
    """
    runs, size = belief.mean.shape
    out = Moments(room((steps + 1, runs), (size,)), room((steps + 1, runs), (size, size)))
    out.mean[0], out.cov[0] = belief.mean - reference, belief.cov
    return out


def _predicted(moves: Conditional, start: Array) -> Array:
    """The prior's means propagated by the transition, without measurements, (T+1, runs, n).

    `start` (runs, n) are those at step 0; they stand in where a mean would be 10³⁰ or larger.
    """
    out = room((moves.offset.shape[0] + 1, start.shape[0]), start.shape[1:])
    out[0] = start
    if len(out) > 1:
        # An unstable transition leads beyond all numbers where measurements hold the beliefs.
        with np.errstate(over="ignore", invalid="ignore"):
            tree = levels(Map(moves.matrix, moves.offset), after)
            out[1:] = prefixes(Value(start[None]), tree, send).value
    return np.where(np.abs(out) < _BEYOND, out, start)


def _refuse(known: Moments) -> None:
    """Raise NumericalError with the first step whose moments are not finite, if there is one.

    There may be none: the caller looks at a sum, which may overflow although no term does.
    """
    bad = ~np.isfinite(known.cov).all(axis=(1, 2, 3)) | ~np.isfinite(known.mean).all(axis=(1, 2))
    if not bad.any():
        return
    step = int(np.flatnonzero(bad)[0])
    raise NumericalError(
        f"the covariance of a transition or belief about step {step} is indefinite or not finite, "
        "so that the steps up to it have no element; use a rule with positive weights or more "
        "samples, or compile without pgm.Balanced(), for a chain of slices",
        step=step,
    )


def steps_as_elements(moves: Conditional, likelihood: Likelihood, stacks: list[Stack]) -> Element:
    """The element of each step 1..T about a reference, (T, runs, ...).

    The element of step t has the `likelihood` (T+1, runs, ...) of step t − 1 and the transition to
    t, but not the likelihood of t. The `stacks`, measurements of singular or correlated noise, are
    in the element of their own step. The measurements of step 0 are left out: they are in the
    belief from which all begins. `moves` are the transitions (T, runs, ...) between slices, counted
    from the reference.
    """
    precision = room(moves.matrix.shape[:2], moves.matrix.shape[2:])
    h = room(moves.offset.shape[:2], moves.offset.shape[2:])
    precision[:1], h[:1] = 0.0, 0.0
    precision[1:], h[1:] = likelihood.K[1:-1], likelihood.h[1:-1]
    if not stacks:
        return Element(*moves, precision, h)
    matrix, offset, cov = (np.array(part) for part in moves)
    whole = Element(matrix, offset, cov, precision, h)
    for stack in stacks:
        _absorb_exact(whole, stack)
    return whole


def _absorb_exact(moves: Element, stack: Stack) -> None:
    """Condition the transitions to a stack's steps on its measurements, in place.

    `moves` are the elements of steps 1..T; measurements at step 0 are left out. NumericalError
    where an exact measurement is of what the transition makes certain: then the covariance of the
    measurements given the states before is singular.
    """
    later = np.flatnonzero(stack.steps)
    if not later.size:
        return
    rows = stack.steps[later] - 1
    matrix, noise = stack.matrix[later], stack.noise[later]
    left = stack.residual[later] - apply(matrix, moves.b[rows])
    moves.F[rows], shift, moves.cov[rows], (precision, h, g) = absorb_readings(
        moves.F[rows], moves.cov[rows], matrix, left, noise, stack.missing[later]
    )
    bad = np.isnan(g).any(axis=-1)
    if bad.any():
        step = int(rows[np.flatnonzero(bad)[0]]) + 1
        raise NumericalError(
            f"the measurements at step {step} are exact, and so is what the transition leads to: "
            "their covariance given the states before is singular, and the step has no element; "
            "compile without pgm.Balanced(), for a chain of slices",
            step=step,
        )
    moves.b[rows] += shift
    moves.K[rows] += precision
    moves.h[rows] += h
