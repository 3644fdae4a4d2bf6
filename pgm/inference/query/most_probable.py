"""The most probable assignment of a discrete network, or path of a chain's discrete variables.

Messages with maxima in place of sums go to the root of each tree, and the states of the maxima are
traced back from there. A *plan* is the layout of a graph's tables and messages. A cluster's table
is a matrix, with a *column* for each joint state of the variables that the cluster shares with its
parent (a root has one column), and a *row* for each joint state of its other variables. A *stack*
is some clusters of like shape and depth, whose matrices stand side by side in one. Tables and
messages have logarithms as entries. *Tops*, (tops, runs), sum to ln p(assignment, evidence): there
is one for each cluster, or several. That of a root is the largest entry of its table after all
messages came in; all others are 0. The *home* of a variable is the smallest cluster that holds it.
The mapping ``plan.storage.homes`` gives the home of each variable, and arrays (variables, runs)
have the variables in the order of this mapping. A run is one set of evidence of a batch.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.beliefs.discrete.impossible import require_possible
from pgm.beliefs.discrete.place import steps
from pgm.beliefs.discrete.run import of_tree
from pgm.beliefs.discrete.run_pieces import Distinct, some_runs, tree_pieces
from pgm.beliefs.discrete.tree_passes import collect, enter
from pgm.beliefs.discrete.tree_plan import Stack, TreePlan, plan_for
from pgm.beliefs.hypotheses.most_probable_path import most_probable_path as most_probable_modes
from pgm.beliefs.markov.most_probable_path import most_probable_path
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.beliefs.markov.run import require_beliefs
from pgm.boundary import is_whole
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import LEFT_OUT, Listing, Shown, Summary, few, titled
from pgm.errors import EvidenceError, GraphError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.factors.axes import States, discrete
from pgm.factors.scope import namesake
from pgm.immutable import Immutable
from pgm.inference.query.marginal_map import summed_out
from pgm.inference.query.question import wanted
from pgm.kernels.arrays import Array, Integers, Mask, frozen
from pgm.kernels.semirings import MAX_PRODUCT
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.summaries import spread
from pgm.progress import Progress, counted, reporting
from pgm.schedules.binding import bind_chain
from pgm.schedules.limits import Room, require_runs
from pgm.schedules.options import PATHS, Call, require
from pgm.variables import Discrete, Variable
from pgm.workers.workers import Workers

if TYPE_CHECKING:
    from concurrent.futures import Executor

# How many paths of modes are kept at each step, if nothing else is asked for.
PATHS_KEPT = 256
# How many variables a repr lists.
LISTED = 10


@dataclass(frozen=True, eq=False, repr=False)
class MostProbable(Shown, Immutable):
    """The most probable assignment of discrete variables, given evidence.

    Attributes
    ----------
    assignment : mapping of Discrete
        The name of each variable's state, also of variables with evidence; or, if some variables
        were asked for, of those, in their order. Where the evidence has axes of runs, the indices
        of the states, (*runs), whose names `states` gives. For a dynamic network of steps 0 to T,
        the indices of each hidden variable's states by step, (*runs, T+1); for a control, which has
        no step 0, (*runs, T).
    log_probability : ndarray
        (*runs): ln p(assignment, evidence), natural logarithms.
    exact : ndarray of bool
        (*runs): whether it is known that no other assignment is more probable. It is not known of a
        path of modes where others were left out, or CPDs linearised.

    Examples
    --------
    >>> from pgm.examples import rain, still, wet
    >>> graph = pgm.compile(still, steps=2)
    >>> found = pgm.most_probable(graph, {wet: [1, 1]})
    >>> found.assignment[rain]
    array([1, 1, 1])
    >>> found.states(rain).tolist()
    ['yes', 'yes', 'yes']
    """

    assignment: Mapping[Discrete, str | Integers]
    log_probability: Array
    exact: Mask

    def states(self, variable: Variable) -> str | npt.NDArray[np.str_]:
        """The name of a variable's most probable state.

        Parameters
        ----------
        variable : Discrete

        Returns
        -------
        str or ndarray of str
            The name; an array of names where `assignment` has an array of indices, in its shape.

        Raises
        ------
        EvidenceError
            If the network does not have the variable.
        """
        if not isinstance(variable, Discrete) or variable not in self.assignment:
            require_variable(variable)
            raise EvidenceError(
                f"{variable!r} is not in the network; its variables are {list(self.assignment)}"
                f"{namesake(variable, self.assignment)}",
                variable=variable,
            )
        found = self.assignment[variable]
        return found if isinstance(found, str) else np.array(variable.states)[found]

    @property
    def _title(self) -> str:
        lead = self.log_probability.shape
        if lead:
            count = len(self.assignment)
            return f"MostProbable({count} variable{'s' * (count != 1)}, runs {lead})"
        if self._over_time:
            steps = max(np.shape(state)[-1] for state in self.assignment.values())
            return (
                f"MostProbable({len(self.assignment)} variables over {steps} steps; "
                f"ln p {self.log_probability:.6g})"
            )
        shown = [f"{v!r} {state}" for v, state in list(self.assignment.items())[:LISTED]]
        if len(self.assignment) > LISTED:
            shown.append(f"... {len(self.assignment)} variables")
        return f"MostProbable({', '.join(shown)}; ln p {self.log_probability:.6g})"

    @property
    def _over_time(self) -> bool:
        """Whether any state is an array of indices: over steps, or over the user's axes of runs."""
        return any(not isinstance(state, str) for state in self.assignment.values())

    def _summary(self) -> Summary:
        lead = self.log_probability.shape
        if not self._over_time or not self.log_probability.size:
            return Summary(self._title)
        rows = []
        for variable, found in list(self.assignment.items())[:LISTED]:
            path = np.asarray(found)[(0,) * len(lead)]
            shown = few(path.size, LISTED)
            names = [LEFT_OUT if k is None else variable.states[int(path.flat[k])] for k in shown]
            rows.append((repr(variable), ", ".join(names)))
        parts: list[str | Listing] = [Listing(("", "run 0" * bool(lead)), rows, names=2, cell=80)]
        if lead:
            parts.append(f"ln p {spread(self.log_probability)}")
        left = len(self.assignment) - len(rows)
        return Summary(self._title, parts + [f"... {left} more"] * (left > 0))


