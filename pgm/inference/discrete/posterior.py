"""Posteriors of discrete networks: the run that makes one, and joints of variables of clusters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.structure import Forest
from pgm.display import Summary, titled
from pgm.errors import EvidenceError, GraphError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.factors import Table
from pgm.factors.axes import AXES, States, discrete, sizes, spread
from pgm.factors.scope import Scope, as_scope, names, namesake
from pgm.inference import limits
from pgm.inference.discrete.first_question import FirstBeliefs
from pgm.inference.discrete.impossible import ALLOW, RAISE, AllowedBeliefs, allows, beliefs_of
from pgm.inference.discrete.loopy_messages import LoopyBeliefs, TableMessages
from pgm.inference.discrete.storage import Storage, axes_left, entered, put_in, sepset_between
from pgm.inference.discrete.tree_beliefs import TreeBeliefs
from pgm.inference.limits import Room
from pgm.inference.loopy import run_loopy
from pgm.inference.posterior import Posterior, require_variable
from pgm.inference.schedule import Loopy, Schedule
from pgm.inference.status import Status
from pgm.inference.summaries import of_network
from pgm.kernels.arrays import Array, frozen
from pgm.kernels.tables import exp
from pgm.resources import gibibytes
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False, repr=False)
class DiscretePosterior(Posterior):
    """The beliefs of a discrete network; leading axes are runs.

    ``posterior[v]`` and ``posterior.joint(v, w)`` are a `Table` of probabilities. Of a tree they
    are exact, of a graph with loops approximate. A variable that is observed in some runs alone
    has one for its state there.

    Of a tree, runs of equal evidence are computed once, those that differ in pieces, or one by one
    where less than 64 would fit. Half the ``memory`` given to `pgm.infer`, 128 MiB, is for a piece,
    whose tables take a fourth of it; the other half for calibrated tables that are kept. Of larger
    batches marginals and log-evidence alone are kept, and each joint, belief or message calibrates
    the runs again: ask once for a joint of several variables. An answer of more than a gibibyte is
    refused.
    """

    graph: ClusterGraph
    status: Status
    _beliefs: TreeBeliefs | AllowedBeliefs | FirstBeliefs | LoopyBeliefs

    def __getitem__(self, variable: Variable) -> Table:  # type: ignore[override]
        """The marginal of a variable that is not observed in all runs, (*runs, size)."""
        wanted = self._require_hidden(variable)
        return self._table((wanted,), self._beliefs.marginal(wanted))

    def _require_hidden(self, variable: Variable) -> Discrete:
        require_variable(variable)
        if variable not in self.graph.network._places or not isinstance(variable, Discrete):
            raise EvidenceError(
                f"{variable!r} is not in the network; its variables are "
                f"{list(self.graph.network.variables)}"
                f"{namesake(variable, self.graph.network.variables)}",
                variable=variable,
            )
        if self._is_observed(variable):
            raise EvidenceError(
                f"{variable!r} is observed: its value is its evidence", variable=variable
            )
        return variable

    def _is_observed(self, variable: Variable) -> bool:
        state = self._beliefs.evidence.states.get(discrete((variable,))[0])
        return state is not None and bool(np.min(state) >= 0)

    @property
    def _hidden(self) -> Scope:
        return tuple(v for v in self.graph.network.variables if not self._is_observed(v))

    def joint(self, *variables: Variable) -> Table:  # type: ignore[override]
        """The joint of variables that are not observed in all runs, in the order given.

        Probabilities (*runs, size of each variable...). Variables of several clusters are joined
        along the tree between them, as far as the tables on the way are not too large.
        """
        scope: States = tuple(self._require_hidden(v) for v in as_scope(variables))
        if not scope:
            raise EvidenceError("joint takes one or more variables")
        self._require_room(scope, f"the joint over {names(scope)}")
        storage = self._beliefs.storage
        if not self.graph.is_tree and holder(storage, scope) is None:
            raise GraphError(
                f"no cluster holds all of {names(scope)}, and on a graph with loops only "
                "variables of one cluster have a joint; compile a junction tree"
            )
        return self._table(scope, self._beliefs.read(lambda t: joint(storage, t, scope)))

    def _require_room(self, scope: States, what: str) -> None:
        runs = self._beliefs.evidence.runs
        if runs > 1:
            limits.require_runs(math.prod(sizes(scope)), runs, what)

    def message(self, source: int | Cluster, target: int | Cluster) -> Table:
        """The message from one cluster to a neighbour, over their sepset, unnormalised.

        Variables whose evidence is one state for all runs are put in; those whose evidence differs
        by run keep their axis. Of a tree its scale carries the evidence that went into it; on a
        graph with loops messages sum to one.
        """
        i, j = self.graph.index(source), self.graph.index(target)
        if j not in self.graph.neighbours(i):
            raise GraphError(
                f"clusters {i} and {j} are not joined; the neighbours of {i} are "
                f"{self.graph.neighbours(i)}",
                cluster=i,
            )
        shared = sepset_between(self.graph, i, j)
        scope = axes_left(self._beliefs.evidence, shared)
        self._require_room(scope, f"the message over {names(scope)}")
        values, log_scale = self._beliefs.message(i, j)
        return self._table(scope, values[put_in(self._beliefs.evidence, shared)], log_scale)

    def belief(self, cluster: int | Cluster) -> Table:
        """The belief of a cluster, unnormalised: its potential times all messages to it.

        Its axes are as of a message. Of a graph without loops its sum is p(the evidence of the
        cluster's tree): p(evidence), where the graph is one tree.
        """
        index = self.graph.index(cluster)
        storage, evidence = self._beliefs.storage, self._beliefs.evidence
        put = put_in(evidence, storage.scopes[index])
        scope = axes_left(evidence, storage.scopes[index])
        self._require_room(scope, f"the belief over {names(scope)}")
        values = self._beliefs.read(lambda tables: storage.table(tables, index)[put])
        return self._table(scope, values, self._beliefs.log_total(index))

    def potential(self, cluster: int | Cluster) -> Table:
        """The potential of a cluster: the product of its CPDs, with their evidence put in.

        Its axes are as of a message. States that are observed enter all clusters of their variable.
        """
        index = self.graph.index(cluster)
        storage, evidence = self._beliefs.storage, self._beliefs.evidence
        put = put_in(evidence, storage.scopes[index])
        scope = axes_left(evidence, storage.scopes[index])
        self._require_room(scope, f"the potential over {names(scope)}")
        logs = entered(storage, evidence, index)[put]
        top = logs.max(axis=tuple(range(logs.ndim - 1)))
        top = np.where(top == -np.inf, 0.0, top)
        return self._table(scope, exp(logs - top), top)

    def _table(self, scope: States, values: Array, log_scale: Array | None = None) -> Table:
        """Values (sizes..., [runs]) as a table whose leading axes are those of the runs."""
        lead = self._beliefs.evidence.lead
        if values.ndim > len(scope):
            values = np.moveaxis(values, -1, 0)
        if lead or values.ndim > len(scope):
            values = values.reshape((*lead, *sizes(scope)))
        if log_scale is None:
            return Table._plain(scope, frozen(values) if values.flags.writeable else values)
        return Table._make(scope, values, log_scale.reshape(lead))

    @cached_property
    def log_evidence(self) -> Array:
        """The value ln p(evidence), (...); see `log_evidence_kind`."""
        return frozen(self._beliefs.log_evidence().reshape(self._beliefs.evidence.lead))

    @property
    def log_evidence_kind(self) -> str:
        """Exact of a tree whose messages have settled, else bethe."""
        return "exact" if self.graph.is_tree and self.status.converged.all() else "bethe"

    @property
    def _title(self) -> str:
        lead = self._beliefs.evidence.lead
        return f"DiscretePosterior({self.graph._title}{f', runs {lead}' if lead else ''})"

    def _summary(self) -> Summary:
        return of_network(self._title, self, self._hidden, self._beliefs.evidence.lead)


# A factor: its axes, then that of the runs, if any.
Factor = tuple[States, Array]


def holder(storage: Storage, wanted: States) -> int | None:
    """The smallest cluster that holds some variables, if one does."""
    members: set[Discrete] = set(wanted)
    fits = [k for k, scope in enumerate(storage.scopes) if members.issubset(scope)]
    return min(fits, key=storage.graph.sizes.__getitem__, default=None)


def joint(storage: Storage, tables: Array, scope: States) -> Array:
    """The probabilities of some variables, (sizes..., [runs]), from one cluster or from a tree.

    Each cluster's belief given its sepset is multiplied into its parent's, along the smallest
    subtree that holds the variables, and what is not asked for is summed out as soon as may be.
    """
    one = holder(storage, scope)
    if one is not None:
        return _sum((storage.scopes[one], storage.table(tables, one)), scope)
    forest = storage.graph.derived(Forest.of)
    homes = {v: storage.homes[v] for v in scope}
    tree = forest.roots
    result: Factor = ((), np.ones(tables.shape[1:]))
    for root in dict.fromkeys(tree[list(homes.values())].tolist()):
        mine = tuple(v for v in scope if tree[homes[v]] == root)
        result = _product(result, _of_tree(storage, forest, tables, mine, {homes[v] for v in mine}))
    return _sum(result, scope)


def _of_tree(
    storage: Storage, forest: Forest, tables: Array, scope: States, homes: set[int]
) -> Factor:
    parent = forest.parent
    below: dict[int, int] = {}
    for home in homes:
        k = home
        while k >= 0:
            below[k] = below.get(k, 0) + 1
            k = int(parent[k])
    common = [k for k, count in below.items() if count == len(homes)]
    top = max(common, key=lambda k: forest.depth[k])
    inside = sorted(below.keys() - (set(common) - {top}), key=lambda k: -forest.depth[k])
    found: dict[int, Factor] = {}
    for k in inside:
        own = storage.scopes[k]
        factor: Factor = own, storage.table(tables, k)
        shared: States = ()
        if k != top:
            shared = sepset_between(storage.graph, k, int(parent[k]))
            factor = own, _given(factor, shared)
        below_it = [found.pop(child) for child in forest.children[k] if child in found]
        found[k] = _combined([factor, *below_it], {*scope, *shared})
    return found[top]


def _combined(factors: Sequence[Factor], keep: set[Discrete]) -> Factor:
    """The product of some factors, each variable summed out as soon as no other factor has it."""
    result, *others = factors
    while True:
        later = keep.union(*(scope for scope, _ in others))
        left = tuple(v for v in result[0] if v in later)
        result = left, _sum(result, left)
        if not others:
            return result
        result = _product(result, others.pop(0))


def _given(factor: Factor, sepset: States) -> Array:
    """Probabilities given the sepset; zero where that has probability zero."""
    scope, values = factor
    axes = tuple(k for k, v in enumerate(scope) if v not in sepset)
    total = values.sum(axis=axes, keepdims=True)
    conditional: Array = values / np.where(total == 0.0, 1.0, total)
    return conditional


def _product(a: Factor, b: Factor) -> Factor:
    scope = a[0] + tuple(v for v in b[0] if v not in a[0])
    runs = a[1].shape[len(a[0]) :]
    entries = math.prod(sizes(scope)) * math.prod(runs)
    if entries > limits.LIMIT or len(scope) > AXES:
        raise GraphError(
            f"the joint needs a table over {names(scope)}, {len(scope)} variables and "
            f"{gibibytes(entries)}, where {AXES} variables and "
            f"{gibibytes(limits.LIMIT)} are the limit; ask for fewer variables at once, "
            "with fewer runs, or pgm.query, which may need less"
        )
    return scope, _arranged(a, scope) * _arranged(b, scope)


def _arranged(factor: Factor, scope: States) -> Array:
    """Values with an axis for each variable of a scope, of length one if new."""
    own, values = factor
    # Turned round, so that runs lead as in tables.
    return spread(values.T, own[::-1], scope[::-1]).T


def _sum(factor: Factor, keep: States) -> Array:
    scope, values = factor
    total = values.sum(axis=tuple(k for k, v in enumerate(scope) if v not in keep))
    return _arranged((tuple(v for v in scope if v in keep), total), keep)


def run(
    graph: ClusterGraph,
    evidence: Evidence,
    schedule: Schedule | None,
    memory: float | None = None,
    impossible: str = RAISE,
) -> DiscretePosterior:
    """Send the messages of a schedule; see `pgm.infer`."""
    bound = bind_discrete(graph.network._places.keys(), evidence)
    allow = allows(impossible)
    if isinstance(schedule, Loopy):
        if allow:
            raise GraphError(
                f'impossible="{ALLOW}" is for graphs without loops: on {titled(graph)} messages '
                "that go round need not find out that evidence is impossible"
            )
        if memory is not None:
            raise GraphError(
                f"memory= is for graphs without loops: on {titled(graph)} all runs go round "
                "together; to hold less at a time, give fewer runs to a call"
            )
        messages = TableMessages(graph, bound, schedule.damping)
        status = run_loopy(messages, schedule, bound.lead)
        return DiscretePosterior(graph, status, LoopyBeliefs.of(messages))
    room = Room.of(memory, graph)
    first = None if bound.lead else FirstBeliefs.of(graph, bound, room)
    return (
        of_tree(graph, bound, room, allow=allow)
        if first is None
        else DiscretePosterior(graph, ONCE, first)
    )


def of_tree(
    graph: ClusterGraph, bound: BoundStates, room: Room, *, allow: bool = False
) -> DiscretePosterior:
    """The posterior of a graph without loops, of evidence that is bound."""
    beliefs = beliefs_of(graph, bound, room, allow=allow)
    return DiscretePosterior(graph, _calibrated(bound.lead) if bound.lead else ONCE, beliefs)


def _calibrated(lead: tuple[int, ...]) -> Status:
    return Status(1, np.zeros((0, *lead)), np.ones(lead, dtype=bool))


ONCE = _calibrated(())
