"""The workers of an executor: jobs go to them, and answers come back.

A job is the work on a part of the runs. Its answer is a `Done`: a result, or an error, with the
warnings that were given. Jobs go to another process in a *parcel*, their pickles with large arrays
apart from them in a *block*, memory that both processes can map.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar, cast

from pgm.boundary import is_whole
from pgm.errors import ExecutorError, ModelError
from pgm.kernels.arrays import Array, vacant
from pgm.workers.parcels import Parcel, loads, refuse
from pgm.workers.shared_memory import (
    Block,
    Room,
    Shape,
    borrow,
    idle_blocks,
    keep,
)
from pgm.workers.work_done import Done, here, there

if TYPE_CHECKING:
    from concurrent.futures import Executor, Future


# Workers for each CPU core, if an executor does not say how many it has.
_SHARES = 4

# The most results whose arrays have a block each, which is an open file.
_FILES = 100

Job = TypeVar("Job")


@dataclass(frozen=True, eq=False)
class Task:
    """The work on some runs that an executor has been given.

    The result of `future` is a `Done`; or, from another process, the pickled `Done` and the size in
    bytes of its large arrays in the block `answer`.
    """

    runs: slice
    future: Future[Any]
    answer: Block | None

    def done(self) -> Done:
        """The worker's answer, waited for; an error of the executor itself is raised."""
        found = self.future.result()
        if not isinstance(found, Done):
            data, size = found
            memory = self.answer.hold(size) if self.answer and size else None
            return cast(Done, loads(data, memory))
        return found

    @property
    def lost(self) -> bool:
        """Whether the worker has not answered: the future is pending, cancelled or failed."""
        future = self.future
        return not future.done() or future.cancelled() or future.exception() is not None


class Workers:
    """The workers of an executor, `count` of them; without an executor (None), the caller alone.

    `shares` says whether they see the memory of the arrays that `room` makes: threads do, and
    processes that can map a shared block. An object that is no executor of `concurrent.futures` is
    refused by a ModelError.
    """

    def __init__(self, executor: Any) -> None:
        from concurrent.futures import Executor, ThreadPoolExecutor  # here, since few need them

        if executor is not None and not isinstance(executor, Executor):
            of_dask = "; a Dask client's is client.get_executor()"
            raise ModelError(
                "executor= takes a concurrent.futures.Executor, such as ProcessPoolExecutor(2), "
                f"not {executor!r}{of_dask if hasattr(executor, 'get_executor') else ''}"
            )
        self._executor: Executor | None = executor
        self.count = 1 if executor is None else _count(executor)
        self._here = executor is None or isinstance(executor, ThreadPoolExecutor)
        self._idle = None if executor is None else idle_blocks(executor)
        self.shares = self._here or self._idle is not None
        self._room: Room | None = None

    def room(self, shapes: Sequence[Shape]) -> list[Array]:
        """Arrays for the results of all runs, uninitialised; in a shared block if there is one.

        A shape is a pair: the lengths of the leading axes, the last of which is of runs, and those
        of the array's own axes. In memory the axis of runs varies fastest.
        """
        if self._idle is None:
            return [vacant(*shape) for shape in shapes]
        self._room = Room(self._idle, shapes)
        return self._room.arrays

    def each(
        self,
        work: Callable[[Job], Any],
        jobs: Sequence[Job],
        runs: Sequence[slice],
        *,
        large: bool,
        named: Sequence[Any] = (),
    ) -> Iterator[Done]:
        """The answers of all jobs, in their order, as they come.

        `work` is a function of one job, to be found in a module by name. `runs` has the runs of
        each job, which errors name. With `large` the large arrays of answers travel in shared
        blocks, if processes can share memory and there are at most 100 jobs. Without an executor a
        job's error is raised; with one the answer has it. If jobs cannot be pickled, a `ModelError`
        says which of the objects `named` is why.
        """
        if self._executor is None:
            yield from (Done(work(job)) for job in jobs)
            return
        if self._here:
            yield from self._gathered(runs, [(here, work, job) for job in jobs], [None] * len(jobs))
            return
        idle = self._idle
        parcel = Parcel(apart=idle is not None, shared=True, room=self._room)
        try:
            pickles = [parcel.dumps((work, job)) for job in jobs]
        except Exception as error:
            raise refuse(named, error) from error
        own = None if idle is None else borrow(idle, parcel.size)
        memory = None if own is None else own.hold(parcel.size)
        apart = large and own is not None and len(jobs) <= _FILES
        answers = [Block() if apart else None for _ in jobs]

        def calls() -> Iterator[Any]:
            """For each job, in order, what to submit to the executor: a function and its arguments.

            Before a job's call is yielded, its large arrays are copied to the block of the parcel.
            """
            for pickle, answer in zip(pickles, answers, strict=True):
                if memory is not None:
                    pickle.fill(memory)
                yield there, pickle.data, own and own.name, answer and answer.name

        yield from self._gathered(runs, calls(), answers)
        if idle is not None and own is not None:  # now that no worker uses them any more
            keep(idle, own)
            if self._room is not None:
                self._room.done(idle)

    def _gathered(
        self, runs: Sequence[slice], calls: Iterable[Any], answers: Sequence[Block | None]
    ) -> Iterator[Done]:
        """Submit all calls, and yield their answers in the order of the runs.

        Each of `calls` is a tuple of a function and its arguments; `answers` has for each the block
        for the large arrays of its answer, or None; `runs` are those of each call. If the executor
        fails, as when a worker dies, an `ExecutorError` names the runs that were lost; calls that
        still wait are then cancelled.
        """
        assert self._executor is not None
        waiting: deque[Task] = deque()
        try:
            for part, call, answer in zip(runs, calls, answers, strict=True):
                try:
                    waiting.append(Task(part, self._executor.submit(*call), answer))
                except Exception as error:
                    left = [*(task.runs for task in waiting if task.lost), *runs[len(waiting) :]]
                    raise self._lost(left, error) from error
            while waiting:
                try:
                    done = waiting[0].done()
                except Exception as error:
                    left = [task.runs for task in waiting if task.lost]
                    raise self._lost(left or [waiting[0].runs], error) from error
                waiting.popleft()
                yield done
        finally:
            for task in waiting:
                task.future.cancel()

    def _lost(self, runs: Sequence[slice], error: Exception) -> ExecutorError:
        """The error that tells which runs were lost with a worker, adjacent parts as one range.

        `runs` are the lost parts, and `error` is the exception that the executor has raised.
        """
        rows: list[tuple[int, int]] = []
        for part in runs:
            if rows and rows[-1][1] == part.start:
                rows[-1] = (rows[-1][0], part.stop)
            else:
                rows.append((part.start, part.stop))
        said = ", ".join(f"{first} to {stop - 1}" for first, stop in rows)
        return ExecutorError(
            f"{type(self._executor).__name__}: runs {said} were lost: {type(error).__name__}: "
            f"{error}; a worker may have died, of a function of the model or of too little memory, "
            "or the executor be shut down; other runs' results are lost with them",
            runs=rows,
            run=rows[0][0],
        )


def _count(executor: Executor) -> int:
    """The number of an executor's workers; four a CPU core if it does not say."""
    told = getattr(executor, "_max_workers", None)
    return told if is_whole(told) and told > 0 else _SHARES * (os.cpu_count() or 1)
