"""The prior on a lattice: point masses with its mean and covariance, or its density at centres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.inference.grid.densities import Uneven
from pgm.inference.grid.groups import Members
from pgm.inference.grid.lattice import Lattice
from pgm.inference.grid.motion import Motion
from pgm.kernels.arrays import Array
from pgm.kernels.lattice import Span


def start(lattice: Lattice, groups: Sequence[Members], run: int) -> tuple[Array, Array, Uneven]:
    """The probabilities of all cells at step 0, (*cells); their sum lacks the prior's mass outside.

    Second comes the variance that the lattice has added along each axis, in squared cells, (axes,);
    third the prior's density whose sums over centres vary the most, `EVEN` if it has none. `groups`
    are those of the prior.
    """
    nowhere = (Span(0, 1),) * len(lattice.axes)
    made = Motion(lattice, list(groups)).at(0, run, nowhere)
    found, added = made.forward(np.ones((1,) * len(lattice.axes)))
    return lattice.put(found, made.target), added, made.uneven
