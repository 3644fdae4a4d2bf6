"""Initial points of linearisation for nonlinear CPDs."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import numpy.typing as npt

from pgm.errors import EvidenceError
from pgm.factors.scope import listed, namesake
from pgm.kernels.arrays import Array
from pgm.variables import Variable

# Means of hidden variables.
Start = Mapping[Variable, npt.ArrayLike]


def require_hidden(start: Start, hidden: Collection[Variable]) -> None:
    """Refuse a start that is no mapping, or has keys other than hidden variables."""
    if not isinstance(start, Mapping):
        raise EvidenceError(f"start maps variables to means; found {type(start).__name__}")
    for variable in start:
        if variable not in hidden:
            raise EvidenceError(
                f"start has {variable!r}, which is not hidden; it takes {listed(hidden)}"
                f"{namesake(variable, hidden)}",
                variable=variable,
            )


def over_runs(variable: Variable, means: Array, lead: tuple[int, ...], axes: int) -> Array:
    """The means of a variable, (..., own axes), for all of the evidence's runs, (runs, ...)."""
    own, rest = means.shape[: means.ndim - axes], means.shape[means.ndim - axes :]
    try:
        wide = np.broadcast_to(means, (*lead, *rest))
    except ValueError:
        raise EvidenceError(
            f"start for {variable!r} has the axes of runs {own}, which do not broadcast to those "
            f"of the evidence, {lead}",
            variable=variable,
        ) from None
    return wide.reshape(-1, *rest)
