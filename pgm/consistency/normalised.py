"""Errors and innovations, measured by the covariance that a belief gives them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy.typing as npt

from pgm.consistency.errors import error, places
from pgm.errors import ModelError, NumericalError
from pgm.factors import Gaussian
from pgm.inference import Innovations
from pgm.kernels import roots
from pgm.kernels.arrays import Array, block, inner


def nees(belief: Gaussian, truth: npt.ArrayLike, components: Sequence[str] = ()) -> Array:
    """Normalised estimation error squared, eᵀP⁻¹e, (...): χ² with n degrees for a right belief.

    Parameters
    ----------
    belief : Gaussian
    truth : array_like
        (..., n).
    components : sequence of str
        Whose marginal is judged, n of them; all without.

    Raises
    ------
    NumericalError
        If a covariance is singular.

    References
    ----------
    Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4.
    """
    chosen = places(belief, components)
    lower = roots.root(block(belief.cov, chosen, chosen))
    if not roots.is_proper(lower) or roots.determined(lower).any():
        raise NumericalError(
            f"no NEES of {belief.scope}: a covariance is singular, so that an error has no scale"
        )
    errors = error(belief, truth)[..., chosen]
    white = roots.solve_lower(lower, errors[..., None])[..., 0]
    return inner(white, white)


def nis(innovations: Innovations) -> Array:
    """Normalised innovation squared of each step, rᵀS⁻¹r, (..., T+1); NaN where nothing was read.

    χ² for a right model, its degrees the number of components read, ``innovations.dof``.
    """
    return check_innovations(innovations).nis


def check_innovations(innovations: Any) -> Innovations:
    """The innovations; refuses anything else."""
    if not isinstance(innovations, Innovations):
        raise ModelError(
            f"innovations are those of one sensor, posterior.innovations[z], not a "
            f"{type(innovations).__name__}"
        )
    return innovations
