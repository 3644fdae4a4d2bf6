r"""The weights of sightings with robust noise: each counts with the covariance R / w.

A *sighting* is one measurement by a sensor; the k sightings of an array have d components each, and
R is the noise covariance of one. Its weight w = 2 ρ′(s) is twice the slope of the loss ρ at the
square s = rᵀ R⁻¹ r of its residual r. With `Taylor` r is that of the mean, and a fixed point
maximises the density (iteratively reweighted least squares). With rules that take expectations over
the belief, of covariance P, the square is expected, s = rᵀ R⁻¹ r + tr R⁻¹ (H P Hᵀ + Ω), with the
slope H and the covariance Ω of the linearisation's error, and a fixed point maximises the lower
bound of the evidence (expectation–maximisation).

A *graduated* loss, truncated least squares, is reached in stages μ: it begins wide, and is
sharpened until it is the loss asked for.

The sightings of a sensor at one step are also stacked to vectors of D = k d components, in arrays
(D, *batch), `batch` being () for one run and (runs,) for several, or (1,) if all have the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.cpds import ConditionalGaussian, RobustNoise
from pgm.kernels import roots, solving, step
from pgm.kernels.arrays import Array, Index, Integers, Kind, Mask, components_first, independent
from pgm.kernels.dense import KnownRoot, Runs, Stack
from pgm.linearisation.family import Family

# Those of a truncated loss are about 0 or 1.
_HALF = 0.5
# The least information of a measurement, so that its covariance exists.
_UNTOLD = 1e-3


@dataclass(eq=False)
class Weights:
    """The weights w of k sightings of a sensor, and the squares s at which they were found.

    `weight` and `square` are (k, runs). `taken` (k, runs or 1, d) marks the measured components,
    None for all. `white` (k or 1, runs or 1, d, d) is L⁻¹, L being the lower root of the measured
    components' noise covariance R = L Lᵀ. `stage` (runs,) is the μ of a graduated loss: NaN before
    the first stage, infinite once it is the loss asked for, and for all other losses.
    """

    noise: RobustNoise
    white: Array
    taken: Mask | None
    weight: Array
    square: Array
    stage: Array

    @classmethod
    def of(
        cls, cpd: ConditionalGaussian, own: Array, taken: Mask | None, shape: tuple[int, int]
    ) -> Weights:
        """Unit weights of `shape` (k, runs), for noise covariances `own` (k or 1, runs or 1, d, d).

        `cpd` has the loss, and `taken` (k, runs or 1, d) marks the measured components, None for
        all. A ModelError refuses singular covariances; a graduated loss is before its first stage.
        """
        assert cpd.noise is not None
        if taken is not None:
            own = independent(own, taken)
        lower = roots.root(own)
        cpd.require_regular(lower)
        white = solving.solve_lower(lower, np.broadcast_to(np.eye(own.shape[-1]), own.shape))
        stage = np.full(shape[1], np.nan if cpd.noise.graduated else np.inf)
        return cls(cpd.noise, white, taken, np.ones(shape), np.zeros(shape), stage)

    @property
    def count(self) -> Integers:
        """The number of measured components of each sighting, (k, runs or 1), or (1, 1) for all."""
        if self.taken is None:
            return np.full((1, 1), self.white.shape[-1])
        found: Integers = self.taken.sum(axis=-1)
        return found

    def squares(
        self,
        residual: Array,
        matrix: Array | None = None,
        cov: Array | None = None,
        error: Array | None = None,
    ) -> Array:
        """The squares s (k, runs) of residuals r (k, runs, d): rᵀ R⁻¹ r, or what is expected of it.

        They are expected under the belief of covariance P if H and P are given: `matrix` is
        H (k, runs, d, m), `cov` P (k or 1, runs, m, m) over the parents' m components. `error` is
        Ω (k, runs, d, d), None for zero. Missing components do not count.
        """
        # Of one run a few small matrices, of many runs rows of these.
        kind = Stack if residual.shape[1] == 1 else Runs

        def of(array: Array) -> Any:
            return kind(array if kind is Stack else components_first(array, 2))

        off, white = of(residual[..., None]), KnownRoot(of(self.white))
        slope, belief, around = (
            None if part is None else of(part) for part in (matrix, cov, error)
        )
        if self.taken is not None:
            known = self.taken if kind is Stack else components_first(self.taken, 1)
            off = off.kept(known)
            slope = None if slope is None else slope.kept(known)
            around = None if around is None else step.known_part(around, known)
        found: Array = step.whitened(off, white, slope, belief, around).square
        return found

    def take(self, square: Array, active: Mask | None = None) -> Array:
        """Set the weights to those at squares (k, runs); returns how far they move, (runs,).

        That is the largest change of a weight, infinite while a graduated loss is not yet the one
        asked for. Runs that are not `active` (runs,) keep theirs, and move by zero; None means all.
        """
        weight, stage = self._weights(square)
        change = np.abs(weight - self.weight).max(axis=0, initial=0.0)
        moved: Array = np.where(np.isinf(stage), change, np.inf)
        if active is None or active.all():
            self.weight, self.square, self.stage = weight, square, stage
            return moved
        self.weight = np.where(active, weight, self.weight)
        self.square = np.where(active, square, self.square)
        self.stage = np.where(active, stage, self.stage)
        return np.asarray(np.where(active, moved, 0.0))

    def _weights(self, square: Array) -> tuple[Array, Array]:
        """The weights (k, runs) at squares s, and the stage (runs,) of the loss that they are of.

        A graduated loss, truncated least squares, goes on to its first stage, or to the one after
        the present. The stage is infinite where the weights are already those of the loss asked
        for. Any other loss keeps its stage, infinity.
        """
        noise = self.noise
        hard = noise.weight(square, self.count)
        if not noise.graduated:
            return hard, self.stage
        counted = np.where(self.count > 0, square, 0.0)
        stage = np.where(
            np.isnan(self.stage),
            noise.first_stage(counted.max(axis=0, initial=0.0)),
            noise.next_stage(self.stage),
        )
        found = np.where(self.count > 0, noise.staged(square, stage), 1.0)
        # Weights that are those of the hard loss already need no further stage.
        stage = np.where((found == hard).all(axis=0), np.inf, stage)
        return found, stage

    def judged(
        self, gated: tuple[Mask, Mask] | None, rows: slice = slice(None)
    ) -> tuple[Mask, Mask] | None:
        """Masks (k, runs) of sightings rejected by a gate or this noise, and of those judged.

        `rows` picks the k sightings, by default all; `gated` are the two masks of the gate for
        them, None without a gate. A truncated loss judges all sightings with a measured component,
        and rejects those of a weight below ½; other noise judges none, and `gated` is the result.
        """
        if not self.noise.graduated:
            return gated
        weight = self.weight[rows]
        count = self.count if self.taken is None else self.count[rows]
        seen = np.broadcast_to(count > 0, weight.shape)
        left: Mask = (weight < _HALF) & seen
        return (left, seen) if gated is None else (gated[0] | left, gated[1] | seen)

    def surplus(self, rows: slice = slice(None)) -> Array:
        """The robust log-density of each sighting in `rows` less ln N(r; 0, R / w), (k, runs)."""
        count = self.count if self.taken is None else self.count[rows]
        return self.noise.surplus(self.square[rows], count, self.weight[rows])

    @property
    def staged(self) -> Mask:
        """Whether the loss is the one that was asked for, not a stage before it, (runs,)."""
        return np.isinf(self.stage)

    def loss(self, square: Array) -> Array:
        """Twice the loss, 2 ρ(s), at squares (k, runs); if graduated, at its present stage."""
        noise = self.noise
        if noise.graduated:
            found = noise.staged_loss(square, self.stage)
        else:
            found = noise.loss(square, self.count)
        return 2.0 * np.where(self.count > 0, found, 0.0)

    @property
    def information(self) -> float:
        """The share of R⁻¹ that a measured component tells on average: Σ w² s / Σ d, at least 10⁻³.

        It is the variance of the score w R^{−1/2} r at the squares s. Where the density is that of
        the residuals this is Fisher's information, the mean curvature of the loss; of other
        residuals, as of outliers, it is less (Huber, 1967; White, 1982).
        """
        count = np.broadcast_to(self.count, self.weight.shape)
        told = np.where(count > 0, self.weight**2 * self.square, 0.0).sum()
        return max(float(told) / max(int(count.sum()), 1), _UNTOLD)

    def scaled(self, own: Array) -> Array:
        """The covariances R / w, (k, runs, d, d), of noise R = `own`, (k or 1, runs or 1, d, d)."""
        return own / self.weight[..., None, None]

    def rows(self, rows: slice) -> Weights:
        """A copy of the weights of some sightings, its graduated loss before the first stage."""
        white = self.white[rows] if len(self.white) > 1 else self.white
        taken = None if self.taken is None else self.taken[rows]
        stage = np.full(self.stage.shape, np.nan if self.noise.graduated else np.inf)
        weight, square = self.weight[rows].copy(), self.square[rows].copy()
        return replace(self, white=white, taken=taken, weight=weight, square=square, stage=stage)

    def put(self, rows: slice | tuple[slice, Index], other: Weights) -> None:
        """Copy the weights and squares of `other` to some rows, or rows and runs, of these."""
        self.weight[rows], self.square[rows] = other.weight, other.square


def by_sighting(array: npt.NDArray[Kind], height: int, own: int) -> npt.NDArray[Kind]:
    """A stacked array (D, ..., *batch) of k sightings, D = k d, as (k, runs or 1, d, ...).

    `height` is d. `own` is the number of the axes "...", such as 1 for the columns of a slope H.
    """
    count = len(array) // height
    batch = array.shape[1 + own :] or (1,)
    rows = array.reshape(count, height, *array.shape[1 : 1 + own], *batch)
    return np.moveaxis(rows, -1, 1)


def own_blocks(noise: Array, height: int) -> Array:
    """The diagonal blocks (k, runs or 1, d, d) of a covariance (D, D, *batch); `height` is d."""
    count = len(noise) // height
    batch = noise.shape[2:] or (1,)
    each = np.arange(count)
    blocks = noise.reshape(count, height, count, height, *batch)[each, :, each]
    return np.moveaxis(blocks, -1, 1)


def scale(weight: Array, height: int, batch: tuple[int, ...]) -> Array:
    """The factors 1/√w of the standard deviations of stacked components, (D, *batch).

    `weight` is w (k, runs), `height` is d, and `batch` is () for one run, (runs,) for several.
    """
    found: Array = np.repeat(1.0 / np.sqrt(weight), height, axis=0)
    return found if batch else found[:, 0]


def shown(weight: Array, taken: Mask | None) -> Array:
    """Weights (k, runs), NaN where no component was measured.

    `taken` (k, runs or 1, d) marks the measured components; None means all, so that none is NaN.
    """
    if taken is None:
        return weight
    return np.where(taken.any(axis=-1), weight, np.nan)


def bound_kind(families: Iterable[Family], *, affine: bool) -> str:
    """The kind, in words, of a log-evidence that the `families` of robust noise bound.

    It is ``unnormalised`` if a density has no finite integral; else ``bound``, a lower one, if all
    CPDs of the model are `affine`, and ``linearised bound`` if not.
    """
    for family in families:
        noise = family.cpd.noise
        if noise is not None and not noise.is_proper(family.shape[2]):
            return "unnormalised"
    return "bound" if affine else "linearised bound"
