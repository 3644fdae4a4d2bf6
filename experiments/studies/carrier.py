"""Parts carried to workers by Dask, and their figures back into the folder.

Each call takes the missing parts in an order of its own, a few at a time, and leaves out those that
another call has finished meanwhile: calls that share a folder need not know of each other.
"""

from __future__ import annotations

import logging
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from time import monotonic
from typing import Any
from uuid import uuid4

import numpy as np

from experiments.studies.code import differences, versions
from experiments.studies.errors import StudyError
from experiments.studies.folder import Folder
from experiments.studies.study import Part, Study
from experiments.studies.task import Columns, Task

# Parts a worker has or waits for; how often workers are counted [s].
AHEAD, COUNTED = 2, 5.0
# Seconds for a scheduler to answer and for a first worker to be there.
PATIENCE = 60


def carried(
    study: Study, folder: Folder, missing: Sequence[Part], scheduler: Any, workers: int
) -> Generator[Part]:
    """Work out missing parts; each is told of once it is in the folder.

    Raises
    ------
    StudyError
        If there are no workers, one has other code, or a part fails.
    """
    from distributed import as_completed

    with _client(scheduler, workers) as client:
        call = uuid4().hex[:12]  # tasks of two calls are two, of which one may end
        expected = versions(study.function.__module__)
        order = np.random.default_rng().permutation(len(missing))
        waiting = (missing[k] for k in order)
        running: dict[Any, Part] = {}
        finished = as_completed()
        room, counted_at = 0, -COUNTED
        try:
            while True:
                if monotonic() - counted_at > COUNTED:
                    room, counted_at = AHEAD * sum(client.nthreads().values()), monotonic()
                while len(running) < max(room, AHEAD):
                    part = next(waiting, None)
                    if part is None:
                        break
                    if folder.file(part).exists():
                        yield part
                        continue
                    key = f"{call}-{part.setting}-{part.part}"
                    future = client.submit(_worked, study.task(part), expected, key=key)
                    running[future] = part
                    finished.add(future)
                if not running:
                    return
                future = next(finished)
                part = running.pop(future)
                folder.keep(part, _columns(study, part, future))
                yield part
        finally:  # of a client that goes on
            for future in running:
                future.release()


def _worked(task: Task, expected: dict[str, str]) -> Columns:
    """The figures of a part; a worker's work."""
    if differ := differences(versions(task.function.__module__), expected):
        raise StudyError(
            f"a worker has other versions than the study: {differ.replace('here', 'there')}; give "
            "all workers the same"
        )
    return task.figures()


def _columns(study: Study, part: Part, future: Any) -> Columns:
    """The columns that a worker has found; or the error that it had."""
    from distributed import CancelledError

    try:
        found: Columns = future.result()
    except CancelledError as error:
        raise StudyError(
            f"the scheduler has lost {study.called(*part)}, or has gone ({error}); parts that are "
            "done are kept: run the study again"
        ) from error
    except StudyError:
        raise
    except Exception as error:
        raise _failed(study, part, error) from error
    return found


def _failed(study: Study, part: Part, error: Exception) -> StudyError:
    from distributed import KilledWorker

    called = study.called(*part)
    if isinstance(error, KilledWorker):
        return StudyError(
            f"{called} has ended its worker again and again, which a lack of memory does; begin "
            "anew with a smaller part_size, or give workers more memory"
        )
    return StudyError(
        f"{called} fails with {type(error).__name__}: {error}; it is repeated by "
        f"Study(...).part({part.setting}, {part.part}), of seed {study.seed} with the spawn key "
        f"{tuple(part)}; parts that are done are kept"
    )


# Of a cluster on this machine. Workers keep the memory of a part for the next one: given back at
# once, as distributed would have it, it costs a third of the time to get again. Nobody looks at
# profiles, which workers take a hundred times a second.
_SETTINGS = {
    "distributed.nanny.pre-spawn-environ": {
        "MALLOC_MMAP_THRESHOLD_": 1 << 28,
        "MALLOC_TRIM_THRESHOLD_": 1 << 28,
        "OMP_NUM_THREADS": 1,
        "MKL_NUM_THREADS": 1,
        "OPENBLAS_NUM_THREADS": 1,
    },
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
}


@contextmanager
def _client(scheduler: Any, workers: int) -> Iterator[Any]:
    """A client: the user's, of a scheduler at an address, or of a cluster on this machine."""
    import dask
    from distributed import Client, LocalCluster

    if isinstance(scheduler, Client):
        yield scheduler
        return
    if scheduler is not None and not isinstance(scheduler, str):
        raise StudyError(f"scheduler= is an address or a distributed.Client; found {scheduler!r}")
    if not isinstance(workers, int) or isinstance(workers, bool) or workers < 1:
        raise StudyError(f"workers= is a whole number, 1 or more; found {workers!r}")
    with ExitStack() as stack:
        if scheduler is None:
            stack.enter_context(dask.config.set(_SETTINGS))
            scheduler = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",  # another study may have the usual port
                    # A part's error is told here, and a worker that is killed is replaced.
                    silence_logs=logging.CRITICAL,
                )
            )
        try:
            client = stack.enter_context(Client(scheduler, timeout=PATIENCE))
            client.wait_for_workers(1, timeout=PATIENCE)
        except (OSError, TimeoutError, ValueError) as error:
            address = scheduler if isinstance(scheduler, str) else scheduler.scheduler_address
            raise StudyError(
                f"no scheduler with a worker is at {address} ({error or type(error).__name__}); "
                f"start them: dask scheduler, and on each machine dask worker {address}"
            ) from error
        yield client
