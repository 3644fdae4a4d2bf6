"""The hidden variables and steps that a posterior is asked for, and errors for others."""

from __future__ import annotations

from collections.abc import Sequence

from pgm.boundary import is_whole
from pgm.compile import SliceLayout
from pgm.errors import EvidenceError, ModelError
from pgm.factors.scope import Scope, as_scope, namesake
from pgm.posteriors.posterior import require_variable
from pgm.variables import Variable


def require_step(variable: Variable, steps: int) -> int | None:
    """The step that a variable stands at: 3 of ``x.at(3)``; None of ``x``, which is of all steps.

    A step that is no whole number, or after the last step, `steps`, is refused by a ModelError.
    """
    if variable.step is None:
        return None
    if not is_whole(variable.step) or variable.step > steps:
        raise ModelError(
            f"{variable!r} is after the last step, {steps}", variable=variable, step=variable.step
        )
    return int(variable.step)


def located(layout: SliceLayout, variable: Variable, last: int) -> tuple[Variable, int]:
    """The template of a hidden variable, and its first step: 0 of a state, 1 of a control.

    `last` is T. Raises EvidenceError for an input, a measurement, a variable that is not hidden,
    and a step where it does not stand.
    """
    template = require_variable(variable).template
    if variable.lag or template not in layout.slice:
        raise _not_hidden(layout, variable)
    first = 0 if template in layout.states else 1
    if variable.step is not None and not first <= variable.step <= last:
        raise EvidenceError(
            f"{template!r} has steps {first}..{last}; there is no {variable!r}",
            variable=variable,
            step=variable.step,
        )
    return template, first


def measured(layout: SliceLayout, variable: Variable) -> Variable | None:
    """The template of a sensor's measurement, ``z`` or ``z.at(3)``; None of other variables."""
    template = require_variable(variable).template
    return template if template in layout.model.sensors and not variable.lag else None


def _not_hidden(layout: SliceLayout, variable: Variable) -> EvidenceError:
    """The error for an input, a measurement, and a variable that is not hidden."""
    template = variable.template
    if template in layout.model.inputs:
        return EvidenceError(
            f"{variable!r} is an input, which no CPD explains: it has the values that are given "
            f"for it as evidence, and no belief; beliefs are over {list(layout.slice)}",
            variable=variable,
        )
    if template in layout.model.sensors:
        return EvidenceError(_of_measurement(layout, variable), variable=variable)
    return EvidenceError(
        f"{variable!r} is not among the hidden variables, {list(layout.slice)}"
        f"{namesake(variable, layout.model.variables)}",
        variable=variable,
    )


def _of_measurement(layout: SliceLayout, variable: Variable) -> str:
    """The text of an error: a sensor's measurement, `variable`, has no marginal.

    It says also what to ask for instead, such as innovations.
    """
    name, residuals = variable.template.name, ""
    if not layout.model.discrete:
        residuals = f"; how far readings were from what was expected: posterior.innovations[{name}]"
    return (
        f"{variable!r} is a sensor's measurement, and beliefs are over the hidden variables "
        f"{list(layout.slice)} alone{residuals}. Of a reading that nobody took, posterior[{name}."
        "at(t)] is the belief, unless keep= leaves it out; for its joint with others put a copy of "
        "its CPD, for a variable of another name, into transition=: that variable is hidden, and "
        "stands at steps 1..T"
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
