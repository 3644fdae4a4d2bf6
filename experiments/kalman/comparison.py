"""The cluster graph against the textbook on the same drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from experiments.kalman.problems import Problem
from experiments.textbook import Belief, bayes_filter, rts_smoother
from models.networks import fix

Array = npt.NDArray[np.float64]
Numbers = dict[str, dict[str, float]]


@dataclass(frozen=True, eq=False)
class Solved:
    """Drives of one problem, and what the cluster graph says of them.

    Attributes
    ----------
    truth : ndarray
        (runs, T+1, n).
    evidence : mapping
        Controls (T, 2) and readings (runs, T, 2) at steps 1..T.
    filtered, smoothed : Posterior
    """

    truth: Array
    evidence: dict[pgm.Variable, Array]
    filtered: pgm.results.Posterior
    smoothed: pgm.results.Posterior


def solve(problem: Problem, controls: Array, runs: int, seed: int) -> Solved:
    """Draw drives from the network, and pass messages on its cluster graph."""
    sample = problem.network.sample({problem.control: controls}, runs=runs, rng=seed)
    evidence = {problem.control: controls, fix: sample[fix]}
    graph = pgm.compile(problem.network, steps=len(controls))

    def sent(schedule: pgm.Filtering | pgm.Smoothing) -> pgm.results.Posterior:
        found = pgm.infer(graph, evidence, schedule=schedule, lineariser=problem.lineariser)
        assert isinstance(found, pgm.results.Posterior)
        return found

    return Solved(sample[problem.state], evidence, sent(pgm.Filtering()), sent(pgm.Smoothing()))


def differences(problem: Problem, solved: Solved) -> Numbers:
    """The largest over all runs, steps and components, of the filter and of its smoother.

    Returns
    -------
    dict
        ``filter`` and ``smoother``: ``mean``, ``cov`` and ``log_evidence``.
    """
    filtered, smoothed, log_evidence = [], [], []
    initial = problem.initial
    for readings in solved.evidence[fix]:
        steps = bayes_filter(problem.one_step, initial, solved.evidence[problem.control], readings)
        filtered.append([initial, *(step.filtered for step in steps)])
        smoothed.append(rts_smoother(initial, steps))
        log_evidence.append(sum(step.log_density for step in steps))
    found = {}
    for kind, ours, due in (
        ("filter", solved.filtered, filtered),
        ("smoother", solved.smoothed, smoothed),
    ):
        off = np.abs(ours.log_evidence - np.array(log_evidence)).max()
        found[kind] = {**_beliefs(ours[problem.state], due), "log_evidence": float(off)}
    return found


def _beliefs(ours: pgm.Gaussian, due: Sequence[Sequence[Belief]]) -> dict[str, float]:
    means = np.array([[belief.mean for belief in run] for run in due])
    covs = np.array([[belief.cov for belief in run] for run in due])
    return {
        "mean": float(np.abs(ours.mean - means).max()),
        "cov": float(np.abs(ours.cov - covs).max()),
    }
