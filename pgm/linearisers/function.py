"""The function of a CPD as linearisers see it: evidence bound, hidden parents stacked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from pgm.factors import AffineGaussian, Gaussian
from pgm.factors.scope import Scope, angle_mask, dimension, positions
from pgm.kernels import differences
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Index, Integers, Mask, laid_out_as
from pgm.linearisers.calls import Call
from pgm.variables import Variable

Function = Callable[..., Any]


class Lineariser(Protocol):
    """Anything that makes an affine Gaussian of a function at a belief: a bare function will do."""

    def __call__(self, function: BoundFunction, at: Gaussian, /) -> AffineGaussian:
        """The affine Gaussian; its covariance is the approximation error alone."""
        ...


class Affine(NamedTuple):
    """What a lineariser makes of a function, as arrays: y = F x + b + n, n ~ N(0, cov).

    Attributes
    ----------
    F, b : ndarray
        (..., d, n) and (..., d).
    cov : ndarray or None
        (..., d, d): the approximation error; None where there is none.
    """

    F: Array
    b: Array
    cov: Array | None


class ArrayLineariser(ABC):
    """A lineariser that works on arrays, so that engines need make no objects to call it."""

    @abstractmethod
    def affine(self, function: BoundFunction, mean: Array, cov: Array) -> Affine:
        """Linearise a function at beliefs (..., n) and (..., n, n)."""

    def is_semidefinite(self, dimension: int) -> bool:
        """Whether the error's covariance cannot be indefinite, at beliefs of so many components."""
        return False

    def __call__(self, function: BoundFunction, at: Gaussian, /) -> AffineGaussian:
        """Linearise a function at a belief."""
        matrix, offset, cov = self.affine(function, at.mean, at.cov)
        size = offset.shape[-1]
        return AffineGaussian(matrix, offset, np.zeros((size, size)) if cov is None else cov)


@dataclass(frozen=True, eq=False)
class FunctionTemplate:
    """What does not change from call to call: the function, its parents, and who is hidden.

    Parameters
    ----------
    child : Variable
        Whose CPD it is.
    given : tuple of Variable
        All parents, in the order of the function's arguments.
    hidden : tuple of Variable
        The parents without evidence, in the same order.
    function : callable
        ``function(*given)``.
    jacobians : tuple of callable or None
        The derivative by each parent, where one was given.
    """

    child: Variable
    given: Scope
    hidden: Scope
    function: Function
    jacobians: tuple[Function | None, ...]

    @cached_property
    def angles(self) -> Mask:
        """Which components of the value are angles."""
        return self.child.angle_mask

    @cached_property
    def input_angles(self) -> Mask:
        """Which components of the hidden parents are angles."""
        return angle_mask(self.hidden)

    @cached_property
    def size(self) -> int:
        """Number of components of the stacked hidden parents."""
        return dimension(self.hidden)

    @cached_property
    def places(self) -> tuple[Index | None, ...]:
        """Where each parent stands among the hidden ones; None for a parent with evidence."""
        return tuple(
            positions(self.hidden, [parent]) if parent in self.hidden else None
            for parent in self.given
        )

    @cached_property
    def numerical(self) -> tuple[int, ...]:
        """The stacked components whose derivative has to be taken by differences."""
        return tuple(
            int(k)
            for place, jacobian in zip(self.places, self.jacobians, strict=True)
            if place is not None and jacobian is None
            for k in np.arange(self.size)[place]
        )


@dataclass(frozen=True, eq=False, slots=True)
class BoundFunction:
    """A CPD's function of its hidden parents alone, the evidence bound.

    Calling it maps (..., n) to (..., d); the leading axes are those of the belief at hand,
    optionally followed by more, such as an axis of sigma points, over which evidence is expanded.

    Parameters
    ----------
    template : FunctionTemplate
    inputs : tuple of ndarray or None
        Values of the parents with evidence, (*lead, d) each, None for the hidden ones.
    lead : int
        Number of leading axes of the belief.
    step : int, ndarray of int or None
        The step, or an array over the leading axes where one call covers many.
    group : int, optional
        How many readings one value stacks; their axis is then the last but one of the inputs.
    timed : bool
        Whether the step is one in time, for messages.
    first_run : int or None
        The number of the first run in messages; None in a trial call.
    cpd : CPD, optional
        For programs that handle an error.
    """

    template: FunctionTemplate
    inputs: tuple[Array | None, ...]
    lead: int
    step: int | Integers | None = None
    group: int | None = None
    timed: bool = True
    first_run: int | None = 0
    cpd: Any = None

    @property
    def name(self) -> str:
        """The name of the CPD's child."""
        return self.template.child.name

    @property
    def angles(self) -> Mask:
        """Which components of the value are angles, (d,)."""
        angles = self.template.angles
        return angles if self.group is None else np.tile(angles, self.group)

    @property
    def input_angles(self) -> Mask:
        """Which components of the stacked hidden parents are angles, (n,)."""
        return self.template.input_angles

    @property
    def analytic(self) -> bool:
        """Whether the user gave the derivative by every hidden parent."""
        return not self.template.numerical

    def residual(self, a: Array, b: Array) -> Array:
        """A − b, (..., d), angles wrapped to [−π, π)."""
        return difference(a, b, self.angles)

    def __call__(self, x: Array) -> Array:
        """The value, (..., d), at stacked hidden parents x, (..., n)."""
        arguments, shape = self._arguments(x)
        template = self.template
        value = self._call("function", x)(
            template.function, arguments, (*shape, template.child.dimension)
        )
        if self.group is not None:
            return value.reshape(*x.shape[:-1], -1)
        return laid_out_as(x, value, 1)

    def jacobian(self, x: Array, std: Array | None = None) -> Array:
        """The derivative, (..., d, n), as the user gave it, else by central differences.

        Parameters
        ----------
        x : ndarray
            (..., n).
        std : ndarray, optional
            Standard deviations, (..., n), which set the steps of the differences.
        """
        template = self.template
        if template.numerical:
            spread = np.zeros_like(x) if std is None else std
            numerical = differences.jacobian(self, x, spread, self.angles)
            if len(template.numerical) == template.size:
                return numerical
        arguments, shape = self._arguments(x)
        height = template.child.dimension
        parts = []
        for parent, place, derivative in zip(
            template.given, template.places, template.jacobians, strict=True
        ):
            if place is None:
                continue
            if derivative is None:
                parts.append(numerical[..., place])
                continue
            part = self._call(f"jacobian by {parent!r}", x)(
                derivative, arguments, (*shape, height, parent.dimension)
            )
            if self.group is not None:
                part = part.reshape(*x.shape[:-1], -1, parent.dimension)
            parts.append(part)
        whole = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
        return laid_out_as(x, whole, 2)

    def _arguments(self, x: Array) -> tuple[list[Array], tuple[int, ...]]:
        extra = (1,) * (x.ndim - 1 - self.lead)
        shape = x.shape[:-1]
        if self.group is not None:
            x, shape = x[..., None, :], (*shape, self.group)
        arguments = []
        for place, value in zip(self.template.places, self.inputs, strict=True):
            if place is not None:
                argument = x[..., place]
            elif value is not None:
                at = self.lead
                argument = value.reshape(*value.shape[:at], *extra, *value.shape[at:])
            if argument.shape[:-1] != shape:
                argument = np.broadcast_to(argument, (*shape, argument.shape[-1]))
            arguments.append(argument)
        return arguments, shape

    def _call(self, what: str, x: Array) -> Call:
        step = self.step if self.timed else None
        lead = x.shape[: self.lead]
        return Call(self.template.child, what, lead, step, self.first_run, self.cpd)
