"""Linearisers, and their prepared form, which is ready for many calls.

An engine prepares a lineariser for each function once. Prepared arrays have components first and
the batch last: no axis for one run, or an axis of runs, or one of steps before that. A plain
callable of a user is wrapped.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from pgm.display import ByAttributes
from pgm.errors import LinearisationError
from pgm.factors import AffineGaussian, Gaussian
from pgm.factors.arrays import is_symmetric, symmetrised
from pgm.kernels.arrays import Array, block_diagonal, components_first, components_last, times
from pgm.linearisers.function import BoundFunction, sealed
from pgm.linearisers.template import FunctionTemplate


class Lineariser(Protocol):
    """Anything that makes an affine Gaussian of a function at a belief: a bare function will do.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> def at_mean(function, at):
    ...     F = function.jacobian(at.mean)
    ...     b = function(at.mean) - (F @ at.mean[..., None])[..., 0]
    ...     return pgm.AffineGaussian(F, b, cov=0.0)
    ...
    >>> pgm.infer(pgm.compile(square), {}, lineariser=at_mean)[y].mean
    array([9.])
    """

    def __call__(self, function: BoundFunction, at: Gaussian, /) -> AffineGaussian:
        """Linearise a function at a belief.

        Parameters
        ----------
        function : BoundFunction
            Maps stacked hidden parents (..., n) to (..., d).
        at : Gaussian
            Over the hidden parents, (*batch, n).

        Returns
        -------
        AffineGaussian
            F (*batch, d, n), b (*batch, d); its covariance is the approximation error alone.
        """
        ...


class Line(NamedTuple):
    """A linearisation at a belief of mean μ: y = value + F (x − μ) + n, n ~ N(0, error).

    Attributes
    ----------
    matrix : ndarray
        F, (d, n, *batch). Like the value it may be an array that a function of the user keeps.
    value : ndarray
        (d, *batch).
    error : ndarray or None
        (d, d, *batch): the covariance of the approximation error; None where there is none.

    Examples
    --------
    >>> from pgm.linearisers import Line
    >>> line = Line(matrix=np.array([[6.0]]), value=np.array([9.0]), error=None)  # of x² at 3
    >>> line.value + line.matrix @ [0.5]
    array([12.])
    """

    matrix: Array
    value: Array
    error: Array | None


class Prepared(Protocol):
    """A lineariser prepared for one function template, as a callable.

    Examples
    --------
    >>> from pgm.linearisers import TAYLOR, BoundFunction, FunctionTemplate
    >>> x, y = pgm.variables("x y")
    >>> slope = lambda x: 2.0 * x[..., None]
    >>> template = FunctionTemplate(y, (x,), (x,), lambda x: x**2, (slope,), (1.0,))
    >>> prepared = TAYLOR.prepare(template)
    >>> prepared(BoundFunction(template, [None], lead=0), np.array([3.0]), np.eye(1))
    Line(matrix=array([[6.]]), value=array([9.]), error=None)
    """

    def __call__(self, function: BoundFunction, mean: Array, cov: Array, /) -> Line:
        """Linearise at beliefs (n, *batch) and (n, n, *batch).

        ``function`` takes points with the batch first, (*batch, ..., n). Where its ``group`` is k,
        a value stacks k sightings, d components each: unless they are ``joint``, each is to be
        linearised by itself, as `apart` does it.

        Returns
        -------
        Line
            (d, n, *batch), (d, *batch) and None or (d, d, *batch).
        """
        ...


def prepare(lineariser: Lineariser, template: FunctionTemplate) -> Prepared:
    """A lineariser prepared for many calls with one template."""
    own = getattr(lineariser, "prepare", None)
    if own is None:
        return Wrapped(lineariser, template)
    prepared: Prepared = own(template)
    # A form made in this package is known to fit; a user's is checked in every call.
    # Code that was executed without a module's name, as in a notebook's cell, has None for it.
    ours = (getattr(own, "__module__", None) or "").startswith(f"{__package__}.")
    return prepared if ours else _Checked(prepared)


def by_values(lineariser: Lineariser | None) -> bool:
    """Whether a lineariser asks for nothing but a function's values and derivatives.

    Rules that draw points ask for the name of the CPD's child, too, and one that a user has written
    may ask for anything, as for the parents.
    """
    ours = type(lineariser).__module__.startswith(f"{__package__}.")
    return ours and not getattr(lineariser, "drawn", False)


def needs_cov(lineariser: Lineariser, template: FunctionTemplate) -> bool:
    """Whether a linearisation depends on the belief's covariance; it does unless it says not."""
    need: Any = getattr(lineariser, "needs_cov", True)
    said = need(template) if callable(need) else need
    if not isinstance(said, bool | np.bool_ | int):
        raise LinearisationError(
            f"{lineariser!r}: needs_cov is {said!r}; True or False was due, or a function of a "
            "template that returns one of them"
        )
    return bool(said)


