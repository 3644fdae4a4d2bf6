"""What later evidence says of a mixed chain's components, back from step to step.

The message to a component is in the form of Bryson and Frazier (`kernels.merging.Message`), which
inverts no covariance. It is split into messages to the members that were merged into the component;
each of these goes back through what the member has taken in; and those to the copies of one
component are joined: those of a step's stages, and at last, through the motion, those of the step
before. Arrays are as of the forward pass (`chain`), but hypotheses and runs come first:
(K, runs, n) of components.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.chain import HypothesisChain, Mixing, Stage
from pgm.kernels.arrays import Array, Mask, components_last
from pgm.kernels.merging import Message, joined, split
from pgm.kernels.semirings import log_sum


class Flow(NamedTuple):
    """The log-weights of hypotheses given all evidence, (hypotheses, runs), and the messages."""

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

    def opened(self, step: int, flow: Flow) -> Flow:
        """What flows back to a step's components, as it flows back to the members of its end."""
        return self._split(self.chain.kept[step].stages[-1], flow)

    def back(self, step: int, later: Flow) -> Flow:
        """What flows back to a step's components from the last members of the step after."""
        kept = self.chain.kept[step + 1]
        flow = later
        for before, stage in zip(kept.stages[-2::-1], kept.stages[:0:-1], strict=True):
            flow = self._split(before, self._joined(self._through(stage, flow), stage))
        first = kept.stages[0]
        flow = self._through(first, flow)
        copies = first.members.copies
        shape = len(flow.logs) // copies, copies, self.chain.runs
        assert kept.choice is not None
        slopes = self.chain.slopes(step + 1, kept.choice, shape[0])
        size = slopes.shape[-1]
        flow = Flow(flow.logs, flow.message.through(slopes.reshape(-1, shape[2], size, size)))
        if kept.mixed is not None:
            return self._unmixed(kept.mixed, flow)
        return self._joined(flow, first)

    def regimes(self, step: int, opened: Flow) -> Array:
        """The log-probabilities of a step's regimes given what flows back, (S, runs)."""
        stage = self.chain.kept[step].stages[-1]
        return self.chain.by_regime(opened.logs, stage.members)

    @staticmethod
    def _through(stage: Stage, flow: Flow) -> Flow:
        """What flows back to members through the measurements that they have taken in."""
        if stage.seen is None:
            return flow
        seen = stage.seen
        return Flow(flow.logs, flow.message.before(seen.matrix, seen.vector, seen.information))

    def _split(self, stage: Stage, flow: Flow) -> Flow:
        """What flows back to components, as it flows back to their members."""
        members = stage.members
        found = split(
            flow.message,
            components_last(stage.mean, 1),
            components_last(stage.cov, 2),
            stage.owner,
            members.logs,
            (components_last(members.mean, 1), components_last(members.cov, 2)),
        )
        self._count(found.divided, flow.logs)
        logs = found.logs + np.take_along_axis(flow.logs, stage.owner, axis=0)
        return Flow(logs, found.message)

    def _count(self, divided: Mask, logs: Array) -> None:
        self.undivided += (~divided & (logs > -np.inf)).sum(axis=0)

    def _joined(self, flow: Flow, stage: Stage) -> Flow:
        """What flows back to components, from that to the copies of each."""
        copies, runs = stage.members.copies, self.chain.runs
        logs = flow.logs.reshape(-1, copies, runs)
        size = flow.message.vector.shape[-1]
        message = Message(
            flow.message.vector.reshape(*logs.shape, size),
            flow.message.matrix.reshape(*logs.shape, size, size),
        )
        return _of_copies(logs, message)

    def _unmixed(self, mixed: Mixing, later: Flow) -> Flow:
        """The messages to mixtures, one a regime, as such to the components that were mixed."""
        logs = later.logs[None]
        found = split(
            Message(later.message.vector[None], later.message.matrix[None]),
            components_last(mixed.mean, 1),
            components_last(mixed.whole, 2),
            np.zeros(mixed.logs.shape, dtype=np.intp),
            mixed.logs,
            (components_last(mixed.members, 1), components_last(mixed.cov, 2)),
        )
        self._count(found.divided[0], later.logs)
        return _of_copies(found.logs + logs, found.message)


def _of_copies(logs: Array, message: Message) -> Flow:
    """The messages to components from those to their copies, (components, copies, runs, ...)."""
    total = log_sum(logs, 1)
    shares = np.exp(logs - np.where(total > -np.inf, total, 0.0)[:, None])
    dead = total == -np.inf
    if dead.any():
        shares = np.where(dead[:, None], 1.0 / shares.shape[1], shares)
    return Flow(total, joined(shares, message))
