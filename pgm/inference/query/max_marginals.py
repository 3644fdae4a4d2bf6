r"""Max-marginals: how probable the best assignment is in which a variable has each of its states.

Messages with maxima in place of sums go to the roots of a tree of tables and back. Afterwards each
cluster's table has, as logarithms, the largest product of all factors over the other variables, but
for the maximum of its tree; the maxima of all trees add to that of the network.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from pgm.arguments import public
from pgm.beliefs.discrete.impossible import require_possible
from pgm.beliefs.discrete.run_pieces import Distinct, tree_pieces
from pgm.beliefs.discrete.tree_passes import collect, distribute, enter, log_tops
from pgm.beliefs.discrete.tree_plan import TreePlan, plan_for
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import Listing, Shown, Summary, column, few, titled
from pgm.errors import GraphError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.factors import Table
from pgm.factors.axes import discrete
from pgm.immutable import Immutable
from pgm.inference.query.asked import found_of, require_mapping, require_whole_tables
from pgm.inference.query.log_tables import table_of
from pgm.kernels.arrays import Array, frozen
from pgm.kernels.semirings import MAX_PRODUCT
from pgm.posteriors.summaries import spread
from pgm.progress import Progress, reporting
from pgm.schedules.limits import Room, require_runs
from pgm.variables import Discrete, Variable

# How many variables a repr lists, and how many states of each.
LISTED, STATES = 10, 6


@dataclass(frozen=True, eq=False, repr=False)
class MaxMarginals(Shown, Immutable):
    r"""The max-marginals of discrete variables, given evidence.

    .. math:: m(x) = \max_{\text{others}} p(x, \text{others}, \text{evidence})

    ``found[x]`` is the `Table` of m, its largest value one and ln m of that state its log-scale;
    ``found.log_values(x)`` are ln m(x), however far apart they are. Variables with evidence have
    max-marginals too, zero but for their states.

    Attributes
    ----------
    log_maximum : ndarray
        (*runs): the largest ln p(assignment, evidence) of all assignments. That is the largest
        ln m(x) of each variable, up to rounding.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> found = pgm.max_marginals(pgm.compile(rainy), {wet: "yes"})
    >>> np.exp(found.log_values(rain))
    array([0.125, 0.375])
    >>> found[rain]
    Table(rain: no 0.125, yes 0.375)
    """

    # Python would else iterate by asking for the variables 0, 1, ....
    __iter__: ClassVar[None] = None

    log_maximum: Array
    _logs: Mapping[Discrete, Array]

    @property
    def variables(self) -> tuple[Discrete, ...]:
        """The variables, in the network's order."""
        return tuple(self._logs)

    def log_values(self, variable: Variable) -> Array:
        """The logarithms ln m(x) of a variable's max-marginal.

        Parameters
        ----------
        variable : Discrete

        Returns
        -------
        ndarray
            (*runs, size); −∞ where no assignment with this state is possible.

        Raises
        ------
        EvidenceError
            If the network does not have the variable.
        """
        lacking = "has no max-marginal; the network's variables are"
        return found_of(self._logs, variable, lacking)

    def __getitem__(self, variable: Variable) -> Table:
        """The max-marginal of a variable; its leading axes are runs.

        Raises an EvidenceError if the network does not have the variable, a NumericalError if a
        value that is not zero would be one beside the largest.
        """
        logs = self.log_values(variable)
        scope = discrete((variable,))
        return table_of(
            scope,
            logs,
            f"the max-marginal of {variable!r}",
            f"take their logarithms, log_values({variable!r})",
        )

    @property
    def _title(self) -> str:
        count, lead = len(self._logs), self.log_maximum.shape
        level = f"runs {lead}" if lead else f"ln of the maximum {self.log_maximum:.6g}"
        return f"MaxMarginals({count} variable{'s' * (count != 1)}; {level})"

    def _summary(self) -> Summary:
        lead = self.log_maximum.shape
        rows = []
        for variable in list(self._logs)[:LISTED]:
            logs = self._logs[variable][(0,) * len(lead)]
            shown = few(variable.size, STATES)
            texts = iter(column(np.array([logs[k] for k in shown if k is not None]), 3))
            cells = ["..." if k is None else f"{variable.states[k]} {next(texts)}" for k in shown]
            rows.append((repr(variable), ", ".join(cells)))
        parts: list[str | Listing] = [Listing(("", "ln m" + ", run 0" * bool(lead)), rows, 2, 80)]
        if lead:
            parts.append(f"ln of the maximum {spread(self.log_maximum)}")
        left = len(self._logs) - len(rows)
        return Summary(self._title, parts + [f"... {left} more"] * (left > 0))


