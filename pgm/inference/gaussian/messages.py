"""Messages as rows, in one buffer with those of all factors: eliminated, sent, compared."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from pgm.errors import NumericalError
from pgm.factors.scope import names
from pgm.inference.gaussian.beliefs import (
    Beliefs,
    Calibrated,
    Flat,
    Places,
    make_potentials,
    relinearise,
)
from pgm.inference.gaussian.layout import Rounds, Stack
from pgm.inference.gaussian.model import Model, contradiction
from pgm.inference.loopy import Directed
from pgm.kernels import moments, rows
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.rows import Eliminated, Rows, eliminate


@dataclass(eq=False)
class Buffer:
    """Factors and messages as rows; see `Rounds` for where they stand.

    V runs have a matrix each and N = 1, or V = 1 matrix is for all of N runs; log-scales are (V,
    clusters + messages + 1, N), the last zero. `coarse` and `largest` are those of the factors and
    of all eliminations.
    """

    rounds: Rounds
    model: Model
    proper: Flat
    exact: Flat | None
    log_scale: Array
    coarse: float = 0.0
    largest: float = 0.0

    @classmethod
    def make(cls, rounds: Rounds, model: Model) -> Buffer:
        """A buffer in which nothing stands yet; see `refresh`."""
        stacked, sides = (1, model.runs) if model.shared else (model.runs, 1)
        entries, rows = int(rounds.entry_starts[-1]) + 1, int(rounds.row_starts[-1]) + 1
        logs = len(rounds.layout.scopes) + len(rounds.layout.directed) + 1
        proper = Flat(np.zeros((stacked, entries)), np.zeros((stacked, rows, sides)))
        return cls(rounds, model, proper, None, np.zeros((stacked, logs, sides)))

    def refresh(self) -> None:
        """Take the CPDs' factors as they are linearised; messages stay."""
        potentials = make_potentials(self.model)
        self.coarse = float(np.maximum(self.coarse, potentials.coarse))
        own = potentials.proper
        self.largest = float(np.maximum(self.largest, np.abs(own.matrix).max(initial=0.0)))
        there = slice(own.matrix.shape[1]), slice(own.right.shape[1])
        self.proper.put(*there, *own)
        if self.exact is None and potentials.exact is not None:
            # The noise of a linearised CPD may vanish later on.
            self.exact = Flat(np.zeros_like(self.proper.matrix), np.zeros_like(self.proper.right))
        if self.exact is not None:
            self.exact.put(*there, *(potentials.exact or ()))
        layout = self.rounds.layout
        self.log_scale[:, : len(layout.scopes)] = 0.0
        none = np.zeros(0, dtype=np.intp)
        clusters = np.concatenate([none, *(group.clusters for group in layout.groups)])
        np.add.at(self.log_scale.swapaxes(0, 1), clusters, potentials.log_scale.swapaxes(0, 1))

    def factor(self, stack: Stack) -> Rows:
        """The factors of a stack, products of clusters' CPDs and messages: (V, B, k, n)."""
        return self._rows(stack.entries, stack.rows)

    def _rows(self, entries: Integers, rows: Integers) -> Rows:
        exact = () if self.exact is None else self.exact.at(entries, rows)
        return Rows(*self.proper.at(entries, rows), *exact)

    def eliminate(self, stack: Stack) -> tuple[Eliminated, Array]:
        """The rows that a stack's elimination leaves, and their log-scale, (V, B, N)."""
        done = eliminate(self.factor(stack), stack.drop)
        self.largest = float(np.maximum(self.largest, done.largest))  # NaN stays
        if done.contradiction is not None and done.contradiction.any():
            v, b, n = (int(axis[0]) for axis in np.nonzero(done.contradiction))
            raise contradiction(self.model, int(stack.clusters[b]), max(v, n))
        unit = np.log(self.model.frame.scale[stack.components[:, : stack.drop]]).sum(axis=1)
        known = self.log_scale[:, stack.logs].sum(axis=2)
        return done, known + done.log_scale + unit[:, None]

    def out(self, messages: Integers, size: int) -> tuple[Integers, Integers]:
        """The places of the entries (B, s, s) and rows (B, s) of messages of one size."""
        inside = np.arange(size * size).reshape(size, size)
        entries = self.rounds.entry_starts[messages][:, None, None] + inside
        return entries, self.rounds.row_starts[messages][:, None] + np.arange(size)

    def messages(self, messages: Integers, size: int) -> Rows:
        """The messages of one size as they are kept, (V, B, s, s)."""
        return self._rows(*self.out(messages, size))

    def store(self, stack: Stack, rest: Rows, log_scale: Array | None) -> None:
        """Store a stack of messages."""
        entries, rows = self.out(stack.members, stack.kept)
        self.proper.put(entries, rows, rest.matrix, rest.right)
        if self.exact is not None and rest.exact is not None and rest.exact_right is not None:
            count = rest.exact.shape[2]
            self.exact.put(entries, rows)
            self.exact.put(entries[:, :count], rows[:, :count], rest.exact, rest.exact_right)
        if log_scale is not None:
            self.log_scale[:, len(self.rounds.layout.scopes) + stack.members] = log_scale

    def require_finite(self, done: Array, clusters: Iterable[int]) -> None:
        """Refuse a belief that does not exist."""
        if np.isfinite(done).all():
            return
        bad = ~np.isfinite(done).all(axis=(0, *range(2, done.ndim)))
        cluster = list(clusters)[int(np.flatnonzero(bad)[0])]
        scope = self.rounds.layout.scopes[cluster]
        if not scope:
            raise NumericalError(
                f"the density of the evidence in cluster {cluster} is beyond the range of float64: "
                "a measurement is more than 1e150 deviations from what the model expects",
                cluster=cluster,
            )
        raise NumericalError(
            f"cluster {cluster} has no proper belief over {names(scope)}: its information is "
            "singular in these numbers. Some noise is more than 1e11 times sharper than what else "
            "is known of its variables, or, on a graph with loops, messages diverged or CPDs "
            "without noise form a loop; scale the noise, or compile a junction tree",
            cluster=cluster,
        )


