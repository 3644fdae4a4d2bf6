"""Tables of logarithms that lie far apart, which numbers may not hold."""

from __future__ import annotations

import numpy as np

from pgm.errors import NumericalError
from pgm.factors import Table
from pgm.factors.axes import States, sizes
from pgm.kernels.arrays import Array

# How far below the largest entry a logarithm may be for its number to be one of a `Table`.
DEEPEST = -690.0


def table_of(scope: States, logs: Array, what: str, advice: str) -> Table:
    """The factor of some logarithms, (..., size of each variable...), its largest value one.

    Raises a NumericalError where an entry that is not zero would be one as a number; its text
    begins with `what` the table is and ends with the `advice`.
    """
    lead = logs.shape[: logs.ndim - len(scope)]
    top = logs.max(axis=tuple(range(len(lead), logs.ndim)))
    top = np.where(top == -np.inf, 0.0, top)
    below = logs - top.reshape(*lead, *(1,) * len(scope))
    assert below.shape == (*lead, *sizes(scope))
    if ((below < DEEPEST) & (below > -np.inf)).any():
        raise NumericalError(
            f"{what} has entries e^{below[below > -np.inf].min():.0f} times its largest, which "
            f"numbers of float64 do not hold; {advice}"
        )
    return Table._make(scope, np.exp(below), top)
