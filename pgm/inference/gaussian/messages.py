"""Messages of Gaussian networks on graphs of any shape, as rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from pgm.inference.gaussian.beliefs import Beliefs, Places, relinearise
from pgm.inference.gaussian.buffer import Buffer
from pgm.inference.gaussian.model import Model
from pgm.inference.gaussian.rounds import Rounds, Stack
from pgm.inference.loopy import LOST, Directed
from pgm.kernels import moments, row_messages
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.rows import Rows, eliminate


class RowRound(NamedTuple):
    """Some messages, in stacks of one shape; `order` is where each stack's stand among them."""

    stacks: list[Stack]
    order: list[Integers]


@dataclass(eq=False)
class RowMessages:
    """Messages as rows; they start as unit information about the frame.

    From any positive start the information converges to the same fixed point, and with a proper
    one every message exists.
    """

    buffer: Buffer
    places: Places
    damping: float
    _point: Array
    _proposed: list[tuple[Stack, Rows]] = field(default_factory=list)

    @classmethod
    def make(cls, rounds: Rounds, places: Places, model: Model, damping: float) -> RowMessages:
        """Messages not yet sent."""
        buffer = Buffer.make(rounds, model)
        buffer.matrix[:, rounds.identity] = 1.0
        return cls(buffer, places, damping, model.frame.mean)

    @property
    def directed(self) -> Directed:
        """The messages' numbers."""
        return self.buffer.rounds.layout.directed

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.buffer.model.runs

    def round(self, messages: Sequence[int]) -> RowRound:
        """Lay out the computation of some messages, in stacks of one shape."""
        place = {message: k for k, message in enumerate(messages)}
        stacks = self.buffer.rounds.messages(messages)
        return RowRound(
            stacks, [np.array([place[m] for m in stack.members.tolist()]) for stack in stacks]
        )

    def propose(self, round: RowRound) -> Array:
        """Compute them from the messages kept; how much each would change, (messages, runs)."""
        self._proposed = []
        change = np.empty((sum(order.size for order in round.order), self.runs))
        for stack, order in zip(*round, strict=True):
            done, _ = self.buffer.eliminate(stack)
            self._proposed.append((stack, done.rest))
            old, against = self._kept(stack, reverse=False), self._kept(stack, reverse=True)
            change[order] = row_messages.change(old, done.rest, against)
        return change

    def _kept(self, stack: Stack | _Sepsets, *, reverse: bool) -> Rows:
        """The messages kept of a stack's members, or of those against them."""
        buffer, size = self.buffer, stack.kept
        entries, rows = buffer.out(stack.members ^ 1 if reverse else stack.members, size)
        shape = (buffer.matrix.shape[0], entries.shape[0], size, size)
        matrix, right = buffer.matrix[:, entries].reshape(shape), buffer.right[:, rows]
        if buffer.exact is None or buffer.exact_right is None:
            return Rows(matrix, right)
        return Rows(
            matrix, right, buffer.exact[:, entries].reshape(shape), buffer.exact_right[:, rows]
        )

    def accept(self, round: RowRound, active: Mask) -> None:
        """Keep what was proposed, damped, for the runs that are active.

        Runs that share matrices go on together, as long as their numbers are in range: the right
        sides of one would no longer fit matrices that settle further for another.
        """
        for stack, new in self._proposed:
            old = self._kept(stack, reverse=False)
            mixed = row_messages.damped(old, new, self.damping) if self.damping else new
            mixed = row_messages.steady(old, mixed)
            going = active
            if mixed.matrix.shape[0] == 1:
                going = active | (np.abs(mixed.right).max(axis=(0, 1, 2), initial=0.0) < LOST)
            if not going.all():
                mixed = row_messages.choose(going, mixed, old)
            self.buffer.store(stack, mixed, None)

    def relinearise(self, active: Mask) -> Array | None:
        """Linearise at the clusters' beliefs; how far the means are from the last point."""
        model = self.buffer.model
        if model.exact:
            return None
        found, logs = self.beliefs()
        self.buffer.require_finite(logs, range(logs.shape[1]))
        mean, std = found.components()
        move = moments.marginal_error(mean[None], self._point[None], std[None])
        self._point = np.where(active[:, None], mean, self._point)
        # What runs that are still on their way are linearised at is thrown away, but must exist.
        at = np.where(active[:, None, None], found.mean, 0.0)
        relinearise(replace(found, mean=at), model, active)
        self.buffer.refresh()
        return move

    def send_once(self, rounds: list[list[Stack]]) -> None:
        """Send the messages of a tree, in an order in which each is made of those before it."""
        for stacks in rounds:
            for stack in stacks:
                done, log_scale = self.buffer.eliminate(stack)
                self.buffer.store(stack, done.rest, log_scale)

    def kept(self, message: int) -> tuple[Rows, Array]:
        """A message, (V, s, s), and its log-scale, (V, N)."""
        rounds = self.buffer.rounds
        one = _Sepsets(np.array([message]), int(rounds.sizes[message]))
        log_scale = self.buffer.log_scale[:, len(self.places.sizes) + message]
        return row_messages.first(self._kept(one, reverse=False)), log_scale

    def belief(self, cluster: int) -> tuple[Rows, Array]:
        """A cluster's factor times all messages to it, (V, k, n), and its log-scale, (V, N)."""
        (stack,) = self.buffer.rounds.beliefs([cluster])
        factor = self.buffer.factor(stack)
        # Columns of the stack are in the order of elimination: here, all, in the scope's.
        return row_messages.first(factor), self.buffer.log_scale[:, stack.logs].sum(axis=2)[:, 0]

    def beliefs(self) -> tuple[Beliefs, Array]:
        """The moments of all clusters, and ln of their integrals, (V, clusters, N)."""
        buffer = self.buffer
        stacked, _, sides = buffer.right.shape
        found = Beliefs.empty(self.places, buffer.model.frame, stacked, sides)
        logs = np.empty((stacked, len(self.places.sizes), sides))
        for stack in buffer.rounds.all_beliefs:
            done, logs[:, stack.clusters] = buffer.eliminate(stack)
            found.mean[:, self.places.means(stack.clusters, stack.columns)] = done.offset
            found.cov[:, self.places.covs(stack.clusters, stack.columns)] = done.noise
        return found, logs

    def log_evidence(self, logs: Array) -> Array:
        """The Bethe value, (V, N): ln of the clusters' integrals less those of the sepsets."""
        total: Array = logs.sum(axis=1)
        sizes = self.buffer.rounds.sizes
        for size in np.unique(sizes).tolist():
            there = np.flatnonzero(sizes == size)[::2]
            stack = _Sepsets(there, size)
            both = (self._kept(stack, reverse=back) for back in (False, True))
            done = eliminate(row_messages.product(*both), size)
            layout = self.buffer.rounds.layout
            places = np.array([layout.components(layout.sepsets[m // 2]) for m in there.tolist()])
            unit = np.log(self.buffer.model.frame.scale[places]).sum(axis=1)
            total = total - (done.log_scale + unit[:, None]).sum(axis=1)
        return total


class _Sepsets(NamedTuple):
    """The numbers and the size of a stack's messages."""

    members: Integers
    kept: int
