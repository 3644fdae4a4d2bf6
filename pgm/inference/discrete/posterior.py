"""Posteriors of discrete networks."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.display import Summary
from pgm.errors import EvidenceError, GraphError
from pgm.factors import Table
from pgm.factors.axes import States, discrete, sizes
from pgm.factors.scope import Scope, as_scope, names, namesake
from pgm.inference import limits
from pgm.inference.discrete.allowed import AllowedBeliefs
from pgm.inference.discrete.entered_evidence import axes_left, entered, put_in
from pgm.inference.discrete.first_beliefs import FirstBeliefs
from pgm.inference.discrete.joints import holder, joint
from pgm.inference.discrete.loopy_messages import LoopyBeliefs
from pgm.inference.discrete.storage import sepset_between
from pgm.inference.discrete.tree_beliefs import TreeBeliefs
from pgm.inference.posterior import Posterior, require_variable
from pgm.inference.status import Status
from pgm.inference.summaries import of_network
from pgm.kernels.arrays import Array, frozen
from pgm.kernels.semirings import exp
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False, repr=False)
class DiscretePosterior(Posterior):
    """The beliefs of a discrete network; leading axes are runs.

    ``posterior[v]`` and ``posterior.joint(v, w)`` are a `Table` of probabilities. Of a tree they
    are exact, of a graph with loops approximate. A variable that is observed in only some runs has
    in these probability one for its state.

    On a tree, runs of equal evidence are computed once, those that differ in pieces, or one by one
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
        """The variable itself; `EvidenceError` if it is unknown, or observed in all runs."""
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
        """Whether a variable is observed in all runs."""
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
        """Raise `GraphError` if a table over a scope is too large for all runs; `what` names it."""
        runs = self._beliefs.evidence.runs
        if runs > 1:
            limits.require_runs(math.prod(sizes(scope)), runs, what)

    def message(self, source: int | Cluster, target: int | Cluster) -> Table:
        """The message from one cluster to a neighbour, over their sepset, unnormalised.

        A variable whose evidence is one state for all runs has no axis; one whose evidence is an
        array of states, one for each run, keeps it. Of a tree the message's scale carries the
        evidence that went into it; on a graph with loops messages sum to one.
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
        """The potential of a cluster: the product of its CPDs, with the evidence put in.

        Its axes are as of a message. A state that is observed enters all clusters that hold its
        variable; soft evidence enters the smallest of them.
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
        """A table of values (sizes..., [runs]), with the user's axes of runs first.

        A single run may lack its axis. `log_scale`, ([runs]), is that of an unnormalised table;
        None where it is zero.
        """
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
        """``"exact"`` of a tree whose messages have settled, else ``"bethe"``."""
        return "exact" if self.graph.is_tree and self.status.converged.all() else "bethe"

    @property
    def _title(self) -> str:
        lead = self._beliefs.evidence.lead
        return f"DiscretePosterior({self.graph._title}{f', runs {lead}' if lead else ''})"

    def _summary(self) -> Summary:
        return of_network(self._title, self, self._hidden, self._beliefs.evidence.lead)
