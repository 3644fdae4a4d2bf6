"""Information rows of all factors and messages in one buffer, eliminated in batches.

A CPD, or a message, is a factor exp(g − ½ ‖A ξ − r‖²) over n components ξ, in units of the prior's
standard deviations. It is kept as k *rows*, a matrix A (k, n) with right sides r (k, N),
and as the log-scale g. V is the number of matrices that are kept of a factor, and N the number of
right sides of each: V = 1 and N = runs where all runs share their matrices, else V = runs and N =
1. The buffer has the *entries* of all matrices along one axis, and the right sides along another;
their indices are laid out by `Rounds`. A *stack* is a batch of B eliminations of equal shape, each
of which gathers the rows of a cluster's CPDs and of messages to it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from pgm.beliefs.gaussian.assembly import Assembly
from pgm.beliefs.gaussian.beliefs import Flat
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.potentials import Potentials, make_potentials
from pgm.beliefs.gaussian.refusals import contradiction, improper
from pgm.beliefs.gaussian.rounds import Stack
from pgm.kernels.arrays import LOG_2PI, Array, Integers
from pgm.kernels.rows import Eliminated, Rows, eliminate


class Places(Protocol):
    """Where the rows of factors and messages stand in a buffer.

    A zero follows the last message, and the entry of unit rows follows it.
    """

    @property
    def assembly(self) -> Assembly:
        """The factors, whose rows come first."""

    @property
    def entry_starts(self) -> Integers:
        """The index of each message's first entry, and of the zero, (messages + 1,)."""

    @property
    def row_starts(self) -> Integers:
        """The index of each message's first row, and of the zero, (messages + 1,)."""

    @property
    def logs(self) -> int:
        """How many log-scales there are."""

    @property
    def of_cluster(self) -> Integers:
        """The number of the log-scale of each cluster's CPDs, (clusters,)."""


Standing = TypeVar("Standing", bound=Places)


