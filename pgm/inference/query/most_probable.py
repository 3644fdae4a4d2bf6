"""The most probable assignment of a discrete network, or path of a chain's discrete variables.

The work itself is in `maximising`, and round loops in `pgm.beliefs.discrete.loopy_messages`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from itertools import islice
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.arguments import public
from pgm.beliefs.discrete.decoding import decoded
from pgm.beliefs.discrete.impossible import require_possible
from pgm.beliefs.discrete.loopy_messages import TableMessages
from pgm.beliefs.discrete.run import of_tree
from pgm.beliefs.discrete.run_pieces import Distinct
from pgm.beliefs.discrete.tree_plan import TreePlan, plan_for
from pgm.beliefs.hypotheses.most_probable_path import most_probable_path as most_probable_modes
from pgm.beliefs.markov.most_probable_path import most_probable_path
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.beliefs.markov.run import require_beliefs
from pgm.boundary import is_whole
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import titled
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.factors.axes import States, discrete
from pgm.inference.query.asked import require_mapping, require_whole_tables
from pgm.inference.query.assignments import MostProbable, best, known, named
from pgm.inference.query.k_best import likeliest
from pgm.inference.query.marginal_map import marginal_map
from pgm.inference.query.maximising import Search, in_parts, maxima
from pgm.inference.query.question import wanted
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.semirings import MAX_PRODUCT
from pgm.progress import Progress, reporting
from pgm.schedules.binding import bind_chain
from pgm.schedules.convergence import tell_of_messages
from pgm.schedules.limits import Room, require_runs
from pgm.schedules.loopy import run_loopy
from pgm.schedules.options import PATHS, Call, require
from pgm.schedules.schedule import Loopy
from pgm.variables import Discrete, Variable
from pgm.workers.workers import Workers

if TYPE_CHECKING:
    from concurrent.futures import Executor

# How many paths of modes are kept at each step, if nothing else is asked for.
PATHS_KEPT = 256


@public
def most_probable(
    graph: ClusterGraph,
    evidence: Evidence,
    *,
    schedule: Loopy | None = None,
    variables: Variable | Iterable[Variable] | None = None,
    count: int | None = None,
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

    On a graph with loops a schedule sends such messages round after round (max-product), as `infer`
    does with sums. Where they settle, and no two states are equally good, the assignment is more
    probable than all that differ from it in variables which form trees or single loops of the graph
    (Weiss & Freeman, 2001); it need not be the most probable, and ``exact`` is False. States are
    chosen cluster by cluster, each given those before it, so that ties are broken consistently. ln
    p is that of the assignment told, exactly.

    States that many causes of a child amount to (`CausalIndependence`) are summed over before
    maxima are taken, as for a marginal MAP.

    For a dynamic network of discrete and continuous variables the assignment is the path of the
    discrete ones, with the continuous ones integrated out: each step keeps the likeliest paths so
    far, each with its own Gaussian, and leaves others out.

    Parameters
    ----------
    graph : ClusterGraph
        The graph of a discrete network, without loops unless a schedule is given, or of a dynamic
        network with discrete variables, with continuous ones beside them or not.
    evidence : mapping of Variable
        The name or index of a state, an array of indices with −1 for "not observed in this run", or
        `soft` weights, which count as factors of the probability; for a dynamic network arrays by
        step, as for `infer`. Leading axes are runs.
    schedule : Flooding, Sequential, Residual or another Loopy, optional
        The order in which messages are sent round a graph with loops, their damping, tolerance and
        number; a graph without loops needs none. Not with any of the options below but `progress`,
        and not for a dynamic network.
    variables : Discrete or iterable of Discrete, optional
        Those whose states are asked for, not observed in all runs; all others are summed over (a
        *marginal MAP*). The others have to be summed out first; where that makes tables too large,
        branch and bound searches states of some of the variables. It is exact, unless so long a
        search is given up: then `exact` is False, and `bound` tells how much is open. Not for a
        dynamic network.
    count : int, optional
        How many assignments are asked for. The result has an axis of them, as of runs, the most
        probable first; it is shorter where no more are possible. Of one set of evidence; not for a
        dynamic network.
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

    Warns
    -----
    ConvergenceWarning
        If the messages of a schedule have not settled, in any run.

    Raises
    ------
    GraphError
        If the network is continuous, the graph has loops and no schedule, or too large a cluster,
        there are too many runs, or `memory` is too small.
    ModelError
        If the schedule is none for messages on any graph.
    EvidenceError
        If the evidence does not fit the network, or has probability zero.
    NumericalError
        If messages round loops lead to no assignment of positive probability.

    References
    ----------
    Koller & Friedman, Probabilistic Graphical Models, 2009, sections 13.3 and 13.4; Viterbi, Error
    bounds for convolutional codes, 1967; Park & Darwiche, Solving MAP exactly using systematic
    search, 2003; Weiss & Freeman, On the optimality of solutions of the max-product
    belief-propagation algorithm in arbitrary graphs, 2001.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> found = pgm.most_probable(pgm.compile(rainy), {wet: "yes"})
    >>> found.assignment[rain]
    'yes'
    >>> pgm.most_probable(pgm.compile(rainy), {wet: "yes"}, variables=rain)
    MostProbable(rain yes; ln p -0.980829)
    >>> around = pgm.compile(rainy, method=pgm.Bethe())
    >>> pgm.most_probable(around, {wet: "yes"}, schedule=pgm.Flooding()).states(rain)
    'yes'
    """
    if not isinstance(graph, ClusterGraph):
        raise GraphError(
            f"most_probable takes a cluster graph (pgm.compile(network)), not {titled(graph)}"
        )
    require_mapping(evidence)
    mixed = isinstance(graph, DynamicGraph) and graph.model.mixed
    if schedule is not None:
        others = {
            "variables": variables,
            "count": count,
            "memory": memory,
            "executor": executor,
            "paths": paths,
        }
        _require_schedule(graph, schedule, [n for n, v in others.items() if v is not None])
    if count is not None:
        _require_countable(graph, count, executor)
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
    if schedule is not None:
        require_whole_tables(
            graph,
            "there is no max-product by a schedule",
            "what they amount to would be maximised over, not summed; leave the schedule out",
        )
        bound = bind_discrete(frozenset(graph.network.variables), evidence)
        with reporting(progress):
            return _max_product(graph, bound, schedule)
    if not graph.is_tree:
        raise GraphError(
            f"{titled(graph)} has loops, and most_probable is for trees; compile a junction tree, "
            "pgm.compile(network), or send messages round the loops, schedule=pgm.Flooding(), "
            "which vouch for no optimum"
        )
    room = Room.of(memory, graph)
    bound = bind_discrete(frozenset(graph.network.variables), evidence)
    distinct = Distinct.of(bound)
    every = discrete(graph.network.variables)
    summed = variables is not None or graph._factorised is not graph.network
    if variables is not None:
        asked = wanted(variables, frozenset(every), bound, "most_probable")
    else:
        asked = every
    if summed and executor is not None:
        raise GraphError(
            "variables with many independent causes (pgm.CausalIndependence) are maximised over "
            "one run after another; leave executor= out"
        )
    if count is not None:
        with reporting(progress):
            return _kbest(graph, asked, bound, count, room, summed=summed)
    if summed:
        with reporting(progress):
            return _marginal_map(graph, asked, bound, distinct, room)
    plan = plan_for(graph, distinct.evidence.runs, room.batch)
    require_runs(len(plan.storage.homes), bound.runs, "the states of all variables")
    job = Search(graph, distinct.evidence, distinct.evidence.runs, room.batch)
    with reporting(progress):
        found = in_parts(Workers(executor), job)
    states = np.concatenate([s for s, _ in found], axis=1, dtype=np.intp)
    log_tops = np.concatenate([t for _, t in found], axis=1)
    if distinct.which is not None:
        states, log_tops = states[:, distinct.which], log_tops[:, distinct.which]
    states.flags.writeable = False
    require_possible(plan, bound, log_tops)
    log_probability = frozen(log_tops.sum(axis=0).reshape(bound.lead))
    return best(_assignment(plan, bound, states), log_probability)


