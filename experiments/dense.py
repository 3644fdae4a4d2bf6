"""The joint of a small linear Gaussian network as one large Gaussian, in plain NumPy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Dense:
    """A weighted Gaussian over all variables without evidence: exp(log_evidence) N(mean, cov).

    With each CPD v = Σ F p + offset + n, all of them together are v = A v + offset + n, so that
    the mean is (I − A)⁻¹ offset and the covariance (I − A)⁻¹ Q (I − A)⁻ᵀ. It takes time cubic in
    the number of components: a check, nothing else.
    """

    places: Mapping[pgm.Variable, slice]
    mean: Array
    cov: Array
    log_evidence: float = 0.0

    @classmethod
    def of(cls, network: pgm.MarkovNetwork) -> Dense:
        """Multiply the CPDs out."""
        ends = np.cumsum([variable.dimension for variable in network.variables])
        places = {
            v: slice(end - v.dimension, end)
            for v, end in zip(network.variables, ends.tolist(), strict=True)
        }
        matrix, noise = np.zeros((2, ends[-1], ends[-1]))
        offset = np.zeros(ends[-1])
        for cpd in network.cpds:
            assert isinstance(cpd, pgm.GaussianCPD | pgm.LinearGaussianCPD)
            rows = places[cpd.child]
            offset[rows], noise[rows, rows] = cpd.offset, cpd.cov
            for parent, factor in cpd.matrices.items():
                matrix[rows, places[parent]] = factor
        total = np.linalg.inv(np.eye(ends[-1]) - matrix)
        return cls(places, total @ offset, total @ noise @ total.T)

    def _index(self, *variables: pgm.Variable) -> npt.NDArray[np.intp]:
        everywhere = np.arange(self.mean.size)
        return np.concatenate([everywhere[:0], *(everywhere[self.places[v]] for v in variables)])

    def given(self, evidence: Mapping[pgm.Variable, npt.ArrayLike]) -> Dense:
        """Condition on values."""
        seen = self._index(*evidence)
        value = np.concatenate([np.zeros(0), *map(np.ravel, evidence.values())])
        gain = np.linalg.solve(self.cov[np.ix_(seen, seen)], self.cov[seen]).T
        innovation = value - self.mean[seen]
        mean = self.mean + gain @ innovation
        cov = self.cov - gain @ self.cov[seen]
        weight = _log_density(innovation, self.cov[np.ix_(seen, seen)])
        return Dense(self.places, mean, cov, self.log_evidence + weight)

    def marginal(self, *variables: pgm.Variable) -> tuple[Array, Array]:
        """Mean and covariance of some variables."""
        index = self._index(*variables)
        return self.mean[index], self.cov[np.ix_(index, index)]

    def form(self, *variables: pgm.Variable) -> tuple[Array, Array, float]:
        """K, h and g of the marginal, with the weight of the evidence."""
        mean, cov = self.marginal(*variables)
        K = np.asarray(np.linalg.inv(cov), dtype=np.float64)
        return K, K @ mean, self.log_evidence + _log_density(mean, cov)


def _log_density(offset: Array, cov: Array) -> float:
    """The log-density of N(0, cov) at an offset."""
    square = offset @ np.linalg.solve(cov, offset)
    return float(-0.5 * (square + np.linalg.slogdet(2.0 * np.pi * cov)[1]))
