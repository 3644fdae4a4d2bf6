"""The progress of a call that takes long: a bar on a terminal or in a notebook, or calls back.

Loops say that their items may be `counted`. A call that was asked to report does so on the
outermost loop that runs; else a loop is given its own items back, and costs nothing. The report is
found by context, as NumPy's error state is, since it is no part of any result.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache
from typing import Any, TypeVar

from pgm.errors import ModelError

Progress = bool | Callable[[int, int], object]
T = TypeVar("T")


def reporting(progress: Progress) -> AbstractContextManager[None]:
    """Report progress within this block: True for bars, or ``progress(done, total)``."""
    if progress is False:
        return _SILENT
    if not isinstance(progress, bool) and (isinstance(progress, type) or not callable(progress)):
        raise ModelError(
            "progress= is True, for a bar, or a function that is called with the numbers done and "
            f"in all, progress(done, total); found {progress!r}"
        )
    return _reported(_bar if progress is True else _calls(progress))


_SILENT = nullcontext()


@contextmanager
def _reported(begin: Callable[[str, int], _Stage]) -> Iterator[None]:
    report = _Report(begin)
    token = _REPORT.set(report)
    try:
        yield
    finally:
        _REPORT.reset(token)
        report.end()  # of a loop that an error has left


def counted(items: Iterable[T], what: str, total: int | None = None) -> Iterable[T]:
    """The items of a loop, counted where a call reports its progress and no loop around does.

    `items` are a sequence, or in all `total`; `what` names the loop in the bar.
    """
    report = _REPORT.get()
    if report is None or report.busy:
        return items
    if total is None:
        assert isinstance(items, Sequence)
        total = len(items)
    return report.each(items, what, total) if total > 1 else items


# A stage of work, as two calls: so many are done, and it is over.
_Stage = tuple[Callable[[int], object], Callable[[], object]]


class _Report:
    """The progress report of one call, one loop at a time."""

    def __init__(self, begin: Callable[[str, int], _Stage]) -> None:
        self.begin, self.busy = begin, False
        self.end: Callable[[], object] = lambda: None

    def each(self, items: Iterable[T], what: str, total: int) -> Iterator[T]:
        self.busy = True
        tell, self.end = self.begin(what, total)
        try:
            for done, item in enumerate(items, 1):
                yield item
                tell(done)
        finally:
            self.end()
            self.busy = False


_REPORT: ContextVar[_Report | None] = ContextVar("report", default=None)


def _calls(function: Callable[[int, int], object]) -> Callable[[str, int], _Stage]:
    def begin(what: str, total: int) -> _Stage:
        function(0, total)
        return lambda done: function(done, total), lambda: None

    return begin


def _bar(what: str, total: int) -> _Stage:
    # None: on a terminal, but in no file and no pipe, which a notebook's own stream seems to be.
    disable = False if "ipykernel.zmqshell" in sys.modules else None
    bar = _bars()(total=total, desc=what, disable=disable)
    return lambda done: bar.update(), bar.close


@cache
def _bars() -> Any:
    from tqdm.auto import tqdm  # here, since only bars need it

    # A thread that watches over slow loops would be forked into the workers of an executor.
    return type("Bar", (tqdm,), {"monitor_interval": 0})
