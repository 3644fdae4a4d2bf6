"""The rows of all factors and messages, and eliminations of stacks of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pgm.errors import NumericalError
from pgm.factors.scope import names
from pgm.inference.gaussian.model import Model
from pgm.inference.gaussian.potentials import Potentials, make_potentials
from pgm.inference.gaussian.refusals import contradiction
from pgm.inference.gaussian.rounds import Rounds, Stack
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.rows import Eliminated, Rows, eliminate


@dataclass(eq=False)
class Buffer:
    """Factors and messages as rows; see `Rounds` for where they stand.

    Attributes
    ----------
    rounds : Rounds
    model : Model
    matrix, right : ndarray
        (V, entries) and (V, rows, N): V runs with a matrix each and N = 1, or V = 1 matrix for
        all of N runs.
    exact, exact_right : ndarray or None
        The same for exact relations; None where there are none.
    log_scale : ndarray
        (V, clusters + messages + 1, N); the last is zero.
    coarse, largest : float
        The largest of the factors' `coarse`, and of their entries and all eliminations' `largest`.
    """

    rounds: Rounds
    model: Model
    matrix: Array
    right: Array
    exact: Array | None
    exact_right: Array | None
    log_scale: Array
    coarse: float = 0.0
    largest: float = 0.0

    @classmethod
    def make(cls, rounds: Rounds, model: Model) -> Buffer:
        """A buffer in which every message says nothing yet."""
        potentials = make_potentials(model)
        stacked, _, sides = potentials.right.shape
        entries, rows = int(rounds.entry_starts[-1]) + 1, int(rounds.row_starts[-1]) + 1
        logs = len(rounds.layout.scopes) + len(rounds.layout.directed) + 1
        singular = potentials.exact is not None
        buffer = cls(
            rounds,
            model,
            np.zeros((stacked, entries)),
            np.zeros((stacked, rows, sides)),
            np.zeros((stacked, entries)) if singular else None,
            np.zeros((stacked, rows, sides)) if singular else None,
            np.zeros((stacked, logs, sides)),
        )
        buffer._put(potentials)
        return buffer

    def refresh(self) -> None:
        """Take the CPDs' factors anew, after they were linearised; messages stay."""
        self._put(make_potentials(self.model))

    def _put(self, potentials: Potentials) -> None:
        self.coarse = float(np.maximum(self.coarse, potentials.coarse))
        largest = np.abs(potentials.matrix).max(initial=0.0)
        self.largest = float(np.maximum(self.largest, largest))
        entries, rows = potentials.matrix.shape[1], potentials.right.shape[1]
        self.matrix[:, :entries], self.right[:, :rows] = potentials.matrix, potentials.right
        if self.exact is None and potentials.exact is not None:
            # The noise of a linearised CPD may vanish later on.
            self.exact, self.exact_right = np.zeros_like(self.matrix), np.zeros_like(self.right)
        if self.exact is not None and self.exact_right is not None:
            proper = potentials.exact is None or potentials.exact_right is None
            self.exact[:, :entries] = 0.0 if proper else potentials.exact
            self.exact_right[:, :rows] = 0.0 if proper else potentials.exact_right
        layout = self.rounds.layout
        self.log_scale[:, : len(layout.scopes)] = 0.0
        none = np.zeros(0, dtype=np.intp)
        clusters = np.concatenate([none, *(group.clusters for group in layout.groups)])
        np.add.at(self.log_scale.swapaxes(0, 1), clusters, potentials.log_scale.swapaxes(0, 1))

    def factor(self, stack: Stack) -> Rows:
        """The factors of a stack, products of clusters' CPDs and messages: (V, B, k, n)."""
        if self.exact is None or self.exact_right is None:
            return Rows(self.matrix[:, stack.entries], self.right[:, stack.rows])
        return Rows(
            self.matrix[:, stack.entries],
            self.right[:, stack.rows],
            self.exact[:, stack.entries],
            self.exact_right[:, stack.rows],
        )

    def eliminate(self, stack: Stack) -> tuple[Eliminated, Array]:
        """The rows that a stack's elimination leaves, and their log-scale, (V, B, N)."""
        done = eliminate(self.factor(stack), stack.drop)
        self.largest = float(np.maximum(self.largest, done.largest))  # NaN stays
        if done.contradiction is not None and done.contradiction.any():
            self._refuse_contradiction(stack, done.contradiction)
        unit = np.log(self.model.frame.scale[stack.components[:, : stack.drop]]).sum(axis=1)
        known = self.log_scale[:, stack.logs].sum(axis=2)
        return done, known + done.log_scale + unit[:, None]

    def out(self, messages: Integers, size: int) -> tuple[Integers, Integers]:
        """Where the entries and rows of messages of one size stand."""
        entries = self.rounds.entry_starts[messages][:, None] + np.arange(size * size)
        return entries, self.rounds.row_starts[messages][:, None] + np.arange(size)

    def store(self, stack: Stack, rest: Rows, log_scale: Array | None) -> None:
        """Keep what a stack of messages came to."""
        entries, rows = self.out(stack.members, stack.kept)
        self.matrix[:, entries] = rest.matrix.reshape(*rest.matrix.shape[:2], -1)
        self.right[:, rows] = rest.right
        if self.exact is not None and self.exact_right is not None and rest.exact is not None:
            count = rest.exact.shape[2]
            self.exact[:, entries] = 0.0
            self.exact_right[:, rows] = 0.0
            self.exact[:, entries[:, : count * stack.kept]] = rest.exact.reshape(
                *rest.exact.shape[:2], -1
            )
            self.exact_right[:, rows[:, :count]] = rest.exact_right
        if log_scale is not None:
            self.log_scale[:, len(self.rounds.layout.scopes) + stack.members] = log_scale

    def _refuse_contradiction(self, stack: Stack, where: Mask) -> None:
        v, b, n = (int(axis[0]) for axis in np.nonzero(where))
        cluster = int(stack.clusters[b])
        raise contradiction(self.model, cluster, max(v, n))

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
                "a reading is more than 1e150 deviations from what the model expects",
                cluster=cluster,
            )
        raise NumericalError(
            f"cluster {cluster} has no proper belief over {names(scope)}: its information is "
            "singular in these numbers. Some noise is more than 1e11 times sharper than what else "
            "is known of its variables, or, on a graph with loops, messages diverged or CPDs "
            "without noise form a loop; scale the noise, or compile a junction tree",
            cluster=cluster,
        )
