"""The function of a CPD as linearisers see it: evidence bound, hidden parents stacked."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from pgm.errors import PgmError
from pgm.immutable import set_writeable
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, Mask, components_first, components_last, quiet
from pgm.kernels.differences import jacobian as by_differences
from pgm.kernels.gaussian import lengths
from pgm.linearisers.calls import Call
from pgm.linearisers.numbering import COUNTED, Numbering
from pgm.linearisers.template import Function, FunctionTemplate
from pgm.tracing import Answers, Points, Program, beside

_ARRAY, _FLOAT = np.ndarray, np.dtype(np.float64)
# Up to so many numbers are copied in less time than it takes to broadcast them.
FEW = 4096


class Source(NamedTuple):
    """Whose function it is, for messages and for programs that handle an error.

    `timed` says whether the step is one in time; `numbering` is of the axis of runs, None in
    a trial call. `answers` are those of its trace, which somebody judges after the call; without,
    each evaluation is compared with the function at once.
    """

    cpd: Any = None
    timed: bool = True
    numbering: Numbering | None = COUNTED
    answers: Answers | None = None


class BoundFunction(NamedTuple):
    """A CPD's function of its hidden parents alone, the evidence bound.

    Calling it maps (..., n) to (..., d); the leading axes are those of the belief at hand,
    optionally followed by more, such as an axis of sigma points, over which evidence is expanded.

    Parameters
    ----------
    template : FunctionTemplate
    inputs : sequence of ndarray or None
        Values of the parents with evidence, (*lead, d) each, None for the hidden ones.
    lead : int
        Number of leading axes of the belief.
    step : int, ndarray of int or None
        The step, or an array over the leading axes where one call covers many.
    group : int, optional
        How many sightings one value stacks; their axis is then the last but one of the inputs.
    joint : bool
        Whether these are linearised as one vector, with the covariances between their errors.
    source : Source
        For messages.

    Examples
    --------
    >>> from pgm.linearisers import BoundFunction, FunctionTemplate
    >>> x, y = pgm.variables("x y")
    >>> slope = lambda x: 2.0 * x[..., None]
    >>> template = FunctionTemplate(y, (x,), (x,), lambda x: x**2, (slope,), (1.0,))
    >>> square = BoundFunction(template, [None], lead=0)
    >>> square(np.array([3.0])), square.jacobian(np.array([3.0]))
    (array([9.]), array([[6.]]))
    """

    template: FunctionTemplate
    inputs: Sequence[Array | None]
    lead: int
    step: int | Integers | None = None
    group: int | None = None
    joint: bool = False
    source: Source = Source()

    @property
    def name(self) -> str:
        """The name of the CPD's child."""
        return self.template.child.name

    @property
    def angles(self) -> Mask:
        """The mask of components of the value that are angles, (d,)."""
        angles = self.template.child.angle_mask
        return angles if self.group is None else np.tile(angles, self.group)

    @property
    def turning(self) -> list[int]:
        """The places of the components that are angles."""
        template, group = self.template, self.group
        if group is None or not template.turning:
            return template.turning
        height = template.height
        return [k * height + angle for k in range(group) for angle in template.turning]

    @property
    def input_angles(self) -> Mask:
        """The mask of components of the stacked hidden parents that are angles, (n,)."""
        return self.template.input_angles

    def residual(self, a: Array, b: Array) -> Array:
        """The difference a − b of values, (..., d), angles wrapped to [−π, π)."""
        return difference(a, b, self.angles)

    def __call__(self, x: Array) -> Array:
        """The value at stacked hidden parents.

        Parameters
        ----------
        x : ndarray
            (..., n).

        Returns
        -------
        ndarray
            (..., d).

        Raises
        ------
        ModelError
            If the CPD's function fails or returns a wrong shape.
        """
        arguments, shape = self._arguments(x)
        function, due = self.template.function, (*shape, self.template.height)
        try:  # here, and not in `_call`, which a user's traceback need not tell of
            value = function(*arguments)
        except Exception as error:
            raise self._failure(x, arguments, error) from error
        value = self._fitting("function", function, x, arguments, value, due)
        return value if not self.lead else _along_runs(value, 1)

    def _failure(self, x: Array, arguments: Sequence[Array], error: Exception) -> PgmError:
        """The error to raise where the CPD's function has failed at points (..., n)."""
        function, due = self.template.function, self._due(x)
        return self._told("function", x).failure(function, arguments, error, due)

    def _array(self, x: Array, arguments: Sequence[Array], value: Any) -> Array:
        """A value of the CPD's function at points (..., n), as an array (..., d), or refused."""
        function, due = self.template.function, self._due(x)
        return self._fitting("function", function, x, arguments, value, due)

    def _due(self, x: Array) -> tuple[int, ...]:
        """The shape of the CPD's own values at points (..., n)."""
        group = () if self.group is None else (self.group,)
        return (*x.shape[:-1], *group, self.template.height)

    def jacobian(self, x: Array, std: Array | None = None) -> Array:
        """The derivative, as the user gave it, else its trace's, else by central differences.

        Parameters
        ----------
        x : ndarray
            (..., n).
        std : ndarray, optional
            Standard deviations, (..., n), which set the steps of the differences.

        Returns
        -------
        ndarray
            (..., d, n).
        """
        arguments, shape = self._arguments(x)
        cov = None if std is None else std[..., None] * np.eye(x.shape[-1]) * std[..., None, :]
        traced = self._traced(x, cov, arguments, shape)
        slopes = None if traced is None else traced[1]
        return _along_runs(self._jacobian(x, std, arguments, shape, slopes), 2)

    def tangent(self, x: Array, cov: Array | None = None) -> tuple[Array, Array]:
        """The value, (..., d), and the derivative, (..., d, n), as `jacobian` takes it.

        Steps of differences are set by the lengths over which a function may vary: the deviations
        of the components, or less where one tells much of another.

        Parameters
        ----------
        x : ndarray
            (..., n).
        cov : ndarray, optional
            Covariances of the belief about x, (..., n, n).

        Returns
        -------
        tuple of ndarray
        """
        template, inputs, lead, _, group, _, _ = self
        derivative = template.derivatives[0][3] if template.undivided else None
        if derivative is None or group is not None:
            arguments, shape = self._arguments(x)
            traced = self._traced(x, cov, arguments, shape)
            if traced is not None and len(template.missing) == template.size:
                return traced
            if traced is None:
                due = *shape, template.height
                value = self._call("function", template.function, x, arguments, due)
                slopes = None
            else:
                value, slopes = traced
            std = None if slopes is not None else self._lengths(cov)
            return value, self._jacobian(x, std, arguments, shape, slopes)
        # Of a single hidden parent the derivative is all of the Jacobian.
        if lead:
            arguments, shape = self._arguments(x)
        else:
            if x.flags.writeable:
                x = sealed(x)
            arguments, shape = [x if value is None else value for value in inputs], ()
        role, function = "function", template.function
        try:
            value = function(*arguments)
            role, function = "derivative", derivative
            slope = function(*arguments)
        except Exception as error:
            raise self._told(role, x).failure(function, arguments, error, None) from error
        due, steep = (*shape, template.height), (*shape, template.height, template.size)
        if not is_due(value, due):
            value = self._told("function", x).array(template.function, arguments, value, due)
        if not is_due(slope, steep):
            slope = self._told("derivative", x).array(derivative, arguments, slope, steep)
        return value, slope

    def apart(self) -> BoundFunction:
        """The function of each sighting by itself: they are the first leading axis."""
        inputs = [None if v is None else np.moveaxis(v, self.lead, 0) for v in self.inputs]
        return self._replace(inputs=inputs, lead=self.lead + 1, group=None)

    def _traced(
        self,
        x: Array,
        cov: Array | None,
        arguments: list[Array],
        shape: tuple[int, ...],
    ) -> tuple[Array, Array] | None:
        """The value, (..., d), and the missing derivatives, (..., d, n), by the trace.

        `cov` (..., n, n) are the covariances of the belief about x (..., n).
        """
        answers = self.source.answers
        program = self.template.program if answers is None else answers.program
        if program is None or (answers is not None and answers.fault is not None):
            return None
        std = None
        if cov is not None and (shape or answers is None):
            std = np.sqrt(np.maximum(np.einsum("...ii->...i", cov), 0.0))
        if shape:
            if answers is None:
                value, slope = program.batch(arguments, shape)
            else:
                value, slope = answers.batch(arguments, shape, std)
            if answers is None and self._misled(arguments, shape, value, slope, std):
                return None
            value, slope = components_last(value, 1), components_last(slope, 2)
            if self.group is not None:
                value = value.reshape(*x.shape[:-1], -1)
                slope = slope.reshape(*x.shape[:-1], -1, slope.shape[-1])
            with quiet():
                finite = isfinite(value.sum() + slope.sum())
        elif answers is None:
            value, slope, finite = program.single(arguments)
            if self._misled(arguments, shape, value, slope, std):
                return None
        else:
            value, slope, finite = answers.single(arguments, cov)
        if answers is None or not finite:
            # Warnings and errors are the function's own; it may return an array that it uses again.
            followed = answers is not None or self._followed(program, x, std)
            function, due = self.template.function, (*shape, self.template.height)
            own = self._call("function", function, x, arguments, due)
            if answers is None and not (followed and _alike(own, value, self.angles)):
                return None
            value = own
        if not finite:
            numerical = self._differences(x, self._lengths(cov))[..., list(self.template.missing)]
            slope = np.where(np.isfinite(slope), slope, numerical)
        if len(self.template.missing) < self.template.size:
            wide = np.zeros((*slope.shape[:-1], self.template.size))
            wide[..., list(self.template.missing)] = slope
            slope = wide
        return value, slope

    def _misled(
        self,
        arguments: list[Array],
        shape: tuple[int, ...],
        value: Array,
        slope: Array,
        std: Array | None,
    ) -> bool:
        """Whether derivatives (d, n, *shape) of a trace are wrong for the belief; see `Slopes`.

        `std` (..., size) are the standard deviations of the hidden parents, None where nobody has
        told them.
        """
        slopes, missing = self.template.slopes, self.template.missing
        if slopes is None:
            return False
        if std is None:
            std = np.zeros(self.template.size)
        own = std if len(missing) == self.template.size else std[..., list(missing)]
        if not shape:
            components = [c for argument in arguments for c in argument.tolist()]
            if not slopes.doubtful(components, slope, own):
                return False
        points = Points.of_batch(shape, arguments, value, slope, own)
        return slopes.misled(points) is not None

    def _followed(self, program: Program, x: Array, std: Array | None) -> bool:
        """Whether a trace has the values of its function beside x, too, where this is in doubt.

        It may be of another branch than the function, which slopes show where values are alike: as
        at zero. A trace that makes floats is the likelier to be.
        """
        if not program.cast and x.all():
            return True
        x = beside(x, np.full(x.shape, 1e-2) if std is None else std)
        arguments, shape = self._arguments(x)
        try:
            due = self.template.function(*arguments)
        except Exception:  # which the call itself raises, where it needs the value
            return False
        value = components_last(program.batch(arguments, shape)[0], 1)
        noise = np.sqrt(self.template.variances)
        with quiet():
            error = np.abs(difference(due, value, self.template.child.angle_mask))
            wrong = ~(error <= 1e-9 * np.abs(due) + 1e-6 * noise)
            return not (wrong & np.isfinite(due)).any()

    @staticmethod
    def _lengths(cov: Array | None) -> Array | None:
        """The lengths (..., n) over which a function may vary, by covariances (..., n, n)."""
        if cov is None:
            return None
        return components_last(lengths(components_first(cov, 2)), 1)

    def _differences(self, x: Array, std: Array | None) -> Array:
        spread = np.zeros_like(x) if std is None else std
        return by_differences(self.__call__, x, spread, self.angles)

    def _jacobian(
        self,
        x: Array,
        std: Array | None,
        arguments: list[Array],
        shape: tuple[int, ...],
        slopes: Array | None = None,
    ) -> Array:
        template = self.template
        if template.missing:
            if slopes is None:
                slopes = self._differences(x, std)
            if len(template.missing) == template.size:
                return slopes
        parts = []
        for role, width, place, derivative in template.derivatives:
            if derivative is None:
                assert slopes is not None
                parts.append(slopes[..., place])
                continue
            due = (*shape, template.height, width)
            parts.append(self._call(role, derivative, x, arguments, due))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)

    def _arguments(self, x: Array) -> tuple[list[Array], tuple[int, ...]]:
        x = sealed(x)
        if not self.lead and self.group is None and self.template.undivided and x.ndim <= 2:
            # Of one run there is little to broadcast, and often nothing to cut.
            if x.ndim == 1:
                return [x if value is None else value for value in self.inputs], ()
            count = len(x)
            return [x if v is None else v[None].repeat(count, 0) for v in self.inputs], (count,)
        lead, shape = self.lead, x.shape[:-1]
        extra = shape[lead:]
        if self.group is not None:
            x, shape = x[..., None, :], (*shape, self.group)
        arguments = []
        for place, value in zip(self.template.places, self.inputs, strict=True):
            if value is None:
                argument = x if self.template.undivided else x[..., place]
            else:
                argument = value if not extra else _expanded(value, lead, extra)
            if argument.shape[:-1] != shape:
                argument = np.broadcast_to(argument, (*shape, argument.shape[-1]))
            arguments.append(argument)
        return arguments, shape

    def _call(
        self, role: str, function: Function, x: Array, arguments: list[Array], due: tuple[int, ...]
    ) -> Array:
        try:
            value = function(*arguments)
        except Exception as error:
            raise self._told(role, x).failure(function, arguments, error, due) from error
        return self._fitting(role, function, x, arguments, value, due)

    def _fitting(
        self,
        role: str,
        function: Function,
        x: Array,
        arguments: Sequence[Array],
        value: Any,
        due: tuple[int, ...],
    ) -> Array:
        """The value of a function, sightings stacked; refused if its shape is not `due`."""
        found: Array = value
        if not is_due(value, due):
            found = self._told(role, x).array(function, arguments, value, due)
        if self.group is None:
            return found
        # Behind the leading axes of x are that of the sightings, and the components of each.
        return found.reshape(*x.shape[:-1], -1, *due[x.ndim + 1 :])

    def _told(self, role: str, x: Array) -> Call:
        source = self.source
        if role == "derivative":
            role = self.template.derivatives[0][0]
        step = self.step if source.timed else None
        lead = x.shape[: self.lead]
        return Call(self.template.child, role, lead, step, source.numbering, source.cpd)


