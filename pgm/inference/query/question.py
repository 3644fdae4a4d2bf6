"""Queries: the joint of some variables of a discrete network given evidence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from types import MappingProxyType
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple, is_unordered
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.cpds import TableCPD
from pgm.display import titled
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.factors import Table
from pgm.factors.axes import States, as_states, sizes
from pgm.factors.scope import in_run, listed, names, unknown_name
from pgm.inference import limits
from pgm.inference.discrete.impossible import RAISE, allows
from pgm.inference.discrete.posterior import of_tree
from pgm.inference.discrete.storage import one_hot, pieces, some_runs
from pgm.inference.discrete.tree_passes import ADVICE, OF_RUNS, ImpossibleEvidence
from pgm.inference.query.plan import EliminationPlan, Requisite, Step, certain
from pgm.kernels.arrays import Array
from pgm.kernels.tables import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.variables import Discrete, Variable


def eliminate(plan: EliminationPlan, evidence: BoundStates) -> Array:
    """The probabilities of what is asked, (sizes..., runs or 1); NaN where evidence is impossible.

    With logarithms, where a number would be lost to underflow.
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
    tables = Tables(plan, evidence, semiring)
    for step in plan.steps:
        tables.do(step)
    return tables.last


class Tables:
    """The tables of an elimination under way, (sizes..., runs or 1)."""

    last: Array

    def __init__(self, plan: EliminationPlan, evidence: BoundStates, semiring: Semiring) -> None:
        self.plan = plan
        self.evidence = evidence
        self.semiring = semiring
        self._sizes = [v.size for v in plan.order]
        self._made: dict[int, Array] = {}
        self._count = len(plan.scopes)

    def do(self, step: Step) -> None:
        """Make one product, and sum over its first axes."""
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
        """A table and its variables; what a step made is used once, and not kept."""
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
        soft = self.evidence.weights.get(variable)
        if soft is not None:
            return soft.T
        return one_hot(np.asarray(self.evidence.states[variable]), variable.size)

    def _over(self, scope: Sequence[int], own: Sequence[int], table: Array) -> Array:
        """A view with an axis for each variable of a scope, of length one where it is new."""
        if len(own) == len(scope):
            return table
        members = set(own)
        shape = [self._sizes[k] if k in members else 1 for k in scope]
        return table.reshape((*shape, table.shape[-1]))


def require_possible(plan: EliminationPlan, probabilities: Array) -> None:
    """Refuse evidence of probability zero, where probabilities (sizes..., runs or 1) are NaN."""
    lost = np.isnan(probabilities).any(axis=tuple(range(probabilities.ndim - 1)))
    if not lost.any():
        return
    first = int(lost.argmax())
    involved, scope = _contradiction(plan, first)
    where = in_run(lost.reshape(plan.requisite.evidence.lead))
    lead = plan.requisite.evidence.lead
    raise ImpossibleEvidence(
        f"the evidence has probability zero{where}: that for {names(involved)} contradicts itself, "
        f"for all states of ({listed(scope)}) are impossible given it. {ADVICE}"
        f"{OF_RUNS if lead else ''}",
        lost,
        lead,
        variable=involved[0],
    )


def _contradiction(plan: EliminationPlan, run: int) -> tuple[list[Discrete], States]:
    """The evidence that the first product of zeros is made of, and that product's variables."""
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
# What a pass up and down a tree takes, for each entry of its tables and at the least; and what
# planning and summing out a variable takes at the least: as entries of an elimination's tables.
# Measured, to a factor of two.
ENTRY, PASS, VARIABLE = 3, 10_000, 2_000


