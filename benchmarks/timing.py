"""Timing: libraries take turns, so that whatever else the machine does hits all of them alike."""

from __future__ import annotations

import gc
import math
import statistics
import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

# Seconds; what takes less is called several times over. A library finds the caches full of what
# the one before it left there, and a turn has to be long beside the time that this takes away.
SHORTEST = 0.1

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, eq=False)
class Contender:
    """A library with its work prepared: compiled, and waiting for evidence.

    Attributes
    ----------
    call : callable
        The work, evidence in and results out.
    units : int
        How many units of work a call does.
    compiling : float
        Seconds that the first call took longer than the next, where something is compiled.
    fresh : callable, optional
        Makes anew what each timed call is handed, and that nothing may have been kept of; its own
        time does not count.
    """

    call: Callable[..., Any]
    units: int
    compiling: float | None = None
    fresh: Callable[[], Any] | None = None


def compiled(call: Callable[[], Any], units: int) -> Contender:
    """A contender whose first call compiles."""
    first, later = seconds(call), seconds(call)
    return Contender(call, units, first - later)


def compiled_or_not(call: Callable[[], Any], units: int, choice: object) -> Contender:
    """A contender whose first call compiles if that was chosen."""
    return compiled(call, units) if choice else Contender(call, units)


def seconds(
    call: Callable[..., object], times: int = 1, fresh: Callable[[], Any] | None = None
) -> float:
    """Time of a call, the mean of several, each with what `fresh` makes for it.

    It is that of the processor, of all threads of this process: with one thread on an idle machine
    it is the time on the wall, and on a busy one it leaves out what other processes take.
    """
    given = [(fresh(),) if fresh else () for _ in range(times)]
    begin = time.process_time()
    for arguments in given:
        call(*arguments)
    return (time.process_time() - begin) / times


def medians(contenders: Mapping[Key, Contender], repeats: int) -> dict[Key, float]:
    """Median seconds a unit of contenders that take turns, each called before."""
    return {key: statistics.median(each) for key, each in turns(contenders, repeats).items()}


def least(contenders: Mapping[Key, Contender], repeats: int) -> dict[Key, float]:
    """The least seconds a unit, likewise: other processes share caches, and only add to them."""
    return {key: min(each) for key, each in turns(contenders, repeats).items()}


def turns(contenders: Mapping[Key, Contender], repeats: int) -> dict[Key, list[float]]:
    """Seconds a unit, turn by turn."""
    calls = {key: _calls(each) for key, each in contenders.items()}
    times: dict[Key, list[float]] = {key: [] for key in contenders}
    gc.collect()
    gc.freeze()  # what one library leaves about is not searched on another's account
    for _ in range(repeats):
        for key, contender in contenders.items():
            spent = seconds(contender.call, calls[key], contender.fresh)
            times[key].append(spent / contender.units)
    gc.unfreeze()
    return times


def _calls(contender: Contender) -> int:
    return max(1, math.ceil(SHORTEST / max(seconds(contender.call, 1, contender.fresh), 1e-6)))
