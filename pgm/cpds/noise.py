"""Noise covariances: constant, or a function of observed parents."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats
from pgm.errors import ModelError
from pgm.factors.arrays import as_matrix
from pgm.factors.scope import Scope, as_scope, listed
from pgm.kernels.arrays import Array, frozen
from pgm.kernels.checks import covariance_fault, symmetrised
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class Noise:
    """A noise covariance that depends on observed parents; made by `noise`."""

    function: Callable[..., Any]
    given: Scope


def noise(function: Callable[..., Any], given: Variable | Iterable[Variable]) -> Noise:
    """A noise covariance that is a function of parents with evidence.

    Parameters
    ----------
    function : callable
        ``function(*given)``, from arrays (..., d), leading axes equal or none, to covariances
        (..., n, n).
    given : Variable or sequence of Variable
        The parents, which must have evidence, since a covariance cannot be linearised.

    Examples
    --------
    >>> u = Variable("u", components=("v", "dt"))
    >>> driven = noise(lambda u: 0.01 * u[..., 1, None, None] * np.eye(3), given=(u,))
    """
    if not callable(function):
        raise ModelError(f"noise takes a function of the parents, not {function!r}")
    return Noise(function, as_scope(given, "noise: given"))


def evaluate(
    cov: Noise, child: Variable, known: Mapping[Variable, Array], shape: tuple[int, ...], step: Any
) -> Array:
    """The covariance for given values of the parents, (*shape, n, n), checked.

    Parameters
    ----------
    cov : Noise
    child : Variable
        Whose noise it is.
    known : mapping of Variable to ndarray
        Values of the parents, which broadcast to (*shape, d).
    shape : tuple of int
        The leading axes.
    step : array_like of int or None
        The step of each, which broadcasts to the shape, for messages; None where there is no time.
    """
    arguments = [np.broadcast_to(known[v], (*shape, v.dimension)) for v in cov.given]
    try:
        found = cov.function(*arguments)
    except Exception as error:
        raise ModelError(
            f"the noise of the CPD of {child!r} failed on arrays of leading axes {shape}: "
            f"{type(error).__name__}: {error}",
            variable=child,
        ) from error
    what = f"the noise of the CPD of {child!r}"
    value = as_floats(found, what, verb="return", variable=child)
    due = (*shape, child.dimension, child.dimension)
    if value.shape != due:
        raise ModelError(
            f"the noise of the CPD of {child!r} returned shape {value.shape} where {due} was due; "
            "it is called with arrays that have leading axes",
            variable=child,
        )
    value = symmetrised(value)
    if covariance_fault(value):
        for index in np.ndindex(shape):
            if fault := covariance_fault(value[index]):
                at = None if step is None else int(np.broadcast_to(step, shape)[index])
                where = "" if at is None else f" at step {at}"
                raise ModelError(
                    f"the noise of the CPD of {child!r}{where} {fault}",
                    variable=child,
                    step=at,
                )
    return value


def as_covariance(child: Variable, cov: npt.ArrayLike, *, lead: bool = False) -> Array:
    """A covariance of a variable as an array (n, n); a scalar's may be a Python number.

    With `lead`, leading axes of runs are taken too.
    """
    array = as_matrix((child,), cov, f"the covariance of {child!r}", variable=child)
    size = child.dimension
    if array.shape[-2:] != (size, size) or (array.ndim > 2 and not lead):
        raise ModelError(
            f"the covariance of {child!r} has shape {array.shape}; its {size} components "
            f"({listed(child.components)}) need ({size}, {size})",
            variable=child,
        )
    if fault := covariance_fault(array):
        raise ModelError(f"the covariance of {child!r} {fault}", variable=child)
    return frozen(array)
