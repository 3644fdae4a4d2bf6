"""Schedules on graphs of any shape: messages are sent until none changes.

Edge e is the e-th of the graph's sepsets. Message 2e goes along it from the cluster of the lower
number to the other, message 2e + 1 back. A family of messages, tables or square roots of Gaussians,
computes and keeps them. The *change* of a message is one number: of a table the largest change of a
probability; of a Gaussian, in essence, how far a mean of the belief over the sepset moves, in
standard deviations. A run is *lost* when its messages diverge, and *active* until it is lost or has
converged. A *round* of a schedule sends as many messages as there are. A `Step` is a function that
sends one: it takes the masks of the active and of the lost runs, (runs,), and returns the changes
of the messages, (messages, runs).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.cluster import Edge
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.schedules.schedule import Flooding, Loopy, Residual, Sequential

Round = TypeVar("Round")


@dataclass(frozen=True, eq=False)
class Directed:
    """The numbered messages of a cluster graph: from which cluster to which each goes.

    `source` and `target` (messages,) have the number of the cluster that sends each message, and of
    the one that gets it; `clusters` is how many clusters the graph has.
    """

    source: Integers
    target: Integers
    clusters: int

    @classmethod
    def of(cls, graph: ClusterGraph) -> Directed:
        """The messages of a graph, two for each sepset."""
        edges = np.array(list(graph.sepsets), dtype=np.intp).reshape(-1, 2)
        return cls(edges.ravel(), edges[:, ::-1].ravel(), len(graph))

    def __len__(self) -> int:
        return self.source.size

    @cached_property
    def outgoing(self) -> list[list[int]]:
        """For each cluster the numbers of the messages that it sends."""
        found: list[list[int]] = [[] for _ in range(self.clusters)]
        for message, source in enumerate(self.source.tolist()):
            found[source].append(message)
        return found

    def inputs(self, message: int) -> list[int]:
        """The numbers of the messages from which a message is computed.

        They are all messages to its source, but the one from its target.
        """
        return [other ^ 1 for other in self.outgoing[self.source[message]] if other != message]

    def dependents(self, message: int) -> list[int]:
        """The numbers of the messages that are computed from a message.

        They are all messages from its target, but the one to its source.
        """
        return [other for other in self.outgoing[self.target[message]] if other != message ^ 1]


class Messages(Protocol[Round]):
    """A family of messages: how they are computed, kept and compared.

    `round` prepares a group of messages, which may be any of them. `propose` computes the group's
    messages anew, and `accept` puts these in the place of those that were kept.
    """

    @property
    def directed(self) -> Directed:
        """The source and target of each message."""

    @property
    def runs(self) -> int:
        """How many runs the messages are of; 1 for a single run."""

    @property
    def bounded(self) -> bool:
        """Whether changes are of probabilities, so that none can exceed one.

        Changes that grow are then no sign of divergence.
        """

    def round(self, messages: Sequence[int]) -> Round:
        """Prepare a group of messages, given by their numbers, to be computed again and again.

        The result is handed to `propose` and `accept`. It has the layout by which messages of equal
        shape are computed together.
        """

    def propose(self, round: Round) -> Array:
        """Compute a group's messages from the messages that are kept, and return their changes.

        The argument is what the method `round` has returned for the group. The changes are
        (messages, runs), in the order in which that method was given the messages.
        """

    def accept(self, round: Round, active: Mask, lost: Mask) -> None:
        """Replace the kept messages of a group by those that `propose` has just computed for it.

        That is done in the `active` runs, (runs,). If there is damping, the new messages are mixed
        with the old ones. Runs that are `lost`, (runs,), keep their messages. Converged runs keep
        theirs, too, unless they share arrays with active runs.
        """

    def relinearise(self, active: Mask) -> Array | None:
        """Linearise nonlinear CPDs at the beliefs, in the active runs.

        Returns the largest move of a mean since it was linearised last, (runs,), in standard
        deviations; None where no CPD is nonlinear.
        """


# Nonlinear CPDs are linearised anew when no message changes by more than so many standard
# deviations, later than this share of the last move. Changes by edge are kept up to so many, 8 MiB.
_SETTLED, _SHARE = 1e-2, 0.1
_KEPT = 2**20
# A run has diverged when its residual is this many times the least that it has had.
GROWN = 1e4


# Sends a round of messages, given masks of the active and the lost runs; returns how much each
# message changed, or with `Residual` would still change, (messages, runs).
Step = Callable[[Mask, Mask], Array]


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
    step = next(_STEPS[each] for each in type(schedule).__mro__ if each in _STEPS)(messages)
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


def _flooding(messages: Messages[Any]) -> Step:
    """The `Step` that sends all messages at once, from those of the round before."""
    return _in_turn(messages, [range(len(messages.directed))])


def _sequential(messages: Messages[Any]) -> Step:
    """The `Step` in which clusters in order send to later ones, then in reverse to earlier ones."""
    target = messages.directed.target
    there, back = [], []
    for cluster, outgoing in enumerate(messages.directed.outgoing):
        later = [m for m in outgoing if target[m] > cluster]
        earlier = [m for m in outgoing if target[m] < cluster]
        there += [later] if later else []
        back += [earlier] if earlier else []
    return _in_turn(messages, [*there, *reversed(back)])


def _in_turn(messages: Messages[Round], turns: Sequence[Sequence[int]]) -> Step:
    """The `Step` that sends groups of messages in turn, each computed from the latest messages.

    A group in `turns` has the numbers of its messages.
    """
    rounds = [(list(turn), messages.round(turn)) for turn in turns]

    def step(active: Mask, lost: Mask) -> Array:
        change = np.zeros((len(messages.directed), messages.runs))
        for turn, each in rounds:
            change[turn] = messages.propose(each)
            messages.accept(each, active, lost)
        return change

    return step


def _residual(messages: Messages[Any]) -> Step:
    """The `Step` that sends next the message that would change most (Elidan, 2006).

    After each message only that message and those that depend on it are computed anew. The changes
    that the `Step` returns are those still to come: how much each message would change after the
    round.
    """
    directed = messages.directed
    everything = messages.round(range(len(directed)))
    single = [messages.round([m]) for m in range(len(directed))]
    # A damped message has the rest of its change still to come.
    after = [[m, *directed.dependents(m)] for m in range(len(directed))]
    following = [messages.round(found) for found in after]

    def step(active: Mask, lost: Mask) -> Array:
        change = messages.propose(everything)
        for _ in range(len(directed)):
            first = int(change[:, active].max(axis=1).argmax())
            messages.propose(single[first])
            messages.accept(single[first], active, lost)
            change[after[first]] = messages.propose(following[first])
        return change.copy()

    return step


_STEPS = {Flooding: _flooding, Sequential: _sequential, Residual: _residual}