@public
def query(
    network: BayesianNetwork | ClusterGraph,
    variables: Variable | Iterable[Variable],
    evidence: Evidence = NOTHING,
    *,
    impossible: str = RAISE,
) -> Table:
    r"""Find the joint probabilities of some variables of a discrete network given evidence.

    .. math:: p(\text{variables} \mid \text{evidence})
              \propto \sum_{\text{others}} \prod_{\text{CPDs}} p(\text{child} \mid \text{parents})

    The answer is exact, and that of ``infer(compile(network), evidence).joint(*variables)``, but
    for columns that were rounded. It is computed from what bears on the variables alone: CPDs of
    which nothing that is asked for or observed depends are left out, and what the evidence
    separates from the variables. So a network whose junction tree is too large may still be asked.
    One question costs less than all marginals; for many at the same evidence, `infer` once.

    Parameters
    ----------
    network : BayesianNetwork or ClusterGraph
        Discrete. Of a compiled tree the posterior answers where that takes less: keep the graph
        where a small network is asked often. A graph with loops stands for its network.
    variables : Discrete or iterable of Discrete
        Not observed in all runs. The axes of the result are in this order.
    evidence : mapping of Discrete, optional
        As for `infer`; leading axes are runs. Evidence that is separated from the variables by
        other evidence is checked for its form alone, not for being possible.
    impossible : str
        What is done where evidence has probability zero: ``"raise"``, or ``"allow"``, where such
        runs have probabilities of NaN, and the others theirs.

    Returns
    -------
    Table
        Probabilities (..., size of each variable...), with the log-scale zero.

    Raises
    ------
    EvidenceError
        If the evidence does not fit the network or has probability zero, or one of the variables
        is observed or unknown.
    GraphError
        If the network is dynamic or continuous, a table on the way is too large, or the answer
        over all runs.
    ModelError
        If it is no network, or one of the variables is asked for twice.

    References
    ----------
    Zhang and Poole (1996), Exploiting causal independence in Bayesian network inference, section 3.
    Koller and Friedman (2009), Probabilistic Graphical Models, chapter 9.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> query(rainy, rain, {wet: "yes"})
    Table(rain: no 0.25, yes 0.75)
    """
    asked, graph = _discrete(network)
    if not isinstance(evidence, Mapping):
        raise EvidenceError(
            f"evidence maps variables to states; found {type(evidence).__name__}; of a table "
            "pgm.records(table, network) makes it"
        )
    known = frozenset(asked.variables)
    bound = bind_discrete(known, evidence)
    scope = _wanted(variables, known, bound)
    if bound.runs > 1:
        entries = math.prod(sizes(scope))
        limits.require_runs(entries, bound.runs, f"the joint over {names(scope)}")
    requisite = Requisite.of(asked, scope, bound)
    values = _answer(graph, requisite, scope, allow=allows(impossible))
    lead, shape = requisite.evidence.lead, sizes(scope)
    values = np.moveaxis(values, -1, 0).reshape(lead + shape)
    return Table._make(scope, np.broadcast_to(values, bound.lead + shape))


def _discrete(network: Any) -> tuple[BayesianNetwork, ClusterGraph | None]:
    if isinstance(network, DynamicBayesianNetwork | DynamicGraph):
        raise GraphError(
            "query is for discrete networks, and this one is dynamic; its beliefs are "
            "pgm.smooth(model, evidence)[x], or pgm.infer(graph, evidence).joint(...)"
        )
    graph = network if isinstance(network, ClusterGraph) else None
    asked = graph.network if graph is not None else network
    if not isinstance(asked, BayesianNetwork):
        raise ModelError(
            f"query takes a BayesianNetwork or its compiled graph, not {titled(network)}"
        )
    if not asked.discrete:
        raise GraphError(
            "query is for discrete networks, and this one is continuous; its joints are "
            "pgm.infer(pgm.compile(network), evidence).joint(...)"
        )
    return asked, graph


def _wanted(variables: Any, known: frozenset[Variable], evidence: BoundStates) -> States:
    several = None if is_unordered(variables) else as_tuple(variables)
    found = (variables,) if several is None else several
    for variable in found:
        if not isinstance(variable, Variable) or variable not in known:
            raise EvidenceError(
                f"query of {variable!r}, {unknown_name(variable, known)}",
                variable=variable if isinstance(variable, Variable) else None,
            )
    scope = as_states(found)
    if not scope:
        raise EvidenceError("query takes one or more variables")
    observed = certain(evidence)
    for variable in scope:
        if variable in observed:
            raise EvidenceError(
                f"{variable!r} is observed: its value is its evidence", variable=variable
            )
    return scope


def _answer(
    graph: ClusterGraph | None, requisite: Requisite, scope: States, *, allow: bool
) -> Array:
    """The probabilities of variables, (sizes..., runs or 1), by whichever way takes less."""
    if not requisite.hidden:
        return np.ones((*sizes(scope), 1))
    runs, least = requisite.evidence.runs, VARIABLE * len(requisite.hidden)
    tree = math.inf
    if graph is not None and graph.is_tree and sum(graph.sizes) <= limits.LIMIT:
        tree = PASS + ENTRY * graph.cost * runs
    plan = EliminationPlan.of(requisite, scope) if tree > least else None
    if graph is not None and (plan is None or tree <= least + plan.cost * runs):
        # Variables that are far apart in the tree may need larger tables there.
        with suppress(GraphError):
            return _read(graph, requisite.evidence, scope, allow=allow)
    return _eliminated(plan or EliminationPlan.of(requisite, scope), scope, allow=allow)


def _eliminated(plan: EliminationPlan, scope: States, *, allow: bool) -> Array:
    plan.require_size()
    some = pieces(plan.requisite.evidence, limits.BATCH // plan.peak)
    parts = [eliminate(plan, piece) for piece in some]
    values = np.concatenate(parts, axis=-1)
    if not allow:
        require_possible(plan, values)
    asked = plan.order[len(plan.order) - values.ndim + 1 :]
    axes = [asked.index(v) for v in scope if v in asked]
    return values.transpose(*axes, -1).reshape((*sizes(scope), -1))


def _read(graph: ClusterGraph, evidence: BoundStates, scope: States, *, allow: bool) -> Array:
    values = of_tree(graph, evidence, limits.Room.of(None, graph), allow=allow).joint(*scope).values
    return np.moveaxis(values.reshape(-1, *sizes(scope)), 0, -1)
