"""Calls of the functions that users write: failures name the CPD, the step and the run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.boundary import as_floats
from pgm.display import titled
from pgm.errors import ModelError, PgmError
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers
from pgm.linearisers import advice
from pgm.linearisers.numbering import Numbering
from pgm.variables import Variable

# What to do about a shape that was not due.
STACKED = (
    "it is called with arrays that have leading axes, so index components as a[..., i] and stack "
    "results along the last axis"
)


# Errors that arguments of another width, or in another order, may raise.
_OF_ARGUMENTS = TypeError, IndexError, ValueError


@dataclass(frozen=True, slots=True)
class Call:
    """A function of a CPD, and the rows it is called for.

    `what` is its role, ``function`` or ``noise``; `lead` the leading axes of arguments, runs last,
    to which the step broadcasts. `numbering` is of the axis of runs, None of a trial call, which is
    of no run.
    """

    child: Variable
    what: str
    lead: tuple[int, ...]
    step: int | Integers | None
    numbering: Numbering | None
    cpd: Any = None

    def __call__(
        self,
        function: Callable[..., Any],
        arguments: Sequence[Array],
        due: tuple[int, ...],
        remedy: str = STACKED,
    ) -> Array:
        """The function's value as an array of the shape that is due, or an error and a remedy."""
        try:
            value = function(*arguments)
        except Exception as error:
            raise self.failure(function, arguments, error, due) from error
        return self.array(function, arguments, value, due, remedy)

    def failure(
        self,
        function: Callable[..., Any],
        arguments: Sequence[Array],
        error: Exception,
        due: tuple[int, ...] | None = None,
    ) -> PgmError:
        """The error of a call that has raised another one; `due` is the shape of a value."""
        axes = f" on a trial call with arrays of leading axes {self.lead}"
        when = axes if self.numbering is None else ""
        fault = f"failed{when}: {self.reason(function, arguments, error, due)}"
        return self.error(fault, self._first(function, arguments))

    def reason(
        self,
        function: Callable[..., Any],
        arguments: Sequence[Array],
        error: Exception,
        due: tuple[int, ...] | None,
    ) -> str:
        """The error that a function has raised, in words, and what may be done about it."""
        told = f"{type(error).__name__}: {error}"
        if not isinstance(error, _OF_ARGUMENTS):
            return told
        parents = self._parents(arguments)
        if due is not None and (other := advice.other_order(function, arguments, parents, due)):
            return told + other
        return f"{told}{advice.mistake(error)}{advice.order(parents)}"

    def _parents(self, arguments: Sequence[Array]) -> Scope:
        """The variables whose values the arguments are; none where there are others beside."""
        parents: Scope = () if self.cpd is None else self.cpd.given
        if self.what == "noise":
            parents = self.cpd.noise_given
        return parents if len(parents) == len(arguments) else ()

    def array(
        self,
        function: Callable[..., Any],
        arguments: Sequence[Array],
        value: Any,
        due: tuple[int, ...],
        remedy: str = STACKED,
    ) -> Array:
        """A value that a call has returned, as an array of the shape that is due."""
        try:
            array = as_floats(value, "it", verb="return")
        except ModelError as error:
            fault = str(error).removeprefix("it ")
            raise self.error(fault, self._first(function, arguments)) from error.__cause__
        if array.shape != due:
            other = advice.other_order(function, arguments, self._parents(arguments), due)
            told = other or f"; {remedy}"
            raise self.error(f"returned shape {array.shape} where {due} was due{told}")
        return array

    def _first(
        self, function: Callable[..., Any], arguments: Sequence[Array]
    ) -> tuple[int, ...] | None:
        if self.numbering is None:
            return None
        return _first_failure(function, arguments, self.lead)

    def error(
        self,
        fault: str,
        index: tuple[int, ...] | None = None,
        kind: type[PgmError] = ModelError,
    ) -> PgmError:
        """The error of a call, or of the row of it with an index."""
        step = run = None
        which = ""
        if self.step is not None and index is not None:
            step = int(np.broadcast_to(self.step, self.lead)[index])
        elif self.step is not None and np.size(self.step) == 1:
            step = int(np.reshape(self.step, ()))
        if index is not None and self.numbering is not None:
            place = index[-1] if index else 0
            run, which = self.numbering.run(place), f", {self.numbering.words(place)},"
        at = "" if step is None else f" at step {step}"
        factor = getattr(self.cpd, "_of", None)
        of = f"the CPD of {self.child.name}" if factor is None else titled(factor)
        return kind(
            f"the {self.what} of {of}{at}{which} {fault}",
            variable=self.child,
            cpd=self.cpd,
            step=step,
            run=run,
        )


def _first_failure(
    function: Callable[..., Any], arguments: Sequence[Array], lead: tuple[int, ...]
) -> tuple[int, ...] | None:
    """The index of a row at which a function fails, by bisection; None where none fails alone."""
    count, own = math.prod(lead), len(lead)
    flat = [argument.reshape(count, *argument.shape[own:]) for argument in arguments]
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        if _fails(function, [argument[low:middle] for argument in flat]):
            high = middle
        elif _fails(function, [argument[middle:high] for argument in flat]):
            low = middle
        else:
            return None
    return tuple(int(k) for k in np.unravel_index(low, lead)) if count else None


def _fails(function: Callable[..., Any], arguments: Sequence[Array]) -> bool:
    try:
        as_floats(function(*arguments), "it")
    except Exception:
        return True
    return False
