"""Beliefs of a Gaussian network's clusters or fronts: means and covariances, in a frame's units.

The components of all hidden variables make one vector x, (size,). A *frame* has coordinates ξ of
it, x = mean + scale ξ (`Frame`). The *place* of a component is its index in x; its *column* is its
index in the scope of a cluster, or in a front. Clusters and fronts are *blocks* of components.

V is the number of covariances that are kept, and N the number of columns of means that go with each
of them: V = 1 and N = runs where all runs share their covariances, else V = runs and N = 1. The
means of all blocks stand one after another along one axis, and so do the entries of their
covariances, row by row; an index along such an axis is a *flat index*.

A *group* is made of copies of one CPD in which the same variables have evidence. A *stack* is a
batch of B factors, or of B clusters, of equal shape. A factor exp(−½ ‖A ξ − r‖²) over n components
is kept as k *rows*: its matrix A (k, n) and its right sides r (k, N).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.blocks import Blocks
from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.prior import Frame
from pgm.beliefs.gaussian.rounds import Stack
from pgm.kernels.arrays import Array, Integers, Mask


def by_run(array: Array, *, shared: bool) -> Array:
    """Vectors (..., runs, d) as (V, ..., d, N).

    V is 1 and N the number of runs if `shared`, else V is the number of runs and N is 1.
    """
    if shared:
        return np.moveaxis(array, -2, -1)[None]
    return np.moveaxis(array, -2, 0)[..., None]


def runs_first(array: Array) -> Array:
    """An array (V, ..., N) as (runs, ...): of N runs if V is 1, else of V runs."""
    if array.shape[0] == 1:
        return np.moveaxis(array[0], -1, 0)
    return array[..., 0]


@dataclass(frozen=True, eq=False)
class Places:
    """Where the moments of clusters, or of fronts, stand along the flat axes of `Beliefs`.

    Each is a block of components. The means of block k begin at blocks.starts[k], in the order of
    its columns; its covariance, row by row, at block_starts[k]. `of_cluster` (clusters,) tells the
    block of each cluster, and `of_group` those of the CPDs (CPDs,) of a group, by its number, where
    they are others.
    """

    layout: Layout
    blocks: Blocks
    of_cluster: Integers
    of_group: Mapping[int, Integers] = field(default_factory=dict)

    @cached_property
    def block_starts(self) -> Integers:
        """The flat index where each covariance begins, then where all end, (blocks + 1,)."""
        return np.concatenate([[0], np.cumsum(self.blocks.sizes**2)]).astype(np.intp)

    def means(self, blocks: Integers, columns: Integers) -> Integers:
        """Flat indices (B, n) of means: row b has those at columns[b], (n,), in blocks[b].

        A column of −1 has the index behind all means, where a zero stands.
        """
        found = self.blocks.starts[blocks][:, None] + columns
        return np.where(columns < 0, self.blocks.starts[-1], found)

    def covs(self, blocks: Integers, columns: Integers) -> Integers:
        """Flat indices (B, n, n) of covariances: those of columns[b], (n,), in blocks[b].

        A column of −1 has indices behind all covariances, where a zero stands.
        """
        size = self.blocks.sizes[blocks][:, None, None]
        start = self.block_starts[blocks][:, None, None]
        found = start + columns[:, :, None] * size + columns[:, None, :]
        nothing = (columns[:, :, None] < 0) | (columns[:, None, :] < 0)
        return np.where(nothing, self.block_starts[-1], found)

    def of_stack(self, stack: Stack) -> tuple[Integers, Integers]:
        """Flat indices of the moments of a stack's blocks, in its order; they are kept."""
        known = self._stacks.get(stack)
        if known is None:
            at = stack.clusters, stack.columns
            known = self._stacks[stack] = self.means(*at), self.covs(*at)
        return known

    @cached_property
    def _stacks(self) -> dict[Stack, tuple[Integers, Integers]]:
        return {}

    def of(self, blocks: Integers, components: Integers) -> tuple[Integers, Integers]:
        """Flat indices of means (B, n) and covariances (B, n, n) of components in blocks (B,).

        `components` (B, n) are their places; row b is of components that blocks[b] holds.
        """
        at = blocks, self.blocks.columns(blocks, components)
        return self.means(*at), self.covs(*at)

    @cached_property
    def families(self) -> list[tuple[Integers, Integers]]:
        """For each group of CPDs a pair: flat indices of the moments of the CPDs' hidden parents.

        Those of means are (CPDs, n), those of covariances (CPDs, n, n), for n components of the
        parents; the moments are those of the CPD's own block, or of its cluster's.
        """
        found = []
        for g, group in enumerate(self.layout.groups):
            blocks = self.of_group.get(g, self.of_cluster[group.clusters])
            found.append(self.of(blocks, group.parents))
        return found


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Moments of all blocks in a frame: means (V, components + 1, N), covariances (V, entries + 1).

    `places` tells where each block's moments stand; both end in a zero.
    """

    places: Places
    frame: Frame
    mean: Array
    cov: Array

    @classmethod
    def empty(cls, places: Places, frame: Frame, stacked: int, sides: int) -> Beliefs:
        """Beliefs whose arrays are not initialised, for V = `stacked` and N = `sides`."""
        mean = np.empty((stacked, int(places.blocks.starts[-1]) + 1, sides))
        cov = np.empty((stacked, int(places.block_starts[-1]) + 1))
        mean[:, -1] = cov[:, -1] = 0.0
        return cls(places, frame, mean, cov)

    def put(self, stack: Stack, mean: Array, cov: Array) -> None:
        """Store means (V, B, n, N) and covariances (V, B, n, n) of the B blocks of a stack.

        Entry b is of the block ``stack.clusters[b]``, whose n components are in the order of the
        columns ``stack.columns[b]``.
        """
        means, covs = self.places.of_stack(stack)
        self.mean[:, means], self.cov[:, covs] = mean, cov
        self.mean[:, -1] = self.cov[:, -1] = 0.0  # where columns that stand for nothing were put

    def moments(self, where: Integers, entries: Integers, places: Integers) -> tuple[Array, Array]:
        """Means (runs, ..., n) and covariances (V, ..., n, n) of components, in the user's units.

        `where` (..., n) and `entries` (..., n, n) are the flat indices of these means and
        covariances, as `Places.of` finds them; `places` (..., n) are the places of the components.
        """
        scale = self.frame.scale[places]
        mean = self.frame.mean[:, places] + scale * runs_first(self.mean[:, where])
        return mean, self.cov[:, entries] * (scale[..., :, None] * scale[..., None, :])

    def of_parents(self, g: int, mean: Array | None = None) -> tuple[Array, Array]:
        """The moments of the hidden parents of group g's CPDs, in the user's units.

        Means are (CPDs, runs, n) and covariances (CPDs, V, n, n), for n components of the parents,
        in the blocks of the clusters that the CPDs are assigned to. If `mean` (runs, size) is
        given, the means of all hidden components, they are these.
        """
        places = self.places.layout.groups[g].parents
        own, cov = self.moments(*self.places.families[g], places)
        known = own if mean is None else mean[:, places]
        return known.swapaxes(0, 1), cov.swapaxes(0, 1)

    def with_means(self, mean: Array) -> Beliefs:
        """The beliefs with other means of all hidden components, (runs, size), in all blocks."""
        frame, blocks = self.frame, self.places.blocks
        moved = ((mean - frame.mean) / frame.scale)[:, blocks.components]
        moved = np.pad(moved, [(0, 0), (0, 1)])
        return replace(self, mean=by_run(moved, shared=self.mean.shape[0] == 1))

    def components(self) -> tuple[Array, Array]:
        """Means (runs, size) and standard deviations (V, size) of all hidden components.

        They are in the user's units.
        """
        mean, variance = self.in_frame()
        scale = self.frame.scale
        mean = self.frame.mean + scale * runs_first(mean)
        return mean, scale * np.sqrt(variance)

    def in_frame(self) -> tuple[Array, Array]:
        """Means (V, size, N) and variances (V, size) of all hidden components, in the frame."""
        blocks = self.places.blocks
        home, column = blocks.homes
        where = blocks.starts[home] + column
        entries = self.places.block_starts[home] + column * (blocks.sizes[home] + 1)
        return self.mean[:, where], np.maximum(self.cov[:, entries], 0.0)


class Sizes(NamedTuple):
    """The sizes of numbers that cost digits, the largest of all runs; see `certificate`.

    Attributes
    ----------
    largest : float
        The largest entry of all rows.
    coarse : float
        A tenth of the largest summand of a residual, in deviations of its noise; infinite where
        rounding may decide which rows are exact.
    information : ndarray or None
        The square of each component's column in all rows, (V, size); None if rows are exact, or
        messages go round loops.
    magnified : float
        How much larger summands of a variance are than itself, on the way down a tree.
    residual : float
        The largest residual of a row at the solution, in deviations of its noise.
    """

    largest: float
    coarse: float
    information: Array | None = None
    magnified: float = 1.0
    residual: float = 0.0


class TreePoint(NamedTuple):
    """A point of linearisation: means of all hidden components, and beliefs for covariances.

    `mean` (1, runs, size) are in the user's units, and so are the standard deviations `std` (1, V,
    size). Their first axis is that of time steps, of which a network without time has one. The
    covariances of `beliefs` go with the means, whatever means the beliefs have themselves; None is
    for covariances of zero.
    """

    mean: Array
    std: Array
    beliefs: Beliefs | None

    def of_parents(self, layout: Layout, g: int) -> tuple[Array, Array]:
        """The moments of the hidden parents of group g's CPDs, as of `Beliefs.of_parents`."""
        if self.beliefs is not None:
            return self.beliefs.of_parents(g, self.mean[0])
        mean = self.mean[0][:, layout.groups[g].parents].swapaxes(0, 1)
        return mean, np.zeros((*mean.shape, mean.shape[-1]))

    def mixed(self, other: TreePoint, share: float) -> TreePoint:
        """The point with `share` times this point's moments plus 1 − `share` times another's."""

        def mix(mine: Array, its: Array) -> Array:
            return share * mine + (1.0 - share) * its

        after = other.beliefs
        assert after is not None
        known = np.zeros(()) if self.beliefs is None else self.beliefs.cov
        return TreePoint(
            mix(self.mean, other.mean),
            mix(self.std, other.std),
            replace(after, cov=mix(known, after.cov)),
        )