@dataclass(eq=False)
class Buffer(Generic[Standing]):
    """Factors and messages as rows; `rounds` tells where each of them stands.

    `proper` are the rows with noise. `exact` are the rows of relations without noise, None if there
    are none. `log_scale` (V, clusters + messages + 1, N) has the log-scales of each cluster's CPDs,
    of each message, then a zero. Two numbers tell how many digits float64 keeps: `coarse` is a
    tenth of the largest summand of a CPD's residual, in standard deviations of its noise, or
    infinite where rounding may decide which rows are exact; `largest` is the largest entry of all
    factors and eliminations.
    """

    rounds: Standing
    model: Model
    proper: Flat
    exact: Flat | None
    log_scale: Array
    coarse: float = 0.0
    largest: float = 0.0

    @classmethod
    def make(cls, rounds: Standing, model: Model) -> Buffer[Standing]:
        """A buffer of zeros, for a model whose factors `refresh` puts in."""
        stacked, sides = (1, model.runs) if model.shared else (model.runs, 1)
        entries, rows = int(rounds.entry_starts[-1]) + 2, int(rounds.row_starts[-1]) + 1
        proper = Flat(np.zeros((stacked, entries)), np.zeros((stacked, rows, sides)))
        proper.matrix[:, -1] = 1.0
        return cls(rounds, model, proper, None, np.zeros((stacked, rounds.logs, sides)))

    def refresh(self, potentials: Potentials | None = None) -> None:
        """Put in the CPDs' factors as they are linearised now; the messages stay.

        `potentials` are these factors, if they have been made already.
        """
        potentials = potentials or make_potentials(self.model)
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
        clusters = self.rounds.assembly.clusters
        logs = self.rounds.of_cluster
        self.log_scale[:, logs] = 0.0
        np.add.at(
            self.log_scale.swapaxes(0, 1), logs[clusters], potentials.log_scale.swapaxes(0, 1)
        )

    def factor(self, stack: Stack) -> Rows:
        """The rows that a stack's B eliminations gather: A (V, B, k, n) and r (V, B, k, N)."""
        return self._rows(stack.entries, stack.rows)

    def _rows(self, entries: Integers, rows: Integers) -> Rows:
        """The rows A (V, B, k, n) at indices `entries` (B, k, n), with r at `rows` (B, k)."""
        exact = () if self.exact is None else self.exact.at(entries, rows)
        return Rows(*self.proper.at(entries, rows), *exact)

    def eliminate(self, stack: Stack, clusters: Integers | None = None) -> tuple[Eliminated, Array]:
        """Integrate the first `stack.drop` columns out of each of a stack's B factors.

        Returns two results. The first, stacked (V, B, ...), has the conditionals of these columns
        given the others, and the rows of the integrals, which are factors over the others. The
        second are the log-scales of the integrals, (V, B, N), taken in the user's units. Exact
        relations that contradict one another are a NumericalError. It names the stack's cluster,
        which is that of a front in `clusters` (fronts,).
        """
        factor = self.factor(stack)
        if factor.exact is None or any(np.any(part) for part in factor[2:]):
            done = eliminate(factor, stack.drop)
        else:  # as at most clusters of a network that has relations
            done = eliminate(Rows(factor.matrix, factor.right), stack.drop)
            none = np.zeros_like(done.rest.matrix), np.zeros_like(done.rest.right)
            done = done._replace(rest=Rows(done.rest.matrix, done.rest.right, *none))
        self.largest = float(np.maximum(self.largest, done.largest))  # NaN stays
        if done.contradiction is not None and done.contradiction.any():
            v, b, n = np.nonzero(done.contradiction)
            where = stack.clusters[b[0]] if clusters is None else clusters[stack.clusters[b[0]]]
            raise contradiction(self.model, int(where), (v, n))
        scale = np.append(self.model.frame.scale, 1.0)
        unit = np.log(scale[stack.components[:, : stack.drop]]).sum(axis=1)
        unit = unit - 0.5 * LOG_2PI * stack.padded
        known = self.log_scale[:, stack.logs].sum(axis=2)
        total = known + done.log_scale + unit[:, None]
        nothing = stack.components[:, stack.drop :] == len(scale) - 1
        if nothing[:, -1:].any():  # rows that are left over no component are of the residual
            residual = np.where(nothing[..., None], done.rest.right, 0.0)
            total = total - 0.5 * np.square(residual).sum(axis=-2)
        return done, total

    def out(self, messages: Integers, size: int) -> tuple[Integers, Integers]:
        """The indices at which the buffer has the rows of some messages, by their numbers (B,).

        Returns the indices of the entries, (B, s, s), and those of the right sides, (B, s). The
        sepset of each of the messages has s = `size` components.
        """
        inside = np.arange(size * size).reshape(size, size)
        entries = self.rounds.entry_starts[messages][:, None, None] + inside
        return entries, self.rounds.row_starts[messages][:, None] + np.arange(size)

    def messages(self, messages: Integers, size: int) -> Rows:
        """The rows A (V, B, s, s) and r (V, B, s, N) of stored messages, by their numbers (B,).

        Each is over s = `size` components.
        """
        return self._rows(*self.out(messages, size))

    def store(self, stack: Stack, rest: Rows, log_scale: Array | None) -> None:
        """Store a stack's messages: the rows `rest`, of A (V, B, s, s), and log-scales (V, B, N).

        If `log_scale` is None, the messages' log-scales stay as they are.
        """
        entries, rows = self.out(stack.members, stack.kept)
        self.proper.put(entries, rows, rest.matrix, rest.right)
        if self.exact is not None and rest.exact is not None and rest.exact_right is not None:
            count = rest.exact.shape[2]
            self.exact.put(entries, rows)
            self.exact.put(entries[:, :count], rows[:, :count], rest.exact, rest.exact_right)
        if log_scale is not None:
            self.log_scale[:, len(self.rounds.of_cluster) + stack.members] = log_scale

    def require_finite(self, done: Array, clusters: Iterable[int]) -> None:
        """Refuse log-scales that are not finite, by a NumericalError naming the first cluster.

        `done` (V, B, N) are the log-scales of B eliminations, `clusters` (B,) the clusters in which
        they were made.
        """
        if np.isfinite(done).all():
            return
        bad = ~np.isfinite(done).all(axis=(0, *range(2, done.ndim)))
        cluster = list(clusters)[int(np.flatnonzero(bad)[0])]
        raise improper(self.model, self.rounds.assembly, cluster, self.proper.matrix)
