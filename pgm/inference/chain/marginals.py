"""Marginals over time, asked for by variable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.compile import SliceLayout
from pgm.errors import EvidenceError
from pgm.factors import Gaussian
from pgm.factors.scope import positions
from pgm.inference.chain.backward import Beliefs
from pgm.inference.kind import Kind
from pgm.inference.posterior import require_variable
from pgm.kernels.arrays import block
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class Marginals:
    """The marginals of hidden variables over all steps, by variable.

    Attributes
    ----------
    kind : Kind
        Which readings they know.
    """

    layout: SliceLayout
    beliefs: Beliefs
    lead: tuple[int, ...]
    kind: Kind

    def __getitem__(self, variable: Variable) -> Gaussian:
        """Of ``x`` at all its steps, stacked; of ``x.at(3)`` at one."""
        layout, last = self.layout, self.beliefs.mean.shape[0] - 1
        template, first = located(layout, variable, last)
        places = positions(layout.slice, [template])
        if variable.step is not None:
            mean = self.beliefs.mean[variable.step][:, places]
            cov = block(self.beliefs.cov[variable.step], places, places)
            shape = self.lead
            return Gaussian._make(
                (variable,),
                mean.reshape(*shape, mean.shape[-1]),
                cov.reshape(*shape, *cov.shape[-2:]),
            )
        mean = self.beliefs.mean[first:][..., places].swapaxes(0, 1)
        cov = block(self.beliefs.cov[first:], places, places).swapaxes(0, 1)
        return Gaussian._make(
            (variable,),
            mean.reshape(*self.lead, *mean.shape[1:]),
            cov.reshape(*self.lead, *cov.shape[1:]),
            np.arange(first, last + 1),
        )

    def __repr__(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"Marginals({self.kind}, steps 0..{self.beliefs.mean.shape[0] - 1}{runs})"


def located(layout: SliceLayout, variable: Variable, last: int) -> tuple[Variable, int]:
    """The template of a hidden variable, and its first step; refuses what has no marginal."""
    template = require_variable(variable).template
    if template in layout.model.inputs:
        raise EvidenceError(
            f"{variable!r} is observed: its value is its evidence", variable=variable
        )
    if template in layout.model.sensors:
        raise EvidenceError(
            f"{variable!r} is observed; see posterior.innovations[{variable.name}]",
            variable=variable,
        )
    if variable.lag or template not in layout.slice:
        raise EvidenceError(
            f"{variable!r} is not among the hidden variables, {list(layout.slice)}",
            variable=variable,
        )
    first = 0 if template in layout.states else 1
    if variable.step is not None and not first <= variable.step <= last:
        raise EvidenceError(
            f"{template!r} has steps {first}..{last}; there is no {variable!r}",
            variable=variable,
            step=variable.step,
        )
    return template, first