@public
def most_probable(
    graph: ClusterGraph,
    evidence: Evidence,
    *,
    variables: Variable | Iterable[Variable] | None = None,
    memory: float | None = None,
    executor: Executor | None = None,
    paths: int | None = None,
    progress: Progress = False,
) -> MostProbable:
    r"""Find the assignment of all discrete variables that is most probable given the evidence.

    .. math:: \arg\max_x p(x, \text{evidence})

    Here x has a state for every variable, or for each of `variables`. For a dynamic network of
    tables the assignment is the most probable path of the hidden variables through all steps
    (Viterbi); measurements that were not taken are summed over.

    Messages with maxima in place of sums are sent to the roots of the tree, and the states of the
    maxima are traced back from there. Of several equally probable assignments the same one is
    always returned.

    For a dynamic network of discrete and continuous variables the assignment is the path of the
    discrete ones, with the continuous ones integrated out: each step keeps the likeliest paths so
    far, each with its own Gaussian, and leaves others out.

    Parameters
    ----------
    graph : ClusterGraph
        The graph of a discrete network, without loops, or of a dynamic network with discrete
        variables, with continuous ones beside them or not.
    evidence : mapping of Variable
        The name or index of a state, an array of indices with −1 for "not observed in this run", or
        `soft` weights, which count as factors of the probability; for a dynamic network arrays by
        step, as for `infer`. Leading axes are runs.
    variables : Discrete or iterable of Discrete, optional
        Those whose states are asked for, not observed in all runs; all others are summed over (a
        *marginal MAP*). It is exact, and needs wider tables than either question alone, since the
        others have to be summed out first. Not for a dynamic network.
    memory : number, optional
        How many bytes the tables of all runs may take, besides the compiled graph, the evidence and
        the result; 2²⁸ (256 MiB), if not given. Of several workers each may take so much. Not for a
        dynamic network.
    executor : concurrent.futures.Executor, optional
        A pool of processes or threads, or another executor that `infer` takes, whose workers are
        handed about equally many runs each. Not for a dynamic network.
    paths : int, optional
        How many paths are kept at each step of a dynamic network of discrete and continuous
        variables; 256, if not given. For no other network.
    progress : bool or callable
        Whether bars show how far the work is, on a terminal or in a notebook and nowhere else; or a
        function, ``progress(done, total)``, called at the start of each stage and after each of its
        items: steps, or parts of the runs.

    Raises
    ------
    GraphError
        If the network is continuous, the graph has loops or too large a cluster, there are too
        many runs, or `memory` is too small.
    EvidenceError
        If the evidence does not fit the network, or has probability zero.

    References
    ----------
    Koller & Friedman, Probabilistic Graphical Models, 2009, section 13.3; Viterbi, Error bounds for
    convolutional codes, 1967.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> found = pgm.most_probable(pgm.compile(rainy), {wet: "yes"})
    >>> found.assignment[rain]
    'yes'
    >>> pgm.most_probable(pgm.compile(rainy), {wet: "yes"}, variables=rain)
    MostProbable(rain yes; ln p -0.980829)
    """
    if not isinstance(graph, ClusterGraph):
        raise GraphError(
            f"most_probable takes a cluster graph (pgm.compile(network)), not {titled(graph)}"
        )
    if not isinstance(evidence, Mapping):
        raise EvidenceError(
            f"evidence maps variables to states; found {type(evidence).__name__}; of a table of "
            "records pgm.records(table, network) makes it"
        )
    mixed = isinstance(graph, DynamicGraph) and graph.model.mixed
    if variables is not None and (executor is not None or isinstance(graph, DynamicGraph)):
        raise GraphError(
            "variables= are some of a network without time, one run after another; leave "
            f"{'executor=' if executor is not None else 'it'} out"
        )
    if paths is not None and not mixed:
        raise GraphError(
            f"paths={paths!r} says how many paths of modes are kept, and {titled(graph)} has no "
            "discrete variables beside continuous ones over time; leave it out"
        )
    if isinstance(graph, DynamicGraph) and (mixed or graph.model.discrete):
        call = Call(executor=executor, memory=memory)
        require(call.asked(graph), graph, PATHS)
        with reporting(progress):
            if mixed:
                return _most_probable_modes(graph, evidence, _count(paths))
            return _most_probable_path(graph, evidence)
    if not isinstance(graph, DynamicGraph) and graph.network.mixed:
        raise GraphError(
            f"most_probable is for discrete networks, and for discrete variables over time; "
            f"{titled(graph)} has continuous variables too, and no time: posterior[d] of pgm.infer "
            "has the probabilities of each discrete variable, posterior.joint those of several"
        )
    if isinstance(graph, DynamicGraph) or not graph.network.discrete:
        raise GraphError(
            "most_probable is for discrete networks, and for discrete variables over time; of "
            "continuous variables that are Gaussian the most probable values are the means of "
            "pgm.infer(...), and mixtures have posterior[x].modes()"
        )
    if not graph.is_tree:
        raise GraphError(
            f"{titled(graph)} has loops, and most_probable is for trees; compile a junction tree, "
            "pgm.compile(network)"
        )
    room = Room.of(memory, graph)
    bound = bind_discrete(frozenset(graph.network.variables), evidence)
    distinct = Distinct.of(bound)
    if variables is not None:
        known = frozenset(graph.network.variables)
        asked = wanted(variables, known, bound, "most_probable")
        with reporting(progress):
            return _marginal_map(graph, asked, bound, distinct, room)
    plan = plan_for(graph, distinct.evidence.runs, room.batch)
    require_runs(len(plan.storage.homes), bound.runs, "the states of all variables")
    search = _Search(graph, distinct.evidence, distinct.evidence.runs, room.batch)
    with reporting(progress):
        found = _shared(Workers(executor), search)
    states = np.concatenate([s for s, _ in found], axis=1, dtype=np.intp)
    log_tops = np.concatenate([t for _, t in found], axis=1)
    if distinct.which is not None:
        states, log_tops = states[:, distinct.which], log_tops[:, distinct.which]
    states.flags.writeable = False
    require_possible(plan, bound, log_tops)
    log_probability = frozen(log_tops.sum(axis=0).reshape(bound.lead))
    assignment = MappingProxyType(_assignment(plan, bound, states))
    return MostProbable(assignment, log_probability, _known(np.ones(bound.lead, dtype=bool)))


