"""Noise covariances: constant, or a function of observed parents."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pgm.display import InCode, called
from pgm.errors import ModelError
from pgm.factors.arrays import as_matrix
from pgm.factors.scope import Scope, as_scope, listed
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.checks import covariance_fault, symmetrised
from pgm.linearisers.calls import Call
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.cpds.conditional import ConditionalGaussian


@dataclass(frozen=True, eq=False, repr=False)
class Noise(InCode):
    """A noise covariance that depends on observed parents; made by `noise`."""

    function: Callable[..., Any]
    given: Scope

    def __repr__(self) -> str:
        return f"Noise({called(self.function)}, given=({listed(self.given)}))"


def noise(function: Callable[..., Any], given: Variable | Iterable[Variable]) -> Noise:
    """A noise covariance that is a function of parents with evidence.

    Parameters
    ----------
    function : callable
        ``function(*given)``, from arrays (..., d), leading axes equal or none, to covariances
        (..., n, n).
    given : Variable or sequence of Variable
        The parents, which must have evidence, since a covariance cannot be linearised.

    Returns
    -------
    Noise
        For the `cov` of a CPD; its values are checked where they are used.

    Raises
    ------
    ModelError
        If the function cannot be called, or the parents are no variables, repeat or are a set.

    Examples
    --------
    >>> u = Variable("u", components=("v", "dt"))
    >>> driven = noise(lambda u: 0.01 * u[..., 1, None, None] * np.eye(3), given=(u,))
    """
    if not callable(function):
        raise ModelError(f"noise takes a function of the parents, not {function!r}")
    return Noise(function, as_scope(given, "noise: given"))


def evaluate(
    cpd: ConditionalGaussian,
    known: Mapping[Variable, Array],
    shape: tuple[int, ...],
    step: int | Integers | None,
    first_run: int = 0,
) -> Array:
    """The covariance for given values of the parents, (*shape, n, n), checked.

    Parameters
    ----------
    cpd : CPD
        Of such noise.
    known : mapping of Variable to ndarray
        Values of the parents, which broadcast to (*shape, d).
    shape : tuple of int
        The leading axes, runs last.
    step : int, ndarray of int or None
        The step of each, which broadcasts to the shape, for messages; None where there is no time.
    first_run : int
        The number of the first run, for messages.
    """
    cov, child = cpd.cov, cpd.child
    assert isinstance(cov, Noise)
    arguments = [np.broadcast_to(known[v], (*shape, v.dimension)) for v in cov.given]
    call = Call(child, "noise", shape, step, first_run, cpd)
    value = call(cov.function, arguments, (*shape, child.dimension, child.dimension))
    value = symmetrised(value)
    if covariance_fault(value):
        for index in np.ndindex(shape):
            if fault := covariance_fault(value[index]):
                raise call.error(fault, index)
    return value


def as_covariance(
    child: Variable, cov: npt.ArrayLike, *, lead: bool = False, flat: bool = False
) -> Array:
    """A covariance of a variable as an array (n, n); a scalar's may be a Python number.

    With `lead`, leading axes of runs are taken too; with `flat`, infinite variances of components
    that are independent of all others, and infinity for all components.
    """
    array = as_matrix((child,), cov, f"the covariance of {child!r}", variable=child)
    size = child.dimension
    if flat and array.ndim == 0 and array == np.inf:
        array = np.diag(np.full(size, np.inf))
    if array.shape[-2:] != (size, size) or (array.ndim > 2 and not lead):
        raise ModelError(
            f"the covariance of {child!r} has shape {array.shape}; its {size} components "
            f"({listed(child.components)}) need ({size}, {size})",
            variable=child,
        )
    proper = array
    if flat and array.ndim >= 2 and (array == np.inf).any():
        variances = np.diagonal(array, axis1=-2, axis2=-1)
        open_ = variances == np.inf
        infinite = open_[..., None] & np.eye(size, dtype=bool)
        met = (open_[..., None] | open_[..., None, :]) & ~infinite
        if (array[met] != 0.0).any():
            raise ModelError(
                f"the covariance of {child!r}: a component of infinite variance has a covariance "
                "with another one; it must be 0",
                variable=child,
            )
        if not (open_ == open_.reshape(-1, size)[0]).all():
            raise ModelError(
                f"the covariance of {child!r} is infinite in other components in some runs than in "
                "others; give all runs the same ones",
                variable=child,
            )
        proper = np.where(infinite, 1.0, array)
    if fault := covariance_fault(proper):
        raise ModelError(f"the covariance of {child!r} {fault}", variable=child)
    return frozen(array)