class RowRound(NamedTuple):
    """Some messages, and the stacks of one shape that compute them."""

    messages: list[int]
    stacks: list[Stack]


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
    def make(cls, buffer: Buffer, places: Places, damping: float) -> RowMessages:
        """Messages not yet sent, in a buffer without any."""
        buffer.refresh()
        for size, members in buffer.rounds.by_size:
            entries, _ = buffer.out(members, size)
            buffer.proper.matrix[:, np.diagonal(entries, axis1=1, axis2=2)] = 1.0
        return cls(buffer, places, damping, buffer.model.frame.mean)

    @property
    def directed(self) -> Directed:
        """The messages' numbers."""
        return self.buffer.rounds.layout.directed

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.buffer.model.runs

    @property
    def bounded(self) -> bool:
        """Means may move any number of deviations."""
        return False

    def round(self, messages: Sequence[int]) -> RowRound:
        """Lay out some messages, in stacks of one shape."""
        return RowRound(list(messages), self.buffer.rounds.messages(messages))

    def propose(self, round: RowRound) -> Array:
        """Compute them from the messages kept; how much each would change, (messages, runs)."""
        self._proposed = []
        change = np.empty((len(self.directed), self.runs))
        for stack in round.stacks:
            done, _ = self.buffer.eliminate(stack)
            self._proposed.append((stack, done.rest))
            old, against = (
                self.buffer.messages(members, stack.kept)
                for members in (stack.members, stack.members ^ 1)
            )
            change[stack.members] = rows.change(old, done.rest, against)
        return change[round.messages]

    def accept(self, round: RowRound, active: Mask, lost: Mask) -> None:
        """Keep what was proposed, damped, for the runs that are active.

        Runs that share matrices go on together: else the right sides of one would no longer fit
        matrices that settle further for another. Only those that are lost stay behind.
        """
        for stack, new in self._proposed:
            old = self.buffer.messages(stack.members, stack.kept)
            mixed = rows.damped(old, new, self.damping) if self.damping else new
            mixed = rows.steady(old, mixed)
            going = ~lost if mixed.matrix.shape[0] == 1 else active
            if not going.all():
                mixed = rows.choose(going, mixed, old)
            self.buffer.store(stack, mixed, None)

    def relinearise(self, active: Mask) -> Array | None:
        """Linearise at the clusters' beliefs; how far the means are from the last point."""
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
        """Send the messages of a tree, in an order in which each is made of those before it."""
        for stacks in rounds:
            for stack in stacks:
                done, log_scale = self.buffer.eliminate(stack)
                self.buffer.store(stack, done.rest, log_scale)

    def kept(self, message: int) -> tuple[Rows, Array]:
        """A message, (V, s, s), and its log-scale, (V, N)."""
        size = int(self.buffer.rounds.sizes[message])
        one = self.buffer.messages(np.array([message]), size)
        log_scale = self.buffer.log_scale[:, len(self.places.sizes) + message]
        return rows.first(one), log_scale

    def belief(self, cluster: int) -> tuple[Rows, Array]:
        """A cluster's factor times all messages to it, (V, k, n), and its log-scale, (V, N)."""
        return self._product(*self.buffer.rounds.beliefs([cluster]))

    def potential(self, cluster: int) -> tuple[Rows, Array]:
        """A cluster's factor alone, (V, k, n), and its log-scale, (V, N)."""
        return self._product(*self.buffer.rounds.potentials([cluster]))

    def _product(self, stack: Stack) -> tuple[Rows, Array]:
        factor = self.buffer.factor(stack)
        # Columns of the stack are in the order of elimination: here, all, in the scope's.
        return rows.first(factor), self.buffer.log_scale[:, stack.logs].sum(axis=2)[:, 0]

    def beliefs(self) -> tuple[Beliefs, Array]:
        """The moments of all clusters, and ln of their integrals, (V, clusters, N)."""
        buffer = self.buffer
        stacked, _, sides = buffer.proper.right.shape
        found = Beliefs.empty(self.places, buffer.model.frame, stacked, sides)
        logs = np.empty((stacked, len(self.places.sizes), sides))
        for stack in buffer.rounds.all_beliefs:
            done, logs[:, stack.clusters] = buffer.eliminate(stack)
            found.put(stack, done.offset, done.noise)
        buffer.require_finite(logs, range(logs.shape[1]))
        return found, logs

    def calibrated(self) -> Calibrated:
        """The beliefs, and the Bethe value: ln of the clusters' integrals less the sepsets'."""
        found, logs = self.beliefs()
        total: Array = logs.sum(axis=1)
        layout = self.buffer.rounds.layout
        for size, members in self.buffer.rounds.by_size:
            there, back = (self.buffer.messages(members[k::2], size) for k in (0, 1))
            done = eliminate(rows.product(there, back), size)
            edges = (members[::2] // 2).tolist()
            places = np.array([layout.components(layout.sepsets[edge]) for edge in edges])
            unit = np.log(self.buffer.model.frame.scale[places]).sum(axis=1)
            total = total - (done.log_scale + unit[:, None]).sum(axis=1)
        return Calibrated(found, total)
