"""Modes of a chain's posterior besides the one that the Gaussian answer fits.

They are found by short smoothers that start from C other trajectories for each run. All of these
are one call, on a plan (a chain with its evidence) that has every run C times: its run
c · runs + r is the copy c of run r, and it has N = C · runs runs in all.

T is the last step, n the number of components of a slice. A `Conditional` is an affine Gaussian: a
matrix, an offset and a covariance. The audit makes *defensive* draws from a density with wider
tails than the answer's. The *share* of a mode is the probability that such a draw is from the
mode's Gaussian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.smoothers import parallel, smoother
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.errors import ModelError, PgmError
from pgm.factors.scope import angle_mask
from pgm.inference.audit.drives import starts
from pgm.inference.audit.modes import MOST, FixedPoints, Modes, choose
from pgm.inference.audit.repeated import repeated
from pgm.kernels.arrays import Array, deviation, quiet
from pgm.kernels.moments import Conditional
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.schedule import Smoothing

# A short smoother: linearisations, standard deviations within which it has arrived, tries of a step
# that raises the cost, and, where no cost can control it, the share of the old point that is kept.
ITERATIONS, TOLERANCE, TRIES, HELD = 12, 0.02, 1, 0.5
# Numbers of all smoothers that are held at once, and about as many starts a run.
ROOM, STARTS = 2**26, 24
# The part of the smoothers below which those that fail together are given up.
SMALLEST = 1.0 / 64.0

# Makes the law of trajectories of their smoothed moments and the conditionals of states given the
# slice after them.
MakePath = Callable[[Beliefs, Conditional], Path]


class Arrived(NamedTuple):
    """The results of N smoothers.

    mean, cov: The smoothed moments of all slices, (T+1, N, n) and (T+1, N, n, n).
    states: The conditionals of the states given the slice after them, (T, N, ...).
    log_evidence: The log-evidence of the last linearisation, (N,); −∞ for a smoother that has
        failed.
    """

    mean: Array
    cov: Array
    states: Conditional
    log_evidence: Array


def find(
    plan: ChainPlan, answer: Beliefs, own: Conditional, make: MakePath, most: int = MOST
) -> Modes:
    """The modes other than the answer's at which smoothers from other starts arrive.

    Parameters
    ----------
    plan : ChainPlan
        The chain with its evidence.
    answer : Beliefs
        The answer's smoothed moments of all runs.
    own : Conditional
        (T, runs, ...): the answer's conditionals of the states given the slice after them.
    make : callable
        Makes the law of trajectories, a `Path`, from smoothed moments and conditionals of all runs,
        in the forms of `answer` and `own`.
    most : int
        The largest number of modes that are to be drawn from.
    """
    if plan.exact:
        return Modes.none(plan.runs)
    size = plan.layout.slice_size
    part = max(1, ROOM // ((plan.steps + 1) * STARTS * 8 * size * (size + 1)))
    found = []
    for first in range(0, plan.runs, part):
        runs = slice(first, min(first + part, plan.runs))
        some = plan if part >= plan.runs else plan.of(runs)
        moments = Beliefs(answer.mean[:, runs], answer.cov[:, runs])
        states = Conditional(*(each[:, runs] for each in own))
        found.append(_of_runs(some, moments, states, most))
    return _joined(found, make)


class Found(NamedTuple):
    """K other modes of some runs.

    beliefs: For each mode the smoothed moments, (T+1, runs, ...).
    states: For each mode the conditionals of the states given the slice after them, (T, runs, ...).
    shares: The modes' shares of the defensive draws, (K, runs).
    missed: The part of all modes' evidence that belongs to modes not drawn from, (runs,).
    answer: The moments and conditionals of the Gaussian answer. They take the place of a mode in
        runs that have fewer than K.
    """

    beliefs: list[Beliefs]
    states: list[Conditional]
    shares: Array
    missed: Array
    answer: tuple[Beliefs, Conditional]


def _of_runs(plan: ChainPlan, answer: Beliefs, own: Conditional, most: int) -> Found:
    """Find the other modes of the runs of `plan`, by one call of the smoothers from all starts.

    answer: The smoothed moments of the Gaussian answer in these runs, (T+1, runs, ...).
    own: Its conditionals of the states given the slice after them, (T, runs, ...).
    most: The largest number K of modes that are to be drawn from.
    """
    begun = starts(plan, answer.mean)
    steps, runs, count, size = begun.shape
    flat = np.ascontiguousarray(begun.swapaxes(1, 2)).reshape(steps, count * runs, size)
    arrived = _arrived(repeated(plan, count), flat)
    std = deviation(arrived.cov)

    def wide(each: Array) -> Array:
        """An array (T+1, C · runs, n) reshaped to (C, runs, (T+1) · n)."""
        return each.reshape(steps, count, runs, size).transpose(1, 2, 0, 3).reshape(count, runs, -1)

    angles = np.tile(angle_mask(plan.layout.slice), steps)
    evidence = arrived.log_evidence.reshape(count, runs)
    points = FixedPoints(wide(arrived.mean), wide(std), evidence, angles)
    centre = answer.mean.swapaxes(0, 1).reshape(runs, -1)
    spread = deviation(answer.cov).swapaxes(0, 1).reshape(runs, -1)
    chosen = choose(points, centre, spread, most)
    beliefs, states = [], []
    for index in chosen.index:
        place, there = np.maximum(index, 0) * runs + np.arange(runs), index >= 0

        def taken(other: Array, mine: Array, place: Array = place, there: Array = there) -> Array:
            """A mode's array, (steps, runs, ...), with the answer's values in runs that lack it.

            other: The array of all N smoothers, (steps, N, ...).
            mine: That of the answer, (steps, runs, ...).
            place: For each run, the index in `other` of the smoother that found the mode, (runs,).
            there: The mask of the runs that have the mode, (runs,).
            """
            return np.where(there.reshape(-1, *(1,) * (mine.ndim - 2)), other[:, place], mine)

        beliefs.append(Beliefs(taken(arrived.mean, answer.mean), taken(arrived.cov, answer.cov)))
        parts = zip(arrived.states, own, strict=True)
        states.append(Conditional(*(taken(other, mine) for other, mine in parts)))
    return Found(beliefs, states, chosen.shares, chosen.missed, (answer, own))


def _joined(found: list[Found], make: MakePath) -> Modes:
    """The modes of all runs, from the modes found in parts of the runs.

    found: The modes of each part, in the order of the runs. Where a part has fewer modes than
        another, its Gaussian answer stands for each mode that it lacks, with a share of zero.
    make: Makes the law of a mode's trajectories from its smoothed moments and conditionals.
    """
    missed = np.concatenate([each.missed for each in found])
    laws = []
    for k in range(max(len(each.beliefs) for each in found)):
        beliefs = [e.beliefs[k] if k < len(e.beliefs) else e.answer[0] for e in found]
        states = [e.states[k] if k < len(e.states) else e.answer[1] for e in found]
        shares = [e.shares[k] if k < len(e.shares) else np.zeros(len(e.missed)) for e in found]
        whole = Beliefs(
            np.concatenate([each.mean for each in beliefs], axis=1),
            np.concatenate([each.cov for each in beliefs], axis=1),
        )
        parts = (np.concatenate(part, axis=1) for part in zip(*states, strict=True))
        laws.append((partial(make, whole, Conditional(*parts)), np.concatenate(shares)))
    return Modes.made(laws, missed)


@quiet()
def _arrived(plan: ChainPlan, begun: Array) -> Arrived:
    """Run N smoothers from the trajectories `begun` (T+1, N, n); `plan` has a run for each.

    A batch of smoothers that fails is tried again in halves, unless it has 1/64 of all smoothers or
    fewer. A smoother that fails, or whose result is not finite, has a `log_evidence` of −∞.
    """
    size, front = plan.layout.slice_size, plan.layout.state_size
    runs = plan.runs
    found = Arrived(
        begun.copy(),
        np.broadcast_to(0.0, (*begun.shape, size)).copy(),
        Conditional(
            np.zeros((plan.steps, runs, front, size)),
            np.zeros((plan.steps, runs, front)),
            np.zeros((plan.steps, runs, front, front)),
        ),
        np.full(runs, -np.inf),
    )
    least = max(1, int(runs * SMALLEST))
    left = [slice(0, runs)]
    while left:
        part = left.pop()
        some = plan if part == slice(0, runs) else plan.of(part)
        try:
            done = _smoothed(some, begun[:, part])
        except (PgmError, np.linalg.LinAlgError):
            if part.stop - part.start > least:
                half = (part.start + part.stop) // 2
                left += [slice(part.start, half), slice(half, part.stop)]
            continue
        finite = np.isfinite(done.mean).all(axis=(0, 2)) & np.isfinite(done.cov).all(axis=(0, 2, 3))
        finite &= np.isfinite(done.log_evidence)
        found.log_evidence[part] = np.where(finite, done.log_evidence, -np.inf)
        found.mean[:, part], found.cov[:, part] = done.mean, done.cov
        for whole, each in zip(found.states, done.states, strict=True):
            whole[:, part] = each
    return found


def _smoothed(plan: ChainPlan, begun: Array) -> Arrived:
    """The results of a few smoothing iterations of all runs, from trajectories `begun` (T+1, N, n).

    Steps that raise the cost, −2 ln p, are held back (Levenberg–Marquardt). A model without a cost,
    which has nonlinear motions without noise, is damped by a fixed factor instead.
    """
    schedule = Smoothing(ITERATIONS, TOLERANCE, LevenbergMarquardt(tries=TRIES))
    try:
        found, _ = smoother.smooth(plan, schedule, begun)
    except ModelError:  # nonlinear motions without noise have no cost
        found, _ = smoother.smooth(plan, replace(schedule, damping=HELD), begun)
    log_evidence = parallel.whole(found.forward).log_density.sum(axis=0)
    states = found.reversed_of(plan).states
    return Arrived(found.beliefs.mean, found.beliefs.cov, states, log_evidence)