@dataclass(frozen=True, eq=False)
class Calibrated:
    """The result of sending all messages: beliefs, and ln p(evidence), (V, N).

    `sizes` are those of numbers that decide how many digits float64 has kept; None where all digits
    are known to be there. `digits` (runs,) are the correct decimal digits of each run: k if
    rounding moves no mean by more than about 10⁻ᵏ of its standard deviation, and ln p(evidence) by
    no more than about 10⁻ᵏ. It is None for a solution in float64, whose digits are counted
    elsewhere. Where the control of steps has other means than the beliefs', `moved` (runs, size)
    are these.
    """

    beliefs: Beliefs
    log_evidence: Array
    sizes: Sizes | None = None
    digits: Array | None = None
    moved: Array | None = None

    @property
    def means(self) -> Array:
        """The means of all hidden components in the user's units, (1, runs, size).

        The first axis is that of time steps, of which a network without time has one.
        """
        return self.point.mean

    @cached_property
    def point(self) -> TreePoint:
        """The beliefs with their means and standard deviations, to linearise nonlinear CPDs at."""
        mean, std = self.beliefs.components()
        return TreePoint(
            (mean if self.moved is None else self.moved)[None], std[None], self.beliefs
        )


def relinearise(beliefs: Beliefs, model: Model, active: Mask, mean: Array | None = None) -> None:
    """Linearise every nonlinear CPD of a model anew, in place, at the belief of its hidden parents.

    This is the belief of the cluster that the CPD is assigned to, with other means if `mean` (runs,
    size) is given, those of all hidden components. The mask `active` (runs,) marks the runs in
    which the CPDs are linearised; in the others they stay as they are.
    """
    at = [
        None if family.exact else beliefs.of_parents(g, mean)
        for g, family in enumerate(model.families)
    ]
    model.relinearise(beliefs.components()[0] if mean is None else mean, at, active)


