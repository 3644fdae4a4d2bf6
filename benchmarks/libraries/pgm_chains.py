"""pgm's part of discrete chains: graphs are compiled beforehand, evidence goes in with the call."""

from __future__ import annotations

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.chains import Array, Chains


def smoothing(work: Chains) -> Contender:
    """One run, forward and back: all marginals but that of step 0, (T, states)."""
    graph = pgm.compile(work.network, work.steps)

    def call() -> Array:
        posterior = pgm.infer(graph, {work.symbol: work.readings[0]}, schedule=pgm.Smoothing())
        return _values(posterior, work)[1:]

    return Contender(call, work.steps)


def together(work: Chains) -> Contender:
    """All runs in one call, likewise: (runs, T, states)."""
    graph = pgm.compile(work.network, work.steps)

    def call() -> Array:
        posterior = pgm.infer(graph, {work.symbol: work.readings}, schedule=pgm.Smoothing())
        return _values(posterior, work)[:, 1:]

    return Contender(call, work.runs * work.steps)


def alone(work: Chains) -> Contender:
    """The first of several runs: (1, T, states)."""
    first = smoothing(work)
    return Contender(lambda: np.asarray(first.call())[None], first.units)


def _values(posterior: pgm.results.Posterior, work: Chains) -> Array:
    belief = posterior[work.state]
    assert isinstance(belief, pgm.Table)
    return belief.values
