"""What later evidence says of a mixed chain's components, back from step to step.

The message to a component is in the form of Bryson and Frazier (`kernels.merging.Message`), which
inverts no covariance. It is split into messages to the pairs that were merged into the component;
each of these goes back through its measurements and its motion; and those to the pairs of one
component are joined. Arrays are as of the forward pass (`chain`), but hypotheses and runs come
first: (K, runs, n) of components, (K, S, runs, n) of pairs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.chain import HypothesisChain, Kept
from pgm.kernels.arrays import Array, Mask, components_last
from pgm.kernels.merging import Message, joined, split
from pgm.kernels.semirings import log_sum


class Flow(NamedTuple):
    """The log-weights of a step's components given all evidence, (K, runs), and the message.

    `divided` (K, runs) is whether all messages that it is made of are ratios of densities.
    """

    logs: Array
    message: Message


class Opened(NamedTuple):
    """The log-weights of a step's pairs given all evidence, (K, S, runs), and the messages."""

    logs: Array
    message: Message


class BackwardChain:
    """The backward pass over a forward pass that was kept.

    Attributes
    ----------
    undivided : ndarray of int
        (runs,): how many times a ratio of smoothed and filtered beliefs was no density.
    """

    def __init__(self, chain: HypothesisChain) -> None:
        self.chain = chain
        self.undivided = np.zeros(chain.runs, dtype=np.intp)

    def last(self, step: int) -> Flow:
        """What flows back from a step whose belief knows no later evidence."""
        known = self.chain.kept[step].known
        size = self.chain.size
        shape = known.logs.shape
        none = Message(np.zeros((*shape, size)), np.zeros((*shape, size, size)))
        return Flow(known.shares, none)

    def opened(self, step: int, flow: Flow) -> Opened:
        """What flows back to a step's components, as it flows back to its pairs."""
        kept = self.chain.kept[step]
        shape = kept.pairs.logs.shape
        found = self._split(kept, flow)
        size = self.chain.size
        message = Message(
            found.message.vector.reshape(*shape, size),
            found.message.matrix.reshape(*shape, size, size),
        )
        return Opened(found.logs.reshape(shape), message)

    def _split(self, kept: Kept, flow: Flow) -> Opened:
        """The messages to pairs, and their log-weights, (K · S, runs)."""
        known, members = kept.known, kept.pairs.logs.size // self.chain.runs
        size, runs = self.chain.size, self.chain.runs
        found = split(
            flow.message,
            components_last(known.mean, 1),
            components_last(known.cov, 2),
            kept.owner,
            kept.pairs.logs.reshape(members, runs),
            (
                components_last(kept.members, 1),
                components_last(kept.pairs.cov.reshape(size, size, members, runs), 2),
            ),
        )
        self._count(found.divided, flow.logs)
        logs = found.logs + np.take_along_axis(flow.logs, kept.owner, axis=0)
        return Opened(logs, found.message)

    def _count(self, divided: Mask, logs: Array) -> None:
        self.undivided += (~divided & (logs > -np.inf)).sum(axis=0)

    def back(self, step: int, later: Opened) -> Flow:
        """What flows back to a step's components from the pairs of the step after."""
        kept = self.chain.kept[step + 1]
        logs, message = later
        if kept.seen is not None:
            message = message.before(kept.seen.matrix, kept.seen.vector, kept.seen.information)
        choice = kept.pairs.choice
        assert choice is not None
        message = message.through(self.chain.slopes(step + 1, choice, len(logs)))
        if kept.pairs.mixed is not None:
            logs, message = self._unmixed(kept, Opened(logs, message))
        total = log_sum(logs, 1)
        shares = np.exp(logs - np.where(total > -np.inf, total, 0.0)[:, None])
        dead = total == -np.inf
        if dead.any():
            shares = np.where(dead[:, None], 1.0 / shares.shape[1], shares)
        return Flow(total, joined(shares, message))

    def _unmixed(self, kept: Kept, later: Opened) -> Opened:
        """The messages to mixtures, one a regime, as such to the components that were mixed."""
        mixed = kept.pairs.mixed
        assert mixed is not None
        found = split(
            Message(*later.message),
            components_last(mixed.mean, 1),
            components_last(mixed.whole, 2),
            np.zeros(mixed.logs.shape, dtype=np.intp),
            mixed.logs,
            (components_last(mixed.members, 1), components_last(mixed.cov, 2)),
        )
        self._count(found.divided[0], later.logs[0])
        return Opened(found.logs + later.logs, found.message)
