"""Sweeps of a plan in machine code: what they leave is what the general kernels leave."""

from __future__ import annotations

from collections.abc import Sequence
from contextvars import copy_context
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.called import Calls, Failed
from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.compiled.memory import address
from pgm.beliefs.moments.compiled.plans import (
    Table,
    Uncompiled,
    decided,
    motion_of,
    places,
    sensor_of,
    unknown,
)
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile.machine import Compiled
from pgm.kernels.arrays import Array, Mask, vacant
from pgm.kernels.machine import sweeps, told
from pgm.kernels.machine.asking import asking
from pgm.kernels.machine.extent import is_long
from pgm.kernels.moments import Conditional
from pgm.resources import in_threads
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.iteration import Anchor
from pgm.schedules.schedule import ONCE, Filtering, FixedLag

# Machine code repays its making from a tenth of a second of the general kernels on: a step of
# theirs takes as long as the arithmetic of so many runs, of half a microsecond each.
_STEP, _LONG = 100, 250_000
# Why runs are left to the general kernels, going forward and back.
FAR = "readings are too sharp, a covariance is singular, or numbers are too far apart"
LONG = "step control, and windows of a lag, are compiled for slices of few components"
_SINGULAR = "a covariance is singular on the way back"


@dataclass(frozen=True, eq=False)
class Swept:
    """How a sweep went: the runs that are left to the general kernels, and what it says of others.

    `residuals` and `converged` are as of a `MomentChain`, `closest` and `far` as of `Forward`.
    """

    left: list[slice]
    residuals: list[Array]
    converged: Mask
    closest: float
    far: bool = True


def is_used(plan: ChainPlan, times: int = 1) -> bool:
    """Whether a plan is to be swept in machine code; its account says why not.

    A step of the general kernels takes so many `times` that of a filter, beside making the code.
    """
    choice, account = plan.layout.compiled, plan.account
    if choice is False:
        account.rest = "compiled=False"
    elif choice is None and times * plan.steps * (_STEP + plan.runs) < _LONG:
        account.rest = "machine code is made for longer work, or by compiled=True"
    elif choice is None and find_spec("llvmlite") is None:
        account.rest = "llvmlite is not installed"
    else:
        account.due = True
        return True
    return False


def forward(
    plan: ChainPlan,
    schedule: Filtering | None,
    known: tuple[Array, ...],
    predicted: tuple[Array, ...] = (),
    *,
    keep: bool,
    anchor: Anchor | None = None,
) -> Swept | None:
    """Sweep a plan forward into arrays of its record; None if it is not compiled.

    Parameters
    ----------
    plan : ChainPlan
    schedule : Filtering or None
        None leaves all CPDs as they were linearised.
    known, predicted : tuple of ndarray
        Moments (T+1, runs, ...) and log-densities (T+1, runs) given measurements; moments before
        them, if they are kept.
    keep : bool
        Whether the plan keeps how it is linearised.
    anchor : Anchor or None
        A measurement of all components, for the trial of a step control.
    """
    if not is_used(plan):
        return None
    asked = schedule or ONCE
    stored = schedule is None
    controlled = isinstance(asked.damping, LevenbergMarquardt) and asked.iterations > 1
    calls = Calls(plan.runs)
    # A step control asks for costs at many points: functions that are called are left to NumPy.
    table = Table(plan, lanes_of(plan), None if controlled else calls)
    try:
        why = unknown(plan)
        if why is not None:
            raise Uncompiled(why)
        cpds = {"stored": stored, "keep": keep}
        motions = tuple(motion_of(plan, link, table, **cpds) for link in plan.transition)
        sensors = tuple(
            sensor_of(plan, sensor, table, **cpds, gate=asked.gate, controlled=controlled)
            for sensor in plan.read
        )
    except Uncompiled as error:
        plan.account.leave(str(error))
        return None
    if not predicted and any(f.compiled for f in plan.families):
        predicted = tuple(np.empty_like(part) for part in known[:2])  # for the judge alone
    iterated = asked.iterations > 1 and any(sensor.curved for sensor in sensors)
    record = np.zeros((asked.iterations + 1, plan.runs if iterated else 0))
    if iterated:
        table.numbers[told.ITERATIONS] = asked.iterations
        table.put(told.SETTINGS, settings(asked))
        table.put(told.RESIDUALS, record)
    layout = plan.layout
    held: tuple[told.Array, ...] = ()
    if anchor is not None:
        weight = np.ascontiguousarray(np.broadcast_to(anchor.weight, plan.runs))[None]
        held = table.array(anchor.mean), table.array(anchor.std), table.array(weight)
    chain = told.Forward(
        size=layout.slice_size,
        states=places(layout.state_places, layout.slice_size),
        single=bool(layout.single),
        motions=motions,
        sensors=sensors,
        begin=begun(plan, schedule, table, keep=keep),
        predicted=tuple(map(table.array, predicted)),
        known=(table.array(known[0]), table.array(known[1])),
        density=table.array(known[2]),
        iterated=iterated,
        controlled=iterated and controlled,
        anchor=held,
        asked=table.array(calls.asked.T[None]) if calls.each else None,
    )
    if (chain.controlled or held) and is_long(chain, table.lanes):
        plan.account.leave(LONG)
        return None
    ended = run(plan, chain, table, (*known, *predicted))
    failure = calls.failure
    if isinstance(failure, Failed):
        plan.account.leave(str(failure))
        return None
    if failure is not None:
        raise failure
    decided(table)
    left = stretches(ended[sweeps.LEFT] != 0.0)
    count(plan, left, FAR)
    if schedule is not None:
        done = ended[sweeps.LEFT] == 0.0
        judge(plan, known, predicted or known, done, again=asked.iterations > 1)
    longest = int(record[-2].max(initial=0.0))
    converged = np.full(plan.runs, plan.linear)
    if iterated:
        converged = record[-1] == 0.0
    converged &= ended[sweeps.MOVING] == 0.0
    closest, far = float(ended[sweeps.CLOSEST].min(initial=1.0)), bool(ended[sweeps.FAR].any())
    return Swept(left, list(record[:longest]), converged, closest, far)


