"""The transition of a single run: one CPD after another makes the next slice."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

from pgm.compile import SliceLayout
from pgm.inference.chain.plan import Link
from pgm.kernels import moments, single
from pgm.kernels.arrays import Array, block

_HALF_TURN = np.pi
# F, F μ + b and the noise.
Affinity = tuple[Array, Array, Array]
# What tells a move which step it is to make: a row, or a step with what is known of it.
At = TypeVar("At")


class Move(ABC, Generic[At]):
    """A CPD of the transition.

    Attributes
    ----------
    full : bool
        Whether its noise is known to leave no component out.
    turning : list of (int, int)
        Where the child's angles stand, and where those of the step before.
    """

    full: bool

    def __init__(self, link: Link) -> None:
        self.child, self.parents = link.child, link.parents
        self.size = link.family.cpd.child.dimension
        angles = link.child.start + link.angles
        self.turning = list(zip(angles.tolist(), link.before.tolist(), strict=True))

    @abstractmethod
    def conditional(self, at: At, mean: Array, cov: Array) -> Affinity:
        """F, F μ + b and the noise at a belief over the hidden parents."""

    @abstractmethod
    def unwrap(self, at: At, before: Array, child: Array) -> None:
        """Undo whole turns of a function that wraps its angles, in place."""

    def keep_chart(self, at: At, before: Array, after: Array, front: int) -> None:
        """Keep the child, which stands in a vector less its front, on the chart it was on."""
        for angle, earlier in self.turning:
            if abs(after.item(angle - front) - before.item(earlier)) > _HALF_TURN:
                first = self.child.start - front
                self.unwrap(at, before, after[first : first + self.size])
                return


class Motion(Generic[At]):
    """The transition of a single run."""

    def __init__(self, layout: SliceLayout, moves: Sequence[Move[At]]) -> None:
        self.moves, self.single = moves, layout.single
        self.states = layout.state_places if layout.control_places.size else None
        self.front, self.size = layout.state_size, layout.state_size + layout.slice_size

    def predict(self, at: At, mean: Array, cov: Array) -> tuple[Array, Array]:
        """Moments of the slice from those of the slice before it."""
        front, states = self.front, self.states
        if states is not None:
            mean, cov = mean[states], block(cov, states, states)
        if self.single:
            move = self.moves[0]
            matrix, value, noise = move.conditional(at, mean, cov)
            if move.full:
                after, spread = value.copy(), single.predict(cov, matrix, noise)
            else:
                offset = value - matrix.dot(mean)
                after, spread = moments.predict(
                    mean, cov, moments.Conditional(matrix, offset, noise)
                )
            move.keep_chart(at, mean, after, front)
            return after, spread
        pair, pair_cov = np.zeros(self.size), np.zeros((self.size, self.size))
        pair[:front] = mean
        pair_cov[:front, :front] = cov
        for move in self.moves:
            child, parents = move.child, move.parents
            at_mean, at_cov = pair[parents], block(pair_cov, parents, parents)
            matrix, value, noise = move.conditional(at, at_mean, at_cov)
            if move.full:
                single.extend(pair, pair_cov, child, parents, matrix, value, noise)
            else:
                offset = value - matrix.dot(at_mean)
                moments.extend(pair, pair_cov, child, parents, matrix, offset, noise)
            move.keep_chart(at, pair, pair, 0)
        return pair[front:], pair_cov[front:, front:]
