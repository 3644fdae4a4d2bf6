"""Readings of a robot's loop that come late: the steps since their own are made again.

A filter with a lag keeps, behind each belief, a `Log` of the last steps: the belief at the end of
each, the inputs that led on from it, and the readings that were taken. A late reading goes to the
belief of its own step, as a further update there, and all that came after it is done once more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any, NamedTuple, Protocol

import numpy as np

from pgm.boundary import is_whole
from pgm.display import titled
from pgm.errors import EvidenceError, Unanswered
from pgm.evidence import Constant, Sightings
from pgm.evidence.values import Soft
from pgm.variables import Variable

# From a belief, and inputs or readings, to the next belief.
Step = Callable[[Any, Mapping[Variable, Any]], Any]


class Given(Protocol):
    """Values that were given to a step, of which nobody else has the arrays."""

    @property
    def opened(self) -> Mapping[Variable, Any]:
        """The values, as they were given."""
        ...


class Bare(Protocol):
    """A belief without its log."""

    def restored(self, log: Log) -> Any:
        """The belief, with a log of the steps before it."""
        ...


class Past(NamedTuple):
    """A step that was left: its last belief, the readings taken there, and the inputs from there.

    `updates` has the values of each update in turn, `inputs` those of the prediction that followed.
    """

    belief: Bare
    updates: tuple[Given, ...]
    inputs: Given


class Log(NamedTuple):
    """The steps behind a belief, the last one first left last, and the updates of its own step."""

    past: tuple[Past, ...] = ()
    now: tuple[Given, ...] = ()

    def on(self, belief: Bare, inputs: Given, lag: int) -> Log:
        """The log one step later; at most `lag` steps are kept."""
        past = *self.past, Past(belief, self.now, inputs)
        return Log(past[-lag:] if lag else ())

    def read(self, values: Given) -> Log:
        """The log after a further update."""
        return Log(self.past, (*self.now, values))


NOTHING = Log()


class Copied:
    """A copy of values that were given to a step: the user's arrays may change."""

    __slots__ = ("_values",)

    def __init__(self, values: Mapping[Variable, Any] | None) -> None:
        self._values = {} if values is None else _copies(values)

    @property
    def opened(self) -> dict[Variable, Any]:
        """The values, as they were given."""
        found = self._values.items()
        return {v: Sightings(*each) if type(each) is _Sighted else each for v, each in found}


class _Sighted(NamedTuple):
    """The parts of sightings, which take a tenth of the time to make."""

    values: Any
    step: Any
    given: dict[Variable, Any]


def _copies(values: Mapping[Variable, Any]) -> dict[Variable, Any]:
    return {variable: _copy(value) for variable, value in values.items()}


def _copy(value: Any) -> Any:
    kind = type(value)
    if kind is np.ndarray:
        return value.copy()
    if kind is Sightings:
        return _Sighted(_copy(value.values), value.step, _copies(value._given))
    if kind is Constant:
        return Constant(_copy(value.value))
    if kind is Soft:
        return Soft(_copy(value.weights), value.log)
    if kind is list or kind is tuple or hasattr(value, "__array__"):
        found = np.array(value)
        return found if found.dtype.kind in "biuf" else deepcopy(value)
    return value


def require_step(belief: Any, step: Any, log: Log | None) -> int:
    """How many steps a belief is ahead of the readings of a step; an EvidenceError if too many.

    `log` has the steps behind the belief; None where the filter keeps none.
    """
    if not is_whole(step):
        raise EvidenceError(f"update(..., step=): the number of a step was due, not {step!r}")
    late = int(belief.step) - int(step)
    if late < 0:
        raise EvidenceError(
            f"readings of step {step} for {titled(belief)}: that is ahead of it; predict first",
            step=int(step),
        )
    if late and log is None:
        raise Unanswered(
            f"readings of step {step} for {titled(belief)}: late ones are taken by filters that "
            "keep the steps behind a belief, of Gaussian beliefs and tables: make it with "
            "OnlineFilter(model, lag=20), or so many steps as a reading may be late",
            step=int(step),
        )
    if late and log is not None and late > len(log.past):
        first = belief.step - len(log.past)
        raise EvidenceError(
            f"readings of step {step} for {titled(belief)} are {late} steps late, and the filter "
            f"keeps those of steps {first}..{belief.step}: leave them out, or make it with a "
            "larger lag",
            step=int(step),
        )
    return late


def replayed(
    predict: Step, update: Step, log: Log, readings: Mapping[Variable, Any], late: int
) -> Any:
    """The belief that a filter has if readings are taken so many steps before its own.

    They are one more update at the end of their own step; the steps since then are made again.
    `predict` and `update` are the filter's.
    """
    start, *rest = again = log.past[len(log.past) - late :]
    found = start.belief.restored(Log(log.past[: len(log.past) - late], start.updates))
    found = update(found, readings)
    for past, updates in zip(again, [*(each.updates for each in rest), log.now], strict=True):
        found = predict(found, past.inputs.opened)
        for each in updates:
            found = update(found, each.opened)
    return found