class ArrayLineariser(ByAttributes, ABC):
    """A lineariser that works on arrays, so that engines need make no objects to call it.

    A subclass gives `prepare`.

    Examples
    --------
    >>> from pgm.examples import square, x, y
    >>> def at_mean(function, mean, cov):
    ...     x = np.moveaxis(mean, 0, -1)
    ...     slope = np.moveaxis(function.jacobian(x), (-2, -1), (0, 1))
    ...     return pgm.linearisers.Line(slope, np.moveaxis(function(x), -1, 0), None)
    ...
    >>> class AtMean(pgm.linearisers.ArrayLineariser):
    ...     def prepare(self, template):
    ...         return at_mean
    ...
    >>> pgm.infer(pgm.compile(square), {}, lineariser=AtMean())[y].mean
    array([9.])
    """

    needs_cov: ClassVar[Any] = True

    @abstractmethod
    def prepare(self, template: FunctionTemplate) -> Prepared:
        """The form that is ready for many calls.

        Parameters
        ----------
        template : FunctionTemplate
            The template of the functions that it will be called with.

        Returns
        -------
        Prepared
        """

    def is_semidefinite(self, dimension: int) -> bool:
        """Whether the error's covariance cannot be indefinite.

        Parameters
        ----------
        dimension : int
            Number of components of the belief.

        Returns
        -------
        bool
            False where it is not known.
        """
        return False

    def __call__(self, function: BoundFunction, at: Gaussian, /) -> AffineGaussian:
        """Linearise a function at a belief.

        Parameters
        ----------
        function : BoundFunction
            Maps stacked hidden parents (..., n) to (..., d).
        at : Gaussian
            Over the hidden parents, (*batch, n).

        Returns
        -------
        AffineGaussian
            F (*batch, d, n), b (*batch, d), and the covariance of the approximation error.
        """
        mean, cov = components_first(at.mean, 1), components_first(at.cov, 2)
        matrix, value, error = self.prepare(function.template)(function, mean, cov)
        offset = value - times(matrix, mean)
        size = len(value)
        spread = np.zeros((size, size)) if error is None else components_last(error, 2)
        return AffineGaussian(components_last(matrix, 2), components_last(offset, 1), spread)


class Misfit(Exception):
    """An answer of a lineariser that cannot be used: what was found, and what was due."""


class Wrapped:
    """A plain callable, called with a `Gaussian` over the hidden parents."""

    def __init__(self, lineariser: Lineariser, template: FunctionTemplate) -> None:
        self.lineariser, self.scope = lineariser, template.hidden

    def __call__(self, function: BoundFunction, mean: Array, cov: Array) -> Line:
        """Linearise at beliefs (n, *batch) and (n, n, *batch)."""
        if function.group is not None and not function.joint:
            return apart(self, function, mean, cov)
        at = Gaussian._make(self.scope, components_last(mean, 1), components_last(cov, 2))
        found = self.lineariser(function, at)
        batch = mean.shape[1:]
        if not isinstance(found, AffineGaussian):
            raise Misfit(f"returned {type(found).__name__}", "it must return a pgm.AffineGaussian")
        matrix, offset = found.F, found.b
        error = found.cov if np.count_nonzero(found.cov) else None
        if error is not None:
            _require_symmetric(error)
        due = (function.template.height * (function.group or 1), len(mean))
        if matrix.shape[-2:] != due:
            raise Misfit(f"returned an F of shape {matrix.shape}", f"it must end in {due}")
        if matrix.ndim != 2 or offset.ndim != 1 or found.cov.ndim != 2:
            lead = np.broadcast_shapes(matrix.shape[:-2], offset.shape[:-1], found.cov.shape[:-2])
            if lead not in ((), batch):
                raise Misfit(f"returned the leading axes {lead}", f"the belief has {batch}")
        if batch:
            matrix, offset = _over(batch, matrix, 2), _over(batch, offset, 1)
            error = None if error is None else _over(batch, error, 2)
        value = times(matrix, mean)
        value += offset
        return Line(matrix, value, error)


