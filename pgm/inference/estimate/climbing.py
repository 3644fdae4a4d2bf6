"""The answer that is sought: modes from several starts, then draws, until it can be vouched for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.modes.adapted import moved
from pgm.beliefs.modes.laws import Laws
from pgm.beliefs.modes.pool import Pool, Weighed
from pgm.beliefs.modes.search import Search
from pgm.inference.estimate.judging import Judged, judge
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.schedules.damping import LevenbergMarquardt

# Starts of the first search, and of the last; modes that are kept; nats of log-evidence below the
# best from which on a mode has no mass that counts.
STARTS, MOST_STARTS, MODES, NEGLIGIBLE = 16, 64, 16, 10.0
# Linearisations, their tolerance and damping: of the first search, and of more careful ones.
PLAIN = 25, 1e-4, 0.0
CAREFUL = 25, 1e-4, LevenbergMarquardt(tries=3)
# Draws of the first round.
FIRST = 1000
# An answer is vouched for within so many nats; estimates need so many effective draws, of weights
# with a tail of such a shape.
WITHIN, ENOUGH, HEAVY = 0.1, 100.0, 0.7


class Sought(NamedTuple):
    """The modes that starts have found, by run.

    laws: Their Gaussians.
    log_evidence: Laplace's approximation, (runs,).
    agreed: Whether every mode was found by two starts or more.
    starts, settled: How many starts there were, and how many settled.
    """

    laws: Laws
    log_evidence: Array
    agreed: Mask
    starts: Integers
    settled: Integers


def seek(search: Search) -> Sought:
    """The modes of all runs, from 16 starts and from none, by Gauss–Newton.

    Where few settle, or one alone found a mode, by Levenberg–Marquardt from twice as many, up to
    64.
    """
    found = _sought(search.by(*PLAIN), STARTS)
    starts = 2 * STARTS
    while starts <= MOST_STARTS and not found.agreed.all():
        runs = np.flatnonzero(~found.agreed)
        more = _sought(search.of(runs).by(*CAREFUL), starts)
        wide = found.laws.padded(max(len(found.laws.weights), len(more.laws.weights)))
        found = Sought(
            wide.put(runs, more.laws),
            *(_put(own, runs, new) for own, new in zip(found[1:], more[1:], strict=True)),
        )
        starts *= 2
    return found


def _sought(search: Search, starts: int) -> Sought:
    """The modes of all runs from so many starts, and from none."""
    found = search.chosen([*search.unled(), *search.arrived(starts)], MODES)
    laws, runs = search.laws(found), search.runs
    near = laws.weights > np.exp(-NEGLIGIBLE) * laws.weights.max(axis=0)
    weights = np.where(near, laws.weights, 0.0)
    laws = laws._replace(weights=weights / weights.sum(axis=0))
    agreed = ((found.hits != 1) | ~near).all(axis=0)
    settled = np.asarray(found.status.arrived).reshape(runs)
    return Sought(
        laws,
        np.reshape(found.log_evidence, runs),
        agreed & (2 * settled > starts),
        np.full(runs, starts + 1),
        settled,
    )


def _put(values: Array, runs: Integers, new: Array) -> Array:
    """Values with those of some runs replaced."""
    found = values.copy()
    found[runs] = new
    return found


class Answer(NamedTuple):
    """The answer of some runs, and what is known of it, by run.

    of: What `within` bounds: 0 nothing, 1 the density, 2 moments.
    moments: The bound on moments.
    sound: Whether enough draws count, and the tail of their weights allows estimates.
    """

    laws: Laws
    log_evidence: Array
    within: Array
    of: Integers
    moments: Array
    sound: Mask
    draws: Integers
    effective: Array
    pareto_k: Array


def weigh(search: Search, sought: Sought, effort: int) -> Answer:
    """Draws of the modes of all runs, more and more of them until they vouch for an answer."""
    rng, count = np.random.default_rng(0), min(FIRST, effort)
    laws, runs = sought.laws, np.arange(search.runs)
    pool = Pool(search.target(laws))
    pool.draw(laws, count, rng)
    judged, rest = judge(pool, laws, None), runs
    found = own = _answer(judged, pool)
    while True:
        left = np.flatnonzero(own.of == 0)
        if not left.size or 3 * pool.count > effort:
            return found
        rest = rest[left]
        part = search.of(rest)
        laws = moved(pool, laws, Weighed(pool, laws)).of(left)
        before = [type(m)(m.mean[:, left], m.cov[:, left]) for m in judged.marginals]
        pool = pool.of(part.target(laws), left)
        pool.draw(laws, 2 * pool.rounds[-1].count, rng)
        judged = judge(pool, laws, before)
        own = _answer(judged, pool)
        found = _better(found, own, rest)


def _better(found: Answer, own: Answer, runs: Integers) -> Answer:
    """The answers of all runs, those of some with what more draws say of them.

    Laws that the draws make worse are left as they were: estimates of few effective draws, or of
    weights with a heavy tail, are of no use.
    """
    worse = (found.sound[runs] & ~own.sound) | (
        (found.sound[runs] == own.sound) & (found.moments[runs] < own.moments)
    )
    better = np.flatnonzero(~worse)
    rest = (_put(a, runs, b) for a, b in zip(found[1:], own[1:], strict=True))
    return Answer(found.laws.put(runs[better], own.laws.of(better)), *rest)


def _answer(judged: Judged, pool: Pool) -> Answer:
    """What draws say of all runs of a pool."""
    sound = (judged.effective > ENOUGH) & (judged.pareto_k < HEAVY)
    density, moments = sound & (judged.density < WITHIN), sound & (judged.moments < WITHIN)
    moments &= len(pool.rounds) > 1
    of = np.where(density, 1, np.where(moments, 2, 0))
    within = np.where(density, judged.density, judged.moments)
    count = np.full(of.shape, pool.count)
    figures = count, judged.effective, judged.pareto_k
    return Answer(judged.laws, judged.log_evidence, within, of, judged.moments, sound, *figures)
