"""Is a belief right about its own errors? Errors and normalised errors against the truth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv

from pgm.errors import ModelError, NumericalError
from pgm.factors import Gaussian
from pgm.kernels import roots
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, inner


def error(belief: Gaussian, truth: npt.ArrayLike) -> Array:
    """Mean less truth, (..., n), angles wrapped to [−π, π).

    Raises
    ------
    ModelError
        If the truth has another number of components than the belief.
    """
    values = np.asarray(truth, dtype=float)
    if values.shape[-1:] != belief.mean.shape[-1:]:
        raise ModelError(
            f"a truth of shape {values.shape} for a belief with means of shape "
            f"{belief.mean.shape}; the last axes must agree"
        )
    return difference(belief.mean, values, belief.angles)


def rmse(belief: Gaussian, truth: npt.ArrayLike, components: tuple[str, ...] = ()) -> float:
    """Root mean square error over all runs and steps.

    √ of the mean of Σ e², the sum taken over the components named, or over all.
    """
    errors = error(belief, truth)
    if components:
        labels = [label for variable in belief.scope for label in variable.components]
        lost = [label for label in components if label not in labels]
        if lost:
            raise ModelError(f"the belief has components {labels}, not {lost}")
        errors = errors[..., [labels.index(label) for label in components]]
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


def nees(belief: Gaussian, truth: npt.ArrayLike) -> Array:
    """Normalised estimation error squared, eᵀP⁻¹e, (...): χ² with n degrees for a right belief.

    Raises
    ------
    NumericalError
        If a covariance is singular.

    References
    ----------
    Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4.
    """
    lower = roots.root(belief.cov)
    if not roots.is_proper(lower) or roots.determined(lower).any():
        raise NumericalError(
            f"no NEES of {belief.scope}: a covariance is singular, so that an error has no scale"
        )
    white = roots.solve_lower(lower, error(belief, truth)[..., None])[..., 0]
    return inner(white, white)


def mean_band(dof: int, count: int, confidence: float = 0.99) -> tuple[float, float]:
    """The two-sided χ² band of the mean of independent normalised errors squared.

    Parameters
    ----------
    dof : int
        Degrees of freedom of each.
    count : int
        How many are averaged.
    confidence : float
        Probability of the band.
    """
    tail = 0.5 * (1.0 - confidence)
    low, high = (2.0 * float(gammaincinv(0.5 * dof * count, p)) for p in (tail, 1.0 - tail))
    return low / count, high / count
