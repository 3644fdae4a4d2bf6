"""How the derivatives of a nonlinear CPD are found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from pgm.display import Listing, Shown
from pgm.display.summary import Summary
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.cpds.gaussian import NonlinearGaussianCPD


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
