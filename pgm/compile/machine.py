"""The choice of machine code for sweeps along chains."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Compiled:
    """Sweeps in machine code, the runs shared by threads.

    Parameters
    ----------
    threads : int
        Threads, each with its own runs.
    """

    threads: int = 1
