"""Filtering or smoothing a chain of tables: in plain numbers, or in logarithms where these fail.

A forward sweep makes the filtered beliefs of all steps, and is kept as a `StateChain`; the backward
messages of a smoother are made when the posterior is asked for what needs them.
"""

from __future__ import annotations

import math

import numpy as np

from pgm.beliefs.markov.chain import TINY, StateChain
from pgm.beliefs.markov.impossible_runs import first_lost
from pgm.beliefs.markov.outcome import StateOutcome
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.beliefs.markov.single_state import DirectChain
from pgm.compile import DynamicGraph
from pgm.errors import GraphError
from pgm.evidence import BoundEvidence
from pgm.factors.axes import require_axes
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.posteriors.belief_kind import FILTERED
from pgm.posteriors.status import Status
from pgm.resources import require_memory
from pgm.schedules.impossible import OVER_TIME, RAISE, ImpossibleEvidence, allows
from pgm.schedules.schedule import Schedule, kind_of


def run(
    graph: DynamicGraph, bound: BoundEvidence, schedule: Schedule | None, impossible: str = RAISE
) -> StateOutcome:
    """The posterior after the messages of a filter, a fixed-lag smoother or a smoother.

    `schedule` is a `Filtering`, `FixedLag` or `Smoothing`; None or a `Calibration` smooths. Beliefs
    that would not fit memory raise `GraphError`. Impossible evidence raises `ImpossibleEvidence` if
    `impossible` is "raise", and gives NaN if "allow".
    """
    allow = allows(impossible)
    kind = kind_of(schedule, "tables")
    plan = SlicePlan(graph.layout)
    sets = 1 if kind == FILTERED else 2
    require_beliefs(plan, bound, sets)
    slices = TableSlices(plan, bound, of_runs=OVER_TIME)
    try:
        chain = solved(slices)
    except ImpossibleEvidence:
        if not allow:
            raise
        require_beliefs(plan, bound, sets + 1)  # a copy has the NaN
        chain = _without_impossible(slices)
    status = Status.of([], np.ones(bound.runs, dtype=bool), bound.lead)
    return StateOutcome(graph, status, kind, plan, chain)


def solved(slices: TableSlices) -> StateChain:
    """The chain after its forward sweep, of logarithms if plain numbers may have lost a state.

    A state is lost if its probability underflows. Evidence of probability zero is refused with an
    `ImpossibleEvidence`.
    """
    found = _in_numbers(slices) if slices.smallest >= TINY else None
    return found or StateChain(slices.within(LOG_SUM_PRODUCT), LOG_SUM_PRODUCT).run()


def _in_numbers(slices: TableSlices) -> StateChain | None:
    """The chain after its forward sweep in plain numbers; None if these may have lost a state.

    A state is lost to underflow, which may also be why evidence seems impossible.
    """
    with np.errstate(under="ignore"):
        try:
            if slices.single and slices.steps:
                direct = DirectChain(slices).run()
                if direct.precise and slices.smallest >= TINY:
                    return direct
            chain = StateChain(slices).run()
        except ImpossibleEvidence:
            # A state that is possible may have become smaller, step by step, than any number.
            return None
    return chain if min(chain.smallest, slices.smallest) >= TINY else None


def _without_impossible(slices: TableSlices) -> StateChain:
    """The chain after its forward sweep, for evidence that is impossible in some runs.

    The measurements of such a run are left out from the first step on at which they have
    probability zero; its log-density at this step is −∞. `chain.slices.lost` has the step of each
    run.
    """
    lost = first_lost(slices)
    chain = solved(slices.until(lost))
    by_run = chain.log_density.reshape(slices.steps + 1, -1)
    runs = np.flatnonzero(lost <= slices.steps)
    by_run[np.atleast_1d(lost)[runs], runs] = -np.inf
    return chain


def require_beliefs(plan: SlicePlan, bound: BoundEvidence, sets: int) -> None:
    """Raise `GraphError` if the beliefs, or the tables of one step's message, do not fit memory.

    It is raised also for tables of more variables than NumPy's arrays have axes for. `sets` is how
    many beliefs are kept for each step and run.
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
    require_axes(plan.widest(), "the message from a step to the next")
