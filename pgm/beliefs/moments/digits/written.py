"""The steps of the passes in twice the digits as traces, of which machine code is made.

A trace is recorded from the very functions that NumPy's passes call, on arrays of traced numbers of
one run; pairs of float64 are then pairs of traced numbers (`Twofold`). So a step is written once.
"""

from __future__ import annotations

from functools import lru_cache, partial
from math import prod
from typing import Any

import numpy as np

from pgm.beliefs.moments.digits import laid_out
from pgm.beliefs.moments.digits.adjoint_belief import closer, given, is_close
from pgm.beliefs.moments.digits.careful_belief import informed, predicted, take
from pgm.beliefs.moments.digits.laid_out import flat, two
from pgm.kernels.extended import Twofold
from pgm.kernels.machine.emitter.functions import Function
from pgm.tracing.traced import Node, Recorder, Traced, bare


class Trace:
    """A trace that is being recorded, with arguments of one run."""

    def __init__(self) -> None:
        self._graph, self._count = Recorder(), 0

    def given(self, shape: tuple[int, ...]) -> Any:
        """An array of traced numbers, (1, *shape): one argument more."""
        graph, size = self._graph, prod(shape)
        found = np.empty(size, dtype=object)
        for k in range(size):
            found[k] = Node(graph, graph.input(self._count, k))
        self._count += size > 0
        return found.reshape(1, *shape).view(Traced)

    def function(self, value: Any) -> Function:
        """The trace of a value."""
        graph = self._graph
        numbers = tuple(graph.number(x) for part in flat(value) for x in bare(part).flat)
        return Function(tuple(graph.operations), numbers, (), (), ())


@lru_cache(maxsize=16)
def prediction(size: int, unknown: int) -> Function:
    """The belief over the next slice, of a belief and a transition."""
    trace = Trace()
    belief = laid_out.belief(trace.given, size, unknown)
    return trace.function(predicted(belief, laid_out.move(trace.given, size)))


@lru_cache(maxsize=16)
def measurement(size: int, unknown: int) -> Function:
    """A belief and the information Σ [v V]ᵀ[v V] / S given a scalar measurement; see `Taken`."""
    trace = Trace()
    make = trace.given
    belief, known = laid_out.belief(make, size, unknown), two(make, 1 + unknown, 1 + unknown)
    row, value, noise, seen = two(make, size), two(make), two(make), make(())
    after, component, predictive, improper = take(belief, row, value, noise, seen != 0.0)
    known = informed(known, component)
    return trace.function((after, known, component[1:], predictive, np.where(improper, 1.0, 0.0)))


@lru_cache(maxsize=16)
def smoothing(size: int, unknown: int) -> Function:
    """The smoothed belief of a filtered one and a message, its shares of rounding, and `is_close`.

    That is one where Bayes' rule is to be tried.
    """
    trace = Trace()
    known = laid_out.belief(trace.given, size, unknown)
    belief, parts = given(known, laid_out.later(trace.given, size, unknown))
    return trace.function((belief, parts, np.where(is_close(parts), 1.0, 0.0)))


@lru_cache(maxsize=16)
def bayes(size: int, unknown: int) -> Function:
    """The belief and its shares by Bayes' rule where that is closer, the gain, and one if it was.

    It is of a filtered belief, the smoothed one and its shares, the transition to the next slice,
    the belief predicted there, and the smoothed one with its shares.
    """
    trace = Trace()
    make, belief = trace.given, partial(laid_out.belief, trace.given, size, unknown)
    known, found, parts, move = belief(), belief(), make((size,)), laid_out.move(make, size)
    found, parts, back = closer(known, found, parts, move, belief(), belief(), make((size,)))
    return trace.function((found, parts, back.gain, np.where(back.lost, 1.0, 0.0)))


@lru_cache(maxsize=16)
def message(size: int, unknown: int) -> Function:
    """A message of later measurements carried back through a scalar one."""
    trace = Trace()
    later = laid_out.later(trace.given, size, unknown)
    return trace.function(later.past(laid_out.component(trace.given, size, unknown)))


@lru_cache(maxsize=16)
def carried(size: int, unknown: int) -> Function:
    """A message carried back through the matrix of a transition."""
    trace = Trace()
    later = laid_out.later(trace.given, size, unknown)
    return trace.function(later.back(two(trace.given, size, size)))


@lru_cache(maxsize=1)
def difference() -> Function:
    """The difference of two floats."""
    trace = Trace()
    return trace.function(Twofold(trace.given((1,))) - trace.given((1,)))
