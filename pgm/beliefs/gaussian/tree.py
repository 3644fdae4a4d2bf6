"""Calibrating a tree: rows are eliminated towards the roots, moments pushed back.

The clusters are joined to *fronts*. Upward, each front integrates out its pivots c, the components
that are not among its separators s, which it shares with its parent. It keeps their conditional,
c = G s + offset + noise, with the *gain* G; this is a sparse QR factorisation. Downward, the
parent's moments of s go through the conditional, which gives those of c. Nothing is divided or
subtracted, and covariances may be singular.

A CPD or message is a factor exp(−½ ‖A ξ − r‖²), and is kept as *rows*: those of A, with right sides
r. The rows of all CPDs and messages stand in one buffer. A *stack* is a batch of B eliminations of
equal shape. V is 1 where all runs share their covariances,
else the number of runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.assembly import Assembly
from pgm.beliefs.gaussian.beliefs import Beliefs, Calibrated, Places, Sizes
from pgm.beliefs.gaussian.blocks import Blocks
from pgm.beliefs.gaussian.downward import Regression, certain, magnified, moments
from pgm.beliefs.gaussian.front_squares import FrontSquares
from pgm.beliefs.gaussian.front_stacks import FrontStacks
from pgm.beliefs.gaussian.fronts import FEW, SEVERAL, Fronts
from pgm.beliefs.gaussian.hidden_noise import Candidates, HiddenNoise
from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.machine_plan import told
from pgm.beliefs.gaussian.potentials import Potentials
from pgm.beliefs.gaussian.prior import Frame
from pgm.beliefs.gaussian.rounds import Rounds, Stack
from pgm.beliefs.gaussian.row_buffer import Buffer
from pgm.clustergraph.structure import Forest
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.machine.fronts.plan import Plan
from pgm.progress import counted


@dataclass(frozen=True, eq=False)
class TreePlan:
    """The plan of the passes over a tree, and of its messages: where rows and moments stand.

    Hidden `noise`, if there is some, is integrated out before, and read back. `few` is as of
    `Fronts.of`.
    """

    layout: Layout
    noise: HiddenNoise | None = None
    few: int = FEW

    def without_noise(self, candidates: Candidates) -> TreePlan:
        """The plan in which noise variables among candidates are integrated out; it is kept."""

        def make() -> TreePlan:
            noise = HiddenNoise.of(self.layout, candidates)
            return replace(self, noise=noise) if noise.pairs else self

        return self.layout.derived("without noise", make, candidates)

    def for_numpy(self) -> TreePlan:
        """The plan by which NumPy solves one run: with larger fronts where the tree is narrow."""
        if not self.fronts.is_narrow:
            return self
        return self.layout.derived("for NumPy", lambda: replace(self, few=SEVERAL), id(self))

    @property
    def assembly(self) -> Assembly:
        """The factors of the fronts."""
        return self.layout.assembly if self.noise is None else self.noise.assembly

    @cached_property
    def fronts(self) -> Fronts:
        """The fronts of the tree."""
        return Fronts.of(self.layout, None if self.noise is None else self.noise.places, self.few)

    @cached_property
    def blocks(self) -> Blocks:
        """The components of each front, then those of each noise variable's block."""
        own = self.fronts.blocks
        if self.noise is None:
            return own
        more = self.noise.blocks
        sizes = np.concatenate([own.sizes, more.sizes])
        return Blocks(own.count, sizes, np.concatenate([own.components, more.components]))

    @cached_property
    def hanging(self) -> Hanging:
        """The tree of the blocks."""
        parent, depth = self.fronts.parent, self.fronts.depth
        if self.noise is not None:
            above = self.fronts.of_cluster[self.noise.clusters]
            parent = np.concatenate([parent, above])
            depth = np.concatenate([depth, depth[above] + 1])
        return Hanging(parent, depth)

    @cached_property
    def stacks(self) -> FrontStacks:
        """The stacks of fronts, and where their rows stand in a buffer."""
        return FrontStacks(self.assembly, self.fronts)

    @cached_property
    def of_fronts(self) -> Places:
        """Where the moments of fronts stand in the `Beliefs` of a solution without noise."""
        return Places(self.layout, self.fronts.blocks, self.fronts.of_cluster)

    @cached_property
    def places(self) -> Places:
        """Where the moments of fronts, and then of noise variables' blocks, stand in `Beliefs`."""
        if self.noise is None:
            return self.of_fronts
        first, own = len(self.fronts), dict[int, Integers]()
        for pairs in self.noise.pairs:
            group = self.layout.groups[pairs.child]
            blocks = own.setdefault(pairs.child, self.fronts.of_cluster[group.clusters])
            blocks[pairs.child_rows] = first + np.arange(len(pairs.child_rows))
            first += len(pairs.child_rows)
        return Places(self.layout, self.blocks, self.fronts.of_cluster, own)

    @cached_property
    def separators(self) -> list[list[tuple[Integers, Integers]]]:
        """For each stack of fronts, where `Beliefs` has the moments of their separators.

        They are those of the parents' beliefs. separators[level][stack] is a pair of flat indices,
        of means (B, s) and covariances (B, s, s), for the B fronts of a stack.
        """
        return [[self._above(stack) for stack in level] for level in self.stacks.levels]

    def _above(self, stack: Stack) -> tuple[Integers, Integers]:
        at = np.maximum(self.fronts.parent[stack.members], 0), self.stacks.above(stack)
        return self.of_fronts.means(*at), self.of_fronts.covs(*at)

    @cached_property
    def squares(self) -> FrontSquares:
        """Where the normal equations of the stacks stand."""
        return FrontSquares(self.stacks)

    @cached_property
    def machine(self) -> Plan:
        """The fronts as machine code is told of them."""
        return told(self.assembly, self.fronts)

    @cached_property
    def rounds(self) -> Rounds:
        """Where the rows of factors and of messages between clusters stand in a buffer."""
        return Rounds(self.layout)

    @cached_property
    def cluster_places(self) -> Places:
        """Where the moments of clusters stand in `Beliefs` that messages have made."""
        blocks = self.layout.blocks
        return Places(self.layout, blocks, np.arange(len(blocks)))

    @cached_property
    def forest(self) -> Forest:
        """The trees of the graph, each with a root."""
        return Forest.of(self.layout.graph)

    @cached_property
    def both_ways(self) -> list[list[Stack]]:
        """Rounds of stacks: messages to parents, deepest first, then messages to children."""
        source, target = self.layout.directed.source, self.layout.directed.target
        upward = np.full(len(self.forest.parent), -1)
        messages = np.flatnonzero(self.forest.parent[source] == target)
        upward[source[messages]] = messages
        down = [upward[level] for level in self.forest.levels[1:]]
        both = [*reversed(down), *(messages ^ 1 for messages in down)]
        return [self.rounds.messages(messages.tolist()) for messages in both]


