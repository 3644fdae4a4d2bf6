"""Blocks of particles, the shares of threads, and sums over them that no share changes.

A block has particles of one run alone, and where it ends is decided by their number alone. What is
summed is summed by block, and the sums of blocks are joined in their order: so results are the same
for any number of threads, and those of a run whatever other runs there are.

Of a run's arrays the particles are beside each other, those of run 0 first; a particle's *place* is
its index among those of all runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels.arrays import Integers, address
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.studies.sums import LANES, table

# The particles of a block: enough for a thread, and few enough that threads end together.
SIZE = 2**12
# Arguments of the functions: the numbers of a call, and its blocks from one to below another.
KINDS = ADDRESS, WHOLE, WHOLE
# `resources.in_threads`, which kernels do not know.
InThreads = Callable[[Callable[[int, int], object], int], None]
_ENTRIES = 4


def blocks(starts: Integers) -> Integers:
    """The blocks (blocks, 4) of all runs: run, first place, count, and first index in the run.

    No block of a run of as many particles as a pack has is shorter than a pack.

    starts: The place at which each run begins, and the end, (runs + 1,).
    """
    found = []
    for run, (first, last) in enumerate(
        zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)
    ):
        count = last - first
        edges = [*(k * SIZE for k in range(max(1, count // SIZE))), count]
        found += [(run, first + begin, end - begin, begin) for begin, end in pairwise(edges)]
    return np.array(found, dtype=np.int64)


def work(function: Callable[..., Any], shares: Integers, threads: InThreads, *given: Any) -> None:
    """Call a function of `KINDS` for all blocks, in threads; `given` are the numbers of a call."""
    numbers = table(shares, *given)
    threads(partial(function, address(numbers)), len(shares))


class Block(NamedTuple):
    """A block that machine code is at.

    number: Its place among all blocks.
    run, first, size, begin: As of `blocks`: its run, the place of its first particle, how many it
        has, and the index in the run of the first.
    """

    number: Whole
    run: Whole
    first: Whole
    size: Whole
    begin: Whole


@contextmanager
def each_block(code: Code, shares: Address) -> Iterator[Block]:
    """The blocks of a call; code is that of a function of `KINDS`."""
    _, first, last = code.arguments
    numbers = code.wholes(shares)
    with code.loop(last, first) as k:
        yield Block(k, *(numbers.load(k * _ENTRIES + i) for i in range(_ENTRIES)))


@contextmanager
def each_pack_once(code: Code, count: Whole) -> Iterator[tuple[Whole, Number]]:
    """The first particles of packs in a block, and a mask of the lanes that no pack before had.

    The last pack may share particles with the one before.
    """
    lanes = code.constant(0.0)
    for lane in range(1, LANES):
        lanes = lanes.with_lane(lane, float(lane))
    with code.loop((count + (LANES - 1)) // LANES) as k:
        first = (k * LANES).at_most(count - LANES)
        yield first, lanes >= (k * LANES - first).number()
