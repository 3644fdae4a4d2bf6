"""A CPD's function with its parents, before evidence is bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from pgm.factors.scope import Scope, angle_mask, dimension, positions
from pgm.kernels.arrays import Index, Mask
from pgm.tracing import Program, Slopes, Tracer
from pgm.variables import Variable

Function = Callable[..., Any]


@dataclass(frozen=True, eq=False)
class FunctionTemplate:
    """A CPD's function with its parents, hidden or observed; fixed for all calls.

    Parameters
    ----------
    child : Variable
        The child of the CPD.
    given : tuple of Variable
        All parents, in the order of the function's arguments.
    hidden : tuple of Variable
        The parents without evidence, in the same order.
    function : callable
        ``function(*given)``.
    jacobians : tuple of callable or None
        The derivative by each parent, where one was given.
    variances : tuple of float
        The least variance of each component's own noise; zero where it is not known beforehand.
    tracer : Tracer, optional
        The function's tracer; Jacobians that are not given come from its trace, if it has one.

    Examples
    --------
    >>> from pgm.linearisers import FunctionTemplate
    >>> x, y = pgm.variables("x y")
    >>> template = FunctionTemplate(y, (x,), (x,), lambda x: x**2, (None,), (1.0,))
    >>> template.size, template.height, template.numerical
    (1, 1, (0,))
    """

    child: Variable
    given: Scope
    hidden: Scope
    function: Function
    jacobians: tuple[Function | None, ...]
    variances: tuple[float, ...]
    tracer: Tracer | None = None

    @cached_property
    def input_angles(self) -> Mask:
        """The mask of components of the hidden parents that are angles."""
        return angle_mask(self.hidden)

    @cached_property
    def size(self) -> int:
        """Number of components of the stacked hidden parents."""
        return dimension(self.hidden)

    @cached_property
    def places(self) -> tuple[Index | None, ...]:
        """The place of each parent among the hidden ones; None for a parent with evidence."""
        return tuple(
            positions(self.hidden, [parent]) if parent in self.hidden else None
            for parent in self.given
        )

    @cached_property
    def undivided(self) -> bool:
        """Whether there is a single hidden parent, so that none has to be cut out."""
        return len(self.hidden) == 1

    @cached_property
    def derivatives(self) -> tuple[tuple[str, int, Index, Function | None], ...]:
        """For each hidden parent: its name, size, place in the stack, and Jacobian if given."""
        every = zip(self.given, self.places, self.jacobians, strict=True)
        return tuple(
            (f"jacobian by {parent!r}", parent.dimension, place, by)
            for parent, place, by in every
            if place is not None
        )

    @cached_property
    def height(self) -> int:
        """Number of components of the child."""
        return self.child.dimension

    @cached_property
    def turning(self) -> list[int]:
        """The places of the value's components that are angles."""
        return [int(k) for k in np.flatnonzero(self.child.angle_mask)]

    @cached_property
    def columns(self) -> tuple[tuple[int, int], ...]:
        """For each stacked component: its argument, and its index in that argument."""
        return tuple((self.given.index(v), i) for v in self.hidden for i in range(v.dimension))

    @cached_property
    def missing(self) -> tuple[int, ...]:
        """The stacked components by which no derivative was given."""
        return tuple(k for k, (a, _) in enumerate(self.columns) if self.jacobians[a] is None)

    @cached_property
    def missing_columns(self) -> tuple[tuple[int, int], ...]:
        """For each component without a given Jacobian: its argument, and its index there."""
        return tuple(self.columns[k] for k in self.missing)

    @property
    def program(self) -> Program | None:
        """The program of value and missing derivatives; None where there is no trace."""
        tracer = self.tracer
        if tracer is None or tracer.trace is None or not self.missing:
            return None
        return tracer.trace.by(self.missing_columns)

    @property
    def slopes(self) -> Slopes | None:
        """The derivatives of `program` to be looked at; None where there is none, or no need."""
        program = self.program
        if program is None or program.smooth:
            return None
        if not self._slopes or self._slopes[0].program is not program:  # the trace was made anew
            made = Slopes(self.function, program, self.child.angle_mask, np.sqrt(self.variances))
            self._slopes[:] = [made]
        return self._slopes[0]

    @cached_property
    def _slopes(self) -> list[Slopes]:
        return []

    def __getstate__(self) -> dict[str, Any]:
        # The function that is traced with its derivatives, and machine code, are of this process.
        keep, own = self.__dict__.items(), ("whole", "compiled", "_slopes")
        return {name: value for name, value in keep if name not in own}

    @cached_property
    def compiled(self) -> dict[Program, Any]:
        """The function with its whole derivative, by its trace, as machine code is told of it."""
        return {}

    @cached_property
    def whole(self) -> Tracer:
        """The tracer of the value followed by the derivatives that were given, for machine code."""
        given = tuple(by for _, _, _, by in self.derivatives if by is not None)
        if not given and self.tracer is not None:
            return self.tracer
        more = self.height * (self.size - len(self.missing))
        widths = [parent.dimension for parent in self.given]
        angles = np.pad(self.child.angle_mask, (0, more))
        return Tracer(partial(_with_slopes, self.function, given), widths, angles)

    @property
    def numerical(self) -> tuple[int, ...]:
        """The stacked components whose derivative has to be taken by differences."""
        return self.missing if self.program is None else ()


def _with_slopes(function: Function, jacobians: tuple[Function, ...], *arguments: Any) -> Any:
    slopes = [jacobian(*arguments) for jacobian in jacobians]
    flat = [slope.reshape(*slope.shape[:-2], -1) for slope in slopes]
    return np.concatenate([function(*arguments), *flat], axis=-1)