class Flat(NamedTuple):
    """The rows of many factors end to end: `matrix` (V, entries) and `right` (V, rows, N).

    `matrix` has the entries of all matrices A, row by row, and `right` their right sides r.
    """

    matrix: Array
    right: Array

    @classmethod
    def of(cls, matrices: list[Array], rights: list[Array]) -> Flat:
        """Join matrices (V, B, k, n) and right sides (V, B, k, N) of several stacks end to end.

        A stack has B factors of k rows each, over n components.
        """
        return cls(
            np.concatenate([part.reshape(part.shape[0], -1) for part in matrices], axis=1),
            np.concatenate(
                [part.reshape(part.shape[0], -1, part.shape[-1]) for part in rights], axis=1
            ),
        )

    def before(self, other: Flat) -> Flat:
        """These rows, then other ones."""
        return Flat.of(*([mine, its] for mine, its in zip(self, other, strict=True)))

    def at(self, entries: Integers, rows: Integers) -> tuple[Array, Array]:
        """Gather the matrices and the right sides of B factors, by their flat indices.

        The matrices, at `entries` (B, k, n), are (V, B, k, n); the right sides, at `rows` (B, k),
        are (V, B, k, N).
        """
        return self.matrix[:, entries], self.right[:, rows]

    def put(
        self,
        entries: Integers | slice,
        rows: Integers | slice,
        matrix: Array | float = 0.0,
        right: Array | float = 0.0,
    ) -> None:
        """Store `matrix` at the flat indices `entries`, and `right` at the flat indices `rows`.

        For indices (...) `matrix` is (V, ...) and `right` (V, ..., N). Where one of them is left
        out, zeros are stored.
        """
        self.matrix[:, entries], self.right[:, rows] = matrix, right
