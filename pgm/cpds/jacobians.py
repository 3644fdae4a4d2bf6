"""Whether the Jacobians given with CPDs are their functions' derivatives."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pgm.cpds.base import CPD
from pgm.cpds.gaussian import AffineCPD, NonlinearGaussianCPD
from pgm.errors import ModelError
from pgm.factors.scope import components
from pgm.kernels.arrays import Array
from pgm.linearisers.function import Source
from pgm.linearisers.jacobians import disagreement


def check_jacobians(cpds: Iterable[CPD]) -> None:
    """Compare the Jacobians given with CPDs with their functions' derivatives.

    They are compared at drawn points about the prior's mean, and there.

    Raises
    ------
    ModelError
        Naming the CPD, the parent and the entry that is wrong.
    """
    every = list(cpds)
    means = {
        cpd.child: cpd.offset.reshape(-1, cpd.child.dimension)[0]
        for cpd in every
        if isinstance(cpd, AffineCPD) and not cpd.parents
    }
    checked = []  # a function may be that of many CPDs
    for cpd in every:
        if isinstance(cpd, NonlinearGaussianCPD) and cpd.jacobian:
            centres = [
                means.get(v, means.get(v.template, np.zeros(v.dimension))) for v in cpd.given
            ]
            key = (cpd.function, *cpd.jacobian.values(), *(centre.tobytes() for centre in centres))
            if key not in checked:
                checked.append(key)
                _check(cpd, centres)


def _check(cpd: NonlinearGaussianCPD, centres: list[Array]) -> None:
    template = cpd._template(cpd.given)
    found = disagreement(template, centres, Source(cpd, True, None))
    if found is None:
        return
    ends = np.cumsum([parent.dimension for parent in cpd.given])
    which = int(np.searchsorted(ends, found.column, side="right"))
    parent = cpd.given[which]
    column = found.column - int(ends[which]) + parent.dimension
    row_of, column_of = components((cpd.child,))[found.row], components((parent,))[column]
    values = np.split(found.at, ends[:-1])
    at = ", ".join(
        f"{v!r} = {each.round(4).tolist()}" for v, each in zip(cpd.given, values, strict=True)
    )
    of = "the function's trace" if found.traced else "differences of the function"
    raise ModelError(
        f"{cpd!r}: the Jacobian by {parent!r} is wrong in row {found.row} ({row_of}), column "
        f"{column} ({column_of}): it gives {found.given:.6g}, {of} {found.due:.6g}, at {at}; mend "
        "that entry, or leave this Jacobian out: derivatives of traced functions are exact",
        variable=parent,
        cpd=cpd,
    )
