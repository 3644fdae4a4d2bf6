"""pgm's part of switching motions: graphs are compiled beforehand."""

from __future__ import annotations

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.manoeuvres import Array, Manoeuvres
from models.networks import fix, target


def filtering(kind: str, work: Manoeuvres, *, compiled: bool = False) -> Contender:
    """The probabilities of modes and the means of states, (runs, T, ·).

    `kind` is ``"imm"``, the interacting multiple model, or ``"gpb2"``, as many Gaussians as modes.
    """
    graph = pgm.compile(work.network, work.steps, compiled=compiled)
    belief = pgm.Gaussians(mix=kind == "imm")

    def call() -> tuple[Array, Array]:
        posterior = pgm.infer(graph, {fix: work.readings}, schedule=pgm.Filtering(), belief=belief)
        modes, states = posterior[work.mode], posterior[target]
        assert isinstance(modes, pgm.Table)
        assert isinstance(states, pgm.GaussianMixture)
        return modes.probabilities[:, 1:], np.asarray(states.mean)[:, 1:]

    return Contender(call, work.readings[..., 0].size)
