"""A *start*: the means, by variable, that a user gives as first points of linearisation."""

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
    """Refuse a start that is no mapping, or has a key that is no hidden variable.

    `hidden` are the variables without evidence. The error is an `EvidenceError`.
    """
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
    """A variable's means as (runs, ...), for all runs of the evidence.

    The last `axes` axes of `means` are the variable's own. The axes before are broadcast to the
    evidence's axes of runs, `lead`, and reshaped to one; means that do not broadcast are an
    `EvidenceError`.
    """
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