class Hanging(NamedTuple):
    """The block above each, −1 of a root, and how many are above it, (blocks,) each."""

    parent: Integers
    depth: Integers


@dataclass(frozen=True, eq=False)
class TreeBeliefs(Beliefs):
    """Moments of a tree's fronts.

    `gain` gives, for the number of a front, the regression of its pivots on its separators, (V,
    pivots, separators).
    """

    gain: Callable[[int], Array]


def not_kept(front: int) -> Array:
    """The `gain` of a solution that is only to move by: it takes as much memory as its moments."""
    raise LookupError(f"the regression of front {front} was not kept")


@dataclass(frozen=True, eq=False)
class _Gains:
    """The regressions that stacks of fronts have kept, (V, B, c, s) each."""

    fronts: Fronts
    stacks: list[tuple[Stack, Array]]

    def __call__(self, front: int) -> Array:
        k, row = self._where[front]
        own, shared = int(self.fronts.pivots[front]), int(self.fronts.separators[front])
        return self.stacks[k][1][:, row, :own, :shared]

    @cached_property
    def _where(self) -> dict[int, tuple[int, int]]:
        return {
            front: (k, row)
            for k, (stack, _) in enumerate(self.stacks)
            for row, front in enumerate(stack.members.tolist())
        }


def read_back(
    plan: TreePlan,
    noise: HiddenNoise,
    done: Calibrated,
    given: Sequence[Regression],
    *,
    exact: bool,
) -> Calibrated:
    """The solution with the moments of noise variables, from those of the fronts.

    `given` are the conditionals of noise variables, as `HiddenNoise.integrated` returns them;
    `exact` says whether relations without noise are left.
    """
    beliefs, sizes = done.beliefs, done.sizes
    assert isinstance(beliefs, TreeBeliefs)
    means, covs, worst = [beliefs.mean[:, :-1]], [beliefs.cov[:, :-1]], 1.0
    for pairs, own in zip(noise.pairs, given, strict=True):
        above = plan.fronts.of_cluster[pairs.clusters]
        where, entries = plan.of_fronts.of(above, pairs.others)
        spread = beliefs.cov[:, entries]
        found = moments(own, beliefs.mean[:, where], spread, exact=exact)
        means.append(found.mean.reshape(len(found.mean), -1, found.mean.shape[-1]))
        covs.append(found.cov.reshape(len(found.cov), -1))
        worst = max(worst, magnified(own, spread, found.cov))
    if sizes is not None:
        sizes = sizes._replace(magnified=max(sizes.magnified, worst))
    mean, cov = (
        np.concatenate([*parts, np.zeros_like(parts[0][:, :1])], axis=1) for parts in (means, covs)
    )
    gain = _NoiseGains(beliefs.gain, len(plan.fronts), [own.gain for own in given])
    whole = TreeBeliefs(plan.places, beliefs.frame, mean, cov, gain)
    return replace(done, beliefs=whole, sizes=sizes)


