"""How the derivatives of a nonlinear CPD are found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgm.display import Told
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.cpds.gaussian import NonlinearGaussianCPD


class Derivatives(Told[Variable]):
    """How the derivative of a CPD's mean by each parent is found.

    For each parent ``"given"``, by ``jacobian=``; ``"traced"``, exact derivatives of the function's
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

    __slots__ = ("reason",)

    def __init__(self, cpd: NonlinearGaussianCPD) -> None:
        kind, self.reason = "given", None
        if any(parent not in cpd.jacobian for parent in cpd.given):
            cpd._tracer.traced()
            self.reason = cpd._tracer.reason
            kind = "traced" if self.reason is None else "numerical"
        found = {v: "given" if v in cpd.jacobian else kind for v in cpd.given}
        why = [] if self.reason is None else [f"no trace: {self.reason}"]
        super().__init__(f"Derivatives of {cpd._title}", found, *why)
