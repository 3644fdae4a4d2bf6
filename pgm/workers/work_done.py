"""The answer of a worker: a result or an error, with the warnings that it gave.

A worker that is another process gets a job, which is the work on a part of the runs, as a pickle,
and answers by one. A *parcel* is one or more pickles and their large arrays, which lie apart from
them in a *block* of memory that both processes can map.
"""

from __future__ import annotations

import threading
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pgm.errors import ExecutorError
from pgm.workers.parcels import Parcel, loads
from pgm.workers.shared_memory import (
    Name,
    seen,
)

# The warnings of each file that workers have told of.
_REGISTRIES: dict[str, dict[Any, Any]] = {}


class RemoteTraceback(Exception):
    """The traceback of another process's error, as text; the cause of the error raised here."""


class Done(NamedTuple):
    """The answer of a worker: a value, or an error with its traceback as text.

    `warned` has the warnings that were given in the worker: message, category, file and line.
    """

    value: Any
    error: Exception | None = None
    trace: str = ""
    warned: Sequence[tuple[str, type[Warning], str, int]] = ()

    def result(self) -> Any:
        """Give the worker's warnings again, then return its value or raise its error."""
        for message, category, file, line in self.warned:
            registry = _REGISTRIES.setdefault(file, {})  # so that a filter may show it once
            warnings.warn_explicit(message, category, file, line, registry=registry)
        if self.error is None:
            return self.value
        # A cause that has come through a pickle has no traceback any more.
        raise self.error from (RemoteTraceback(self.trace) if self.trace else self.error.__cause__)


def here(work: Callable[[Any], Any], job: Any) -> Done:
    """The `Done` of work(job), called in this process; an exception is in it, and not raised."""
    try:
        return Done(work(job))
    except Exception as error:
        return Done(None, error)


def there(data: bytes, own: Name | None, answer: Name | None) -> tuple[bytes, int]:
    """Do a job in this worker process; return its `Done`, pickled, and the size of large arrays.

    `data` is the pickle of a function and its argument, the job; `own` names the block of the
    pickle's parcel, None if it has none. Large arrays of the `Done` go to the block named `answer`,
    and their size is in bytes; if `answer` is None they stay in the pickle, and the size is zero.
    """
    try:
        work, job = loads(data, None if own is None else seen(own))
    except Exception as error:
        fault = ExecutorError(
            f"a worker cannot read what it was handed: {type(error).__name__}: {error}; functions "
            "and classes of a model must stand in modules that workers can import too"
        )
        return _packed(Done(None, fault, traceback.format_exc()), None)
    if threading.current_thread() is threading.main_thread():
        done = _watched(work, job)
    else:  # warnings of threads cannot be told apart
        done = here(work, job)
    if done.error is not None:
        done = done._replace(trace="".join(traceback.format_exception(done.error)))
    return _packed(done, answer)


def _watched(work: Callable[[Any], Any], job: Any) -> Done:
    """The `Done` of work(job) with its warnings, which the caller's process gives again."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        done = here(work, job)
    told = tuple((str(each.message), each.category, each.filename, each.lineno) for each in found)
    return done._replace(warned=told)


def _packed(done: Done, answer: Name | None) -> tuple[bytes, int]:
    """A `Done` pickled, and the size in bytes of its large arrays in the block named `answer`.

    If `answer` is None, they stay in the pickle, and the size is zero.
    """
    parcel = Parcel(apart=answer is not None)
    pickle = parcel.dumps(done)
    if answer is not None and parcel.size:
        pickle.fill(answer.open(parcel.size))
    return pickle.data, parcel.size
