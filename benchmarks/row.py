"""A row of the benchmark: one kind of work, and the libraries that do it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any

from benchmarks.timing import Contender, medians

Prepare = Callable[[Any], Contender]
Check = Callable[[str, Any, Any], None]


@dataclass(frozen=True, eq=False)
class Row:
    """One kind of work.

    Attributes
    ----------
    name, unit : str
        A key of the summary; what a time is for.
    work : callable
        From a size to the work.
    contenders : mapping
        By library, what prepares its part. The first is pgm, with which the others are compared.
    check : callable
        ``check(library, ours, theirs)`` raises AssertionError where results differ.
    size, quick : int
        Of the work in `make bench` and in `make bench-quick`, which leaves a row of size 0 out.
    most : mapping
        The largest size that a slow library is given, whose cost a unit does not depend on it.
    unchecked : frozenset
        Contenders that do a part of the work only, or find something else.
    repeats : int, optional
        Timed calls at the most, where one takes long.
    timed : callable
        From contenders and how many turns they take to seconds a unit.
    """

    name: str
    unit: str
    work: Callable[[int], Any]
    contenders: Mapping[str, Prepare]
    check: Check
    size: int
    quick: int
    most: Mapping[str, int] = field(default_factory=dict)
    unchecked: frozenset[str] = frozenset()
    repeats: int | None = None
    timed: Callable[[Mapping[str, Contender], int], dict[str, float]] = medians

    def prepared(self, size: int) -> tuple[dict[str, Contender], dict[str, str]]:
        """The libraries that are here, with their work, and why others are left out."""
        work = cache(self.work)
        here, missing = {}, {}
        for library, prepare in self.contenders.items():
            try:
                here[library] = prepare(work(self.size_for(library, size)))
            except ImportError as error:
                missing[library] = str(error)
        return here, missing

    def agree(self, here: Mapping[str, Contender], size: int) -> None:
        """Compare what each library found with what pgm finds on the same work.

        Raises
        ------
        AssertionError
            Where they differ.
        """
        ours = next(iter(self.contenders.values()))
        at = cache(lambda small: ours(self.work(small)).call())
        for library, contender in here.items():
            if library not in self.unchecked:
                self.check(library, at(self.size_for(library, size)), contender.call())

    def size_for(self, library: str, size: int) -> int:
        """How much work a library is given."""
        return min(size, self.most.get(library, size))


def part(module: str, function: str, *args: Any, **settings: Any) -> Prepare:
    """A library's part; the library is imported only when its part is prepared."""

    def prepare(work: Any) -> Contender:
        home = import_module(f"benchmarks.libraries.{module}")
        made: Contender = getattr(home, function)(*args, work, **settings)
        return made

    return prepare
