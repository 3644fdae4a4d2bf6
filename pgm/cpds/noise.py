"""Noise covariances: constant, or a function of observed parents."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.display import InCode, called
from pgm.errors import ModelError
from pgm.factors.arrays import diagonal as on_diagonal
from pgm.factors.scope import Scope, as_scope, listed
from pgm.kernels.arrays import Array, Integers
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
    diagonal: bool = False

    def __repr__(self) -> str:
        return f"Noise({called(self.function)}, given=({listed(self.given)}))"


def noise(
    function: Callable[..., Any],
    given: Variable | Iterable[Variable],
    *,
    diagonal: bool = False,
) -> Noise:
    """A noise covariance that is a function of parents with evidence.

    Parameters
    ----------
    function : callable
        ``function(*given)``, from arrays (..., d), leading axes equal or none, to covariances
        (..., n, n), with the same leading axes.
    given : Variable or sequence of Variable
        The parents, which must have evidence, since a covariance cannot be linearised.
    diagonal : bool
        Whether the function returns the variances of the components, (..., n), instead, which are
        independent. It is said here since three rows of variances of three components and one
        matrix have the same shape.

    Returns
    -------
    Noise
        For the `cov` of a CPD; its values are checked where they are used.

    Raises
    ------
    ModelError
        If the function cannot be called, the parents are no variables, repeat or are a set, or
        `diagonal` is no bool.

    Examples
    --------
    >>> u = Variable("u", components=("v", "dt"))
    >>> driven = noise(lambda u: 0.01 * u[..., 1, None, None] * np.eye(3), given=(u,))
    >>> slipping = noise(lambda u: 0.1 * u**2, given=(u,), diagonal=True)
    """
    if not callable(function):
        raise ModelError(f"noise takes a function of the parents, not {function!r}")
    if not isinstance(diagonal, bool):
        raise ModelError(f"noise: diagonal is True or False, not {diagonal!r}")
    return Noise(function, as_scope(given, "noise: given"), diagonal)


# What to do about a shape that was not due.
_MATRICES = (
    "it is called with arrays that have leading axes and returns a matrix for each; variances "
    "(..., n) are declared by noise(function, given, diagonal=True)"
)
_VARIANCES = (
    "it is called with arrays that have leading axes and returns the variance of each component, "
    "as diagonal=True says; leave that out for matrices (..., n, n)"
)


def evaluate(
    cpd: ConditionalGaussian,
    known: Mapping[Variable, Array],
    shape: tuple[int, ...],
    step: int | Integers | None,
    first_run: int = 0,
) -> Array:
    """The covariance for given values of the parents, (*shape, n, n), checked.

    Values of the parents broadcast to (*shape, d), steps to the shape, whose last axis is of runs;
    step and `first_run` are for messages.
    """
    cov, child = cpd.cov, cpd.child
    assert isinstance(cov, Noise)
    arguments = [np.broadcast_to(known[v], (*shape, v.dimension)) for v in cov.given]
    call = Call(child, "noise", shape, step, first_run, cpd)
    size = child.dimension
    if cov.diagonal:
        value = on_diagonal(call(cov.function, arguments, (*shape, size), _VARIANCES))
    else:
        value = symmetrised(call(cov.function, arguments, (*shape, size, size), _MATRICES))
    if covariance_fault(value):
        for index in np.ndindex(shape):
            if fault := covariance_fault(value[index]):
                raise call.error(fault, index)
    return value
