"""Calibrating a tree: rows are eliminated towards the roots, moments pushed back.

Upward, each cluster integrates out its components c that are not in the sepset s with its parent.
It keeps their conditional, c = G s + offset + noise, with the *gain* G; this is a sparse QR
factorisation. Downward, the parent's moments of s go through the conditional, which gives those of
c. Nothing is divided or subtracted, and covariances may be singular.

A CPD or message is a factor exp(−½ ‖A ξ − r‖²), and is kept as *rows*: those of A, with right sides
r. The rows of all CPDs and messages stand in one buffer. A *stack* is a batch of B eliminations of
equal shape, which compute B messages or beliefs. V is 1 where all runs share their covariances,
else the number of runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.beliefs.gaussian.beliefs import Beliefs, Calibrated, Places
from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.rounds import Rounds, Stack
from pgm.beliefs.gaussian.row_buffer import Buffer
from pgm.clustergraph.structure import Forest
from pgm.kernels import dense, step
from pgm.kernels.arrays import Array, Integers, frozen, transpose
from pgm.kernels.rows import Eliminated
from pgm.progress import counted
from pgm.schedules.iteration import Anchor

# Variances below this, in units of the prior's, are rounding of what exact relations determine.
CERTAIN = 1e-28


@dataclass(frozen=True, eq=False)
class TreePlan:
    """The plan of both passes over a tree: their rounds, and where rows and moments stand."""

    layout: Layout

    @cached_property
    def rounds(self) -> Rounds:
        """Where the rows of factors and messages stand in the buffer."""
        return Rounds(self.layout)

    @cached_property
    def places(self) -> Places:
        """Where the moments of clusters stand in `Beliefs`."""
        return Places(self.layout)

    @cached_property
    def forest(self) -> Forest:
        """The trees of the graph, each with a root."""
        return Forest.of(self.layout.graph)

    @cached_property
    def levels(self) -> list[list[Stack]]:
        """Stacks of messages to parents, in a list for each depth of the tree, deepest first.

        The last list has the stacks of the roots' beliefs.
        """
        *below, roots = reversed(self.forest.levels)
        found = [self.rounds.messages(self.upward[level].tolist()) for level in below]
        return [*found, self.rounds.beliefs(roots.tolist())]

    @cached_property
    def upward(self) -> Integers:
        """The number of each cluster's message to its parent, (clusters,); −1 of a root."""
        source, target = self.layout.directed.source, self.layout.directed.target
        found = np.full(len(self.forest.parent), -1)
        messages = np.flatnonzero(self.forest.parent[source] == target)
        found[source[messages]] = messages
        return found

    @cached_property
    def senders(self) -> dict[int, tuple[int, int, int]]:
        """For each cluster with a parent, where `levels` has its message to the parent.

        It is the index of a level, that of a stack in it, and that of the message in the stack.
        """
        return {
            cluster: (level, k, row)
            for level, stacks in enumerate(self.levels[:-1])
            for k, stack in enumerate(stacks)
            for row, cluster in enumerate(stack.clusters.tolist())
        }

    @cached_property
    def both_ways(self) -> list[list[Stack]]:
        """Rounds of stacks: messages to parents, deepest first, then messages to children."""
        downward = (self.upward[level] ^ 1 for level in self.forest.levels[1:])
        down = [self.rounds.messages(messages.tolist()) for messages in downward]
        return [*self.levels[:-1], *down]

    @cached_property
    def separators(self) -> list[list[tuple[Integers, Integers]]]:
        """For each stack of messages to parents, where `Beliefs` has the moments of their sepsets.

        These are moments of the parents' beliefs. separators[level][stack] is a pair of flat
        indices, of means (B, s) and covariances (B, s, s), for the B messages of
        ``levels[level][stack]``.
        """
        parent = self.forest.parent
        return [
            [
                self.places.of(parent[stack.clusters], stack.components[:, stack.drop :])
                for stack in level
            ]
            for level in self.levels[:-1]
        ]


@dataclass(frozen=True, eq=False)
class TreeBeliefs(Beliefs):
    """Moments of a tree's clusters, with the gains G of the upward pass.

    gains[level][stack] (V, B, c, s) are those of the B clusters whose messages to their parents
    ``TreePlan.levels[level][stack]`` computes. Each is the regression of the c components that the
    cluster integrates out on the s components of the sepset with its parent.
    """

    gains: list[list[Array]]


def calibrate(plan: TreePlan, buffer: Buffer, anchor: Anchor | None = None) -> Calibrated:
    """The beliefs of a tree, and ln p(evidence): both passes, with the CPDs as linearised now.

    An anchor's measurement is added to them, if there is one; the layout has to be anchored then.
    Measurements that contradict CPDs without noise, and a belief that is not proper, are a
    NumericalError.
    """
    buffer.refresh(anchor)
    kept: list[list[Eliminated]] = []
    stacked, _, sides = buffer.proper.right.shape
    total = np.zeros((stacked, sides))
    for level in counted(plan.levels, "up the tree"):
        kept.append([])
        for stack in level:
            done, log_scale = buffer.eliminate(stack)
            buffer.require_finite(log_scale, stack.clusters.tolist())
            kept[-1].append(done)
            if level is plan.levels[-1]:
                total += log_scale.sum(axis=1)
            else:
                buffer.store(stack, done.rest, log_scale)
    blank = Beliefs.empty(plan.places, buffer.model.frame, stacked, sides)
    gains = [[done.gain for done in results] for results in kept[:-1]]
    beliefs = TreeBeliefs(blank.places, blank.frame, blank.mean, blank.cov, gains)
    exact = buffer.exact is not None
    for stack, done in zip(plan.levels[-1], kept[-1], strict=True):
        beliefs.put(stack, done.offset, _certain(done.noise) if exact else done.noise)
    below = list(zip(plan.levels[:-1], plan.separators, kept[:-1], strict=True))
    for level, separators, results in reversed(below):
        for stack, (where, entries), done in zip(level, separators, results, strict=True):
            at, spread = beliefs.mean[:, where], beliefs.cov[:, entries]
            parts = dense.Stack(spread, True), dense.Stack(done.gain), dense.Stack(done.noise)
            cross, own = (each.array for each in step.crossed(*parts))
            if exact:
                own = _certain(own)
                cross = np.where(
                    (np.diagonal(own, axis1=-2, axis2=-1) > 0.0)[..., None], cross, 0.0
                )
            beliefs.put(
                stack,
                np.concatenate([done.gain @ at + done.offset, at], axis=2),
                np.block([[own, cross], [transpose(cross), spread]]),
            )
    return Calibrated(beliefs, frozen(total))


def _certain(cov: Array) -> Array:
    """Covariances (..., n, n) in which variances of at most 10⁻²⁸, mere rounding, are set to zero.

    Variances are in units of the prior's. The covariances of such a component are set to zero, too.
    """
    open_ = np.diagonal(cov, axis1=-2, axis2=-1) > CERTAIN
    if open_.all():
        return cov
    return np.where(open_[..., None] & open_[..., None, :], cov, 0.0)
