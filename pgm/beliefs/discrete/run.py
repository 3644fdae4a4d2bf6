"""Inference in a discrete network: exact on a tree, or by a schedule on any graph.

A run is one set of evidence of a batch.
"""

import numpy as np

from pgm.beliefs.discrete.allowed import beliefs_of
from pgm.beliefs.discrete.first_beliefs import FirstBeliefs
from pgm.beliefs.discrete.loopy_messages import LoopyBeliefs, TableMessages
from pgm.beliefs.discrete.outcome import DiscreteOutcome
from pgm.clustergraph import ClusterGraph
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.posteriors.status import Status
from pgm.schedules.impossible import RAISE, allows
from pgm.schedules.limits import Room
from pgm.schedules.loopy import run_loopy
from pgm.schedules.schedule import Loopy, Schedule


def run(
    graph: ClusterGraph,
    evidence: Evidence,
    schedule: Schedule | None,
    memory: float | None = None,
    impossible: str = RAISE,
) -> DiscreteOutcome:
    """The posterior of a discrete network, computed by messages on its cluster graph.

    The schedules `Flooding`, `Sequential` and `Residual` send messages on a graph of any shape;
    `memory` and `impossible` are not for them. Any other schedule, or None, stands for exact
    inference; the graph must then have no loops.

    evidence: Of each observed variable, its state, or an array with a state for each run; or soft
        weights of its states.
    memory: How many bytes the tables of all runs may take; None for 256 MiB.
    impossible: What is done with runs whose evidence has probability zero: ``"raise"`` refuses the
        evidence, ``"allow"`` gives such runs beliefs of NaN and a log-evidence of −∞.
    """
    bound = bind_discrete(graph.network._places.keys(), evidence)
    allow = allows(impossible)
    if isinstance(schedule, Loopy):
        messages = TableMessages(graph, bound, schedule.damping)
        status = run_loopy(messages, schedule, bound.lead)
        return DiscreteOutcome(graph, status, LoopyBeliefs.of(messages))
    room = Room.of(memory, graph)
    first = None if bound.lead else FirstBeliefs.of(graph, bound, room)
    if first is not None:
        return DiscreteOutcome(graph, ONCE, first)
    return of_tree(graph, bound, room, allow=allow)


def of_tree(
    graph: ClusterGraph, bound: BoundStates, room: Room, *, allow: bool = False
) -> DiscreteOutcome:
    """The exact posterior of a graph without loops.

    `bound` is the evidence, checked, in arrays by run. `room` limits how many table entries, times
    runs, are computed at once, and how many are kept. Evidence of probability zero in some run
    raises `ImpossibleEvidence`, or with `allow` gives that run beliefs of NaN; tables too large for
    memory raise `GraphError`.
    """
    beliefs = beliefs_of(graph, bound, room, allow=allow)
    return DiscreteOutcome(graph, _calibrated(bound.lead) if bound.lead else ONCE, beliefs)


def _calibrated(lead: tuple[int, ...]) -> Status:
    """The status of exact inference on a tree: one iteration, no residuals, all runs converged.

    `lead` are the lengths of the user's axes of runs.
    """
    return Status(1, np.zeros((0, *lead)), np.ones(lead, dtype=bool))


ONCE = _calibrated(())
