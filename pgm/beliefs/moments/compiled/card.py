"""Sweeps of a plan on a card: its arrays are copied there, and back when its runs are swept.

Runs that do not fit into the card's memory together are swept one part after another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

import numpy as np

from pgm.beliefs.moments.compiled.spans import Anything, Span, spans_of
from pgm.beliefs.moments.compiled.table import Integers64
from pgm.errors import ExecutorError
from pgm.kernels.arrays import address
from pgm.kernels.machine.emitter.driver import THREADS, OutOfMemory, device
from pgm.kernels.machine.sweeps import card, told
from pgm.kernels.machine.sweeps.chain import Chain
from pgm.resources import NUMBER, gibibytes

# Of parts this share of the free memory is left free: the driver takes more than is asked for.
_SPARE = 1 / 32


class OnCard:
    """The sweep of a chain on the card of this machine, a thread a run.

    It raises an ExecutorError where one run alone does not fit into the card's memory, or its
    driver fails.
    """

    def __init__(self, chain: Chain) -> None:
        self._card = device()
        try:
            self._kernel = card.loaded(chain, self._card)
        except OSError as error:
            raise ExecutorError(f"a sweep cannot be made for the card: {error}") from error

    def __call__(self, numbers: Integers64, arrays: Mapping[int, Anything], runs: int) -> None:
        """Sweep so many runs, whose table's numbers have the addresses of arrays at their places.

        What could be written to is copied back.
        """
        try:
            self._sweep(numbers, arrays, runs)
        except OSError as error:
            raise ExecutorError(f"{runs} runs could not be swept on the card: {error}") from error

    def _sweep(self, numbers: Integers64, arrays: Mapping[int, Anything], runs: int) -> None:
        spans, first = spans_of(arrays.values(), runs), 0
        with self._card.current():
            most = self._most(spans, numbers.nbytes, runs)
            while first < runs:
                try:
                    with self._rooms(spans, numbers.nbytes, most) as places:
                        while first < runs:
                            last = min(first + most, runs)
                            self._part(numbers, arrays, spans, places, (first, last, runs))
                            first = last
                except OutOfMemory as error:
                    if most == 1:
                        raise _too_little(spans, numbers.nbytes, self._card.free()) from error
                    most = -(-most // 2)

    def _most(self, spans: Sequence[Span], table: int, runs: int) -> int:
        """How many runs are swept at once."""
        free = self._card.free()
        if _due(spans, table, runs) <= free:
            return runs
        one = _due(spans, table, 1)
        if one > free:
            raise _too_little(spans, table, free)
        each = _due(spans, table, 2) - one
        most = max(1 + int((1.0 - _SPARE) * free - one) // max(each, 1), 1)
        most = min(most, runs - 1)
        return most - most % THREADS if most > THREADS else most

    @contextmanager
    def _rooms(self, spans: Sequence[Span], table: int, runs: int) -> Iterator[list[int]]:
        """Memory of the card for each span of so many runs, and at last for the table."""
        with ExitStack() as stack:
            lengths = [*(span.room(runs) for span in spans), table]
            yield [stack.enter_context(self._card.room(length)) for length in lengths]

    def _part(
        self,
        numbers: Integers64,
        arrays: Mapping[int, Anything],
        spans: Sequence[Span],
        places: Sequence[int],
        part: tuple[int, int, int],
    ) -> None:
        """Sweep the runs of a part, from the first to below the last of all."""
        first, last, _ = part
        own, count, head = self._card, last - first, places[-1]
        for span, place in zip(spans, places, strict=False):
            own.put(place, *_lines(span, first, count))
        table = numbers.copy()
        table[told.RUNS] = count
        begins = np.array([span.first for span in spans])
        for at, array in arrays.items():
            k = int(np.searchsorted(begins, address(array), side="right")) - 1
            _tell(table, at, array, spans[k], places[k], part)
        own.put(head, address(table), table.nbytes)
        own.launch(self._kernel, count, (head, 0, count), card.KINDS)
        for span, place in zip(spans, places, strict=False):
            if span.written:
                own.get(place, *_lines(span, first, count))


def _lines(span: Span, first: int, count: int) -> tuple[int, ...]:
    """Where some runs of a span begin, the bytes of a line, their number, and their distances.

    These are of this machine's memory and of the card's.
    """
    by_runs = span.by_runs
    if by_runs is None or count == by_runs.runs:
        return span.first, span.length
    there = by_runs.of(count)
    begin = span.first + first * by_runs.apart
    return begin, there.width, by_runs.blocks, by_runs.pitch, there.pitch


def _tell(
    table: Integers64,
    at: int,
    array: Anything,
    span: Span,
    place: int,
    part: tuple[int, int, int],
) -> None:
    """Put into a table where an array of a span lies whose runs of a part are at a place."""
    first, last, runs = part
    offset, by_runs = address(array) - span.first, span.by_runs
    if last - first == runs:
        table[at] = place + offset
    elif by_runs is None:
        divided = array.ndim > 1 and array.shape[1] == runs
        table[at] = place + offset + (first * array.strides[1] if divided else 0)
    else:
        table[at] = place + by_runs.moved(offset, last - first)
        if at >= told.FIRST:
            for k in (at + told.DOWN, at + told.CELL):
                table[k] = by_runs.moved(int(table[k]) * NUMBER, last - first) // NUMBER


def _due(spans: Sequence[Span], table: int, runs: int) -> int:
    """The bytes that so many runs take."""
    return sum(span.room(runs) for span in spans) + table


def _too_little(spans: Sequence[Span], table: int, free: int) -> ExecutorError:
    due = gibibytes(_due(spans, table, 1) / NUMBER)
    return ExecutorError(
        f"a single run's arrays take {due}, and the card has {gibibytes(free / NUMBER)} of memory "
        "free: leave out device="
    )
