"""Where a belief of an online filter comes from: whose it is, and what its last update took in.

From these the innovations are found when they are asked for, by making the update again. What was
taken in is copied, since the user's arrays may change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pgm.evidence import Constant, Sightings
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.moments.online.beliefs import MomentBelief
    from pgm.beliefs.moments.online.moment_steps import MomentSteps

# The belief before an update, and its readings.
Pair = tuple["MomentBelief", Mapping[Variable, Any]]


class Origin:
    """The filter's `steps` that made a belief, and the belief and readings of its last update.

    `pair` makes these two. It is None of a prediction, and where a sliding window has both.
    """

    def __init__(self, steps: MomentSteps, pair: Callable[[], Pair] | None = None) -> None:
        self.steps, self._pair = steps, pair

    @cached_property
    def pair(self) -> Pair | None:
        """The belief before the update, and its readings; None as of `Origin`."""
        return None if self._pair is None else self._pair()

    def __getstate__(self) -> dict[str, Any]:
        return {"steps": self.steps, "pair": self.pair}


def kept(values: Mapping[Variable, Any]) -> dict[Variable, Any]:
    """A copy of values that were given to a step, to be `opened`; nobody else has its arrays."""
    return {variable: _kept(value) for variable, value in values.items()}


def _kept(value: Any) -> Any:
    """A copy of a value; sightings are their parts, which take a tenth of the time to make."""
    kind = type(value)
    if kind is np.ndarray:
        return value.copy()
    if kind is Sightings:
        return _Sighted(_kept(value.values), value.step, kept(value._given))
    if kind is Constant:
        return Constant(_kept(value.value))
    if kind is list or kind is tuple or hasattr(value, "__array__"):
        return np.array(value)
    return value


class _Sighted(NamedTuple):
    """The parts of sightings."""

    values: Any
    step: Any
    given: dict[Variable, Any]


def opened(values: Mapping[Variable, Any]) -> dict[Variable, Any]:
    """The values of a copy, as they were given."""
    return {v: Sightings(*each) if type(each) is _Sighted else each for v, each in values.items()}
