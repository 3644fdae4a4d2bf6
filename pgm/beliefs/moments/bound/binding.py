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
from pgm.compile.machine import Squared, is_for_card
from pgm.evidence import BoundEvidence
from pgm.linearisers import Lineariser
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.schedule import Filtering, FixedLag, Schedule, Smoothing


def bound_to(
    graph: DynamicGraph, evidence: BoundEvidence, schedule: Schedule | None, lineariser: Lineariser
) -> ChainOutcome | None:
    """The posterior by what has been bound for a form of evidence; None where nothing serves.

    A call that is bound has gone the general way before, where all but values was checked.
    """
    bindable = _bindable(graph, schedule, evidence)
    blank = Blank.known(graph.layout, evidence, lineariser) if bindable else None
    if blank is None or bindable is None:
        return None
    key = _key(bindable, evidence)
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
    bindable = _bindable(found.graph, schedule, evidence)
    if blank is None or bindable is None:
        return
    key = _key(bindable, evidence)
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
        blank.bound[key] = _bound(blank, bindable, found, evidence)
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


def _bindable(
    graph: DynamicGraph, schedule: Schedule | None, evidence: BoundEvidence
) -> Filtering | Smoothing | None:
    """The schedule of a call that may be bound; None of others."""
    if evidence.runs > _RUNS or isinstance(graph, BalancedGraph):
        return None
    if is_for_card(graph.layout.compiled) or isinstance(graph.layout.compiled, Squared):
        return None  # sweeps that keep more are not bound
    if schedule is None:
        return _ONCE
    if type(schedule) is FixedLag and not schedule.lag:
        schedule = schedule.filtering
    if type(schedule) not in (Filtering, Smoothing):
        return None
    assert isinstance(schedule, Filtering | Smoothing)
    return None if isinstance(schedule.damping, LevenbergMarquardt) else schedule


def _bound(
    blank: Blank, schedule: Filtering | Smoothing, found: ChainOutcome, evidence: BoundEvidence
) -> Bound:
    """A call bound as one was made that went the general way."""
    plan, keep = found._planned, not isinstance(found._swept, Filtered)
    if isinstance(schedule, Filtering):
        return BoundOnce(blank, plan, evidence, Sweeps(schedule, back=False, keep=keep))
    if schedule.iterations > 1 and not plan.exact:
        from pgm.beliefs.moments.bound.iterated import BoundIterated

        return BoundIterated(blank, plan, evidence, schedule)
    return BoundOnce(blank, plan, evidence, Sweeps(schedule.first, back=True, keep=keep))


def _key(schedule: Filtering | Smoothing, evidence: BoundEvidence) -> Any:
    """The schedule, and which sensors lack readings: by these calls of one form differ."""
    return schedule, *[each.whole for each in evidence.readings]
