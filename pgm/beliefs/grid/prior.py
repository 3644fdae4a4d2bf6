"""The prior on a lattice: point masses with its mean and covariance, or its density at centres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.beliefs.grid.densities import Uneven
from pgm.beliefs.grid.groups import Members
from pgm.beliefs.grid.lattice import Lattice
from pgm.beliefs.grid.motion import Motion
from pgm.kernels.arrays import Array
from pgm.kernels.lattice import Span


def start(lattice: Lattice, groups: Sequence[Members], run: int) -> tuple[Array, Array, Uneven]:
    """Put the prior of a run, at step 0, on a lattice: (probabilities, added, uneven).

    `groups` are the sets of states of the prior that are put on the lattice together.

    The three results are:

    - the probabilities (*cells) of all cells; their sum lacks the prior's mass outside the bounds;
    - the variance along each axis that the point masses have in excess of the prior's, for want of
      narrower cells, in squared cells, (axes,);
    - the density of the prior whose sum over centres varies the most as the centres shift within a
      cell, and by what share it varies; the share is 0 if the prior is Gaussian.
    """
    nowhere = (Span(0, 1),) * len(lattice.axes)
    made = Motion(lattice, list(groups)).at(0, run, nowhere)
    found, added = made.forward(np.ones((1,) * len(lattice.axes)))
    return lattice.put(found, made.target), added, made.uneven