def _marginal_map(
    graph: ClusterGraph, asked: States, bound: BoundStates, distinct: Distinct, room: Room
) -> MostProbable:
    """The most probable states of some variables, with all others summed over.

    The trees of the variables asked for leave constants out, so that ln p(states, evidence) is the
    log-evidence of the whole network.
    """
    of_tree(graph, bound, room)  # impossible evidence is told here
    states = np.empty((len(asked), distinct.evidence.runs), dtype=np.intp)
    for run, tree in enumerate(summed_out(graph.network, asked, distinct.evidence)):
        best = most_probable(tree, {})
        states[:, run] = [v.index(cast(str, best.assignment[v])) for v in asked]
    if distinct.which is not None:
        states = states[:, distinct.which]
    chosen = dict(zip(asked, states, strict=True))
    weights = {v: soft for v, soft in bound.weights.items() if v not in chosen}
    hard = {v: own if bound.lead else int(own[0]) for v, own in chosen.items()}
    known = BoundStates(bound.lead, {**bound.states, **hard}, weights)
    log_probability = of_tree(graph, known, room).log_evidence
    for variable, soft in bound.weights.items():
        if variable in chosen:
            runs = np.arange(bound.runs) % len(soft)
            levels = np.log(soft[runs, chosen[variable]])
            log_probability = log_probability + levels.reshape(bound.lead)
    return MostProbable(
        MappingProxyType(_named(chosen, bound.lead)),
        frozen(np.asarray(log_probability)),
        _known(np.ones(bound.lead, dtype=bool)),
    )


