"""Other modes of a chain, found by smoothers that begin elsewhere.

There are C starts for each run, and copy c of run r is run c · runs + r of one call, N = C · runs
in all (`repeated`). n is the number of components of a slice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from pgm.errors import ModelError, PgmError
from pgm.factors.scope import angle_mask
from pgm.inference.audit.drives import starts
from pgm.inference.audit.modes import MOST, FixedPoints, Modes, choose
from pgm.inference.audit.proposal import Path
from pgm.inference.audit.repeated import repeated
from pgm.inference.chain import parallel, smoother
from pgm.inference.chain.backward import Beliefs
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.damping import LevenbergMarquardt
from pgm.inference.schedule import Smoothing
from pgm.kernels.arrays import Array, deviation, quiet
from pgm.kernels.moments import Conditional

# A short smoother: linearisations, standard deviations within which it has arrived, tries of a step
# that raises the cost, and, where no cost can control it, the share of the old point that is kept.
ITERATIONS, TOLERANCE, TRIES, HELD = 12, 0.02, 1, 0.5
# Numbers of all smoothers that are held at once, and about as many starts a run.
ROOM, STARTS = 2**26, 24
# The part of the smoothers below which those that fail together are given up.
SMALLEST = 1.0 / 64.0

# From smoothed moments and the conditionals of states given the slice after them to their law.
MakePath = Callable[[Beliefs, Conditional], Path]


class Arrived(NamedTuple):
    """The results of N smoothers.

    They are smoothed moments (T+1, N, ...), the states given the slice after them, (T, N, ...), and
    ln of the evidence of the last linearisation, (N,).
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
    answer : Beliefs
        The smoothed moments of all runs.
    own : Conditional
        (T, runs, ...): its states given the slice after them.
    make : callable
        Of smoothed moments and such conditionals of all runs, returns their `Path`.
    most : int
        Modes at the most that are to be drawn from.
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

    Each has smoothed moments (T+1, runs, ...), and the states given the slice after them; `shares`
    (K, runs) and `missed` (runs,) are those of `Modes`, `answer` the answer's own moments and
    states. In runs that have fewer modes the arrays are the answer's.
    """

    beliefs: list[Beliefs]
    states: list[Conditional]
    shares: Array
    missed: Array
    answer: tuple[Beliefs, Conditional]


def _of_runs(plan: ChainPlan, answer: Beliefs, own: Conditional, most: int) -> Found:
    """The modes of some runs, whose smoothers from all starts are one call.

    `answer`, `own` and `most` are as of `find`, of the runs of `plan`.
    """
    begun = starts(plan, answer.mean)
    steps, runs, count, size = begun.shape
    flat = np.ascontiguousarray(begun.swapaxes(1, 2)).reshape(steps, count * runs, size)
    arrived = _arrived(repeated(plan, count), flat)
    std = deviation(arrived.cov)

    def wide(each: Array) -> Array:
        """(T+1, C runs, n) as (C, runs, (T+1) n)."""
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
            """The mode's array in the runs that have it, the answer's array in the rest."""
            return np.where(there.reshape(-1, *(1,) * (mine.ndim - 2)), other[:, place], mine)

        beliefs.append(Beliefs(taken(arrived.mean, answer.mean), taken(arrived.cov, answer.cov)))
        parts = zip(arrived.states, own, strict=True)
        states.append(Conditional(*(taken(other, mine) for other, mine in parts)))
    return Found(beliefs, states, chosen.shares, chosen.missed, (answer, own))


def _joined(found: list[Found], make: MakePath) -> Modes:
    """The modes of all runs, from those found in parts of the runs, in their order.

    A part with fewer modes than another has its answer, at a share of zero, for those it lacks.
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
    """Smooth from starts (T+1, N, n); a batch that fails is tried in halves.

    `plan` is of all N smoothers. Those that fail, or whose result is not finite, have a
    `log_evidence` of −∞. Batches of 1/64 of them, or less, are not halved.
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
    """A short smoother of all runs, from trajectories (T+1, N, n).

    Its steps are controlled by their cost; if there is none (a ModelError), by damping.
    """
    schedule = Smoothing(ITERATIONS, TOLERANCE, LevenbergMarquardt(tries=TRIES))
    try:
        found, _ = smoother.smooth(plan, schedule, begun)
    except ModelError:  # nonlinear motions without noise have no cost
        found, _ = smoother.smooth(plan, replace(schedule, damping=HELD), begun)
    log_evidence = parallel.whole(found.forward).log_density.sum(axis=0)
    return Arrived(found.beliefs.mean, found.beliefs.cov, found.reverse.states, log_evidence)
