"""Rounds of messages on graphs of any shape: what a message is computed from, and in which order.

Edge e is the e-th of the graph's sepsets. Message 2e goes along it from the cluster of the lower
number to the other, message 2e + 1 back. A family of messages, tables or square roots of Gaussians,
computes and keeps them. The *change* of a message is one number: of a table the largest change of a
probability; of a Gaussian, in essence, how far a mean of the belief over the sepset moves, in
standard deviations. A run is *active* until it has converged, or is *lost*, as its messages
diverge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np

from pgm.boundary import is_whole
from pgm.clustergraph import ClusterGraph
from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Integers, Mask

Round = TypeVar("Round")


@dataclass(frozen=True, eq=False)
class Directed:
    """The numbered messages of a cluster graph: from which cluster to which each goes.

    Attributes
    ----------
    source, target : ndarray of int
        (messages,): the number of the cluster that sends each message, and of the one that gets it.
    clusters : int
        How many clusters the graph has.
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


# Sends a round of messages, as many as there are or more, given masks (runs,) of the active and the
# lost runs; returns how much each message changed, or with `Residual` would still change,
# (messages, runs).
Step = Callable[[Mask, Mask], Array]


def in_turn(messages: Messages[Round], turns: Sequence[Sequence[int]], whose: object) -> Step:
    """The `Step` that sends groups of messages in turn, each computed from the latest messages.

    A group in `turns` has the numbers of its messages. A ModelError, which names the schedule
    `whose` they are, refuses turns in which a message is missing.
    """
    turns = _checked(turns, len(messages.directed), whose)
    rounds = [(list(turn), messages.round(turn)) for turn in turns]

    def step(active: Mask, lost: Mask) -> Array:
        change = np.zeros((len(messages.directed), messages.runs))
        for turn, each in rounds:
            # A message that is sent twice has changed by the larger of its changes.
            change[turn] = np.maximum(change[turn], messages.propose(each))
            messages.accept(each, active, lost)
        return change

    return step


def _checked(turns: Any, count: int, whose: object) -> list[list[int]]:
    """Groups of messages of a round, once each of the `count` messages is in one of them."""
    due = f"groups of the numbers 0 to {count - 1} of messages, as [[0, 1], [2]], were due"
    try:
        found = [list(turn) for turn in turns]
    except TypeError:
        raise ModelError(f"{whose!r}: turns(messages) returned {turns!r}; {due}") from None
    for turn in found:
        odd = [each for each in turn if not is_whole(each) or not 0 <= each < count]
        if odd or len(set(turn)) < len(turn):
            what = f"{odd[0]!r}, which is no message" if odd else "a message twice in one group"
            raise ModelError(f"{whose!r}: turns(messages) has {what}; {due}")
    missing = sorted(set(range(count)).difference(*found))
    if missing:
        raise ModelError(
            f"{whose!r}: turns(messages) leaves out the messages {missing}, which would never be "
            f"sent; {due}, each once or more"
        )
    return found


def largest_first(messages: Messages[Any]) -> Step:
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
