r"""Hidden noise variables: integrated out before a tree is solved, and read back afterwards.

A CPD without noise, y = f(p, u), whose parent u is hidden, has noise of its own and no other child,
is one of y given p with the noise that u makes. Linearised, y = F_p p + F_u u + b with u ~ N(m, Σ):

.. math::

    p(y \mid p) = \mathcal N(F_p p + F_u m + b, \; S), \quad S = F_u \Sigma F_u^\top, \qquad
    u \mid y, p = m + \Sigma F_u^\top S^+ (y - F_p p - F_u m - b) + v.

So a tree that is exact only in such CPDs has no exact rows left: it may be solved by squares and in
machine code. Moments of u are found from those of y and p, which one front holds. Where u is much
sharper than these are known that is a small difference of large numbers, which `Sizes.magnified`
tells.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.assembly import Assembly, Given
from pgm.beliefs.gaussian.beliefs import Flat
from pgm.beliefs.gaussian.blocks import Blocks
from pgm.beliefs.gaussian.downward import Regression
from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.potentials import Potentials
from pgm.beliefs.gaussian.refusals import contradiction
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.rows import Eliminated, Rows, eliminate
from pgm.kernels.solving import left_open


@dataclass(frozen=True, eq=False)
class Pairs:
    """Noise variables of one group, and the CPDs of another whose noise they are, B pairs.

    Attributes
    ----------
    noise, child : int
        The numbers of the two groups.
    noise_rows, child_rows : ndarray of int
        The rows of the variables, and of the CPDs, in their groups, (B,).
    columns : slice
        The columns of u in the matrices of the CPDs.
    places, others : ndarray of int
        The places of u, (B, d), and of the other columns, (B, s).
    clusters : ndarray of int
        The clusters of the CPDs, (B,).
    """

    noise: int
    child: int
    noise_rows: Integers
    child_rows: Integers
    columns: slice
    places: Integers
    others: Integers
    clusters: Integers

    def gathered(self, assembly: Assembly, rows: Flat) -> Array:
        """The matrices (V, B, h, w) of the CPDs, with the columns of u first."""
        own = assembly.matrices(self.child, rows.matrix)[:, self.child_rows]
        columns = self.columns
        parts = own[..., columns], own[..., : columns.start], own[..., columns.stop :]
        return np.concatenate(parts, axis=-1)


class Candidates(NamedTuple):
    """The rows of each group that are CPDs without noise, and those that may be such noise.

    Both are masks of all groups' rows, one group's after another's, as bytes.
    """

    silent: bytes
    noises: bytes

    @classmethod
    def of(cls, model: Model) -> Candidates | None:
        """The candidates of a model; None if no CPD is without noise."""
        silent, noises = [], []
        every = list(zip(model.layout.groups, model.families, strict=True))
        for group, family in every:
            quiet = ~family.own_noise.any(axis=(1, 2, 3))
            silent.append(np.broadcast_to(quiet, len(group.cpds)))
        if not any(part.any() for part in silent):
            return None
        for group, family in every:
            alone = not group.observed and not group.hidden
            proper = _proper(family.own_noise) if alone else np.zeros(1, dtype=bool)
            noises.append(np.broadcast_to(proper, len(group.cpds)))
        return cls(np.concatenate(silent).tobytes(), np.concatenate(noises).tobytes())

    def by_group(self, layout: Layout) -> Iterator[tuple[Mask, Mask]]:
        """The two masks (rows,) of each group."""
        ends = np.cumsum([len(group.cpds) for group in layout.groups])[:-1]
        parts = (np.split(np.frombuffer(each, dtype=bool), ends) for each in self)
        return zip(*parts, strict=True)


def _proper(noise: Array) -> Mask:
    """Which covariances (rows, runs, d, d) are finite and definite in all runs, (rows,)."""
    finite: Mask = np.asarray(np.isfinite(noise).all(axis=(1, 2, 3)))
    open_ = left_open(np.where(finite[:, None, None, None], noise, 0.0))
    return finite if open_ is None else finite & ~open_.any(axis=(1, 2, 3))


@dataclass(frozen=True, eq=False)
class HiddenNoise:
    """The noise variables of a layout, and its factors when these are integrated out."""

    layout: Layout
    pairs: Sequence[Pairs]

    @classmethod
    def of(cls, layout: Layout, candidates: Candidates) -> HiddenNoise:
        """The noise variables among candidates."""
        return cls(layout, list(_pairs(layout, candidates)))

    @cached_property
    def places(self) -> Mask:
        """Which components are of noise variables, (size,)."""
        found = np.zeros(self.layout.size, dtype=bool)
        for pairs in self.pairs:
            found[pairs.places] = True
        return found

    @cached_property
    def clusters(self) -> Integers:
        """The cluster that holds each noise variable's CPD and its others, (pairs,)."""
        return np.concatenate([pairs.clusters for pairs in self.pairs])

    @cached_property
    def blocks(self) -> Blocks:
        """The components of each noise variable, then the others of its CPD."""
        held = [np.concatenate([own.places, own.others], axis=1) for own in self.pairs]
        sizes = np.concatenate([np.full(*each.shape) for each in held])
        return Blocks(self.layout.size, sizes, np.concatenate([each.ravel() for each in held]))

    @cached_property
    def _kept(self) -> list[Integers]:
        """The factors of each item of the layout's assembly that stay, by their rows in it."""
        kept = [np.ones(len(item.places), dtype=bool) for item in self.layout.assembly.factors]
        for pairs in self.pairs:
            kept[pairs.noise][pairs.noise_rows] = False
            kept[pairs.child][pairs.child_rows] = False
        if self.layout.anchored:
            kept[-1][self.places] = False
        return [np.flatnonzero(each) for each in kept]

    @cached_property
    def assembly(self) -> Assembly:
        """The factors that stay, then those that are left by the integrals."""
        every = self.layout.assembly.factors
        factors = [
            Given(item.places[kept], item.clusters[kept], item.height)
            for item, kept in zip(every, self._kept, strict=True)
        ]
        for pairs in self.pairs:
            rows = pairs.places.shape[1] * (1 + self.layout.anchored) + every[pairs.child].height
            height = min(pairs.others.shape[1], rows)
            factors.append(Given(pairs.others, pairs.clusters, height))
        return Assembly(self.layout.size, factors)

    @cached_property
    def _stays(self) -> tuple[Integers, Integers, Integers]:
        """Which entries, rows and factors of the layout's assembly stay."""
        before, first = self.layout.assembly, 0
        entries, rows, numbers = [], [], []
        for k, (item, kept) in enumerate(zip(before.factors, self._kept, strict=True)):
            size = item.height * item.places.shape[1]
            entries.append(before.entry_starts[k] + kept[:, None] * size + np.arange(size))
            rows.append(before.row_starts[k] + kept[:, None] * item.height + np.arange(item.height))
            numbers.append(first + kept)
            first += len(item.places)
        return _joined(entries), _joined(rows), _joined(numbers)

    def integrated(self, model: Model, given: Potentials) -> tuple[Potentials, list[Regression]]:
        """The factors that are left of those `given`, and the conditionals of noise variables."""
        entries, rows, numbers = self._stays
        done = [self._eliminated(model, given, pairs) for pairs in self.pairs]
        heights = [item.height for item in self.assembly.factors[-len(done) :]]
        proper = [Flat(*given.proper.at(entries, rows))]
        exact = [] if given.exact is None else [Flat(*given.exact.at(entries, rows))]
        scales = [given.log_scale[:, numbers]]
        for pairs, each, height in zip(self.pairs, done, heights, strict=True):
            rest = each.rest
            proper.append(_left(rest.matrix, rest.right, height))
            if rest.exact is not None and rest.exact_right is not None:
                exact.append(_left(rest.exact, rest.exact_right, height))
            elif exact:
                exact.append(_left(rest.matrix[..., :0, :], rest.right[..., :0, :], height))
            scales.append(self._scales(model, given, pairs) + each.log_scale)
        coarse = given.coarse_exact * max((each.largest for each in done), default=0.0)
        left = Potentials(
            self.assembly,
            _end_to_end(proper),
            _end_to_end(exact) if any(part.any() for each in exact for part in each) else None,
            np.concatenate(scales, axis=1),
            max(given.coarse, coarse),
        )
        return left, [Regression(each.gain, each.offset, each.noise) for each in done]

    def _eliminated(self, model: Model, given: Potentials, pairs: Pairs) -> Eliminated:
        """The integral over noise variables of their rows, those of their CPDs, and an anchor's."""
        assembly, proper = given.assembly, given.proper
        size, others = pairs.places.shape[1], pairs.others.shape[1]
        beyond = [(0, 0), (0, 0), (0, 0), (0, others)]
        noise = assembly.matrices(pairs.noise, proper.matrix)[:, pairs.noise_rows]
        matrices = [np.pad(noise, beyond), pairs.gathered(assembly, proper)]
        sides = [
            assembly.sides(pairs.noise, proper.right)[:, pairs.noise_rows],
            assembly.sides(pairs.child, proper.right)[:, pairs.child_rows],
        ]
        if self.layout.anchored:
            last = len(assembly.factors) - 1
            sharp = assembly.matrices(last, proper.matrix)[:, pairs.places, 0]
            matrices.append(np.pad(sharp * np.eye(size), beyond))
            sides.append(assembly.sides(last, proper.right)[:, pairs.places, 0])
        rows = Rows(np.concatenate(matrices, axis=2), np.concatenate(sides, axis=2))
        if given.exact is not None:
            right = assembly.sides(pairs.child, given.exact.right)[:, pairs.child_rows]
            rows = Rows(*rows[:2], pairs.gathered(assembly, given.exact), right)
        done = eliminate(rows, size)
        if done.contradiction is not None and done.contradiction.any():
            v, b, n = np.nonzero(done.contradiction)
            raise contradiction(model, int(pairs.clusters[b[0]]), (v, n))
        return done

    def _scales(self, model: Model, given: Potentials, pairs: Pairs) -> Array:
        """The scales (V, B, N) of the factors that an integral takes in, in units of the frame."""
        first = np.cumsum([0, *(len(item.places) for item in given.assembly.factors)])
        numbers = (
            first[pairs.noise] + pairs.noise_rows,
            first[pairs.child] + pairs.child_rows,
        )
        unit = np.log(model.frame.scale[pairs.places]).sum(axis=1)
        return sum((given.log_scale[:, own] for own in numbers), unit[:, None])


