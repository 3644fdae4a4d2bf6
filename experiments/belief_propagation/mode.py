"""The most probable values of a Gaussian network, by SciPy's least squares."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

import pgm
from pgm import NonlinearGaussianCPD

Array = npt.NDArray[np.float64]


def mode(
    network: pgm.BayesianNetwork,
    evidence: Mapping[pgm.Variable, Array],
    start: Mapping[pgm.Variable, Array],
) -> dict[pgm.Variable, Array]:
    """Minimise Σ ‖L⁻¹ (v − f(parents))‖², over all CPDs, whose covariances are L Lᵀ.

    Parameters
    ----------
    network : BayesianNetwork
        Of Gaussian and nonlinear CPDs.
    evidence, start : mapping of Variable to ndarray
        Values (d,) of what is observed, and where to begin with all else.
    """
    ends = np.cumsum([value.size for value in start.values()])[:-1]

    def unpacked(x: Array) -> dict[pgm.Variable, Array]:
        return dict(zip(start, np.split(x, ends), strict=True))

    def residuals(x: Array) -> Array:
        values = {**evidence, **unpacked(x)}
        found = []
        for cpd in network.cpds:
            assert isinstance(cpd, pgm.GaussianCPD | NonlinearGaussianCPD)
            if isinstance(cpd, NonlinearGaussianCPD):
                mean = cpd.function(*(values[parent] for parent in cpd.given))
            else:
                mean = cpd.mean
            error = values[cpd.child] - mean
            angles = [component in cpd.child.angles for component in cpd.child.components]
            error = np.where(angles, np.angle(np.exp(1j * error)), error)
            found.append(np.linalg.solve(np.linalg.cholesky(np.asarray(cpd.cov)), error))
        return np.concatenate(found)

    packed = np.concatenate(list(start.values()))
    exact = 1e-15
    found = least_squares(residuals, packed, jac="3-point", xtol=exact, ftol=exact, gtol=exact)
    return unpacked(found.x)
