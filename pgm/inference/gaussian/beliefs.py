"""Beliefs of the clusters of a Gaussian network, as moments about a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.inference.gaussian.layout import Layout
from pgm.inference.gaussian.model import Model
from pgm.inference.gaussian.prior import Frame
from pgm.inference.gaussian.rounds import Stack
from pgm.kernels.arrays import Array, Integers, Mask


def by_run(array: Array, *, shared: bool) -> Array:
    """(..., runs, d) as (1, ..., d, runs) where runs share matrices, else (runs, ..., d, 1)."""
    if shared:
        return np.moveaxis(array, -2, -1)[None]
    return np.moveaxis(array, -2, 0)[..., None]


def runs_first(array: Array) -> Array:
    """(V, ..., N), of V runs with a matrix each or N that share one, as (runs, ...)."""
    if array.shape[0] == 1:
        return np.moveaxis(array[0], -1, 0)
    return array[..., 0]


@dataclass(frozen=True, eq=False)
class Places:
    """The places of each cluster's moments, and of each variable's."""

    layout: Layout

    @cached_property
    def sizes(self) -> list[int]:
        """Components of each cluster."""
        return [len(columns) for columns in self.layout.columns]

    @cached_property
    def starts(self) -> Integers:
        """The places of clusters' means in the vector of all."""
        return np.cumsum([0, *self.sizes])

    @cached_property
    def block_starts(self) -> Integers:
        """The places of clusters' covariances in the vector of all."""
        return np.cumsum([0, *(size * size for size in self.sizes)])

    def means(self, clusters: Integers, columns: Integers) -> Integers:
        """Flat indices of the means of (B, n) columns in (B,) clusters."""
        return self.starts[clusters][:, None] + columns

    def covs(self, clusters: Integers, columns: Integers) -> Integers:
        """The places of covariances, (B, n, n)."""
        size = np.array(self.sizes, dtype=np.intp)[clusters][:, None, None]
        start = self.block_starts[clusters][:, None, None]
        return start + columns[:, :, None] * size + columns[:, None, :]

    def of(self, clusters: Integers, components: Integers) -> tuple[Integers, Integers]:
        """The places of means and covariances of components (B, n), for (B,) clusters."""
        at = clusters, self.layout.columns_of(clusters, components)
        return self.means(*at), self.covs(*at)

    @cached_property
    def homes(self) -> tuple[Integers, Integers]:
        """For each component the smallest cluster that holds it, and its column there."""
        cluster, column = np.empty((2, self.layout.size), dtype=np.intp)
        # Of clusters of one size the first is written last, and stays.
        for k in reversed(np.argsort(self.sizes, kind="stable").tolist()):
            places = list(self.layout.columns[k])
            cluster[places], column[places] = k, np.arange(len(places))
        return cluster, column

    @cached_property
    def families(self) -> list[tuple[Integers, Integers]]:
        """For each group of CPDs, where the moments of their hidden parents stand."""
        return [self.of(group.clusters, group.parents) for group in self.layout.groups]


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Moments of clusters in a frame: (V, components, N) and (V, entries)."""

    places: Places
    frame: Frame
    mean: Array
    cov: Array

    @classmethod
    def empty(cls, places: Places, frame: Frame, stacked: int, sides: int) -> Beliefs:
        """Beliefs whose arrays are still to be filled in."""
        return cls(
            places,
            frame,
            np.empty((stacked, int(places.starts[-1]), sides)),
            np.empty((stacked, int(places.block_starts[-1]))),
        )

    def put(self, stack: Stack, mean: Array, cov: Array) -> None:
        """Keep the moments of a stack's clusters, (V, B, n, N) and (V, B, n, n)."""
        at = stack.clusters, stack.columns
        self.mean[:, self.places.means(*at)] = mean
        self.cov[:, self.places.covs(*at)] = cov

    def moments(self, where: Integers, entries: Integers, places: Integers) -> tuple[Array, Array]:
        """Means (runs, ..., n) and covariances (V, ..., n, n) as the user knows them, by places."""
        scale = self.frame.scale[places]
        mean = self.frame.mean[:, places] + scale * runs_first(self.mean[:, where])
        return mean, self.cov[:, entries] * (scale[..., :, None] * scale[..., None, :])

    def components(self) -> tuple[Array, Array]:
        """Means and standard deviations of all hidden components, (runs, size), (V, size)."""
        cluster, column = self.places.homes
        where = self.places.starts[cluster] + column
        size = np.array(self.places.sizes, dtype=np.intp)[cluster]
        entries = self.places.block_starts[cluster] + column * (size + 1)
        everything = np.arange(cluster.size)
        scale = self.frame.scale
        mean = self.frame.mean[:, everything] + scale * runs_first(self.mean[:, where])
        return mean, scale * np.sqrt(np.maximum(self.cov[:, entries], 0.0))


class TreePoint(NamedTuple):
    """Beliefs as a linearisation point.

    Means are (1, runs, size) and deviations (1, V, size), over all components.
    """

    mean: Array
    std: Array
    beliefs: Beliefs


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Calibrated beliefs of a tree.

    With them stand ln p(evidence), (V, N), and each run's correct digits where they are measured.
    """

    beliefs: Beliefs
    log_evidence: Array
    digits: Array | None = None

    @property
    def means(self) -> Array:
        """The means of all components, (1, runs, size)."""
        return self.point.mean

    @cached_property
    def point(self) -> TreePoint:
        """The beliefs as a point of linearisation."""
        mean, std = self.beliefs.components()
        return TreePoint(mean[None], std[None], self.beliefs)


def relinearise(beliefs: Beliefs, model: Model, active: Mask) -> None:
    """Linearise every nonlinear CPD at its cluster's belief."""

    def moments(g: int) -> tuple[Array, Array]:
        where, entries = beliefs.places.families[g]
        mean, cov = beliefs.moments(where, entries, model.layout.groups[g].parents)
        return mean.swapaxes(0, 1), cov.swapaxes(0, 1)

    at = [None if family.exact else moments(g) for g, family in enumerate(model.families)]
    model.relinearise(beliefs.components()[0], at, active)


class Flat(NamedTuple):
    """The rows of many factors, one after the other: (V, entries) and (V, rows, N)."""

    matrix: Array
    right: Array

    @classmethod
    def of(cls, matrices: list[Array], rights: list[Array]) -> Flat:
        """All entries and sides of stacks (V, B, k, n) and (V, B, k, N) in one vector each."""
        return cls(
            np.concatenate([part.reshape(part.shape[0], -1) for part in matrices], axis=1),
            np.concatenate(
                [part.reshape(part.shape[0], -1, part.shape[-1]) for part in rights], axis=1
            ),
        )

    def at(self, entries: Integers, rows: Integers) -> tuple[Array, Array]:
        """The matrices and vectors of some entries and rows."""
        return self.matrix[:, entries], self.right[:, rows]

    def put(
        self,
        entries: Integers | slice,
        rows: Integers | slice,
        matrix: Array | float = 0.0,
        right: Array | float = 0.0,
    ) -> None:
        """Store matrices and vectors of some entries and rows."""
        self.matrix[:, entries], self.right[:, rows] = matrix, right