def _alike(a: Array, b: Array, angles: Mask) -> bool:
    """Whether two values (..., d) are equal up to rounding."""
    if a.ndim == 1:  # of one run, mostly without a turn
        pairs = zip(a.tolist(), b.tolist(), strict=True)
        if all(abs(p - q) <= 1e-9 * (1.0 + abs(p)) for p, q in pairs):
            return True
    with quiet():
        error = np.abs(difference(a, b, angles))
        return bool(((error <= 1e-9 * (1.0 + np.abs(a))) | (np.isnan(a) & np.isnan(b))).all())


def is_due(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether a function has returned an array of floats of the shape that was due."""
    return type(value) is _ARRAY and value.dtype is _FLOAT and value.shape == shape


def sealed(array: Array) -> Array:
    """A read-only view: a function that writes into its arguments would change the belief."""
    view = array.view()
    set_writeable(view, False)
    return view


def _along_runs(array: Array, own: int) -> Array:
    """An array (runs, ...) laid out in memory with the runs contiguous, for faster kernels."""
    if array.ndim == own + 1:
        return components_last(np.ascontiguousarray(components_first(array, own)), own)
    return array


def _expanded(value: Array, lead: int, extra: tuple[int, ...]) -> Array:
    shape = value.shape
    wide = value.reshape(*shape[:lead], *(1 for _ in extra), *shape[lead:])
    if len(extra) == 1 and value.size * extra[0] <= FEW:
        return wide.repeat(extra[0], lead)
    return np.broadcast_to(wide, (*shape[:lead], *extra, *shape[lead:]))
