"""Noise covariances: the likeliest ones within bounds, and vectors without bounds for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.cpds import ConditionalGaussian, Noise
from pgm.display import called
from pgm.errors import ModelError
from pgm.kernels.arrays import Array, symmetric
from pgm.learning.declared import Covariance

# Smaller parts of the largest variance are none of a singular covariance.
_NONE = 1e-14
_TINY = 1e-300


class ScaledNoise:
    """A function of noise times a factor."""

    def __init__(self, function: Any, factor: float) -> None:
        self.function, self.factor = function, factor
        self.__name__ = f"{factor:.6g} {called(function)}"

    def __call__(self, *given: Array) -> Array:
        return self.factor * np.asarray(self.function(*given))


class CovarianceStep:
    """The M step of one covariance, and its unbounded coordinates.

    These are logarithms: of the factor, of variances, or the Cholesky factor of the covariance on
    its range with the logarithms of its diagonal. A covariance that is singular at the start stays
    on its range, as EM itself keeps it.

    Parameters
    ----------
    cpd : ConditionalGaussian
        As it was at the start.
    declared : Covariance
    """

    def __init__(self, cpd: ConditionalGaussian, declared: Covariance) -> None:
        self.declared, self.start = declared, cpd.cov
        kind = declared.kind
        if isinstance(cpd.cov, Noise):
            if kind != "scaled":
                raise ModelError(
                    f"{cpd!r}: its noise is a function of parents, of which a factor alone can be "
                    f'learnt: pgm.learning.Covariance("scaled"), not "{kind}"',
                    cpd=cpd,
                )
            return
        if cpd.cov.ndim > 2 or not np.isfinite(cpd.cov).all():
            raise ModelError(
                f"{cpd!r}: its covariance differs by run or is infinite, and one finite one is "
                "learnt of all runs; give it one to start with",
                cpd=cpd,
            )
        if not cpd.cov.any():
            raise ModelError(
                f"{cpd!r}: its covariance is zero, and would stay so, as a factor of nothing or "
                "for want of room; give it one to start with",
                cpd=cpd,
            )
        off = cpd.cov - np.diag(np.diagonal(cpd.cov))
        if kind == "diagonal" and off.any():
            raise ModelError(
                f"{cpd!r}: its covariance has correlations, and a diagonal one is to be learnt; "
                'start with one, or learn pgm.learning.Covariance("full")',
                cpd=cpd,
            )
        values, vectors = np.linalg.eigh(cpd.cov)
        self.range = vectors[:, values > _NONE * values[-1]]
        self.factor_of = np.linalg.pinv(cpd.cov, rcond=_NONE, hermitian=True)

    def likeliest(self, cpd: ConditionalGaussian, own: Array, count: int) -> Any:
        """The covariance that makes sums E[r rᵀ] of so many residuals likeliest, within bounds.

        −½ (N ln |Q| + tr Q⁻¹ S) is largest at S/N, of which variances, the factor, or eigenvalues
        are moved to the nearest bound: the function of each falls on both sides of its maximum.
        """
        declared, mean = self.declared, symmetric(own) / count
        if declared.kind == "scaled":
            rank = self.range.shape[1]
            factor = float(np.sum(self.factor_of * mean)) / rank
            return np.clip(factor, declared.lower, declared.upper) * self.start
        if declared.kind == "diagonal":
            return np.diag(self._bounded(np.diagonal(mean), np.diagonal(self.start) > 0.0))
        inner = self.range.T @ mean @ self.range
        values, vectors = np.linalg.eigh(symmetric(inner))
        low = max(declared.lower, 0.0)
        vectors = self.range @ vectors
        return symmetric((vectors * np.clip(values, low, declared.upper)) @ vectors.T)

    def _bounded(self, variances: Array, there: Any) -> Array:
        found = np.clip(variances, self.declared.lower, self.declared.upper)
        return np.where(there, found, 0.0)

    def factor(self, cpd: ConditionalGaussian) -> float:
        """The factor on the covariance at the start."""
        if isinstance(cpd.cov, Noise):
            function = cpd.cov.function
            own = isinstance(function, ScaledNoise) and function is not self.start.function
            return function.factor if own else 1.0
        return float(np.trace(cpd.cov) / np.trace(self.start))

    def scaled(self, factor: float) -> Any:
        """The covariance at the start times a factor."""
        factor = float(np.clip(factor, self.declared.lower, self.declared.upper))
        if isinstance(self.start, Noise):
            function = ScaledNoise(self.start.function, factor)
            return Noise(function, self.start.given, self.start.diagonal)
        return factor * self.start

    def vector(self, cpd: ConditionalGaussian) -> Array:
        """The coordinates of a CPD's covariance."""
        if self.declared.kind == "scaled":
            return np.array([np.log(max(self.factor(cpd), _TINY))])
        if self.declared.kind == "diagonal":
            there = np.diagonal(self.start) > 0.0
            return np.log(np.maximum(np.diagonal(cpd.cov)[there], _TINY))
        inner = self.range.T @ cpd.cov @ self.range
        values, vectors = np.linalg.eigh(symmetric(inner))
        root = vectors * np.sqrt(np.maximum(values, _TINY))
        lower = np.linalg.qr(root.T, mode="r").T
        lower = lower * np.sign(np.diagonal(lower))
        there = np.tril_indices(len(lower), -1)
        return np.concatenate([np.log(np.maximum(np.diagonal(lower), _TINY)), lower[there]])

    def at(self, vector: Array) -> Any:
        """The covariance of some coordinates, moved within the bounds."""
        if self.declared.kind == "scaled":
            return self.scaled(float(np.exp(vector[0])))
        if self.declared.kind == "diagonal":
            there = np.diagonal(self.start) > 0.0
            variances = np.zeros(len(there))
            variances[there] = np.exp(vector)
            return np.diag(self._bounded(variances, there))
        size = self.range.shape[1]
        lower = np.diag(np.exp(vector[:size]))
        lower[np.tril_indices(size, -1)] = vector[size:]
        inner = lower @ lower.T
        bounds = self.declared
        if bounds.lower > 0.0 or np.isfinite(bounds.upper):
            values, vectors = np.linalg.eigh(inner)
            inner = (vectors * np.clip(values, bounds.lower, bounds.upper)) @ vectors.T
        return symmetric(self.range @ inner @ self.range.T)
