"""Results of inference in a discrete network: tables given the evidence.

These are marginals and joints of variables; messages, beliefs and potentials of clusters; and
ln p(evidence). They are read from beliefs that exact inference on a tree, or a schedule of messages
on any graph, has computed. In shapes, *runs are the user's axes of runs, and runs is one axis to
which these are flattened.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pgm.beliefs.discrete.allowed import AllowedBeliefs
from pgm.beliefs.discrete.draws import draws
from pgm.beliefs.discrete.entered_evidence import axes_left, entered, put_in
from pgm.beliefs.discrete.first_beliefs import FirstBeliefs
from pgm.beliefs.discrete.joints import holder, joint
from pgm.beliefs.discrete.loopy_messages import LoopyBeliefs
from pgm.beliefs.discrete.storage import sepset_between
from pgm.beliefs.discrete.tree_beliefs import TreeBeliefs
from pgm.clustergraph import Cluster, ClusterGraph
from pgm.display import Summary
from pgm.errors import EvidenceError, GraphError
from pgm.factors import Table
from pgm.factors.axes import States, sizes
from pgm.factors.scope import Scope, as_scope, listed, namesake
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.semirings import exp
from pgm.posteriors.outcome import TABLES, Outcome
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import of_network
from pgm.schedules import limits
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False, repr=False)
class DiscreteOutcome(Outcome[Table]):
    """The beliefs of a discrete network; leading axes are runs.

    ``posterior[v]`` and ``posterior.joint(v, w)`` are a `Table` of probabilities. On a tree the
    probabilities are exact, on a graph with loops approximate. In a run that observes a variable
    which other runs do not, the marginal gives the observed state probability one.

    On a tree, runs of equal evidence are computed once. Runs that differ are computed in pieces
    that fit into memory, or one by one if a piece would have fewer than 64 runs. Half the
    ``memory`` given to `pgm.infer`, by default 128 MiB, is for computing a piece: a fourth of this
    half for its tables, the rest for intermediate results. The other half is for calibrated tables
    that the posterior keeps. Of a batch whose tables take more, marginals and log-evidence alone
    are kept, and each call of `joint`, `belief` or `message` computes the runs again: ask once for
    a joint of several variables. An answer of more than a gibibyte is refused with a `GraphError`.

    `status` tells the iterations and residuals of the schedule, and whether each run converged.
    """

    beliefs: ClassVar[str] = "tables"
    form: ClassVar[str] = TABLES

    kind: ClassVar[None] = None
    graph: ClusterGraph
    status: Status
    _beliefs: TreeBeliefs | AllowedBeliefs | FirstBeliefs | LoopyBeliefs

    def __getitem__(self, variable: Variable) -> Table:
        """The marginal probabilities, (*runs, size), of a variable hidden in at least one run."""
        wanted = self._require_hidden(variable)
        return self._table((wanted,), self._beliefs.marginal(wanted))

    def entered(self, run: int) -> dict[Variable, str | None]:
        """The states that were observed, by variable; None of one that was not in this run."""
        found = dict[Variable, str | None]()
        for variable, states in self._beliefs.evidence.states.items():
            each = np.reshape(states, -1)
            state = int(each[run if each.size > 1 else 0])
            found[variable] = variable.states[state] if state >= 0 else None
        return found

    def _require_hidden(self, variable: Variable) -> Discrete:
        """Return the variable if the network has it and at least one run leaves it hidden.

        Otherwise raise `EvidenceError`.
        """
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
        """Whether a variable is observed in every run."""
        states: Mapping[Any, Any] = self._beliefs.evidence.states
        state = states.get(variable)
        return state is not None and bool(np.min(state) >= 0)

    @property
    def _hidden(self) -> Scope:
        """The variables that are hidden in at least one run, and so have marginals."""
        return tuple(v for v in self.graph.network.variables if not self._is_observed(v))

    def joint(self, *variables: Variable) -> Table:
        """The joint of variables, each hidden in at least one run.

        The probabilities are (*runs, size of each variable...), in the order given. On a tree the
        variables need not share a cluster: the clusters between them are then multiplied, and a
        table too large on the way raises `GraphError`. On a graph with loops one cluster has to
        hold all the variables.
        """
        scope: States = tuple(self._require_hidden(v) for v in as_scope(variables))
        if not scope:
            raise EvidenceError("joint takes one or more variables")
        self._require_room(scope, f"the joint over ({listed(scope)})")
        storage = self._beliefs.storage
        if not self.graph.is_tree and holder(storage, scope) is None:
            raise GraphError(
                f"no cluster holds all of ({listed(scope)}), and on a graph with loops only "
                "variables of one cluster have a joint; compile a junction tree"
            )
        return self._table(scope, self._beliefs.read(lambda t: joint(storage, t, scope)))

    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Integers]:
        """So many draws of each hidden variable for each run, (count, *runs) of state indices."""
        drawn = draws(self.graph, self._beliefs, count, rng)
        lead = self._beliefs.evidence.lead
        return {v: drawn[v].reshape(count, *lead) for v in self._hidden}

    def _require_room(self, scope: States, what: str) -> None:
        """Raise `GraphError` if tables over a scope, one for each run, take more than a gibibyte.

        `what` names the tables in the error's text. A single run is not checked.
        """
        runs = self._beliefs.evidence.runs
        if runs > 1:
            limits.require_runs(math.prod(sizes(scope)), runs, what)

    def message(self, source: int | Cluster, target: int | Cluster) -> Table:
        """The message from one cluster to a neighbour, over their sepset.

        The table has an axis for each variable of the sepset, except for variables observed in one
        state given for all runs; a variable observed by an array of states, one for each run, has
        an axis. After exact inference on a tree the message is the sender's potential times the
        messages to the sender from its other neighbours, summed over the variables outside the
        sepset, without any normalisation. The returned table has values and a log-scale: the
        message is the values times exp(log-scale). After `Flooding`, `Sequential` or `Residual` the
        message is divided by its sum.
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
        self._require_room(scope, f"the message over ({listed(scope)})")
        values, log_scale = self._beliefs.message(i, j)
        return self._table(scope, values[put_in(self._beliefs.evidence, shared)], log_scale)

    def belief(self, cluster: int | Cluster) -> Table:
        """The belief of a cluster, unnormalised: its potential times all messages to it.

        The table has an axis for each variable of the cluster, except for variables observed in one
        state given for all runs. After exact inference its sum is the probability of all evidence
        in the cluster's tree: p(evidence), where the graph is one tree.
        """
        index = self.graph.index(cluster)
        storage, evidence = self._beliefs.storage, self._beliefs.evidence
        put = put_in(evidence, storage.scopes[index])
        scope = axes_left(evidence, storage.scopes[index])
        self._require_room(scope, f"the belief over ({listed(scope)})")
        values = self._beliefs.read(lambda tables: storage.table(tables, index)[put])
        return self._table(scope, values, self._beliefs.log_total(index))

    def potential(self, cluster: int | Cluster) -> Table:
        """The potential of a cluster: the product of its CPDs and of the evidence that enters it.

        The table has an axis for each variable of the cluster, except for variables observed in one
        state given for all runs. An observed state enters every cluster that holds its variable;
        soft evidence enters the smallest of these clusters alone.
        """
        index = self.graph.index(cluster)
        storage, evidence = self._beliefs.storage, self._beliefs.evidence
        put = put_in(evidence, storage.scopes[index])
        scope = axes_left(evidence, storage.scopes[index])
        self._require_room(scope, f"the potential over ({listed(scope)})")
        logs = entered(storage, evidence, index)[put]
        top = logs.max(axis=tuple(range(logs.ndim - 1)))
        top = np.where(top == -np.inf, 0.0, top)
        return self._table(scope, exp(logs - top), top)

    def _table(self, scope: States, values: Array, log_scale: Array | None = None) -> Table:
        """The `Table` over a scope with given values, its leading axes the user's axes of runs.

        values: (size of each variable..., runs); the axis of runs may be absent for a single run.
        log_scale: (runs,), or () for a single run: the table is the values times exp(log-scale);
            None if it is the values as they are.
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
        """The value ln p(evidence), (*runs), exact or approximate: see `log_evidence_kind`."""
        return frozen(self._beliefs.log_evidence().reshape(self._beliefs.evidence.lead))

    @property
    def log_evidence_kind(self) -> str:
        """``"exact"`` on a tree if messages converged in all runs, else ``"bethe"``.

        ``"bethe"`` stands for the Bethe approximation of ln p(evidence).
        """
        return "exact" if self.graph.is_tree and self.status.converged.all() else "bethe"

    @property
    def _title(self) -> str:
        lead = self._beliefs.evidence.lead
        return f"Posterior({self.graph._title}{f', runs {lead}' if lead else ''})"

    def _summary(self) -> Summary:
        return of_network(self._title, self, self._hidden, self._beliefs.evidence.lead)