def _end_to_end(parts: Sequence[Flat]) -> Flat:
    return Flat.of([part.matrix for part in parts], [part.right for part in parts])


def _left(matrix: Array, right: Array, height: int) -> Flat:
    """The rows (V, B, k, s) that integrals have left, of which none is beyond the height."""
    spare = [(0, 0), (0, 0), (0, max(height - matrix.shape[2], 0)), (0, 0)]
    return Flat.of(*([np.pad(part, spare)[:, :, :height]] for part in (matrix, right)))


def _joined(parts: Sequence[Integers]) -> Integers:
    return np.concatenate([np.zeros(0, dtype=np.intp), *(part.ravel() for part in parts)])


def _pairs(layout: Layout, candidates: Candidates) -> Iterator[Pairs]:
    groups, masks = layout.groups, list(candidates.by_group(layout))
    owner, row = np.full((2, layout.size), -1)
    for g, (_, noises) in enumerate(masks):
        rows = np.flatnonzero(noises)
        if rows.size:
            first = groups[g].child[rows, 0]
            owner[first], row[first] = g, rows
    every = _joined([group.parents for group in groups])
    owner[np.bincount(every, minlength=layout.size) > 1] = -1
    for g, (silent, _) in enumerate(masks):
        group, free, stop = groups[g], silent.copy(), 0
        for size in (v.dimension for v in group.hidden):
            columns = slice(stop, stop + size)
            stop = columns.stop
            if size < group.height or group.width == size:  # relations, or nothing, would be left
                continue
            first = group.parents[:, columns.start]
            for noise in np.unique(owner[first[free]]).tolist():
                rows = np.flatnonzero(free & (owner[first] == noise))
                if noise < 0 or groups[noise].height != size:
                    continue
                free[rows] = False
                parents, child = group.parents[rows], group.child[rows]
                others = np.delete(parents, np.arange(size) + columns.start, axis=1)
                at = columns.start + child.shape[1]
                yield Pairs(
                    noise,
                    g,
                    row[first[rows]],
                    rows,
                    slice(at, at + size),
                    parents[:, columns],
                    np.concatenate([child, others], axis=1),
                    group.clusters[rows],
                )
