"""The vectors and matrices of a factor as arrays; a factor over one component takes numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, as_wholes
from pgm.errors import ModelError
from pgm.factors.scope import Scope, dimension, labels, names
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.checks import is_symmetric, symmetrised


def as_vector(scope: Scope, value: Any, what: str) -> Array:
    """A copy of a vector over a scope, (..., n)."""
    array = as_floats(value, what, labels=labels(scope)).copy()
    return array[None] if array.ndim == 0 and dimension(scope) == 1 else array


def as_matrix(scope: Scope, value: Any, what: str, **about: Any) -> Array:
    """A copy of a matrix over a scope, (..., n, n), made symmetric if it all but is."""
    array = as_floats(value, what, **about).copy()
    if array.ndim == 0 and dimension(scope) == 1:
        array = array[None, None]
    square = array.ndim >= 2 and array.shape[-1] == array.shape[-2]
    return symmetrised(array) if square else array


def as_information(
    scope: Scope, K: npt.ArrayLike, h: npt.ArrayLike, g: npt.ArrayLike
) -> tuple[Array, Array, Array]:
    """Copies of the matrix, vector and constant of a canonical form; refuses what is none."""
    size = dimension(scope)
    what = f"canonical form over {names(scope)}:"
    K, h = as_matrix(scope, K, f"{what} K"), as_vector(scope, h, f"{what} h")
    g = as_floats(g, f"{what} g").copy()
    if K.shape[-2:] != (size, size) or h.shape[-1:] != (size,):
        raise ModelError(
            f"canonical form over {names(scope)}: K has shape {K.shape} and h {h.shape}; "
            f"they must end in ({size}, {size}) and ({size},)"
        )
    if not all(np.isfinite(part).all() for part in (K, h, g)):
        raise ModelError(f"canonical form over {names(scope)}: K, h and g must be finite")
    if not is_symmetric(K):
        raise ModelError(f"canonical form over {names(scope)}: K is not symmetric")
    return K, h, g


def as_points(scope: Scope, value: Any, lead: tuple[int, ...], what: str) -> Array:
    """Finite values of the variables of a scope, (..., n), at each of some factors."""
    array = as_vector(scope, value, what)
    if array.shape[-1:] != (dimension(scope),):
        raise ModelError(
            f"{what} must be values of its {dimension(scope)} components along the last axis, not "
            f"of shape {array.shape}"
        )
    if not np.isfinite(array).all():
        raise ModelError(f"{what} has entries that are NaN or infinite")
    require_broadcast(array.shape[:-1], lead, what)
    return array


def as_steps(scope: Scope, steps: npt.ArrayLike, lead: tuple[int, ...]) -> Integers:
    """The steps of the last of the leading axes of a Gaussian."""
    array = as_wholes(steps, f"Gaussian over {names(scope)}: its steps")
    if array.shape != lead[-1:]:
        raise ModelError(
            f"Gaussian over {names(scope)}: the steps have shape {array.shape}; the last of the "
            f"leading axes {lead} needs one step for each of its entries"
        )
    return array


def require_broadcast(own: tuple[int, ...], lead: tuple[int, ...], what: str) -> None:
    """Refuse leading axes that do not broadcast to those of some factors."""
    try:
        np.broadcast_shapes(own, lead)
    except ValueError:
        raise ModelError(
            f"{what} has leading axes {own}, which do not broadcast with those of the factors, "
            f"{lead}"
        ) from None
