"""The M step of a Gaussian CPD: regression of the child on its parents, and the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pgm.cpds import AffineCPD, ConditionalGaussian, GaussianCPD, LinearGaussianCPD, Noise
from pgm.errors import ModelError
from pgm.factors.scope import Scope, labels, listed, namesake
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Mask, deviation, transpose
from pgm.learning.residuals import Known, Residuals, residuals, rounded
from pgm.learning.robust import DegreesOfFreedomStep, reweighed, with_noise
from pgm.learning.steps import CovarianceStep
from pgm.learning.values import Coefficients, Covariance, DegreesOfFreedom, Offset
from pgm.posteriors.expectations import FamilyBelief

# Coordinate ascent over coefficients and noise, where neither alone has a closed form.
_ROUNDS = 200
_SETTLED = 1e-13
_LEAST = 1e-300
# A component is in the range of a covariance if its projection is as long as itself, but for this.
_REACHED = 1e-6
# The part of a mean that sums of many rows may be off by.
_STILL = 2.0**-44


@dataclass(frozen=True, eq=False)
class Weighted:
    """Sums that rows enter by the inverses of their own noises.

    The normal equations of the free entries; by recording E[r rᵀ], E[r gᵀ], E[g gᵀ] of each row,
    times its weight if it has one, and its inverse noise; the sum of the noises' ranks, so weighed.
    """

    normal: Array
    said: Array
    moments: list[tuple[Array, Array, Array, Array]]
    ranks: float


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected second moments Σ E[r rᵀ] of a CPD's residuals over N rows.

    N is a number of rows, or the sum of their weights. They are sums of E[r rᵀ], E[r gᵀ], E[g gᵀ],
    regressors being counted from the reference (k,), near their mean where an offset is free, so
    that sums keep their digits; `weighted` in their place, where the noise is a function of
    evidence. `noise` are the sums by which rows enter the covariance of a loss, None if by these.
    """

    cpd: Any
    own: Array
    cross: Array
    gram: Array
    count: float
    reference: Array
    weighted: Weighted | None = None
    noise: Expected | None = None


def _left(own: Array, change: Array, cross: Array, gram: Array) -> Array:
    """E[(r − δ g)(r − δ g)ᵀ], of a row or summed."""
    both = change @ transpose(cross)
    left: Array = own - both - transpose(both) + change @ gram @ change.T
    return left


