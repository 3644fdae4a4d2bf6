"""Sweeps of a plan on a card: its arrays are copied there, and back when all runs are swept."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib.array_utils import byte_bounds

from pgm.beliefs.moments.compiled.table import Integers64
from pgm.errors import ExecutorError
from pgm.kernels.arrays import address
from pgm.kernels.machine.emitter.driver import device
from pgm.kernels.machine.sweeps import card
from pgm.kernels.machine.sweeps.chain import Chain
from pgm.resources import NUMBER, gibibytes


class OnCard:
    """The sweep of a chain on the card of this machine, a thread a run.

    It raises an ExecutorError where the card's memory does not suffice, or its driver fails.
    """

    def __init__(self, chain: Chain) -> None:
        self._card = device()
        try:
            self._kernel = card.loaded(chain, self._card)
        except OSError as error:
            raise ExecutorError(f"a sweep cannot be made for the card: {error}") from error

    def __call__(
        self, numbers: Integers64, arrays: Mapping[int, npt.NDArray[Any]], runs: int
    ) -> None:
        """Sweep so many runs, whose table's numbers have the addresses of arrays at their places.

        What could be written to is copied back.
        """
        try:
            self._sweep(numbers, arrays, runs)
        except OSError as error:
            raise ExecutorError(f"{runs} runs could not be swept on the card: {error}") from error

    def _sweep(
        self, numbers: Integers64, arrays: Mapping[int, npt.NDArray[Any]], runs: int
    ) -> None:
        spans, own = spans_of(arrays.values()), self._card
        with own.current(), ExitStack() as stack:
            self._require_memory(sum(each.length for each in spans) + numbers.nbytes, runs)
            places = [stack.enter_context(own.room(span.length)) for span in spans]
            for span, place in zip(spans, places, strict=True):
                own.put(place, span.first, span.length)
            table, first = numbers.copy(), np.array([span.first for span in spans])
            for at, array in arrays.items():
                here = address(array)
                k = int(np.searchsorted(first, here, side="right")) - 1
                table[at] = places[k] + here - spans[k].first
            head = stack.enter_context(own.room(table.nbytes))
            own.put(head, address(table), table.nbytes)
            own.launch(self._kernel, runs, (head, 0, runs), card.KINDS)
            for span, place in zip(spans, places, strict=True):
                if span.written:
                    own.get(span.first, place, span.length)

    def _require_memory(self, due: int, runs: int) -> None:
        free = self._card.free()
        if due > free:
            raise ExecutorError(
                f"the arrays of {runs} runs take {gibibytes(due / NUMBER)}, and the card has "
                f"{gibibytes(free / NUMBER)} of memory free; give fewer runs at once, or keep= less"
            )


class Span(NamedTuple):
    """Memory in which arrays lie: its first address, its bytes, and whether one may be written."""

    first: int
    length: int
    written: bool


def spans_of(arrays: Iterable[npt.NDArray[Any]]) -> list[Span]:
    """The memory of arrays, in order; those that share some lie in one span."""
    found: list[Span] = []
    for low, high, written in sorted((*byte_bounds(each), each.flags.writeable) for each in arrays):
        if found and low < found[-1].first + found[-1].length:
            before = found.pop()
            end = max(before.first + before.length, high)
            found.append(Span(before.first, end - before.first, before.written or written))
        else:
            found.append(Span(low, high - low, written))
    return found
