"""Running a schedule on a chain of tables."""

from __future__ import annotations

import math

import numpy as np

from pgm.compile import DynamicGraph
from pgm.errors import EvidenceError, GraphError
from pgm.evidence import BoundEvidence
from pgm.inference.markov.chain import TINY, StateChain
from pgm.inference.markov.plan import SlicePlan, TableSlices
from pgm.inference.markov.posterior import StatePosterior
from pgm.inference.markov.schedule_kinds import kind_of, require_chain
from pgm.inference.markov.single_state import DirectChain
from pgm.inference.schedule import Schedule
from pgm.inference.status import FILTERED, Status
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.resources import require_memory


def run(graph: DynamicGraph, bound: BoundEvidence, schedule: Schedule | None) -> StatePosterior:
    """The posterior after the messages of a filter, a fixed-lag smoother or a smoother.

    Beliefs that would not fit memory are refused with a `GraphError`; see `kind_of` for schedules.
    """
    kind = kind_of(schedule, "tables")
    require_chain(graph, "tables")
    plan = SlicePlan(graph.layout)
    require_beliefs(plan, bound, 1 if kind == FILTERED else 2)
    chain = solved(TableSlices(plan, bound))
    status = Status.of([], np.ones(bound.runs, dtype=bool), bound.lead)
    return StatePosterior(graph, status, kind, plan, chain)


def solved(slices: TableSlices) -> StateChain:
    """The chain after its forward sweep, with logarithms where numbers may have lost a state."""
    found = _in_numbers(slices) if slices.smallest >= TINY else None
    return found or StateChain(slices.within(LOG_SUM_PRODUCT), LOG_SUM_PRODUCT).run()


def _in_numbers(slices: TableSlices) -> StateChain | None:
    """The chain after its forward sweep in plain numbers; None if these may have lost a state.

    A state is lost to underflow. Evidence that seems impossible is refused with an `EvidenceError`
    if no number is so small that this may be the reason.
    """
    with np.errstate(under="ignore"):
        if slices.single and slices.steps:
            direct = DirectChain(slices).run()
            if direct.precise and slices.smallest >= TINY:
                return direct
        try:
            chain = StateChain(slices).run()
        except EvidenceError:
            if slices.smallest >= TINY:
                raise
            return None  # the tables of a function have smaller numbers than was known before
    return chain if min(chain.smallest, slices.smallest) >= TINY else None


def require_beliefs(plan: SlicePlan, bound: BoundEvidence, sets: int) -> None:
    """Raise `GraphError` if beliefs, or tables on the way from a step to the next, would not fit.

    `sets` is how many beliefs are kept for each step and run.
    """
    size = math.prod(plan.shape)
    require_memory(
        plan.onward.largest * bound.runs,
        f"the largest table on the way from a step to the next, in {bound.runs} runs,",
        "give each state fewer parents, or fewer runs to a call",
        error=GraphError,
    )
    require_memory(
        sets * (bound.steps + 1) * bound.runs * size,
        f"the beliefs over {size} states at {bound.steps + 1} steps in {bound.runs} runs",
        "give fewer runs or steps to a call",
        error=GraphError,
    )