@public
def max_marginals(
    graph: ClusterGraph,
    evidence: Evidence,
    *,
    memory: float | None = None,
    progress: Progress = False,
) -> MaxMarginals:
    r"""Find, for each state of each variable, the probability of the best assignment that has it.

    .. math:: m(x) = \max_{\text{others}} p(x, \text{others}, \text{evidence})

    Of a network of factors p is their product. The states of the largest m(x) are those of the most
    probable assignment, if only one assignment is most probable; how far the others are below tells
    how much would be lost by another state. They are exact.

    Parameters
    ----------
    graph : ClusterGraph
        The graph of a discrete network, without loops and without time.
    evidence : mapping of Discrete
        As for `infer`: states, arrays of states with −1 for "not observed in this run", or `soft`
        weights, which count as factors of the probability. Leading axes are runs.
    memory : number, optional
        How many bytes the tables of all runs may take, besides the compiled graph, the evidence and
        the result; 2²⁸ (256 MiB), if not given.
    progress : bool or callable
        Whether a bar shows how far the work is, as for `infer`.

    Returns
    -------
    MaxMarginals
        ``found[x]``, the `Table` of each variable, and ``found.log_values(x)``, (*runs, size).

    Raises
    ------
    GraphError
        If the network is not discrete or has time, the graph has loops or too large a cluster,
        there are too many runs, or `memory` is too small.
    EvidenceError
        If the evidence does not fit the network, or has probability zero.

    References
    ----------
    Koller & Friedman, Probabilistic Graphical Models, 2009, section 13.3.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> found = pgm.max_marginals(pgm.compile(rainy), {})
    >>> np.exp(found.log_values(wet))
    array([0.375, 0.375])
    """
    _require_tables(graph)
    require_mapping(evidence)
    room = Room.of(memory, graph)
    bound = bind_discrete(frozenset(graph.network.variables), evidence)
    distinct = Distinct.of(bound)
    plan = plan_for(graph, distinct.evidence.runs, room.batch)
    require_runs(plan.marginals.count, bound.runs, "the max-marginals of all variables")
    with reporting(progress):
        pieces = tree_pieces(plan.storage.entries, distinct.evidence, room.batch)
        found = [_calibrated(plan, piece) for piece in pieces]
    tops = np.concatenate([tops for _, tops in found], axis=1)
    if distinct.which is not None:
        tops = tops[:, distinct.which]
    require_possible(plan, bound, tops)
    logs = np.concatenate([own for own, _ in found], axis=1)
    if distinct.which is not None:
        logs = logs[:, distinct.which]
    log_maximum = tops.sum(axis=0)
    logs += log_maximum
    where = plan.marginals.where
    by_variable = {
        v: frozen(np.ascontiguousarray(logs[where[v]].T).reshape(*bound.lead, v.size))
        for v in discrete(graph.network.variables)
    }
    return MaxMarginals(frozen(log_maximum.reshape(bound.lead)), MappingProxyType(by_variable))


def _calibrated(plan: TreePlan, evidence: BoundStates) -> tuple[Array, Array]:
    """The max-marginals of all variables, (states of all, runs), as logarithms, and the tops.

    The largest of each variable is zero, for the maxima of the trees are in the tops, (tops, runs).
    Where the evidence of some run is impossible, no messages are sent back.
    """
    entry = enter(plan, evidence, MAX_PRODUCT)
    done = collect(plan, entry, MAX_PRODUCT)
    tops = log_tops(plan, evidence, done, MAX_PRODUCT).reshape(-1, evidence.runs)
    if not (tops == -np.inf).any():
        distribute(plan, entry, done, MAX_PRODUCT)
    logs = plan.marginals.sum(entry.tables, MAX_PRODUCT)
    return logs.reshape(-1, evidence.runs), tops


def _require_tables(graph: ClusterGraph) -> None:
    """Refuse, by a GraphError, what is no graph without loops of a network of tables."""
    if not isinstance(graph, ClusterGraph):
        raise GraphError(
            f"max_marginals takes a cluster graph (pgm.compile(network)), not {titled(graph)}"
        )
    if isinstance(graph, DynamicGraph):
        raise GraphError(
            f"max_marginals is for networks without time, and {titled(graph)} has time; of tables, "
            "take pgm.compile(model.unroll(steps)), or the likeliest path, pgm.most_probable"
        )
    if not graph.network.discrete:
        raise GraphError(
            f"max_marginals is for discrete networks, and this one is {graph.network._kind}; the "
            "max-marginals of Gaussian variables are in proportion to their marginals, "
            "pgm.infer(graph, evidence)[x]"
        )
    if not graph.is_tree:
        raise GraphError(
            f"{titled(graph)} has loops, and max_marginals is for trees; compile a junction tree, "
            "pgm.compile(network)"
        )
    require_whole_tables(
        graph,
        "there are no max-marginals",
        "what they amount to would be maximised over, not summed; pgm.most_probable sums",
    )
