"""How the derivatives of a nonlinear CPD are found, and whether those given are right."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from pgm.cpds.linear import AffineCPD
from pgm.display import Listing, Shown
from pgm.display.summary import Summary
from pgm.errors import ModelError
from pgm.factors.scope import components
from pgm.kernels.arrays import Array
from pgm.linearisers.function import Source
from pgm.linearisers.jacobians import disagreement
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.cpds.base import CPD
    from pgm.cpds.nonlinear import NonlinearGaussianCPD


class Derivatives(Shown, Mapping[Variable, str]):
    """How the derivative of a CPD's mean by each parent is found.

    Of each parent ``"given"``, by ``jacobian=``; ``"traced"``, exact derivatives of the function's
    trace; or ``"numerical"``, by fourth-order differences.

    Attributes
    ----------
    reason : str or None
        The reason why the function has no trace; None where it has one, or needs none.

    Examples
    --------
    >>> from pgm.examples import square
    >>> square.cpds[1].derivatives
    Derivatives of NonlinearGaussianCPD(y | x)
      x  traced
    """

    __slots__ = ("_found", "_of", "reason")

    def __init__(self, cpd: NonlinearGaussianCPD) -> None:
        self._of, self.reason = cpd._title, None
        kind = "given"
        if any(parent not in cpd.jacobian for parent in cpd.given):
            traced = cpd._tracer.confirm([np.zeros(parent.dimension) for parent in cpd.given])
            kind, self.reason = "traced" if traced else "numerical", cpd._tracer.reason
        self._found = {v: "given" if v in cpd.jacobian else kind for v in cpd.given}

    def __getitem__(self, parent: Variable) -> str:
        return self._found[parent]

    def __iter__(self) -> Iterator[Variable]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    @property
    def _title(self) -> str:
        return f"Derivatives of {self._of}"

    def _summary(self) -> Summary:
        rows = [(repr(parent), kind) for parent, kind in self._found.items()]
        why = [] if self.reason is None else [f"no trace: {self.reason}"]
        return Summary(self._title, [Listing(("", ""), rows, names=2), *why])


def check_jacobians(cpds: Iterable[CPD]) -> None:
    """Compare the Jacobians given with CPDs with their functions' derivatives.

    They are compared at drawn points about the prior's mean, and there.

    Raises
    ------
    ModelError
        Naming the CPD, the parent and the entry that is wrong.
    """
    from pgm.cpds.nonlinear import NonlinearGaussianCPD

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
