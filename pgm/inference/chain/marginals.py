"""Marginals of the hidden variables of a chain over all steps, cut out of the beliefs over slices.

A slice is the vector of all hidden variables of a step; a chain has the steps 0..T. The template of
a variable ``x.at(3)`` is ``x``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.compile import SliceLayout
from pgm.display import NoArray, Shown, Summary
from pgm.errors import EvidenceError
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, as_scope, namesake, positions
from pgm.inference.belief_kind import Kind
from pgm.inference.chain.backward import Beliefs
from pgm.inference.posterior import require_variable
from pgm.inference.summaries import marginals_over_time
from pgm.kernels.arrays import block
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class Marginals(Shown, NoArray):
    """The marginals of hidden variables over all steps, by variable.

    They are cut out of `beliefs`, the moments of all slices, in which the variables stand as
    `layout` says. `beliefs` has one axis of runs, for which a marginal has the user's axes, `lead`.

    Attributes
    ----------
    kind : Kind
        Which measurements the marginals know: predicted, filtered, fixed-lag or smoothed.
    """

    # The moments of the slices, whose runs are flattened from the axes `lead`.
    layout: SliceLayout
    beliefs: Beliefs
    lead: tuple[int, ...]
    kind: Kind

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a variable: ``x`` gives it at all its steps, ``x.at(3)`` at one step.

        The mean is (*runs, steps, d) for ``x``, stacked by step, and (*runs, d) for ``x.at(3)``;
        d counts the variable's components.

        Raises
        ------
        EvidenceError
            If the variable is not hidden, or has no such step.
        """
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

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"Marginals({self.kind}, steps 0..{self.beliefs.mean.shape[0] - 1}{runs})"

    def _summary(self) -> Summary:
        last = self.beliefs.mean.shape[0] - 1
        return marginals_over_time(self._title, self, self.layout, self.lead, last)


def located(layout: SliceLayout, variable: Variable, last: int) -> tuple[Variable, int]:
    """The template of a hidden variable, and its first step: 0 of a state, 1 of a control.

    `last` is T. Raises EvidenceError for an input, a measurement, a variable that is not hidden,
    and a step where it does not stand.
    """
    template = require_variable(variable).template
    if template in layout.model.inputs:
        raise EvidenceError(
            f"{variable!r} is an input, which no CPD explains: it has the values that are given "
            f"for it as evidence, and no belief; beliefs are over {list(layout.slice)}",
            variable=variable,
        )
    if template in layout.model.sensors:
        raise EvidenceError(_of_measurement(layout, variable), variable=variable)
    if variable.lag or template not in layout.slice:
        raise EvidenceError(
            f"{variable!r} is not among the hidden variables, {list(layout.slice)}"
            f"{namesake(variable, layout.model.variables)}",
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


def _of_measurement(layout: SliceLayout, variable: Variable) -> str:
    """The text of an error: a sensor's measurement, `variable`, has no marginal.

    It says also what to ask for instead, such as innovations.
    """
    name, residuals = variable.template.name, ""
    if not layout.model.discrete:
        residuals = f"; how far readings were from what was expected: posterior.innovations[{name}]"
    return (
        f"{variable!r} is a sensor's measurement, and beliefs are over the hidden variables "
        f"{list(layout.slice)} alone{residuals}. For the distribution of a reading that nobody "
        f"took, put a copy of its CPD, for a variable of another name, into transition=: that "
        "variable is hidden, and has a belief at steps 1..T"
    )


def require_at_steps(layout: SliceLayout, variables: Sequence[Variable], last: int) -> Scope:
    """The scope of a joint, checked: one hidden variable or more, each at a step up to `last`.

    An EvidenceError refuses an empty sequence, a variable without a step, one that is not hidden
    (an input or a measurement), and one at a step where it does not stand. A ModelError refuses a
    variable that stands twice, and a set, which has no order.
    """
    if not variables:
        raise EvidenceError("joint takes variables at steps, like x.at(3), x.at(4)")
    scope = as_scope(variables)
    for variable in scope:
        if variable.step is None:
            raise EvidenceError(
                f"a joint is of variables at steps; write {variable.name}.at(3)", variable=variable
            )
        located(layout, variable, last)
    return scope
