"""Paths of regimes drawn and weighed: hypotheses that are followed, and never merged.

Given a path of regimes, one at each step, a chain of linear CPDs has one Gaussian at each step, and
ln p(path, z) is what its filter says of the measurements z, with the path's own probability. Arrays
of paths are (T+1, draws, runs), or a step's (draws, runs).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.back import BackwardChain
from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.records import Belief, Pairs
from pgm.beliefs.moments.steps.readings import Moments
from pgm.kernels import merging, roots
from pgm.kernels.arrays import LOG_2PI, Array, Integers, apply, components_last
from pgm.kernels.moments import Conditional
from pgm.kernels.semirings import log_sum


class Followed(NamedTuple):
    """Paths that were followed: ln p(path, z), (draws, runs), and trajectories given these.

    `certain` says that some path makes a measurement certain, and has no density. `last` has the
    moments (draws, runs, ...) of the last slice; `back` by step, from the last one on, each slice
    given the next, (draws, runs, ...).
    """

    log_density: Array
    certain: bool
    last: Moments
    back: list[Conditional]

    def drawn(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Trajectories of the paths, given all measurements, (T+1, draws, runs, n).

        And their log-densities (draws, runs), infinite where a direction of a slice has no noise.
        """
        log_density = np.zeros(self.log_density.shape)

        def off(cov: Array) -> Array:
            nonlocal log_density
            root, white = roots.root(cov), rng.standard_normal(cov.shape[:-1])
            with np.errstate(divide="ignore"):
                volume = np.log(np.abs(np.diagonal(root, axis1=-2, axis2=-1)))
            log_density = log_density - (0.5 * (white * white + LOG_2PI) + volume).sum(axis=-1)
            return apply(root, white)

        found = [self.last.mean + off(self.last.cov)]
        for each in self.back:
            found.append(apply(each.matrix, found[-1]) + each.offset + off(each.cov))
        return np.stack(found[::-1]), log_density


def follow(chain: HypothesisChain, paths: Integers) -> Followed:
    """Follow paths, as many as the chain has components."""
    count = chain.regimes.size
    pairs, back = chain.start(), list[Conditional]()
    known: Belief | None = None
    certain = False
    for step, regimes in enumerate(paths):
        if known is not None:
            before = known
            pairs = chain.predict(step, known)
            assert isinstance(pairs, Pairs)
            moments = Moments(before.mean[:, :, None], before.cov[:, :, :, None])
            back.append(_at(chain.reversed(step, pairs, moments), regimes))
        assert isinstance(pairs, Pairs)
        members = chain.informed(step, pairs)
        certain = certain or isinstance(members.counts, np.ndarray)
        copy = np.arange(len(regimes))[:, None] if step else 0
        place = copy * count + regimes
        known = Belief(
            np.take_along_axis(members.logs, place, axis=0),
            chain.regimes.memory[regimes],
            0,
            np.take_along_axis(members.mean, place[None], axis=1),
            np.take_along_axis(members.cov, place[None, None], axis=2),
        )
    assert known is not None
    last = Moments(components_last(known.mean, 1), components_last(known.cov, 2))
    return Followed(known.logs, certain, last, back[::-1])


def _at(conditional: Conditional, regimes: Integers) -> Conditional:
    """The conditionals (draws, S, runs, ...) of one regime of each draw and run."""
    found = []
    for part in conditional:
        index = regimes[:, None].reshape(len(regimes), 1, -1, *(1,) * (part.ndim - 3))
        found.append(np.take_along_axis(part, index, axis=1)[:, 0])
    return Conditional(*found)


# The powers of the model's probabilities, of which a third of the defensive paths are drawn each.
TEMPERS = 1.0, 0.5, 0.0


