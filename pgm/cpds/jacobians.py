"""Whether the Jacobians given with CPDs are their functions' derivatives."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from pgm.cpds.base import CPD
from pgm.cpds.gaussian import AffineCPD, NonlinearGaussianCPD
from pgm.errors import ModelError
from pgm.factors.scope import components
from pgm.kernels.arrays import Array, Mask
from pgm.linearisers import BoundFunction
from pgm.linearisers.function import Source
from pgm.tracing.trace import around

# Entries that are the same differ by less, of themselves; derivatives by differences are less sure.
TRACED, NUMERICAL = 1e-7, 1e-4


def check_jacobians(cpds: Iterable[CPD]) -> None:
    """Compare given Jacobians with derivatives, at the prior's mean and at points drawn about it.

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
            at = [means.get(v, means.get(v.template, np.zeros(v.dimension))) for v in cpd.given]
            key = (cpd.function, *cpd.jacobian.values(), *(mean.tobytes() for mean in at))
            if key not in checked:
                checked.append(key)
                _check(cpd, at)


def _check(cpd: NonlinearGaussianCPD, centres: list[Array]) -> None:
    template = cpd._template(cpd.given)
    cpd._tracer.confirm(centres)
    points = around(centres, least=1e-6)  # a kink is often at the mean itself
    x, known = np.concatenate(points, axis=-1), [None] * len(points)
    bare = replace(template, jacobians=(None,) * len(points))
    with np.errstate(all="ignore"):
        given, due = (
            BoundFunction(each, known, 2, source=Source(cpd, True, None)).jacobian(x)
            for each in (template, bare)
        )
        wrong = _wrong(given, due, NUMERICAL if bare.numerical else TRACED)
    wrong[..., list(template.missing)] = False
    if bare.numerical:  # which are wrong themselves, near what is no derivative
        wrong &= wrong.sum(axis=(0, 1)) * 2 >= np.isfinite(due).sum(axis=(0, 1))
    if not wrong.any():
        return
    # The entry that is wrong at most points, and one of these that is not far away.
    row, column = divmod(int(wrong.sum(axis=(0, 1)).argmax()), template.size)
    point = (0, 2) if wrong[0, 2, row, column] else tuple(np.argwhere(wrong[..., row, column])[0])
    argument, place = template.columns[column]
    parent = cpd.given[argument]
    names = components((cpd.child,))[row], components((parent,))[place]
    at = ", ".join(
        f"{v!r} = {each[point].round(4).tolist()}"
        for v, each in zip(cpd.given, points, strict=True)
    )
    of, why = "the function's trace", ": derivatives of traced functions are exact"
    if bare.numerical:
        of, why = "differences of the function", ""
    raise ModelError(
        f"{cpd!r}: the Jacobian by {parent!r} is wrong in row {row} ({names[0]}), column {place} "
        f"({names[1]}): it gives {given[(*point, row, column)]:.6g}, {of} "
        f"{due[(*point, row, column)]:.6g}, at {at}; mend that entry, or leave this "
        f"Jacobian out{why}",
        variable=parent,
        cpd=cpd,
    )


def _wrong(given: Array, due: Array, share: float) -> Mask:
    scale = np.abs(due).max(axis=-1, keepdims=True)
    found: Mask = np.isfinite(due) & ~(np.abs(given - due) <= share * (np.abs(due) + 1e-3 * scale))
    return found