class GaussianStep:
    """The M step of one Gaussian CPD, in closed form if it is affine.

    Where all rows of the matrix have the same free entries, or the noise is diagonal, the
    coefficients are those of a least-squares regression; else noise and coefficients are found in
    turn, until they settle.
    """

    def __init__(self, cpd: ConditionalGaussian, hidden: Scope, parts: Sequence[Any]) -> None:
        self.hidden, self.noise = hidden, None
        self.dof: DegreesOfFreedomStep | None = None
        order = (*hidden, *(p for p in cpd.given if p not in hidden))
        self.order = order
        starts = np.cumsum([0, *(p.dimension for p in order)])
        self.places = {p: slice(*starts[k : k + 2]) for k, p in enumerate(order)}
        self.free: Mask = np.zeros((cpd.child.dimension, int(starts[-1]) + 1), dtype=bool)
        for part in parts:
            if isinstance(part, Covariance):
                self.noise = CovarianceStep(cpd, part)
            elif isinstance(part, Coefficients):
                self._free_matrices(cpd, part)
            elif isinstance(part, DegreesOfFreedom):
                self.dof = DegreesOfFreedomStep(cpd, part)
            else:
                self._free_offset(cpd, part)
        self._require_noise(cpd)
        self.same = bool((self.free == self.free[0]).all())

    def _free_matrices(self, cpd: ConditionalGaussian, part: Coefficients) -> None:
        if not isinstance(cpd, LinearGaussianCPD):
            raise ModelError(
                f"{cpd!r} has no coefficients to learn; those of functions are learnt as a parent, "
                "pgm.learning.Parameter(start)",
                cpd=cpd,
            )
        free = dict.fromkeys(cpd.given, True) if part.free is None else part.free
        for parent, mask in free.items():
            if parent not in cpd.given:
                raise ModelError(
                    f"{cpd!r}: coefficients of {parent!r} are to be learnt, which is none of its "
                    f"parents ({listed(cpd.given)}){namesake(parent, cpd.given)}",
                    cpd=cpd,
                )
            due = cpd.child.dimension, parent.dimension
            if cpd.matrices[parent].shape != due:
                raise ModelError(
                    f"{cpd!r}: the matrix of {parent!r} is another at each step, and coefficients "
                    "are learnt that are the same at all; give it one to start with, or leave it "
                    "out of Coefficients({...: True})",
                    cpd=cpd,
                )
            self.free[:, self.places[parent]] = _mask(cpd, f"the mask of {parent!r}", mask, due)

    def _free_offset(self, cpd: ConditionalGaussian, part: Offset) -> None:
        if not isinstance(cpd, AffineCPD):
            raise ModelError(
                f"{cpd!r} has no offset; that of a function is learnt as a parent, "
                "pgm.learning.Parameter(start)",
                cpd=cpd,
            )
        if cpd.offset.ndim > 1:
            raise ModelError(
                f"{cpd!r}: its mean differs by run, and one is learnt of all runs; give it one to "
                "start with"
                if cpd.steps is None
                else f"{cpd!r}: its offset is another at each step, and one is learnt of all "
                "steps; give it one to start with",
                cpd=cpd,
            )
        due = (cpd.child.dimension,)
        self.free[:, -1] = _mask(cpd, "the mask of the offset", part.free, due)

    def _require_noise(self, cpd: ConditionalGaussian) -> None:
        """Refuse free entries of a row that noise does not reach, e_i outside of its range.

        Beliefs agree with any value that these have, and no step would move them.
        """
        if isinstance(cpd.cov, Noise) or not np.isfinite(cpd.cov).all():
            return
        unit = deviation(cpd.cov)
        unit = np.where(unit > 0.0, unit, 1.0)
        values, axes = np.linalg.eigh(cpd.cov / unit[..., :, None] / unit[..., None, :])
        some = values > roots.NEGLIGIBLE * values[..., -1:]
        reached = np.where(some[..., None, :], axes * axes, 0.0).sum(axis=-1)
        most = reached.reshape(-1, len(self.free)).max(axis=0)
        certain = self.free.any(axis=1) & (most < 1.0 - _REACHED)
        if certain.any():
            names = np.array(labels((cpd.child,)))[certain]
            raise ModelError(
                f"{cpd!r}: {', '.join(names)} has no noise of its own, so that beliefs fit the "
                "coefficients and the offset as they are, and no step moves them; give it some, or "
                "free those of other components alone, by a mask",
                cpd=cpd,
            )

    def improved(
        self, beliefs: list[FamilyBelief], known: Known, improved: Known
    ) -> tuple[ConditionalGaussian, Array]:
        """The M step, and the gradient of the expected log-density before it.

        Parameters that functions take are `known` before the step, and `improved` by it.
        """
        cpd: Any = beliefs[0].family.cpd
        sums = self.expected(beliefs, known)
        slopes, noise = self.gradient(sums), cpd.noise
        if self.dof is not None:
            slopes = np.append(slopes, self.dof.gradient(cpd, beliefs))
            noise = self.dof.likeliest(cpd, beliefs)
            beliefs = reweighed(beliefs, noise)
        if self.dof is not None or any(variable in cpd.given for variable in improved):
            sums = self.expected(beliefs, improved)
        return with_noise(self.maximised(sums), noise), slopes

    def expected(self, beliefs: Sequence[FamilyBelief], known: Known) -> Expected:
        """The sums over all recordings that M step and gradient need."""
        cpd: Any = beliefs[0].family.cpd
        every = [residuals(belief, known) for belief in beliefs]
        reference = np.zeros(self.free.shape[1])
        some = any(each.count for each in every) and not isinstance(cpd.cov, Noise)
        if some and self.free[:, -1].all() and self.free[:, :-1].any():
            reference = sum(each.weighted(each.regressors).sum(axis=0) for each in every)
            reference = reference / reference[-1]
            reference[-1] = 0.0
        found = self._summed(cpd, every, reference)
        if self.noise is not None and any(each.scale is not None for each in every):
            own = self._summed(cpd, [each.of_noise for each in every], reference)
            found = replace(found, noise=own)
        return found

    def _summed(self, cpd: Any, every: list[Residuals], reference: Array) -> Expected:
        """The sums of residuals, whose regressors are counted from a reference."""
        count = sum(each.count for each in every)
        if isinstance(cpd.cov, Noise):
            return self._by_row(cpd, every, count, reference)
        sums = zip(*(each.sums(reference) for each in every), strict=True)
        own, cross, gram = (np.sum(parts, axis=0) for parts in sums)
        # A regressor that differs from its mean by rounding alone tells nothing.
        still = np.diagonal(gram) <= gram[-1, -1] * (_STILL * reference) ** 2
        still[-1] = False
        cross, gram = np.where(still, 0.0, cross), np.where(still | still[:, None], 0.0, gram)
        return Expected(cpd, own, cross, gram, count, reference)

    def _by_row(self, cpd: Any, every: list[Residuals], count: float, reference: Array) -> Expected:
        """Sums over rows, each weighted by the inverse of its own noise covariance."""
        rows, columns = np.nonzero(self.free)
        normal, said = np.zeros((rows.size, rows.size)), np.zeros(rows.size)
        moments, ranks = [], 0.0
        for each in every:
            own, cross, gram = each.rows()
            weight = np.broadcast_to(np.linalg.pinv(each.noise, hermitian=True), own.shape)
            rank = np.linalg.matrix_rank(each.noise, hermitian=True)
            ranks += float(each.counted(np.broadcast_to(rank, len(own))).sum())
            moments.append((own, cross, gram, weight))
            for k, (i, a) in enumerate(zip(rows, columns, strict=True)):
                normal[k] += np.sum(weight[:, i, rows] * gram[:, a, columns], axis=0)
            said += (weight @ cross).sum(axis=0)[rows, columns]
        if count and normal.size and not any(weight.any() for *_, weight in moments):
            raise ModelError(
                f"{cpd!r}: its noise is zero wherever it was told of, so that beliefs fit the "
                "coefficients and the offset as they are, and no step moves them; give it some",
                cpd=cpd,
            )
        zero = np.zeros((0, 0))
        weighted = Weighted(normal, said, moments, ranks)
        return Expected(cpd, zero, zero, zero, count, reference, weighted)

    def maximised(self, sums: Expected) -> ConditionalGaussian:
        """The CPD whose free parameters maximise the expected log-density."""
        if not sums.count:
            unchanged: ConditionalGaussian = sums.cpd
            return unchanged
        if sums.weighted is not None:
            own = sums.weighted if sums.noise is None else sums.noise.weighted
            assert own is not None
            return self._weighted(sums.cpd, sums.weighted, own)
        change, cov = self._solved(sums)
        change[:, -1] -= change @ sums.reference
        return self._changed(sums.cpd, change, cov)

    def _solved(self, sums: Expected) -> tuple[Array, Any]:
        change, cov, noise = np.zeros(self.free.shape), sums.cpd.cov, sums.noise or sums
        for _ in range(_ROUNDS):
            before, was = change, cov
            if self.free.any():
                change = self._regressed(sums.cross, sums.gram, cov)
            if self.noise is None or not noise.count:  # of a loss none may have a weight
                return change, cov
            own = _left(noise.own, change, noise.cross, noise.gram)
            cov = self.noise.likeliest(own, noise.count)
            if self.same or not self.free.any():
                return change, cov
            moved = np.abs(cov - was).max() / max(np.abs(cov).max(), _LEAST)
            largest = max(np.abs(change).max(), _LEAST)
            if moved < _SETTLED and np.abs(change - before).max() < _SETTLED * largest:
                break
        return change, cov

    def _regressed(self, cross: Array, gram: Array, cov: Array) -> Array:
        """The change of the coefficients."""
        change = np.zeros(self.free.shape)
        if self.same:
            free = self.free[0]
            change[:, free] = _least(gram[np.ix_(free, free)], cross[:, free].T).T
            return change
        if not (cov - np.diag(np.diagonal(cov))).any():
            for row, free in enumerate(self.free):
                if free.any():
                    change[row, free] = _least(gram[np.ix_(free, free)], cross[row, free])
            return change
        weight = np.linalg.pinv(cov, hermitian=True)
        rows, columns = np.nonzero(self.free)
        normal = weight[np.ix_(rows, rows)] * gram[np.ix_(columns, columns)]
        change[rows, columns] = _least(normal, (weight @ cross)[rows, columns])
        return change

    def _weighted(self, cpd: Any, sums: Weighted, noise: Weighted) -> ConditionalGaussian:
        change = np.zeros(self.free.shape)
        if self.free.any():
            change[self.free] = _least(sums.normal, sums.said)
        cov = cpd.cov
        if self.noise is not None and noise.ranks:
            total = sum(
                float(np.sum(weight * _left(own, change, cross, gram)))
                for own, cross, gram, weight in noise.moments
            )
            # Of sums that cancel rounding is left, from which another step begins.
            whole = sum(float(np.sum(weight * own)) for own, *_, weight in noise.moments)
            total = max(total, 2.0**-52 * whole)
            cov = self.noise.scaled(self.noise.factor(cpd) * total / noise.ranks)
        return self._changed(cpd, change, cov)

    def vanishes(self, beliefs: Sequence[FamilyBelief], known: Known, *, searched: bool) -> bool:
        """Whether the noise that is learnt is next to none beside the readings' rounding.

        Deviations are the largest of any row; see `CovarianceStep.vanishes`.
        """
        if self.noise is None:
            return False
        noises = [np.diagonal(each.family.own_noise, axis1=-2, axis2=-1) for each in beliefs]
        std = np.sqrt(np.max([each.max(axis=(0, 1)) for each in noises], axis=0))
        rounding = np.max([rounded(each, known) for each in beliefs], axis=0)
        return self.noise.vanishes(beliefs[0].family.cpd, std, rounding, searched=searched)

    def gradient(self, sums: Expected) -> Array:
        """The derivatives of the expected log-density by the coordinates."""
        cpd, weighted = sums.cpd, sums.weighted
        parts = [np.zeros(0)]
        if self.free.any() and weighted is not None:
            parts.append(weighted.said)
        elif self.free.any():
            reference = sums.reference.copy()
            whole = sums.cross + sums.cross[:, -1:] * reference
            parts.append((np.linalg.pinv(cpd.cov, hermitian=True) @ whole)[self.free])
        if self.noise is not None and weighted is not None:
            total = sum(float(np.sum(weight * own)) for own, *_, weight in weighted.moments)
            parts.append(np.array([(total - weighted.ranks) / np.sqrt(self.noise.factor(cpd))]))
        elif self.noise is not None:
            parts.append(self.noise.gradient(cpd, sums.own, sums.count))
        return np.concatenate(parts)

    def _changed(self, cpd: Any, change: Array, cov: Any) -> ConditionalGaussian:
        if isinstance(cpd, GaussianCPD):
            return GaussianCPD(cpd.child, cpd.offset + change[:, -1] * self.free[:, -1], cov)
        if isinstance(cpd, LinearGaussianCPD):
            matrices = {p: cpd.matrices[p] + change[:, self.places[p]] for p in cpd.given}
            offset = cpd.offset + np.where(self.free[:, -1], change[:, -1], 0.0)
            return LinearGaussianCPD(cpd.child, matrices, cov=cov, offset=offset, noise=cpd.noise)
        changed: ConditionalGaussian = cpd._with_cov(cov)
        return changed

    def vector(self, cpd: Any) -> Array:
        """The coordinates of a CPD: first its free entries, then its covariance's."""
        parts = [np.zeros(0)]
        if self.free.any():
            parts.append(self._coefficients(cpd)[self.free])
        if self.noise is not None:
            parts.append(self.noise.vector(cpd))
        if self.dof is not None:
            parts.append(self.dof.vector(cpd))
        return np.concatenate(parts)

    def _coefficients(self, cpd: Any) -> Array:
        """Coefficients and offset as `free` has them; of those by step, never free, the first."""
        offset = cpd.offset if cpd.offset.ndim == 1 else cpd.offset[0]
        whole = [each if each.ndim == 2 else each[0] for each in map(cpd.matrices.get, self.order)]
        return np.concatenate([*whole, offset[:, None]], axis=1)

    def at(self, cpd: Any, vector: Array) -> ConditionalGaussian:
        """The CPD of some coordinates."""
        count = int(self.free.sum())
        change = np.zeros(self.free.shape)
        if count:
            change[self.free] = vector[:count] - self.vector(cpd)[:count]
        noise = cpd.noise
        if self.dof is not None:
            vector, noise = vector[:-1], self.dof.at(vector[-1:])
        cov = cpd.cov if self.noise is None else self.noise.at(vector[count:])
        return with_noise(self._changed(cpd, change, cov), noise)


def _mask(cpd: Any, what: str, value: Any, due: tuple[int, ...]) -> Mask:
    mask = np.asarray(value)
    if mask.dtype != np.bool_ or mask.shape not in ((), due):
        raise ModelError(
            f"{cpd!r}: {what} is True or False, or an array of these, {due}; found {value!r}",
            cpd=cpd,
        )
    return np.broadcast_to(mask, due)


def _least(normal: Array, said: Array) -> Array:
    """The shortest solution of normal equations, whose unknowns are scaled to be alike."""
    scale = np.sqrt(np.maximum(np.diagonal(normal), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    wide = scale[:, None] if said.ndim > 1 else scale
    found: Array = np.linalg.lstsq(
        normal / np.outer(scale, scale), said / wide, rcond=4.0 * len(scale) * 2.0**-52
    )[0]
    return found / wide
