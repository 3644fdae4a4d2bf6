"""Values of a child and its parents, as users give them to a CPD."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_mapping
from pgm.errors import ModelError
from pgm.factors.arrays import Shape, clash, flat
from pgm.factors.axes import as_known
from pgm.factors.scope import as_value, listed
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    from pgm.cpds.base import CPD

# Values (..., d), or indices of states (...).
Values = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Known:
    """Values (*shape, d) of all parents of a CPD, or indices of states; they broadcast to it.

    `lead` are the axes of runs, those of the CPD itself too, that are flattened to the last of
    `shape`; `step` is for messages.
    """

    values: Mapping[Variable, Values]
    lead: Shape
    shape: Shape
    step: npt.ArrayLike | None


def as_parents(cpd: CPD, given: Any) -> Known:
    """The values of a CPD's parents, checked: none missing, none of another variable."""
    found = as_mapping(given, f"the second argument, parents, of {cpd!r}", ModelError, cpd=cpd)
    for key in found:
        if key not in cpd.parents:
            why = f"which is none of its parents ({listed(cpd.parents)})"
            variable = key if isinstance(key, Variable) else None
            advice = "" if variable else "; give the variable itself"
            raise ModelError(
                f"{cpd!r}: a value of {key!r}, {why}{advice}", variable=variable, cpd=cpd
            )
    for parent in cpd.parents:
        if parent not in found:
            raise ModelError(
                f"{cpd!r}: no value of its parent {parent!r}; give one of each of its parents "
                f"({listed(cpd.parents)})",
                variable=parent,
                cpd=cpd,
            )
    arrays = {parent: as_values(cpd, parent, found[parent]) for parent in cpd.parents}
    shapes = [(parent, shape_of(parent, array)) for parent, array in arrays.items()]
    lead = common(cpd, [*shapes, ("the CPD itself", cpd._lead())])
    values = {v: flat(a, lead, 0 if isinstance(v, Discrete) else 1) for v, a in arrays.items()}
    return Known(values, lead, (math.prod(lead),), cpd.child.step)


def as_values(cpd: CPD, variable: Variable, value: Any) -> Values:
    """Values of a variable of a CPD's family, (..., d), or indices of states (...)."""
    if isinstance(variable, Discrete):
        return as_known(variable, value, f"the value of {variable!r} in {cpd!r}", cpd=cpd)
    missing = cpd.partial and variable == cpd.child
    return as_value(variable, value, f"value in {cpd!r}", missing=missing, cpd=cpd)


def shape_of(variable: Variable, values: Values) -> Shape:
    """The leading axes of values of a variable."""
    return values.shape if isinstance(variable, Discrete) else values.shape[:-1]


def common(cpd: CPD, shapes: Sequence[tuple[object, Shape]]) -> Shape:
    """The leading axes that values broadcast to, from whose axes each are, if they fit."""
    try:
        lead = np.broadcast_shapes(*(shape for _, shape in shapes))
    except ValueError:
        raise ModelError(
            f"{cpd!r}: the leading axes of the values do not broadcast: {clash(shapes)}; "
            "give them the same, or 1",
            cpd=cpd,
        ) from None
    require_memory(
        math.prod(lead) * sum(max(v.dimension, 1) for v in cpd.scope),
        f"{cpd!r} at all of {lead} values",
        "give it fewer at a time",
        cpd=cpd,
    )
    return lead
