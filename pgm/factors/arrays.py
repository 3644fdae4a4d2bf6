"""The vectors and matrices of a factor as arrays; a factor over one component takes numbers."""

from __future__ import annotations

from typing import Any

from pgm.factors.scope import Scope, dimension, labels
from pgm.kernels.arrays import Array
from pgm.kernels.checks import symmetrised
from pgm.numeric import as_floats


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
