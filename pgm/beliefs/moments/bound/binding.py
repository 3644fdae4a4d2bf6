"""Which calls are bound: the first ones of evidence of a form, and who finds that again."""

from __future__ import annotations

from typing import Any

from pgm.beliefs.moments.bound.bound import Bound
from pgm.beliefs.moments.bound.once import BoundOnce
from pgm.beliefs.moments.bound.room import Sweeps
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.forward import Filtered
from pgm.beliefs.moments.steps.plan import Blank
from pgm.compile import BalancedGraph, DynamicGraph
from pgm.evidence import BoundEvidence
from pgm.linearisers import Lineariser
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.schedule import Filtering, FixedLag, Schedule, Smoothing


def bound_to(
    graph: DynamicGraph, evidence: BoundEvidence, schedule: Schedule | None, lineariser: Lineariser
) -> ChainOutcome | None:
    """The posterior by what has been bound for a form of evidence; None where nothing serves.

    A call that is bound has gone the general way before, where all but values was checked.
    """
    bindable = _may_be_bound(graph, schedule, evidence)
    blank = Blank.known(graph.layout, evidence, lineariser) if bindable else None
    if blank is None:
        return None
    key = _key(schedule, evidence)
    bound = blank.bound.get(key)
    if not isinstance(bound, Bound) or not bound.stands:
        return None
    found = bound(graph, evidence)
    if found is not None:
        bound.served += 1
        return found
    bound.failed += 1
    if bound.failed > _FAILURES + bound.served:  # which costs more than it saves
        blank.bound[key] = None
    return None


def bind(
    blank: Blank | None, schedule: Schedule, found: ChainOutcome, evidence: BoundEvidence
) -> None:
    """Bind what later calls for evidence of a form need, after one that went the general way."""
    if blank is None or not _may_be_bound(found.graph, schedule, evidence):
        return
    key = _key(schedule, evidence)
    known = blank.bound.get(key, _NOTHING)
    if known is None or (isinstance(known, Bound) and known.stands):
        return
    plan = found._planned
    if plan.account.left or found._careful is not None:
        return  # of other values machine code may make all
    # Machine code clears what calls have often found right: until then all go the general way.
    whole = [family.compiled for family in plan.families if not family.exact]
    if plan.account.compiled and not all(each and each.tracer.often for each in whole):
        return
    try:
        blank.bound[key] = _bound(blank, schedule, found, evidence)
    except Uncompiled:
        blank.bound[key] = None


# The schedule of calls that name none.
_ONCE = Smoothing()
# What is found where nobody has tried to bind.
_NOTHING = "nothing"
# Calls in vain, beside as many as served, after which a form of evidence is bound no more.
_FAILURES = 4
# Of more runs the arithmetic takes so long that nothing is saved.
_RUNS = 256


def _may_be_bound(graph: DynamicGraph, schedule: Schedule | None, evidence: BoundEvidence) -> bool:
    """Whether a call is of a kind that is bound."""
    if evidence.runs > _RUNS or isinstance(graph, BalancedGraph):
        return False
    if schedule is None:
        return True
    if type(schedule) is FixedLag:
        return not schedule.lag and not isinstance(schedule.damping, LevenbergMarquardt)
    if type(schedule) not in (Filtering, Smoothing):
        return False
    assert isinstance(schedule, Filtering | Smoothing)
    return not isinstance(schedule.damping, LevenbergMarquardt)


def _bound(blank: Blank, schedule: Schedule, found: ChainOutcome, evidence: BoundEvidence) -> Bound:
    """A call bound as one was made that went the general way."""
    plan = found._planned
    if isinstance(schedule, Smoothing) and schedule.iterations > 1 and not plan.exact:
        from pgm.beliefs.moments.bound.iterated import BoundIterated

        return BoundIterated(blank, plan, evidence, schedule)
    if isinstance(schedule, FixedLag):
        schedule = schedule.filtering
    assert isinstance(schedule, Filtering | Smoothing)
    filtering = schedule.first if isinstance(schedule, Smoothing) else schedule
    keep = not isinstance(found._swept, Filtered)
    return BoundOnce(blank, plan, evidence, Sweeps(filtering, found.kind == SMOOTHED, keep))


def _key(schedule: Schedule | None, evidence: BoundEvidence) -> Any:
    """The schedule, and which sensors lack readings: by these calls of one form differ."""
    return schedule or _ONCE, *[each.whole for each in evidence.readings]