def _over(batch: tuple[int, ...], array: Array, own: int) -> Array:
    if array.ndim != own + len(batch) or array.shape[:-own] != batch:
        array = np.broadcast_to(array, (*batch, *array.shape[-own:]))
    return components_first(array, own)


class _Checked:
    """A prepared form of a user's, whose answers are checked in every call."""

    def __init__(self, prepared: Prepared) -> None:
        self.prepared = prepared

    def __call__(self, function: BoundFunction, mean: Array, cov: Array) -> Line:
        found = self.prepared(function, sealed(mean), sealed(cov))
        if not isinstance(found, Line):
            raise Misfit(
                f"returned {type(found).__name__}",
                "its prepared form must return a pgm.linearisers.Line",
            )
        size, *batch = mean.shape
        height = function.template.height * (function.group or 1)
        due = (height, size, *batch), (height, *batch), (height, height, *batch)
        for name, part, shape in zip(Line._fields, found, due, strict=True):
            if name == "error" and part is None:
                continue
            if type(part) is not np.ndarray or part.dtype != np.float64:
                raise Misfit(f"returned a {name} that is no array of floats", f"{shape} was due")
            if part.shape != shape:
                raise Misfit(f"returned a {name} of shape {part.shape}", f"{shape} was due")
        if found.error is not None:
            _require_symmetric(components_last(found.error, 2))
            if function.group is not None and not function.joint:
                _require_apart(found.error, function.group)
        return found


def _require_symmetric(error: Array) -> None:
    """Refuse an error's covariance that is not symmetric; one that is not finite fails later."""
    if not is_symmetric(symmetrised(error)) and np.isfinite(error).all():
        raise Misfit("returned an error whose covariance is not symmetric", "E = Eᵀ was due")


def _require_apart(error: Array, count: int) -> None:
    """Refuse an error whose parts of `count` sightings are correlated; (d, d, *batch) in all."""
    height = len(error) // count
    blocks = error.reshape(count, height, count, height, *error.shape[2:]).swapaxes(1, 2)
    if blocks[~np.eye(count, dtype=bool)].any():
        raise Misfit(
            f"returned an error that is correlated between {count} sightings of a step",
            "each has one of its own: where function.group is not None and function.joint is "
            "False, return pgm.linearisers.apart(line, function, mean, cov)",
        )


def apart(prepared: Prepared, function: BoundFunction, mean: Array, cov: Array) -> Line:
    """Linearise each of several sightings by itself, at one belief for all: their errors differ.

    Parameters
    ----------
    prepared : Prepared
        Called once, with the sightings as the first axis of the batch.
    function : BoundFunction
        With a ``group`` of k sightings; one without is linearised as it is.
    mean, cov : ndarray
        (n, *batch), (n, n, *batch).

    Returns
    -------
    Line
        A line of k d components; the error is block-diagonal.

    Examples
    --------
    >>> from pgm.linearisers import TAYLOR, BoundFunction, FunctionTemplate, apart
    >>> x, m, z = pgm.variables("x m z")
    >>> slope = lambda m, x: m[..., None]
    >>> template = FunctionTemplate(z, (m, x), (x,), lambda m, x: m * x, (None, slope), (1.0,))
    >>> two = BoundFunction(template, [np.array([[2.0], [5.0]]), None], lead=0, group=2)
    >>> apart(TAYLOR.prepare(template), two, np.array([3.0]), np.eye(1)).value
    array([ 6., 15.])
    """
    count = function.group
    if count is None:
        return prepared(function, mean, cov)  # a single sighting
    size, *batch = mean.shape
    at = np.broadcast_to(mean[:, None], (size, count, *batch))
    spread = np.broadcast_to(cov[:, :, None], (size, size, count, *batch))
    matrix, value, error = prepared(function.apart(), at, spread)
    height = len(value)
    # The sightings first, then the components of each.
    slope = np.moveaxis(np.broadcast_to(matrix, (height, size, count, *batch)), 2, 0)
    values = np.moveaxis(np.broadcast_to(value, (height, count, *batch)), 1, 0)
    whole = None
    if error is not None:
        blocks = np.broadcast_to(error, (height, height, count, *batch))
        whole = block_diagonal(np.moveaxis(blocks, 2, 0))
    return Line(
        slope.reshape(count * height, size, *batch), values.reshape(count * height, *batch), whole
    )