def _most_probable_path(graph: DynamicGraph, evidence: Evidence) -> MostProbable:
    """The most probable path of a dynamic network of tables through all steps (Viterbi).

    For steps 0 to T its `assignment` has the indices of each hidden variable's states,
    (*runs, T+1); of a control, which has no step 0, (*runs, T). *runs are the user's axes of runs.
    """
    bound = bind_chain(graph.model, evidence, graph.steps)
    plan = SlicePlan(graph.layout)
    require_beliefs(plan, bound, 1)
    path, log_probability = most_probable_path(TableSlices(plan, bound))
    assignment: dict[Discrete, str | Integers] = {}
    for v, own in zip(plan.slice, path, strict=True):
        own.flags.writeable = False
        assignment[v] = own[:, 0 if v in plan.states else 1 :].reshape(*bound.lead, -1)
    log_probability = np.array(log_probability).reshape(bound.lead)
    exact = _known(np.ones(bound.lead, dtype=bool))
    return MostProbable(MappingProxyType(assignment), frozen(log_probability), exact)


def _known(exact: Mask) -> Mask:
    """Whether assignments are the most probable ones, as a result has it."""
    exact.flags.writeable = False
    return exact


def _count(paths: int | None) -> int:
    """How many paths of modes are kept."""
    if paths is None:
        return PATHS_KEPT
    if not is_whole(paths) or paths < 1:
        raise GraphError(f"paths is how many are kept, 1 or more; found {paths!r}")
    return int(paths)


def _most_probable_modes(graph: DynamicGraph, evidence: Evidence, count: int) -> MostProbable:
    """The most probable path of a mixed network's discrete variables."""
    bound = bind_chain(graph.model, evidence, graph.steps)
    found = most_probable_modes(graph.model, bound, count)
    assignment: dict[Discrete, str | Integers] = {}
    for variable, own in found.states.items():
        own.flags.writeable = False
        path = own[:, 0 if variable in graph.layout.states else 1 :]
        assignment[variable] = path.reshape(*bound.lead, -1)
    return MostProbable(
        MappingProxyType(assignment),
        frozen(np.array(found.log_probability).reshape(bound.lead)),
        _known(found.exact.reshape(bound.lead)),
    )


@dataclass(frozen=True, eq=False)
class _Search:
    """A search for the most probable assignment of some runs, in pieces that fit into memory.

    graph: The cluster graph of the network, without loops.
    evidence: The evidence of these runs.
    runs: The number of runs of the whole call, of which other workers may search the rest. The plan
        is chosen by this number, so that all workers have the same plan.
    batch: The limit on the table entries, times runs, that are computed at once.
    """

    graph: ClusterGraph
    evidence: BoundStates
    runs: int
    batch: int