def _require_schedule(graph: ClusterGraph, schedule: Any, others: list[str]) -> None:
    """Refuse what is no schedule of messages on any graph, or goes with what it does not go with.

    `others` are the names of the other options given.
    """
    if not isinstance(schedule, Loopy) or type(schedule) is Loopy:
        raise ModelError(
            f"{schedule!r} is no schedule of messages round loops, which most_probable takes; give "
            "one like pgm.Flooding(damping=0.5), or none for a graph without loops"
        )
    if isinstance(graph, DynamicGraph):
        raise GraphError(
            f"{titled(graph)} has time, whose most probable path is found without a schedule; "
            f"leave {schedule!r} out"
        )
    if others:
        raise GraphError(
            f"a schedule finds one assignment of all variables: leave {others[0]}= out, or, on a "
            "graph without loops, the schedule"
        )


def _max_product(graph: ClusterGraph, bound: BoundStates, schedule: Loopy) -> MostProbable:
    """The assignment to which messages of a schedule lead, with maxima in place of sums.

    On a graph without loops it is known to be the most probable one if no message has anything new
    to say; on others it is not.
    """
    messages = TableMessages(graph, bound, schedule.damping, MAX_PRODUCT)
    status = run_loopy(messages, schedule, bound.lead)
    states, log_probability = decoded(messages)
    exact = messages.settled() & graph.is_tree
    by_variable = {v: states[v] for v in discrete(graph.network.variables)}
    found = MostProbable(
        MappingProxyType(named(by_variable, bound.lead)),
        frozen(log_probability.reshape(bound.lead)),
        known(exact.reshape(bound.lead)),
        frozen(np.where(exact, log_probability, np.inf).reshape(bound.lead)),
        status,
    )
    tell_of_messages(status, schedule, graph)
    return found