class PathLaw:
    """A law of paths by the smoothed beliefs of pairs of steps, or a *defensive* one.

    The former draws the last regime, then each memory given the regime after it, and the regime
    that had it: a Markov chain, from the end on, of the smoothed probabilities. Defensive paths are
    drawn forward, a third each by the model's probabilities of regimes given the memory before, by
    their roots, and uniformly of those that are possible: so that paths are seen which are rare in
    the model, and of which the answer knows nothing.
    """

    def __init__(self, backward: BackwardChain) -> None:
        chain = backward.chain
        self._regimes, self._steps = chain.regimes, chain.given.bound.steps
        self._runs = chain.runs
        self._smoothed, self._pairs = _smoothed(backward, self._steps)

    def drawn(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Integers:
        """So many paths of each run, of the smoothed beliefs, or defensive ones."""
        found = np.zeros((self._steps + 1, count, self._runs), dtype=np.intp)
        if defensive:
            power = np.array(TEMPERS)[rng.integers(len(TEMPERS), size=(count, 1, self._runs))]
            found[0] = _picked(_tempered(self._start(count), power), rng)
            for step in range(1, self._steps + 1):
                found[step] = _picked(_tempered(self._given(step, found[step - 1]), power), rng)
            return found
        for step in range(self._steps, -1, -1):
            logs = self._smoothed[step]
            if step < self._steps:
                logs = self._before(step, found[step + 1])
            else:
                logs = np.broadcast_to(logs[None], (count, *logs.shape))
            found[step] = _picked(logs, rng)
        return found

    def log_probability(self, paths: Integers, *, defensive: bool) -> Array:
        """The log-probabilities of paths, (draws, runs)."""
        if defensive:
            each = [self.of_model(paths, power) for power in TEMPERS]
            found: Array = log_sum(np.stack(each), 0) - np.log(len(TEMPERS))
            return found
        last = self._smoothed[-1]
        total = _of(np.broadcast_to(last[None], (len(paths[0]), *last.shape)), paths[-1])
        for step in range(self._steps - 1, -1, -1):
            total = total + _of(self._before(step, paths[step + 1]), paths[step])
        return total

    def of_model(self, paths: Integers, power: float = 1.0) -> Array:
        """The log-probabilities of paths by the model's, or by a power of these, (draws, runs)."""
        total = _of(_tempered(self._start(len(paths[0])), power), paths[0])
        for step in range(1, self._steps + 1):
            total = total + _of(_tempered(self._given(step, paths[step - 1]), power), paths[step])
        return total

    def _start(self, count: int) -> Array:
        """Ln p(regime at step 0), (draws, S, runs)."""
        start = self._regimes.prior()
        return np.broadcast_to(start, (count, len(start), self._runs))

    def _given(self, step: int, before: Integers) -> Array:
        """Ln p(regime | that of the step before), (draws, S, runs)."""
        return self._regimes.given(step, self._regimes.memory[before])

    def _before(self, step: int, after: Integers) -> Array:
        """Ln q(regime | that of the step after), (draws, S, runs)."""
        memory = self._regimes.memory
        pairs, own = self._pairs[step], self._smoothed[step]
        total = merging.normalised(pairs[:, after, np.arange(self._runs)])[0]
        share = np.full((len(pairs), len(own), self._runs), -np.inf)
        for kind in range(len(pairs)):
            of_kind = np.where((memory == kind)[:, None], own, -np.inf)
            share[kind] = merging.normalised(of_kind)[0]
        found: Array = total[memory].swapaxes(0, 1) + share[memory, np.arange(len(memory))]
        return found


def _smoothed(backward: BackwardChain, steps: int) -> tuple[list[Array], list[Array]]:
    """By step ln p(regime), (S, runs), and of pairs of steps ln p(memory, regime after)."""
    alone, pairs = list[Array](), list[Array]()
    for step, _, opened, two in backward.walk(steps):
        alone.append(merging.normalised(backward.regimes(step, opened))[0])
        if two is not None:
            pairs.append(backward.by_memory(step, two))
    return alone[::-1], pairs[::-1]


def _tempered(logs: Array, power: Array | float) -> Array:
    """Log-probabilities (draws, S, runs) to a power, normalised; none stay none."""
    some = logs > -np.inf
    found = np.where(some, power * np.where(some, logs, 0.0), -np.inf)
    total = log_sum(found, 1)[:, None]
    return found - np.where(total > -np.inf, total, 0.0)


def _picked(logs: Array, rng: np.random.Generator) -> Integers:
    """A regime of each draw and run, by log-weights (draws, S, runs)."""
    top = logs.max(axis=1, keepdims=True)
    share = np.exp(logs - np.where(top > -np.inf, top, 0.0)).cumsum(axis=1)
    chance = rng.random((len(logs), 1, logs.shape[-1])) * share[:, -1:]
    found: Integers = np.minimum((chance >= share).sum(axis=1), logs.shape[1] - 1)
    return found


def _of(logs: Array, regimes: Integers) -> Array:
    """The entries (draws, S, runs) of a regime of each draw and run."""
    found: Array = np.take_along_axis(logs, regimes[:, None], axis=1)[:, 0]
    return found
