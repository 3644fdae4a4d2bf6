"""The blocks of a study, worked through here or by workers, begun anew or gone on with."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Protocol

from pgm.comparison.drawn_runs import DrawnRuns
from pgm.comparison.kept_sums import KeptSums
from pgm.comparison.sums import Sums, joined
from pgm.errors import ExecutorError, PgmError
from pgm.progress import counted
from pgm.workers.workers import Workers

# Blocks for each worker that are under way together: what waits for its turn takes memory.
_AHEAD = 16


class Work(Protocol):
    """The work on one block: the sums of each method over it."""

    def __call__(self, first: int, /) -> Mapping[str, Sums]:
        """The sums over the block that begins with run `first`."""


def worked(
    work: Work, drawn: DrawnRuns, workers: Workers, kept: KeptSums | None, named: Sequence[Any]
) -> dict[str, Sums]:
    """The sums of all blocks, joined in their order.

    kept: The sums of earlier calls, with which this one goes on.
    named: The parts of the work, of which an error tells the one that cannot be handed to workers.
    """
    blocks = drawn.blocks
    if kept is None:
        return joined(counted(_results(work, drawn, blocks, workers, named), "blocks", len(blocks)))
    found, blocks = kept.begun(work), blocks[kept.blocks :]
    results = counted(_results(work, drawn, blocks, workers, named), "blocks", len(blocks))
    try:
        for first, block in zip(blocks, results, strict=True):
            found = joined([found, block])
            if first + drawn.block <= drawn.runs:  # others are longer in a study of more runs
                kept.add(found)
    finally:
        kept.end()
    return found


def _results(
    work: Work, drawn: DrawnRuns, blocks: range, workers: Workers, named: Sequence[Any]
) -> Iterator[Mapping[str, Sums]]:
    """The sums of each block, in their order."""
    packed, ahead = _Packed(work), _AHEAD * workers.count
    for start in range(0, len(blocks), ahead):
        firsts = blocks[start : start + ahead]
        runs = [slice(first, min(first + drawn.block, drawn.runs)) for first in firsts]
        jobs = [(packed, first) for first in firsts]
        done = workers.each(_block, jobs, runs, large=False, named=named)
        for first, each in zip(firsts, done, strict=True):
            if isinstance(each.error, PgmError) and not isinstance(each.error, ExecutorError):
                work(first)  # whose error is raised here, with the objects that it names
            yield each.result()


class _Packed:
    """Work that is pickled once for all its blocks, and unpickled once by each worker.

    A model that is unpickled anew would be traced and translated to machine code anew.
    """

    def __init__(self, work: Work) -> None:
        self.work = work
        self._data: bytes | None = None

    def __reduce__(self) -> Any:
        if self._data is None:
            self._data = pickle.dumps(self.work, protocol=5)
        return _unpacked, (self._data,)


@lru_cache(1)
def _unpacked(data: bytes) -> _Packed:
    return _Packed(pickle.loads(data))


def _block(job: tuple[_Packed, int]) -> Mapping[str, Sums]:
    packed, first = job
    return packed.work(first)
