"""Summaries of posteriors: log-evidence, status, and beliefs, over time at first and last steps.

Arguments `runs` are the shape of the user's leading axes of runs; `last` is T, the last step;
``beliefs[x.at(t)]`` is the belief of a variable x at step t, of all runs. A *place* is an index
of a run or, with a step after it, of a run and a step. A *listing* is a table of text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from pgm.compile import SliceLayout
from pgm.display import (
    ENDS,
    LEFT_OUT,
    Listing,
    Summary,
    beside,
    by_component,
    column,
    count,
    few,
    number,
    places,
    stacked,
    whereabouts,
)
from pgm.display.summary import Place
from pgm.errors import PgmError
from pgm.factors import Table
from pgm.factors.listing import DIGITS, STATES, states_of
from pgm.factors.scope import components
from pgm.kernels.arrays import Array
from pgm.posteriors.outcome import marginal
from pgm.variables import Discrete, Variable

# Rows for the beliefs of all variables of a chain, and the most variables that share them.
ROWS, VARIABLES = 12, 4
# Rows for a network without time, and how many of its first runs are columns.
NETWORK_ROWS, RUNS = 12, 2


def over_time(
    title: str,
    posterior: Any,
    variables: Sequence[Variable],
    runs: tuple[int, ...],
    last: int,
    told_of: Sequence[str] = (),
) -> Summary:
    """The summary of a posterior over time; beliefs that are not shown are not computed.

    `variables` are hidden ones, without a step; those that are no states, such as controls, begin
    at step 1. `told_of` are further lines, below the log-evidence and the status.
    """
    states = posterior.graph.model.states
    told = [*figures(posterior), *told_of]
    return Summary(title, [*told, *ends(posterior, variables, states, runs, last)])


def marginals_over_time(
    title: str, marginals: Any, layout: SliceLayout, runs: tuple[int, ...], last: int
) -> Summary:
    """The summary of marginals over time alone, without log-evidence and status.

    `layout` tells which variables are hidden, and which of them are states.
    """
    return Summary(title, ends(marginals, layout.slice, layout.states, runs, last))


def ends(
    beliefs: Any,
    variables: Sequence[Variable],
    states: Sequence[Variable],
    runs: tuple[int, ...],
    last: int,
) -> list[str | Listing]:
    """Listings of beliefs: one for each of the first four variables, of its first and last steps.

    Variables that are no `states`, such as controls, begin at step 1. If there are more than four
    variables, a line with their number follows.
    """
    shown = variables[:VARIABLES]
    most = max(ROWS // max(len(shown), 1) - (len(shown) > 1), ENDS)
    parts: list[str | Listing] = []
    for variable in shown if all(runs) else ():
        first = 0 if variable in states else 1
        try:
            parts.append(_ends(beliefs, variable, first, runs, last, most))
        except PgmError as error:
            parts.append(f"{variable!r}: none: {error}")
    if len(variables) > len(shown):
        parts.append(f"... {len(variables)} variables in all")
    return parts


def at_a_step(
    title: str, belief: Any, variables: Sequence[Variable], runs: tuple[int, ...]
) -> Summary:
    """The summary of an online belief: log-evidence, status, and the belief of each variable."""
    parts: list[str | Listing] = [f"log-evidence {spread(np.asarray(belief.log_evidence))}"]
    parts.append(belief.status._title)
    return Summary(title, [*parts, *by_variable(belief, variables, runs)])


def of_network(
    title: str, posterior: Any, variables: Sequence[Variable], runs: tuple[int, ...]
) -> Summary:
    """The summary of a posterior of a network without time, its variables in order."""
    return Summary(title, [*figures(posterior), *by_variable(posterior, variables, runs)])


def by_variable(
    posterior: Any, variables: Sequence[Variable], runs: tuple[int, ...]
) -> list[str | Listing]:
    """A listing of beliefs, with a row for each component; a discrete variable has one row.

    Of more than twelve variables the first few and the last few are shown. The columns are runs
    from the beginning and the end of the axes of runs, two at the most. If there are no variables,
    or an axis of runs has length zero, the result is empty. If rows are cut off, a line with the
    number of variables follows.
    """
    picked = [place for place in places(runs, RUNS) if place is not None][:RUNS]
    rows: list[Sequence[str] | None] = []
    for k in few(len(variables), NETWORK_ROWS) if picked else ():
        if k is None:
            rows.append(None)
            continue
        try:
            found = marginal(posterior, variables[k])
        except PgmError as error:
            rows.append([repr(variables[k]), f"none: {error}", *[""] * (len(picked) - 1)])
            continue
        rows += _of_variable(variables[k], found, picked)
    heads = ["", *(f"run {', '.join(map(str, place))}" if place else "" for place in picked)]
    if not rows:
        return []
    if len(rows) <= NETWORK_ROWS + 1:
        return [Listing(heads, rows, cell=60)]
    first = [*rows[:NETWORK_ROWS], None]
    return [Listing(heads, first, cell=60), f"of {count(len(variables), 'variable')}"]


def moments_of(belief: Any) -> Listing:
    """The listing of the mean and standard deviations of a grid's or particles' belief.

    It has those of all components, for the runs and steps that a summary shows.
    """
    names = [f"{c} [rad]" if c in belief.angles else c for c in belief.components]
    if not belief.lead:
        return by_component(names, belief.mean, belief.cov)

    def moments(place: Place) -> tuple[Array, Array]:
        found = belief[place]
        return found.mean, found.cov

    return stacked(names, belief.lead, belief.steps, moments)


def figures(posterior: Any) -> Iterable[str]:
    """Two lines of text on a posterior: its log-evidence with the kind of that, and its status."""
    try:
        found = np.asarray(posterior.log_evidence)
        yield f"log-evidence {spread(found)} ({posterior.log_evidence_kind})"
    except PgmError as error:
        yield f"log-evidence: none, since {error}"
    yield posterior.status._title


# A log-probability below this is what rounding leaves of zero.
_ROUNDED = 1e-12


def spread(values: Array, digits: int = 6) -> str:
    """Log-probabilities as text, with `digits` significant digits.

    Of several runs it is "the least to the largest", each with four digits, unless they are equal.
    """
    values = np.where(np.abs(values) < _ROUNDED, 0.0, values)
    if not values.ndim:
        return number(float(values), digits)
    if not values.size:
        return "of no runs"
    low, high = float(np.min(values)), float(np.max(values))
    return number(low, digits) if low == high else f"{number(low, 4)} to {number(high, 4)}"


def _ends(
    beliefs: Any, variable: Variable, first: int, runs: tuple[int, ...], last: int, most: int
) -> Listing:
    """The listing of one variable's beliefs from step `first` on, of about `most` rows."""
    steps = range(first, last + 1)
    lead = (*runs, len(steps))
    kept: dict[int, Any] = {}

    def at(place: Place) -> Any:
        """The belief of the variable, for all runs, at the step of a place."""
        step = steps[place[-1]]
        if step not in kept:
            kept[step] = marginal(beliefs, variable.at(step))
        return kept[step]

    if isinstance(variable, Discrete):
        return _states(variable, lead, steps, lambda p: at(p).probabilities[p[:-1]], most)

    def moments(place: Place) -> tuple[Array, Array]:
        found = at(place)[place[:-1]] if runs else at(place)
        return found.mean, found.cov

    heads = components((variable,))
    if len(heads) > 1:
        heads[0] = f"{variable.name}: {heads[0]}"
    return stacked(heads, lead, steps, moments, most)


