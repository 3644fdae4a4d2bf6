"""Summing variables out for a query, for many runs at once; impossible evidence is refused.

A `QueryPlan` has the order of the hidden variables, those asked for last, and the plan of products
that are summed over all but these. A table has an axis for each variable of its scope, and a last
axis of runs: (sizes..., runs or 1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import MappingProxyType

import numpy as np

from pgm import elimination
from pgm.beliefs.discrete.entered_evidence import one_hot
from pgm.beliefs.discrete.impossible import told
from pgm.beliefs.discrete.run_pieces import some_runs
from pgm.cpds.causal_independence import of_user
from pgm.elimination import TableAlgebra
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, scaled
from pgm.factors.axes import States
from pgm.factors.scope import in_run, listed
from pgm.factors.table import Potential
from pgm.inference.query.plan import QueryPlan
from pgm.kernels.arrays import Array, Mask
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring
from pgm.schedules.impossible import OF_RUNS, ImpossibleEvidence
from pgm.variables import Discrete


def eliminate(query: QueryPlan, evidence: BoundStates) -> Array:
    """The joint probabilities of the variables asked for, given evidence, (sizes..., runs or 1).

    The variables are in the plan's order. `evidence` is the evidence that the plan was made for,
    in all of its runs or cut to some of them. Runs of impossible evidence have NaN. If any number
    under- or overflows, all is computed again with logarithms.
    """
    try:
        with np.errstate(all="raise"):
            table = elimination.eliminate(query.sums, *tables(query, evidence, SUM_PRODUCT))
            result: Array = table / table.sum(axis=tuple(range(table.ndim - 1)))
            return result
    except FloatingPointError:
        table = elimination.eliminate(query.sums, *tables(query, evidence, LOG_SUM_PRODUCT))
        axes = tuple(range(table.ndim - 1))
        with np.errstate(invalid="ignore", under="ignore"):
            probabilities: Array = np.exp(table - LOG_SUM_PRODUCT.total(table, axes))
            return probabilities


def tables(
    query: QueryPlan, evidence: BoundStates, semiring: Semiring
) -> tuple[Callable[[int], Array], TableAlgebra]:
    """The tables of a query, made as its plan takes them, and their algebra.

    Their entries are numbers, scaled in each run, or logarithms, as the semiring has them.
    """
    factors, open_, plan = query.requisite.factors, query.requisite.open, query.sums

    def given(factor: int) -> Array:
        """The table of a factor, (sizes..., runs or 1)."""
        if factor < len(factors):
            own = [query.order[k] for k in plan.scopes[factor]]
            table = _reduced(factors[factor]._potential, open_[factor], own, evidence)
        else:
            return _weights(query.weighted[factor - len(factors)], evidence, semiring)
        return semiring.entries(table)

    return given, TableAlgebra(semiring, plan.sizes, scaled=True, aligned=1)


def _reduced(
    potential: Potential,
    unknown: Sequence[Discrete],
    own: Sequence[Discrete],
    evidence: BoundStates,
) -> Array:
    """A factor's values at the states of its observed variables, (sizes..., runs or 1).

    What is answered is but for a constant, and log-scales do not matter.

    unknown: The factor's variables of more than one state that are not observed in all runs.
    own: The same variables in the plan's order, which is that of the result's axes.
    """
    index: list[int | slice] = []
    left: list[Discrete] = []
    by_run: list[Discrete] = []
    for variable in potential.axes:
        # A variable of a single state has that, observed or not.
        state = 0 if variable.size == 1 else evidence.states.get(variable)
        if isinstance(state, int):
            index.append(state)
            continue
        index.append(slice(None))
        left.append(variable)
        if variable not in unknown:
            by_run.append(variable)
    table = potential.values[tuple(index)]
    order = [left.index(variable) for variable in own]
    table = table.transpose(*order, *(left.index(v) for v in by_run))
    if not by_run:
        return table[..., None]
    reduced: Array = table[(..., *(evidence.states[v] for v in by_run))]
    return reduced


def _weights(variable: Discrete, evidence: BoundStates, semiring: Semiring) -> Array:
    """The weights (states, runs or 1) that the evidence gives the states of a variable.

    A variable with soft evidence has the weights of this, divided by the largest. A variable that
    is observed in some runs alone has, in these, the weight one for the state observed and zero for
    all others; in runs without an observation all its states have the weight one. They are entries
    of the semiring.
    """
    soft = evidence.weights.get(variable)
    if soft is not None:
        below, _ = scaled(soft)
        return semiring.of_logs(below.T)
    return semiring.entries(one_hot(np.asarray(evidence.states[variable]), variable.size))


def require_possible(query: QueryPlan, probabilities: Array) -> None:
    """Raise ImpossibleEvidence if probabilities (sizes..., runs or 1) are NaN in any run.

    They are the result of the elimination `query`, whose evidence the error names.
    """
    lost = lost_runs(probabilities)
    if lost.any():
        raise refusal(query, lost, query.requisite.evidence.lead)


def lost_runs(probabilities: Array) -> Mask:
    """The runs, (runs or 1,), in which probabilities (sizes..., runs or 1) are NaN."""
    return np.asarray(np.isnan(probabilities).any(axis=tuple(range(probabilities.ndim - 1))))


def refusal(query: QueryPlan, lost: Mask, lead: tuple[int, ...]) -> ImpossibleEvidence:
    """The error for evidence of probability zero in the runs that the mask `lost` (runs,) marks.

    `lead` are the lengths of the user's axes of runs, () for none.
    """
    # Evidence that is given once for all runs has one run.
    first = int(lost.argmax()) if query.requisite.evidence.lead else 0
    involved, scope = _contradiction(query, first)
    where = in_run(lost.reshape(lead))
    return ImpossibleEvidence(
        f"{told(where, involved, f'({listed(scope)})')}{OF_RUNS if lead else ''}",
        lost,
        lead,
        variable=next(iter(involved), None),
    )


def _contradiction(query: QueryPlan, run: int) -> tuple[list[Discrete], States]:
    """The variables whose evidence contradicts itself in a run, and those whose states it excludes.

    The elimination is done again up to the first step whose product is zero throughout. The list
    has the variables whose evidence went into this product: those with hard evidence, then those
    with soft. The tuple has the variables of the product, all of whose joint states are impossible.
    """
    plan, factors = query.sums, query.requisite.factors
    evidence = some_runs(query.requisite.evidence, slice(run, run + 1))
    made = elimination.results(plan, *tables(query, evidence, LOG_SUM_PRODUCT))
    first = len(plan.scopes)
    for number, table in enumerate(made):  # noqa: B007, used after the loop
        if (table == -np.inf).all():
            break
    waiting, members = [first + number], set[Discrete]()
    while waiting:
        factor = waiting.pop()
        if factor >= first:
            waiting += plan.steps[factor - first].factors
        elif factor < len(factors):
            members.update(factors[factor]._potential.axes)
        else:
            members.add(query.weighted[factor - len(factors)])
    shown = [of_user(v) for v, s in evidence.states.items() if np.min(s) >= 0 and v in members]
    soft = [v for v in evidence.weights if v in members]
    return list(dict.fromkeys(shown + soft)), tuple(
        query.order[k] for k in plan.steps[number].scope
    )


NOTHING: Evidence = MappingProxyType({})