def _marginal_map(
    graph: ClusterGraph, asked: States, bound: BoundStates, distinct: Distinct, room: Room
) -> MostProbable:
    """The most probable states of some variables, with all others summed over.

    So it is of all variables where CPDs of independent causes are in factors: their intermediate
    variables are summed over.
    """
    require_runs(len(asked), bound.runs, "the states of all variables")
    of_tree(graph, bound, room)  # impossible evidence is told here
    found = marginal_map(graph, asked, distinct.evidence, room)
    states, levels, missing = found.states, found.levels, found.missing
    if distinct.which is not None:
        which = distinct.which
        states, levels, missing = states[:, which], levels[which], missing[which]
    levels, missing = levels.reshape(bound.lead), missing.reshape(bound.lead)
    return MostProbable(
        MappingProxyType(named(dict(zip(asked, states, strict=True)), bound.lead)),
        frozen(levels),
        known(np.asarray(missing == 0.0)),
        frozen(np.asarray(levels + missing)),
    )


def _kbest(
    graph: ClusterGraph, asked: States, bound: BoundStates, count: int, room: Room, *, summed: bool
) -> MostProbable:
    """The most probable assignments, along an axis; `summed`, as of a marginal MAP."""
    if bound.lead:
        raise EvidenceError(
            f"count={count} assignments are of one set of evidence, and this has the runs "
            f"{bound.lead}; ask for each by itself"
        )
    of_tree(graph, bound, room)  # impossible evidence is told here
    # Whether each search so far has found what is the best of its part.
    sure = [True]

    def summing(own: BoundStates) -> tuple[Integers, Array]:
        found = marginal_map(graph, asked, own, room)
        sure.append(sure[-1] and not found.missing[found.levels > -np.inf].any())
        return found.states, found.levels

    def maximising(own: BoundStates) -> tuple[Integers, Array]:
        states, tops = maxima(Search(graph, own, own.runs, room.batch))
        # Plans for one run and for many have the variables in orders of their own.
        homes = plan_for(graph, own.runs, room.batch).storage.homes
        place = {v: k for k, v in enumerate(homes)}
        return states[[place[v] for v in asked]].astype(np.intp), tops.sum(axis=0)

    free = tuple(v for v in asked if v.size > 1 and v not in bound.states)
    search = summing if summed else maximising
    best, exact = list[tuple[Integers, float]](), list[bool]()
    for found in islice(likeliest(search, bound, asked, free), min(count, sys.maxsize)):
        best.append(found)
        exact.append(sure[-1])
    states = dict(zip(asked, np.stack([own for own, _ in best], axis=1), strict=True))
    levels = np.array([level for _, level in best])
    return MostProbable(
        MappingProxyType(named(states, levels.shape)),
        frozen(levels),
        known(np.array(exact)),
        frozen(np.where(exact, levels, np.inf)),
    )


def _require_countable(graph: Any, count: Any, executor: Any) -> None:
    """Refuse a `count` that is none, or goes with what it does not go with."""
    if not is_whole(count) or count < 1:
        raise GraphError(f"count is how many assignments are asked for, 1 or more; found {count!r}")
    if isinstance(graph, DynamicGraph) or executor is not None:
        raise GraphError(
            f"count={count} assignments are of a network without time, found one after another; "
            "leave count= out, or executor="
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
    return best(assignment, frozen(np.array(log_probability).reshape(bound.lead)))


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
    log_probability = frozen(np.array(found.log_probability).reshape(bound.lead))
    exact = known(found.exact.reshape(bound.lead))
    at_most = frozen(np.where(exact, log_probability, np.inf))
    return MostProbable(MappingProxyType(assignment), log_probability, exact, at_most)


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
    return named({v: states[place[v]] for v in variables}, evidence.lead)
