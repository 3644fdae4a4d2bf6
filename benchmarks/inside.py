"""Timing what of a call is spent in machine code alone, apart from what is around it."""

from __future__ import annotations

import cProfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import CodeType
from typing import Any

from benchmarks.timing import Contender

# A profile knows no frames of machine code: its time is that of the functions here that enter it.
ENTRIES = str(Path("pgm", "kernels", "machine"))


def least(contenders: Mapping[str, Contender], repeats: int) -> dict[str, float]:
    """The least seconds a unit in machine code, by contenders that spend any there."""
    found: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(repeats):
        for name, contender in contenders.items():
            found[name].append(spent(contender.call) / contender.units)
    return {name: min(each) for name, each in found.items() if min(each) > 0.0}


def spent(call: Callable[[], Any]) -> float:
    """Seconds of the processor that a call spends in machine code."""
    profile = cProfile.Profile(time.process_time)
    profile.runcall(call)
    return sum(
        (
            each.inlinetime
            for each in profile.getstats()
            if isinstance(each.code, CodeType) and ENTRIES in each.code.co_filename
        ),
        0.0,
    )
