"""Summing variables out for a query, for many runs at once; impossible evidence is refused.

An `EliminationPlan` has the order of the hidden variables, those asked for last, and a list of
*steps*: each multiplies some tables, its *factors*, and sums the product over the first variables
of its scope; the last step makes the joint of the variables asked for. The factors are numbered:
first the CPDs' tables, then the evidence weights of variables with soft evidence or observed in
some runs alone, then the results of the steps. The *scope* of a table is a tuple of variables,
given by their places in the plan's order. A table has an axis for each variable of its scope, and a
last axis of runs: (sizes..., runs or 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np

from pgm.cpds import TableCPD
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates
from pgm.factors.axes import States
from pgm.factors.scope import in_run, listed, names
from pgm.inference.discrete.entered_evidence import one_hot
from pgm.inference.discrete.impossible import ADVICE
from pgm.inference.discrete.run_pieces import some_runs
from pgm.inference.impossible import OF_RUNS, ImpossibleEvidence
from pgm.inference.query.plan import EliminationPlan, Step
from pgm.kernels.arrays import Array, Mask
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring
from pgm.variables import Discrete


def eliminate(plan: EliminationPlan, evidence: BoundStates) -> Array:
    """The joint probabilities of the variables asked for, given evidence, (sizes..., runs or 1).

    The variables are in the plan's order. `evidence` is the evidence that the plan was made for,
    in all of its runs or cut to some of them. Runs of impossible evidence have NaN. If any number
    under- or overflows, all is computed again with logarithms.
    """
    try:
        with np.errstate(all="raise"):
            table = _result(plan, evidence, SUM_PRODUCT)
            result: Array = table / table.sum(axis=tuple(range(table.ndim - 1)))
            return result
    except FloatingPointError:
        table = _result(plan, evidence, LOG_SUM_PRODUCT)
        axes = tuple(range(table.ndim - 1))
        with np.errstate(invalid="ignore", under="ignore"):
            probabilities: Array = np.exp(table - LOG_SUM_PRODUCT.total(table, axes, None))
            return probabilities


def _result(plan: EliminationPlan, evidence: BoundStates, semiring: Semiring) -> Array:
    """The joint of the variables asked for, up to a factor in each run, (sizes..., runs or 1).

    Its entries are numbers or logarithms, as `semiring` has them.
    """
    tables = Tables(plan, evidence, semiring)
    for step in plan.steps:
        tables.do(step)
    return tables.last


class Tables:
    """The tables of an elimination, made step by step by a plan, from its evidence in some runs.

    Their entries are numbers or logarithms, as a semiring has them. `last` is the table that the
    last step done has made, (sizes..., runs or 1).
    """

    last: Array

    def __init__(self, plan: EliminationPlan, evidence: BoundStates, semiring: Semiring) -> None:
        self.plan = plan
        self.evidence = evidence
        self.semiring = semiring
        self._sizes = [v.size for v in plan.order]
        self._made: dict[int, Array] = {}
        self._count = len(plan.scopes)

    def do(self, step: Step) -> None:
        """Multiply the factors of a step and sum over the first `step.summed` axes of the product.

        The result is one more factor. Steps are to be done in the order of the plan, each once. If
        entries are numbers, not logarithms, the new table is divided by its largest entry in each
        run, since only ratios matter.
        """
        product: Array | None = None
        for factor in step.factors:
            table = self._over(step.scope, *self._take(factor))
            product = table if product is None else self.semiring.times(product, table)
        assert product is not None
        if step.summed:
            # One axis of all that is summed out.
            rows = product.reshape(-1, *product.shape[step.summed :])
            product = self.semiring.total(rows, 0, None)
        if self.semiring.linear:
            axes = tuple(range(product.ndim - 1))
            product = product / np.maximum.reduce(product, axes)
        self._made[self._count] = self.last = product
        self._count += 1

    def _take(self, factor: int) -> tuple[Sequence[int], Array]:
        """The scope of a factor and its table, (sizes..., runs or 1).

        The result of a step is dropped once it is taken.
        """
        plan = self.plan
        first = len(plan.scopes)
        if factor >= first:
            step = plan.steps[factor - first]
            return step.scope[step.summed :], self._made.pop(factor)
        cpds = plan.requisite.cpds
        if factor < len(cpds):
            table = self._reduced(cpds[factor], plan.requisite.open[factor], plan.scopes[factor])
        else:
            table = self._weights(plan.weighted[factor - len(cpds)])
        return plan.scopes[factor], self.semiring.entries(table)

    def _reduced(self, cpd: TableCPD, unknown: Sequence[Discrete], scope: Sequence[int]) -> Array:
        """A CPD's table at the states of its observed variables, (sizes of scope..., runs or 1).

        `unknown` are the CPD's variables of more than one state that are not observed in all runs,
        and `scope` the places of these variables in the plan's order, ascending.
        """
        states = self.evidence.states
        index: list[int | slice] = []
        left: list[Discrete] = []
        by_run: list[Discrete] = []
        for variable in (*cpd.given, cpd.child):
            # A variable of a single state has that, observed or not.
            state = 0 if variable.size == 1 else states.get(variable)
            if isinstance(state, int):
                index.append(state)
                continue
            index.append(slice(None))
            left.append(variable)
            if variable not in unknown:
                by_run.append(variable)
        table = cpd.table[tuple(index)]
        order = [left.index(self.plan.order[k]) for k in scope]
        table = table.transpose(*order, *(left.index(v) for v in by_run))
        if not by_run:
            return table[..., None]
        reduced: Array = table[(..., *(states[v] for v in by_run))]
        return reduced

    def _weights(self, variable: Discrete) -> Array:
        """The weights (states, runs or 1) that the evidence gives the states of a variable.

        A variable with soft evidence has the weights of this. A variable that is observed in some
        runs alone has, in these, the weight one for the state observed and zero for all others; in
        runs without an observation all its states have the weight one.
        """
        soft = self.evidence.weights.get(variable)
        if soft is not None:
            return soft.T
        return one_hot(np.asarray(self.evidence.states[variable]), variable.size)

    def _over(self, scope: Sequence[int], own: Sequence[int], table: Array) -> Array:
        """A view of a table with an axis for each variable of `scope`, and the last axis of runs.

        The table is over the variables `own`, some of those of `scope`; axes of variables that it
        lacks get length one.
        """
        if len(own) == len(scope):
            return table
        members = set(own)
        shape = [self._sizes[k] if k in members else 1 for k in scope]
        return table.reshape((*shape, table.shape[-1]))


def require_possible(plan: EliminationPlan, probabilities: Array) -> None:
    """Raise ImpossibleEvidence if probabilities (sizes..., runs or 1) are NaN in any run.

    They are the result of the elimination `plan`, whose evidence the error names.
    """
    lost = lost_runs(probabilities)
    if lost.any():
        raise refusal(plan, lost, plan.requisite.evidence.lead)


def lost_runs(probabilities: Array) -> Mask:
    """The runs, (runs or 1,), in which probabilities (sizes..., runs or 1) are NaN."""
    return np.asarray(np.isnan(probabilities).any(axis=tuple(range(probabilities.ndim - 1))))


def refusal(plan: EliminationPlan, lost: Mask, lead: tuple[int, ...]) -> ImpossibleEvidence:
    """The error for evidence of probability zero in the runs that the mask `lost` (runs,) marks.

    `lead` are the lengths of the user's axes of runs, () for none.
    """
    # Evidence that is given once for all runs has one run.
    first = int(lost.argmax()) if plan.requisite.evidence.lead else 0
    involved, scope = _contradiction(plan, first)
    where = in_run(lost.reshape(lead))
    return ImpossibleEvidence(
        f"the evidence has probability zero{where}: that for {names(involved)} contradicts itself, "
        f"for all states of ({listed(scope)}) are impossible given it. {ADVICE}"
        f"{OF_RUNS if lead else ''}",
        lost,
        lead,
        variable=involved[0],
    )


def _contradiction(plan: EliminationPlan, run: int) -> tuple[list[Discrete], States]:
    """The variables whose evidence contradicts itself in a run, and those whose states it excludes.

    The elimination is done again up to the first step whose product is zero throughout. The list
    has the variables whose evidence went into this product: those with hard evidence, then those
    with soft. The tuple has the variables of the product, all of whose joint states are impossible.
    """
    evidence = some_runs(plan.requisite.evidence, slice(run, run + 1))
    tables = Tables(plan, evidence, LOG_SUM_PRODUCT)
    first, cpds = len(plan.scopes), plan.requisite.cpds
    for lost, step in enumerate(plan.steps, first):  # noqa: B007, used after the loop
        tables.do(step)
        if (tables.last == -np.inf).all():
            break
    waiting, members = [lost], set[Discrete]()
    while waiting:
        factor = waiting.pop()
        if factor >= first:
            waiting += plan.steps[factor - first].factors
        elif factor < len(cpds):
            members.update((*cpds[factor].given, cpds[factor].child))
        else:
            members.add(plan.weighted[factor - len(cpds)])
    shown = [v for v, s in evidence.states.items() if np.min(s) >= 0 and v in members]
    soft = [v for v in evidence.weights if v in members]
    return shown + soft, tuple(plan.order[k] for k in step.scope)


NOTHING: Evidence = MappingProxyType({})
