"""The moments of all clusters, stacked in two flat arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.inference.gaussian.layout import Layout
from pgm.inference.gaussian.model import Model
from pgm.inference.gaussian.prior import Frame
from pgm.kernels.arrays import Array, Integers, Mask


@dataclass(frozen=True, eq=False)
class Places:
    """Where the moments of each cluster stand, and where each variable's are read."""

    layout: Layout

    @cached_property
    def sizes(self) -> list[int]:
        """Components of each cluster."""
        return [len(columns) for columns in self.layout.columns]

    @cached_property
    def starts(self) -> Integers:
        """Of each cluster's means."""
        return np.cumsum([0, *self.sizes])

    @cached_property
    def block_starts(self) -> Integers:
        """Of each cluster's covariance."""
        return np.cumsum([0, *(size * size for size in self.sizes)])

    def means(self, clusters: Integers, columns: Integers) -> Integers:
        """Where means stand, for (B,) clusters and (B, n) columns of theirs."""
        return self.starts[clusters][:, None] + columns

    def covs(self, clusters: Integers, columns: Integers) -> Integers:
        """Where covariances stand, (B, n, n)."""
        size = np.array(self.sizes, dtype=np.intp)[clusters][:, None, None]
        start = self.block_starts[clusters][:, None, None]
        return start + columns[:, :, None] * size + columns[:, None, :]

    @cached_property
    def homes(self) -> tuple[Integers, Integers]:
        """For each component the smallest cluster that holds it, and its column there."""
        cluster = np.full(self.layout.size, -1, dtype=np.intp)
        column = np.empty(self.layout.size, dtype=np.intp)
        for k in sorted(range(len(self.sizes)), key=self.sizes.__getitem__):
            for place, at in self.layout.columns[k].items():
                if cluster[place] < 0:
                    cluster[place], column[place] = k, at
        return cluster, column

    @cached_property
    def families(self) -> list[tuple[Integers, Integers]]:
        """For each group of CPDs, where the moments of their hidden parents stand."""
        found = []
        for group in self.layout.groups:
            columns = np.array(
                [
                    [self.layout.columns[cluster][place] for place in row]
                    for cluster, row in zip(
                        group.clusters.tolist(), group.parents.tolist(), strict=True
                    )
                ],
                dtype=np.intp,
            ).reshape(group.parents.shape)
            at = (group.clusters, columns)
            found.append((self.means(*at), self.covs(*at)))
        return found


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Moments of clusters in a frame: (V, components, N) and (V, entries)."""

    places: Places
    frame: Frame
    mean: Array
    cov: Array

    @classmethod
    def empty(cls, places: Places, frame: Frame, stacked: int, sides: int) -> Beliefs:
        """To be filled in."""
        return cls(
            places,
            frame,
            np.empty((stacked, int(places.starts[-1]), sides)),
            np.empty((stacked, int(places.block_starts[-1]))),
        )

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.mean.shape[0] * self.mean.shape[2])

    def _runs_first(self, mean: Array) -> Array:
        """(V, ..., N) as (runs, ...)."""
        if mean.shape[0] == 1:
            return np.moveaxis(mean[0], -1, 0)
        return mean[..., 0]

    def moments(self, where: Integers, entries: Integers, places: Integers) -> tuple[Array, Array]:
        """Means (runs, ..., n) and covariances (V, ..., n, n) as the user knows them.

        Parameters
        ----------
        where, entries : ndarray of int
            (..., n) and (..., n, n): of the means and covariances.
        places : ndarray of int
            (..., n): the components.
        """
        scale = self.frame.scale[places]
        mean = self.frame.mean[:, places] + scale * self._runs_first(self.mean[:, where])
        return mean, self.cov[:, entries] * (scale[..., :, None] * scale[..., None, :])

    def components(self) -> tuple[Array, Array]:
        """Means and standard deviations of all hidden components, (runs, size), (V, size)."""
        cluster, column = self.places.homes
        where = self.places.starts[cluster] + column
        size = np.array(self.places.sizes, dtype=np.intp)[cluster]
        entries = self.places.block_starts[cluster] + column * (size + 1)
        everything = np.arange(cluster.size)
        scale = self.frame.scale
        mean = self.frame.mean[:, everything] + scale * self._runs_first(self.mean[:, where])
        return mean, scale * np.sqrt(np.maximum(self.cov[:, entries], 0.0))


def relinearise(beliefs: Beliefs, model: Model, active: Mask) -> None:
    """Linearise every nonlinear CPD at its cluster's belief."""
    at: list[tuple[Array, Array] | None] = []
    groups = zip(model.layout.groups, model.families, beliefs.places.families, strict=True)
    for group, family, (where, entries) in groups:
        if family.exact:
            at.append(None)
            continue
        mean, cov = beliefs.moments(where, entries, group.parents)
        at.append((mean.swapaxes(0, 1), cov.swapaxes(0, 1)))
    model.relinearise(beliefs.components()[0], at, active)