def _shared(workers: Workers, search: _Search) -> list[tuple[Integers, Array]]:
    """Search all runs of `search`, divided into consecutive parts, one part for each worker.

    Returns a pair for each part, in the order of the runs: the most probable states, (variables,
    runs of the part), as indices; and the tops, (tops, runs of the part).
    """
    runs = search.runs
    edges = [runs * k // workers.count for k in range(workers.count + 1)]
    parts = [slice(*pair) for pair in pairwise(edges) if pair[0] < pair[1]]
    if len(parts) == 1:
        return [_search(search)]
    jobs = [replace(search, evidence=some_runs(search.evidence, part)) for part in parts]
    work = workers.each(_search, jobs, parts, large=False)
    return [done.result() for done in counted(work, "parts of the runs", len(parts))]


def _search(search: _Search) -> tuple[Integers, Array]:
    """The most probable states, (variables, runs), and the tops, (tops, runs).

    Variables are in the order of ``plan.storage.homes``; states are indices, in the smallest type
    of integers that holds them all. The tops of a run sum to ln p(assignment, evidence).
    """
    plan = plan_for(search.graph, search.runs, search.batch)
    homes = plan.storage.homes
    least = np.min_scalar_type(max((variable.size for variable in homes), default=1) - 1)
    pieces = tree_pieces(plan.storage.entries, search.evidence, search.batch)
    found = [_maximise(plan, piece) for piece in pieces]
    states = np.concatenate([states.astype(least) for states, _ in found], axis=1)
    return states, np.concatenate([tops for _, tops in found], axis=1)


def _assignment(
    plan: TreePlan, evidence: BoundStates, states: Integers
) -> dict[Discrete, str | Integers]:
    """The most probable states as a mapping, with the variables in the network's order.

    `states` are indices, (variables, runs), with the variables in the order of
    ``plan.storage.homes``. The mapping has for each variable the name of its state or, where the
    evidence has axes of runs, the array of its indices, (*runs).
    """
    place = {variable: k for k, variable in enumerate(plan.storage.homes)}
    variables = discrete(plan.graph.network.variables)
    return _named({v: states[place[v]] for v in variables}, evidence.lead)


def _named(
    states: Mapping[Discrete, Integers], lead: tuple[int, ...]
) -> dict[Discrete, str | Integers]:
    """States by variable, (runs,), by their names, or as indices (*runs) where there are runs."""
    found: dict[Discrete, str | Integers] = {}
    for variable, own in states.items():
        found[variable] = own.reshape(lead) if lead else variable.states[own[0]]
        own.flags.writeable = False
    return found


def _maximise(plan: TreePlan, evidence: BoundStates) -> tuple[Integers, Array]:
    """The most probable states of some runs, (variables, runs), and the tops, (tops, runs).

    Messages with maxima in place of sums go to the roots. Then, parents before children, the states
    of the variables that a cluster shares with its parent pick a column of the cluster's table, and
    the largest entry of the column gives the states of its other variables. States are indices;
    variables are in the order of ``plan.storage.homes``.
    """
    runs = evidence.runs
    start = enter(plan, evidence, MAX_PRODUCT)
    done = collect(plan, start, MAX_PRODUCT)
    tables = start.tables.reshape(-1, runs)
    column = np.zeros((len(plan.graph), runs), dtype=np.intp)
    entry = np.zeros((len(plan.graph), runs), dtype=np.intp)
    for stack in plan.stacks:
        if stack.down is None:
            column[stack.clusters] = plan.first[stack.clusters][:, None]
        local = column[stack.clusters] - stack.columns.start
        row = _best_row(stack, tables[stack.entries], local)
        width = stack.shape[1]
        at = local * width + row if stack.axis else row * width + local
        for product in stack.absorbed:
            column[product.children] = product.columns(at)
        own = stack.widths[:, None]
        entry[stack.clusters] = row * own + local - stack.first[:, None]
    return _decode(plan, entry), done.tops.reshape(-1, runs)


def _best_row(stack: Stack, entries: Array, column: Integers) -> Integers:
    """The row of the largest entry in one column of each cluster's table, (clusters, runs).

    Of equal entries the first one counts. `entries`, (entries, runs), are the stack's tables;
    `column`, (clusters, runs), is the index of each cluster's column in the stack's matrix.
    """
    runs = entries.shape[1]
    matrix = entries.reshape(*stack.shape, runs)
    by_column = matrix if stack.axis else matrix.swapaxes(0, 1)
    best: Integers = by_column[column, :, np.arange(runs)].argmax(axis=-1)
    return best


def _decode(plan: TreePlan, entry: Integers) -> Integers:
    """The states of all variables, (variables, runs), in the order of ``plan.storage.homes``.

    `entry`, (clusters, runs), is for each cluster the index of the most probable entry of its
    table, counted row by row of the cluster's matrix. Each variable's state is read from its home's
    entry.
    """
    homes = plan.storage.homes
    scopes = {home: plan.storage.places[home].scope for home in homes.values()}
    strides = np.array([steps(scopes[home], 1)[variable] for variable, home in homes.items()])
    sizes = np.array([variable.size for variable in homes])
    states: Integers = entry[[*homes.values()]] // strides[:, None] % sizes[:, None]
    return states
