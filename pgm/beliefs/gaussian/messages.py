"""Messages between clusters as rows: sent by rounds, damped, compared, and taken into beliefs.

A message is a factor exp(g − ½ ‖A ξ − r‖²) over the s components of a sepset. ξ are the components'
coordinates in a *frame*: distances from the prior's means (or those of a start), in the prior's
standard deviations. The *rows* of a message are A (V, s, s) and r (V, s, N), and g (V, N) is its
log-scale: V = 1 and N = runs where all runs share their matrices, else V = runs and N = 1.
Relations among a sepset's components that hold without noise are *exact relations*; a message keeps
them beside its rows.

Messages are numbered: m and m ^ 1 are the two messages along one edge, in opposite directions. A
*stack* is a batch of eliminations of equal shape, which gather the rows of clusters' CPDs and of
messages to them. A run is *lost* when its messages diverge, and *active* until it is lost or has
converged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.beliefs import Beliefs, Calibrated, Places, Sizes, relinearise
from pgm.beliefs.gaussian.rounds import Rounds, Stack
from pgm.beliefs.gaussian.row_buffer import Buffer
from pgm.kernels import moments, row_messages
from pgm.kernels.arrays import Array, Mask
from pgm.kernels.rows import Rows, eliminate
from pgm.schedules.rounds import Directed


class RowRound(NamedTuple):
    """A round: the numbers of its messages, and the batched eliminations that compute them."""

    messages: list[int]
    stacks: list[Stack]


@dataclass(eq=False)
class RowMessages:
    """The messages of a graph with loops, as `run_loopy` sends them, kept as rows in a buffer.

    Each starts as the factor exp(−½ |ξ|²): from any positive start the information matrices
    converge to the same fixed point, and from a proper start every message exists. `damping` is the
    share of the old message in a new one. `buffer` has the rows of CPDs and messages, and `places`
    tells where `Beliefs` of the clusters stand. `_point` (runs, size) are the means of all hidden
    components where CPDs were linearised last, `_proposed` the messages that `propose` computed
    last.
    """

    buffer: Buffer[Rounds]
    places: Places
    damping: float
    _point: Array
    _proposed: list[tuple[Stack, Rows]] = field(default_factory=list)

    @classmethod
    def make(cls, buffer: Buffer[Rounds], places: Places, damping: float) -> RowMessages:
        """The messages at their start, written into a buffer that still holds only zeros.

        The factors of the CPDs are written into it, too. Without damping `damping` is 0.
        """
        buffer.refresh()
        for size, members in buffer.rounds.by_size:
            entries, _ = buffer.out(members, size)
            buffer.proper.matrix[:, np.diagonal(entries, axis1=1, axis2=2)] = 1.0
        return cls(buffer, places, damping, buffer.model.frame.mean)

    @property
    def directed(self) -> Directed:
        """The numbers of the messages, with their source and target clusters."""
        return self.buffer.rounds.layout.directed

    @property
    def runs(self) -> int:
        """How many runs the messages are of: 1 if the user gave no axes of runs."""
        return self.buffer.model.runs

    @property
    def bounded(self) -> bool:
        """Whether a change has an upper bound: False, since it is in standard deviations."""
        return False

    def round(self, messages: Sequence[int]) -> RowRound:
        """Lay out some messages, by number, as batched eliminations of equal shape."""
        return RowRound(list(messages), self.buffer.rounds.messages(messages))

    def propose(self, round: RowRound) -> Array:
        """Compute a round's messages from the stored ones; returns their changes, (messages, runs).

        The computed messages are kept aside for `accept`. A change tells how much a new message
        changes the belief of its sepset: it is the largest number among the moves of the belief's
        means in standard deviations, the relative changes of its information, and the changes of
        the message's exact relations.
        """
        self._proposed = []
        change = np.empty((len(self.directed), self.runs))
        for stack in round.stacks:
            done, _ = self.buffer.eliminate(stack)
            self._proposed.append((stack, done.rest))
            old, against = (
                self.buffer.messages(members, stack.kept)
                for members in (stack.members, stack.members ^ 1)
            )
            change[stack.members] = row_messages.change(old, done.rest, against)
        return change[round.messages]

    def accept(self, round: RowRound, active: Mask, lost: Mask) -> None:
        """Store the messages that `propose` computed last, damped, in the `active` runs, (runs,).

        Where runs share their matrices (V = 1), new messages are stored in converged runs, too, for
        their right sides have to fit the shared matrices, which still change; then only the `lost`
        runs, (runs,), keep their old messages. `round` is that of `propose`.
        """
        for stack, new in self._proposed:
            old = self.buffer.messages(stack.members, stack.kept)
            mixed = row_messages.damped(old, new, self.damping) if self.damping else new
            mixed = row_messages.steady(old, mixed)
            going = ~lost if mixed.matrix.shape[0] == 1 else active
            if not going.all():
                mixed = row_messages.choose(going, mixed, old)
            self.buffer.store(stack, mixed, None)

    def relinearise(self, active: Mask) -> Array | None:
        """Linearise the CPDs of the active runs at the clusters' beliefs.

        Returns how far the means are from the last point of linearisation, (runs,), in standard
        deviations; None if all CPDs are affine.
        """
        model = self.buffer.model
        if model.exact:
            return None
        found, _ = self.beliefs()
        mean, std = found.components()
        move = moments.moved(mean[None], self._point[None], std[None])
        self._point = np.where(active[:, None], mean, self._point)
        # What runs that are still on their way are linearised at is thrown away, but must exist.
        at = np.where(active[:, None, None], found.mean, 0.0)
        relinearise(replace(found, mean=at), model, active)
        self.buffer.refresh()
        return move

    def send_once(self, rounds: list[list[Stack]]) -> None:
        """Send each message of a tree once.

        `rounds` are lists of stacks, whose messages are sent round by round: a round has to come
        after all rounds whose messages enter into its own messages.
        """
        for stacks in rounds:
            for stack in stacks:
                done, log_scale = self.buffer.eliminate(stack)
                self.buffer.store(stack, done.rest, log_scale)

    def kept(self, message: int) -> tuple[Rows, Array]:
        """The stored message of a number: its rows A (V, s, s) and r (V, s, N); its log-scale g."""
        size = int(self.buffer.rounds.sizes[message])
        one = self.buffer.messages(np.array([message]), size)
        log_scale = self.buffer.log_scale[:, len(self.places.blocks) + message]
        return row_messages.first(one), log_scale

    def belief(self, cluster: int) -> tuple[Rows, Array]:
        """The product of a cluster's CPDs and all messages to it: its rows and log-scale (V, N).

        The matrix is (V, k, n), the right side (V, k, N): the k rows are over the n hidden
        components of the cluster, in the order of its scope.
        """
        return self._product(*self.buffer.rounds.beliefs([cluster]))

    def potential(self, cluster: int) -> tuple[Rows, Array]:
        """The product of a cluster's CPDs, without messages: its rows and log-scale (V, N).

        The matrix is (V, k, n), the right side (V, k, N): the k rows are over the n hidden
        components of the cluster, in the order of its scope.
        """
        return self._product(*self.buffer.rounds.potentials([cluster]))

    def _product(self, stack: Stack) -> tuple[Rows, Array]:
        """The product of all factors that a stack gathers for its only cluster, as rows.

        The matrix is (V, k, n), the right side (V, k, N); the second result is the product's
        log-scale, (V, N).
        """
        factor = self.buffer.factor(stack)
        # Columns of the stack are in the order of elimination: here, all, in the scope's.
        return row_messages.first(factor), self.buffer.log_scale[:, stack.logs].sum(axis=2)[:, 0]

    def beliefs(self) -> tuple[Beliefs, Array]:
        """The moments of all clusters, and ln of the integrals of their factors, (V, clusters, N).

        A cluster's factor is the product of its CPDs and all messages to it. A belief that is not
        proper is a NumericalError.
        """
        buffer = self.buffer
        stacked, _, sides = buffer.proper.right.shape
        found = Beliefs.empty(self.places, buffer.model.frame, stacked, sides)
        logs = np.empty((stacked, len(self.places.blocks), sides))
        for stack in buffer.rounds.all_beliefs:
            done, logs[:, stack.clusters] = buffer.eliminate(stack)
            found.put(stack, done.offset, done.noise)
        buffer.require_finite(logs, range(logs.shape[1]))
        return found, logs

    def calibrated(self) -> Calibrated:
        """The beliefs, with Bethe's approximation of ln p(evidence).

        A cluster's factor is the product of its CPDs and all messages to it. The approximation is
        the sum of ln of the integrals of these factors, less another sum: for each sepset ln of the
        integral of the product of its two messages.
        """
        found, logs = self.beliefs()
        total: Array = logs.sum(axis=1)
        layout = self.buffer.rounds.layout
        for size, members in self.buffer.rounds.by_size:
            there, back = (self.buffer.messages(members[k::2], size) for k in (0, 1))
            done = eliminate(row_messages.product(there, back), size)
            edges = (members[::2] // 2).tolist()
            places = np.array([layout.components(layout.sepsets[edge]) for edge in edges])
            unit = np.log(self.buffer.model.frame.scale[places]).sum(axis=1)
            total = total - (done.log_scale + unit[:, None]).sum(axis=1)
        sizes = Sizes(self.buffer.largest, self.buffer.coarse)
        return Calibrated(found, total, sizes)