def _states(
    variable: Discrete,
    lead: tuple[int, ...],
    steps: range,
    chances: Callable[[Place], Array],
    most: int,
) -> Listing:
    """The listing of a discrete variable's probabilities: about `most` rows, a column per state.

    A row is of one place, a run and a step. `lead` is (*runs, number of steps), the axes that a
    place has indices of; `steps` has the steps themselves. `chances` gives the probabilities
    (size,) at a place.
    """
    shown, across = places(lead, most), few(variable.size, STATES)
    found = [place for place in shown if place is not None]
    each = np.array([chances(place) for place in found]).reshape(len(found), variable.size)
    cells = [[LEFT_OUT] * len(found) if k is None else column(each[:, k], DIGITS) for k in across]
    rows = dict(zip(found, zip(*cells, strict=True), strict=True))
    names, where = whereabouts(lead, steps)
    heads = [LEFT_OUT if k is None else variable.states[k] for k in across]
    heads[0] = f"{variable!r}: {heads[0]}"
    listed = [None if place is None else [*where(place), *rows[place]] for place in shown]
    return Listing([*names, *heads], listed, names=len(names))


def _of_variable(variable: Variable, found: Any, picked: Sequence[Place]) -> list[list[str]]:
    """The rows of one variable in a listing: a name, then the belief in each picked run, as text.

    `found` is the variable's marginal, a table or a Gaussian, of all runs, and `picked` has the
    places of the runs to show. A discrete variable has one row, another a row for each component.
    """
    if isinstance(found, Table):
        return [[repr(variable), *(states_of(found, place) for place in picked)]]
    each = [
        beside(
            [float(found.mean[place][k]) for place in picked],
            [float(found.std[place][k]) for place in picked],
            alike=False,
        )
        for k in range(found.mean.shape[-1])
    ]
    names = components((variable,))
    if len(names) > 1:
        names = [f"{variable!r}.{name}" for name in names]
    return [[name, *cells] for name, cells in zip(names, each, strict=True)]