def begun(
    plan: ChainPlan, schedule: Filtering | None, table: Table, *, keep: bool
) -> tuple[told.Array, told.Array]:
    """The moments of the belief with which a plan begins, told."""
    first = replace(plan, transition=[], sensors=[])
    if plan.batch and plan.begin is None and all(link.family.uniform for link in plan.prior):
        first = first.of(slice(0, 1))  # which is as all are
    belief = MomentChain(first, schedule, keep=keep).start()
    return table.array(_by_row(first, belief.mean, 1)), table.array(_by_row(first, belief.cov, 2))


def settings(schedule: Filtering | FixedLag) -> Array:
    """The settings of iterations, as of `told.SETTINGS`."""
    damping = schedule.damping
    if isinstance(damping, LevenbergMarquardt):
        return np.array([schedule.tolerance, 0.0, damping.start, damping.factor, damping.tries])
    return np.array([schedule.tolerance, damping])


def backward(
    plan: ChainPlan,
    ahead: Any,
    transition: Conditional,
    slices: Conditional | None,
    *,
    smooth: bool,
) -> tuple[Conditional, tuple[Array, Array] | None] | None:
    """The states given the slices after them, (T, runs, ...), and smoothed moments, if asked for.

    None where the plan is not compiled, or a covariance is singular. `transition` and `slices` are
    as of `Reverse`.
    """
    if not is_used(plan):
        return None
    table, layout = Table(plan, lanes_of(plan)), plan.layout
    lead, front, width = (plan.steps, plan.runs), layout.state_size, layout.slice_size
    states = Conditional(*(vacant(lead, own) for own in ((front, width), (front,), (front, front))))
    beliefs = None
    if smooth:
        every = plan.steps + 1, plan.runs
        beliefs = vacant(every, (width,)), vacant(every, (width, width))
    chain = told.Backward(
        size=width,
        states=places(layout.state_places, width),
        known=(table.array(ahead.mean), table.array(ahead.cov)),
        predicted=(table.array(ahead.predicted_mean), table.array(ahead.predicted_cov)),
        motion=(table.array(transition.matrix), table.array(transition.cov)),
        reversed=(table.array(states[0]), table.array(states[1]), table.array(states[2])),
        smoothed=tuple(map(table.array, beliefs or ())),
        controls=tuple(map(table.array, slices or ())) if smooth else (),
    )
    ended = run(plan, chain, table, (*states, *(beliefs or ())))
    left = bool(ended[sweeps.LEFT].any())
    count(plan, [slice(0, plan.runs)] if left else [], _SINGULAR)
    return None if left else (states, beliefs)


def lanes_of(plan: ChainPlan) -> int:
    """How many runs of a plan are swept together."""
    return sweeps.LANES if plan.runs >= sweeps.LANES else 1


def run(plan: ChainPlan, chain: sweeps.Chain, table: Table, out: Sequence[Array]) -> Array:
    """Run a sweep on all runs of a plan; what it tells of each, (`sweeps.TOLD`, runs).

    `out` are the arrays that it fills.
    """
    choice, lanes = plan.layout.compiled, table.lanes
    ended = np.zeros((sweeps.TOLD, plan.runs))
    table.put(told.ENDED, ended)
    whole, sweep = table.whole, _sweep(chain, table)
    threads = choice.threads if isinstance(choice, Compiled) else 1
    threads = max(min(threads, plan.runs // lanes), 1)

    def work(first: int, last: int) -> None:
        # Large pages of fresh memory are cleared once, each by one thread.
        for array in out if threads > 1 else ():
            begin, end = (runs * len(array) // plan.runs for runs in (first, last))
            array[begin:end, first:last:512] = 0.0
        sweep(address(whole), first, last)

    in_threads(work, plan.runs, threads)
    return ended


def _sweep(chain: sweeps.Chain, table: Table) -> sweeps.Sweep:
    """The sweep of a chain, which calls the functions that are to be called."""
    calls, lanes = table.calls, table.lanes
    if calls is None or not calls.each:
        return sweeps.made(chain, lanes)
    assert isinstance(chain, told.Forward)
    made, context = asking(chain, lanes), copy_context()

    def sweep(where: int, first: int, last: int) -> None:
        # As the thread of the program that has begun it, of which NumPy's handling of errors is.
        context.copy().run(calls.sweep, made, where, first, last, lanes)

    return sweep


def count(plan: ChainPlan, left: list[slice], why: str) -> None:
    """Note in a plan's account how a sweep went: the runs that it left, and why."""
    account, runs = plan.account, sum(each.stop - each.start for each in left)
    account.compiled += runs < plan.runs
    if runs:
        account.leave(why, runs)


def _by_row(plan: ChainPlan, array: Array, own: int) -> Array:
    """Moments (own axes, *batch) as of one row, (1, runs, own axes)."""
    if not plan.batch:
        return array[None, None]
    return array.transpose(own, *range(own))[None]


def stretches(mask: Mask) -> list[slice]:
    """The stretches of a mask that are true, or all of it, where that takes less time."""
    if not mask.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    if len(edges) // 2 * _STEP + mask.sum() >= _STEP + mask.size:
        return [slice(0, mask.size)]
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
