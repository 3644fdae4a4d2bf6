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
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Integers, Mask, transpose
from pgm.kernels.rows import Rows, eliminate, triangular

# Exact relations that differ by less, in units of the frame, differ by rounding.
_STEADY = 1e-12


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
            change[order] = self._change(stack, done.rest)
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

    def _change(self, stack: Stack, new: Rows) -> Array:
        """How much the sepset beliefs would move, (B, runs): means and variances, relatively.

        With a new message's information K and h and the sender's belief N(m, D²): the largest of
        D |ΔK| D and D |Δh − ΔK m|.
        """
        old, other = self._kept(stack, reverse=False), self._kept(stack, reverse=True)
        belief = eliminate(_product(new, other), stack.kept)
        std = np.sqrt(np.maximum(np.diagonal(belief.noise, axis1=-2, axis2=-1), 0.0))[..., None]
        information = transpose(new.matrix) @ new.matrix - transpose(old.matrix) @ old.matrix
        vector = transpose(new.matrix) @ new.right - transpose(old.matrix) @ old.right
        spread = np.abs(std * information * transpose(std)).max(axis=(-2, -1), initial=0.0)
        shift = np.abs(std * (vector - information @ belief.offset)).max(axis=-2, initial=0.0)
        change = np.maximum(spread[..., None], shift)
        relations = _moved(new, old)
        if relations is not None:
            change = np.maximum(change, relations)
        change = np.where(np.isnan(change), np.inf, change)
        return change[0] if change.shape[0] == 1 else change[..., 0].swapaxes(0, 1)

    def accept(self, round: RowRound, active: Mask) -> None:
        """Keep what was proposed, damped, for the runs that are active.

        Runs that share matrices go on together, as long as their numbers are in range: the right
        sides of one would no longer fit matrices that settle further for another.
        """
        for stack, new in self._proposed:
            old = self._kept(stack, reverse=False)
            mixed = _steady(self._damped(old, new) if self.damping else new, old)
            going = active
            if mixed.matrix.shape[0] == 1:
                going = active | (np.abs(mixed.right).max(axis=(0, 1, 2), initial=0.0) < LOST)
            if not going.all():
                mixed = _where(going, mixed, old)
            self.buffer.store(stack, mixed, None)

    def _damped(self, old: Rows, new: Rows) -> Rows:
        """The geometric mean: information adds up with the shares of both."""
        kept, taken = np.sqrt(self.damping), np.sqrt(1.0 - self.damping)
        size = new.matrix.shape[-1]
        both = triangular(
            np.concatenate([taken * new.matrix, kept * old.matrix], axis=-2),
            np.concatenate([taken * new.right, kept * old.right], axis=-2),
        )
        return new._replace(matrix=both[..., :size, :size], right=both[..., :size, size:])

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
        return _first(self._kept(one, reverse=False)), log_scale

    def belief(self, cluster: int) -> tuple[Rows, Array]:
        """A cluster's factor times all messages to it, (V, k, n), and its log-scale, (V, N)."""
        (stack,) = self.buffer.rounds.beliefs([cluster])
        factor = self.buffer.factor(stack)
        # Columns of the stack are in the order of elimination: here, all, in the scope's.
        return _first(factor), self.buffer.log_scale[:, stack.logs].sum(axis=2)[:, 0]

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
            both = _product(self._kept(stack, reverse=False), self._kept(stack, reverse=True))
            done = eliminate(both, size)
            layout = self.buffer.rounds.layout
            places = np.array([layout.components(layout.sepsets[m // 2]) for m in there.tolist()])
            unit = np.log(self.buffer.model.frame.scale[places]).sum(axis=1)
            total = total - (done.log_scale + unit[:, None]).sum(axis=1)
        return total


class _Sepsets(NamedTuple):
    """What tells the messages of a stack: their numbers and size."""

    members: Integers
    kept: int


def _product(a: Rows, b: Rows) -> Rows:
    """Of two stacks of factors: their rows together."""
    exact = None if a.exact is None or b.exact is None else _together(a.exact, b.exact)
    sides = (
        None
        if a.exact_right is None or b.exact_right is None
        else _together(a.exact_right, b.exact_right)
    )
    return Rows(_together(a.matrix, b.matrix), _together(a.right, b.right), exact, sides)


def _first(stack: Rows) -> Rows:
    """The only factor of a stack."""
    matrix, right, exact, sides = stack
    return Rows(
        matrix[:, 0],
        right[:, 0],
        None if exact is None else exact[:, 0],
        None if sides is None else sides[:, 0],
    )


def _together(a: Array, b: Array) -> Array:
    return np.concatenate([a, b], axis=-2)


def _moved(new: Rows, old: Rows) -> Array | None:
    """How much exact relations differ, (V, B, N), whatever rows they are written as."""
    if new.exact is None or old.exact is None:
        return None
    assert new.exact_right is not None
    assert old.exact_right is not None
    relations = transpose(new.exact) @ new.exact - transpose(old.exact) @ old.exact
    sides = transpose(new.exact) @ new.exact_right - transpose(old.exact) @ old.exact_right
    far = np.abs(relations).max(axis=(-2, -1), initial=0.0)[..., None]
    moved: Array = np.maximum(far, np.abs(sides).max(axis=-2, initial=0.0))
    return moved


def _steady(new: Rows, old: Rows) -> Rows:
    """New rows, but exact relations as they were where they differ by rounding.

    Loops feed certainties back to themselves, and can amplify their rounding without end.
    """
    moved = _moved(new, old)
    if moved is None:
        return new
    assert new.exact is not None
    assert old.exact is not None
    assert new.exact_right is not None
    assert old.exact_right is not None
    same = (moved.max(axis=-1) < _STEADY)[..., None, None]
    count = new.exact.shape[-2]
    return new._replace(
        exact=np.where(same, old.exact[..., :count, :], new.exact),
        exact_right=np.where(same, old.exact_right[..., :count, :], new.exact_right),
    )


def _where(active: Mask, new: Rows, old: Rows) -> Rows:
    """New rows for the runs that are active; runs that share matrices have right sides alone."""
    shared = new.matrix.shape[0] == 1

    def matrix(a: Array, b: Array) -> Array:
        return a if shared else np.where(active[:, None, None, None], a, b)

    def right(a: Array, b: Array) -> Array:
        return np.where(active if shared else active[:, None, None, None], a, b)

    if new.exact is None or old.exact is None:
        return Rows(matrix(new.matrix, old.matrix), right(new.right, old.right))
    assert new.exact_right is not None
    assert old.exact_right is not None
    count = new.exact.shape[-2]
    return Rows(
        matrix(new.matrix, old.matrix),
        right(new.right, old.right),
        matrix(new.exact, old.exact[..., :count, :]),
        right(new.exact_right, old.exact_right[..., :count, :]),
    )
