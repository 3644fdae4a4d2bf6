"""Running a schedule on a graph of any shape: rounds of messages until none changes.

See `rounds` for the messages, and for what a round sends.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.clustergraph.cluster import Edge
from pgm.kernels.arrays import Array, Mask
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.schedules.rounds import Messages
from pgm.schedules.schedule import Loopy

# Nonlinear CPDs are linearised anew when no message changes by more than so many standard
# deviations, later than this share of the last move. Changes by edge are kept up to so many, 8 MiB.
_SETTLED, _SHARE = 1e-2, 0.1
_KEPT = 2**20
# A run has diverged when its residual is this many times the least that it has had.
GROWN = 1e4


def run_loopy(messages: Messages[Any], schedule: Loopy, lead: tuple[int, ...]) -> Status:
    """Send messages until none changes, and relinearisation moves no mean; returns the status.

    Nonlinear CPDs are linearised again whenever messages have nearly settled. A run that has
    converged keeps its messages, so that a batch equals its single runs, unless it shares arrays
    with runs that go on. A run has diverged, and always keeps its messages, if its residual (the
    largest change in a round) is not finite or grows to over 10⁴ times its least since its CPDs
    were linearised last, or if a relinearisation moves a mean over 10⁴ times as far as the one that
    moved means least. Changes that cannot exceed one, as of probabilities, never count as grown.
    `lead` is the shape of the user's axes of runs.
    """
    step = schedule._step(messages)
    active = np.ones(messages.runs, dtype=bool)
    converged = np.zeros(messages.runs, dtype=bool)
    lost = np.zeros(messages.runs, dtype=bool)
    changes, moves = _Growth(messages.runs), _Growth(messages.runs)
    gate = np.full(messages.runs, max(_SETTLED, schedule.tolerance))
    residuals: list[Array] = []
    along: list[Array] = []
    for _ in counted(range(schedule.iterations), "rounds"):
        if not active.any():
            break
        each = step(active, lost)
        change = each.max(axis=0, initial=0.0)
        if len(residuals) * each.size <= 2 * _KEPT:
            along.append(np.where(active, np.maximum(each[::2], each[1::2]), 0.0))
        residuals.append(np.where(active, change, residuals[-1]) if residuals else change)
        lost |= active & (~np.isfinite(change) if messages.bounded else changes.grown(change))
        active &= ~lost
        ready = active & (change <= gate)
        if not ready.any():
            continue
        move = messages.relinearise(ready)
        if move is None:
            gate[:] = schedule.tolerance
            converged |= active & (change <= schedule.tolerance)
        else:
            residuals[-1] = np.where(ready, np.maximum(change, move), residuals[-1])
            converged |= ready & (residuals[-1] <= schedule.tolerance)
            gate = np.where(ready, np.clip(_SHARE * move, schedule.tolerance, gate), gate)
            lost |= ready & moves.grown(np.where(ready, move, np.inf))
            changes.forget(ready)
        active &= ~(converged | lost)
    return Status(
        len(residuals),
        np.array(residuals).reshape(len(residuals), *lead),
        converged.reshape(lead),
        _by_edge(messages, lead),
        edge_residuals=np.array(along).reshape(len(along), len(messages.directed) // 2, *lead)
        if len(along) == len(residuals)
        else None,
    )


class _Growth:
    """The least residual so far of each run, (runs,), by which divergence is noticed."""

    def __init__(self, runs: int) -> None:
        self.least = np.full(runs, np.inf)

    def grown(self, residual: Array) -> Mask:
        """Whether a run's `residual` is not finite, or over 10⁴ times the least before, (runs,).

        The residual (runs,) is the newest one, which is kept if it is the least so far.
        """
        found: Mask = ~np.isfinite(residual) | (residual > GROWN * self.least)
        self.least = np.fmin(self.least, residual)
        return found

    def forget(self, runs: Mask) -> None:
        """Forget the least residuals of the runs in a mask (runs,), as at the start."""
        self.least[runs] = np.inf


def _by_edge(messages: Messages[Any], lead: tuple[int, ...]) -> dict[Edge, Array]:
    """By edge, a pair of clusters' numbers, how much its messages would change if sent now.

    That is the larger change of its two messages, (*lead), `lead` being the shape of the user's
    axes of runs.
    """
    directed = messages.directed
    change = messages.propose(messages.round(range(len(directed))))
    edges = zip(directed.source[::2].tolist(), directed.target[::2].tolist(), strict=True)
    larger = np.maximum(change[::2], change[1::2])
    return {edge: row.reshape(lead) for edge, row in zip(edges, larger, strict=True)}
