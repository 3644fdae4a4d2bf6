"""The memory that the beliefs of a grid take."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.grid.lattice import Lattice
from pgm.beliefs.grid.settings import GridSettings
from pgm.resources import NUMBER, gibibytes, require_memory

# Arrays of one belief's size that a step works with.
_WORK = 12


def require_room(lattice: Lattice, grid: GridSettings, steps: int, runs: int, sets: int) -> None:
    """Refuse a grid whose beliefs would not fit memory, by a ModelError, before any is made.

    steps: How many beliefs a run has, T + 1.
    sets: How many sets of beliefs are kept, of all steps and runs: 1 of a filter, 3 of a smoother.
    """
    share = np.dtype(grid.dtype).itemsize / NUMBER
    kept = int(sets * steps * runs * lattice.size * share)
    cells = " × ".join(str(axis.cells) for axis in lattice.axes)
    over = f"{steps} steps" + (f" of {runs} runs" if runs > 1 else "")
    narrower = "" if grid.dtype == np.float32 else ", or dtype=np.float32"
    require_memory(
        kept + _WORK * lattice.size,
        f"the beliefs of {cells} = {lattice.size:,} cells ({gibibytes(lattice.size)} each) at "
        f"{over}",
        f"take wider cells or closer bounds, fewer steps or runs to a call{narrower}",
    )