@dataclass(frozen=True, eq=False)
class _NoiseGains:
    """The regressions of fronts, and those of noise variables, whose blocks begin at `first`."""

    of_fronts: Callable[[int], Array]
    first: int
    noises: list[Array]

    def __call__(self, block: int) -> Array:
        row = block - self.first
        if row < 0:
            return self.of_fronts(block)
        for gains in self.noises:
            if row < gains.shape[1]:
                break
            row -= gains.shape[1]
        return gains[:, row]


def calibrate(plan: TreePlan, buffer: Buffer[FrontStacks], potentials: Potentials) -> Calibrated:
    """The beliefs of a tree, and ln p(evidence): both passes, with the CPDs as linearised now.

    Measurements that contradict CPDs without noise, and a belief that is not proper, are a
    NumericalError. `buffer` has its rows where `plan.stacks` has them; `potentials` are the CPDs'.
    """
    buffer.refresh(potentials)
    kept: list[list[Regression]] = []
    stacked, _, sides = buffer.proper.right.shape
    total = np.zeros((stacked, sides))
    tops = plan.fronts.tops
    for level in counted(plan.stacks.levels, "up the tree"):
        kept.append([])
        for stack in level:
            done, log_scale = buffer.eliminate(stack, tops)
            buffer.require_finite(log_scale, tops[stack.clusters].tolist())
            # Without the rows that are left, which hold the memory of all rows of the stack.
            kept[-1].append(Regression(done.gain, done.offset, done.noise))
            total += log_scale.sum(axis=1)
            if stack.kept:
                buffer.store(stack, done.rest, None)
    exact = potentials.exact is not None
    beliefs, worst = _back(plan, buffer.model.frame, kept, exact=exact, measured=not exact)
    sizes = Sizes(buffer.largest, buffer.coarse, magnified=worst)
    return Calibrated(beliefs, frozen(total), sizes)


def calibrate_by_squares(
    plan: TreePlan, frame: Frame, potentials: Potentials, share: float
) -> Calibrated | None:
    """The beliefs of a tree by its normal equations, without ln p; None where these lose digits.

    They are taken to lose them where a pivot is cancelled to this share of what it was.
    """
    kept = plan.squares.eliminate(potentials, share)
    if kept is None:
        return None
    stacked, _, sides = potentials.proper.right.shape
    beliefs, _ = _back(plan, frame, kept, exact=False, measured=False)
    beliefs = replace(beliefs, gain=not_kept)
    return Calibrated(beliefs, np.full((stacked, sides), np.nan))


def _back(
    plan: TreePlan,
    frame: Frame,
    kept: Sequence[Sequence[Regression]],
    *,
    exact: bool,
    measured: bool,
) -> tuple[TreeBeliefs, float]:
    """The moments of all fronts, from the conditionals that the upward pass has kept.

    If that is `measured`, there comes with them how much larger the summands of a variance are than
    itself, at the most. `exact` says whether there are relations without noise.
    """
    every = list(zip(chain(*plan.stacks.levels), chain(*kept), strict=True))
    stacked, sides = (1, 1) if not every else (every[0][1].offset.shape[k] for k in (0, -1))
    blank = Beliefs.empty(plan.of_fronts, frame, stacked, sides)
    gains = _Gains(plan.fronts, [(stack, done.gain) for stack, done in every])
    beliefs = TreeBeliefs(blank.places, frame, blank.mean, blank.cov, gains)
    worst = 1.0
    below = list(zip(plan.stacks.levels, plan.separators, kept, strict=True))
    for level, separators, results in reversed(below):
        for stack, (where, entries), done in zip(level, separators, results, strict=True):
            if not stack.kept:
                beliefs.put(stack, done.offset, certain(done.noise) if exact else done.noise)
                continue
            spread = beliefs.cov[:, entries]
            found = moments(done, beliefs.mean[:, where], spread, exact=exact)
            if measured:
                worst = max(worst, magnified(done, spread, found.cov))
            beliefs.put(stack, *found)
    return beliefs, worst
