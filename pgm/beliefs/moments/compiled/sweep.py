"""Sweeps of a plan in machine code: what they leave is what the general kernels leave."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from contextvars import copy_context
from dataclasses import dataclass, replace
from importlib.util import find_spec
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled.called import Calls, Failed
from pgm.beliefs.moments.compiled.card import OnCard
from pgm.beliefs.moments.compiled.gates import decided, undecided
from pgm.beliefs.moments.compiled.groups import Group, groups_of
from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.compiled.key import decisive
from pgm.beliefs.moments.compiled.named_table import Filled, NamedTable
from pgm.beliefs.moments.compiled.robust_noise import untried
from pgm.beliefs.moments.compiled.rows import motion_of, places
from pgm.beliefs.moments.compiled.sensors import sensor_of, vector_of
from pgm.beliefs.moments.compiled.table import Integers64, Record
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, unknown
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.gate import Asked
from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import LONG, Compiled, Squared, is_for_card
from pgm.kernels.arrays import Array, Mask, address, vacant
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told
from pgm.kernels.machine.sweeps.asking import asking
from pgm.kernels.machine.sweeps.extent import is_long
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
CLOSE = f"two candidates are as likely or on the edge of a gate, {FAR}"
_SINGULAR = "a covariance is singular on the way back"
# Sweeps of so many forms of plans are kept by a network's layout.
_TOLD = 64
# One of so many packs of runs keeps beliefs that are looked at here and there alone.
THINNED = 8
# In so many ways the arrays of each lie.
_WAYS = 4
# The names in a record of the belief to begin with, of beliefs, and of densities.
BEGIN, PREDICTED = ("begin mean", "begin cov"), ("predicted mean", "predicted cov")
KNOWN = "known mean", "known cov", "density"
_ANCHOR = "anchor mean", "anchor std", "anchor weight"
# And those of a sweep back.
REVERSED, SMOOTHED = ("gain", "shift", "cov"), ("smoothed mean", "smoothed cov")
_CONTROLS = "control matrix", "control offset", "control cov"


@dataclass(frozen=True, eq=False)
class Swept:
    """How a sweep went: the runs that are left to the general kernels, and what it says of others.

    `residuals` and `converged` are as of a `MomentChain`; `closest`, `far`, `held`, `nis` and
    `squares` as of `Forward`.
    """

    left: list[slice]
    residuals: list[Array]
    converged: Mask
    closest: float
    far: bool = True
    held: bool | None = None
    nis: Array | None = None
    squares: tuple[Array, ...] = ()

    @classmethod
    def told(
        cls,
        left: list[slice],
        ended: Array,
        residuals: Array | None,
        *,
        linear: bool,
        judged: bool = True,
        squares: tuple[Array, ...] = (),
    ) -> Swept:
        """How a sweep went by what it tells of each run, (`chain.TOLD`, runs).

        `residuals` (iterations + 1, runs) has those of iterations, then how many there were, and
        which runs have not converged; None where nothing was iterated. `linear` says whether all
        sensors are affine, and `judged` whether all gates have decided in this sweep.
        """
        every: list[Array] = []
        if residuals is None:
            converged = np.full(ended.shape[1], linear)
        else:
            every = list(residuals[: int(residuals[-2].max(initial=0.0))])
            converged = residuals[-1] == 0.0
        converged &= ended[sweeps.MOVING] == 0.0
        far = bool(ended[sweeps.FAR].any())
        closest = float(ended[sweeps.CLOSEST].min(initial=1.0))
        held = None if left or not judged else not ended[sweeps.LOST].any()
        return cls(left, every, converged, closest, far, held, squares=squares)


def is_iterated(plan: ChainPlan, schedule: Filtering) -> bool:
    """Whether a schedule linearises sensors of a plan more than once."""
    return schedule.iterations > 1 and any(sensor.family.template for sensor in plan.read)


def repays(steps: int, runs: int, times: int = 1) -> bool:
    """Whether NumPy would take longer than making machine code does, for so many such sweeps."""
    return times * steps * (_STEP + runs) >= _LONG


def is_used(plan: ChainPlan, times: int = 1) -> bool:
    """Whether a plan is to be swept in machine code; its account says why not.

    A step of the general kernels takes so many `times` that of a filter in float64.
    """
    choice, account = plan.layout.compiled, plan.account
    if choice is False:
        account.rest = "compiled=False"
    elif choice is None and not repays(plan.steps, plan.runs, times):
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
    times: int = 1,
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
    times : int
        As of `is_used`.
    """
    if not is_used(plan, times):
        return None
    asked = schedule or ONCE
    stored, calls = schedule is None, Calls(plan.runs)
    controlled = isinstance(asked.damping, LevenbergMarquardt) and asked.iterations > 1
    keep = keep or controlled  # since trials are made with what is kept
    try:
        groups = groups_of(plan, asked.gate, stored=stored, controlled=controlled)
        why = unknown(plan, [group.sensor for group in groups])
        if why is not None:
            raise Uncompiled(why)
        key = decisive(plan, stored=stored, keep=keep, gate=asked.gate)
        thinned = 1
        if not predicted and any(f.compiled for f in plan.families):  # for the judge alone
            thinned = _thinned(plan)
            predicted = _predicted(plan, thinned, known)
        iterated = not stored and is_iterated(plan, asked)
        record: Record = dict(zip(BEGIN, begun(plan, schedule, keep=keep), strict=True))
        record |= zip(KNOWN, known, strict=True)
        record |= zip(PREDICTED, predicted, strict=False)
        squares = _squares(plan) if anchor is None else {}
        record |= squares
        record |= undecided(plan, asked.gate, stored=stored)
        residuals = np.zeros((asked.iterations + 1, plan.runs)) if iterated else None
        if residuals is not None:
            record |= {"settings": settings(asked), "residuals": residuals}
        if anchor is not None:
            weight = np.ascontiguousarray(np.broadcast_to(anchor.weight, plan.runs))[None]
            record |= zip(_ANCHOR, (anchor.mean, anchor.std, weight), strict=True)
        record |= untried(plan) if controlled else {}
        control = controlled and iterated

        def tell(table: NamedTable) -> told.Forward:
            cpds = {"stored": stored, "keep": keep, "controlled": control}
            chain = told_ahead(plan, table, groups, **cpds, gate=asked.gate, thinned=thinned)
            if (control or chain.anchor) and is_long(chain, table.lanes):
                raise Uncompiled(LONG)
            return chain

        owners = (
            *(link.family for link in plan.transition),
            *(sensor.family for sensor in plan.read),
            *plan.read,
            record,
            *groups,
        )
        out = (*known, *predicted)
        # A step control asks for costs at many points: functions that are called are left to NumPy.
        rest = record, None if controlled else calls, asked.iterations
        ended = _run(plan, (*key, control, thinned, *record), tell, owners, out, *rest)
    except Uncompiled as error:
        plan.account.leave(str(error))
        return None
    if isinstance(calls.failure, Failed):
        plan.account.leave(str(calls.failure))
        return None
    if calls.failure is not None:
        raise calls.failure
    decided(plan, record)
    for group in groups if keep and not stored else ():
        group.keep()
    left = stretches(ended[sweeps.LEFT] != 0.0)
    count(plan, left, CLOSE if any(isinstance(s, OpenSensor) for s in plan.read) else FAR)
    if schedule is not None:
        done = ended[sweeps.LEFT] == 0.0
        again = asked.iterations > 1
        judge(plan, known, predicted or known, done, again=again, thinned=thinned)
    # Gates that have decided before are not told to sweeps with stored linearisations.
    judged = not (stored and any(sensor.gated is not None for sensor in plan.read))
    own = tuple(squares.values())
    return Swept.told(left, ended, residuals, linear=plan.linear, judged=judged, squares=own)


def _thinned(plan: ChainPlan) -> int:
    """One of how many packs of runs keeps predicted beliefs, at which traces are judged.

    Where of so many points no more are looked at, the others need not be written.
    """
    choice, lanes = plan.layout.compiled, lanes_of(plan)
    shared = isinstance(choice, Compiled) and choice.threads > 1
    if shared or lanes != sweeps.LANES or plan.runs < lanes * THINNED:
        return 1
    every = (family.compiled.every for family in plan.families if family.compiled)
    return THINNED if all(each >= THINNED for each in every) else 1


def _predicted(plan: ChainPlan, thinned: int, known: tuple[Array, ...]) -> tuple[Array, ...]:
    """Room for predicted beliefs, of all runs or of those that are kept."""
    if thinned == 1:
        return tuple(np.empty_like(part) for part in known[:2])
    lead = plan.steps + 1, len(sweeps.kept_runs(plan.runs, thinned))
    return tuple(vacant(lead, part.shape[2:]) for part in known[:2])


def _squares(plan: ChainPlan) -> Record:
    """Room for the NIS of each sensor, if it is to be kept and no sighting is open."""
    asked = isinstance(plan.layout.compiled, Squared)
    if not asked or any(isinstance(sensor, OpenSensor) for sensor in plan.read):
        return {}
    return squares_of(plan)


def squares_of(plan: ChainPlan) -> Record:
    """Room for the NIS of each sensor that is read, in their order."""
    return {_square(sensor): np.empty((plan.steps + 1, plan.runs)) for sensor in plan.read}


def _square(sensor: Sensor) -> str:
    """The name in a record of a sensor's NIS."""
    return f"square {sensor.variable.name}"


def told_ahead(
    plan: ChainPlan,
    table: NamedTable,
    groups: Sequence[Group],
    *,
    stored: bool,
    keep: bool,
    gate: Asked | None,
    controlled: bool,
    thinned: int = 1,
) -> told.Forward:
    """A forward sweep, told; see `forward`."""
    layout, record, calls = plan.layout, table.record, table.calls

    def array(name: str) -> told.Array:
        return table.of(record, itemgetter(name))

    cpds = {"stored": stored, "keep": keep}
    motions = tuple(motion_of(plan, link, table, **cpds) for link in plan.transition)
    vectors = {group.sensor: vector_of(plan, group, table, **cpds) for group in groups}
    sensors = tuple(
        vectors.get(sensor)
        or sensor_of(plan, sensor, table, **cpds, gate=gate, controlled=controlled)
        for sensor in plan.read
    )
    iterated = "residuals" in record
    if iterated:
        table.put_of(told.SETTINGS, record, itemgetter("settings"))
        table.put_of(told.RESIDUALS, record, itemgetter("residuals"))
    return told.Forward(
        size=layout.slice_size,
        states=places(layout.state_places, layout.slice_size),
        single=bool(layout.single),
        motions=motions,
        sensors=sensors,
        begin=(array(BEGIN[0]), array(BEGIN[1])),
        predicted=tuple(array(name) for name in PREDICTED if name in record),
        known=(array(KNOWN[0]), array(KNOWN[1])),
        density=array(KNOWN[2]),
        iterated=iterated,
        controlled=controlled,
        anchor=tuple(array(name) for name in _ANCHOR if name in record),
        asked=table.array(calls.asked.T[None]) if calls is not None and calls.each else None,
        thinned=thinned,
        squares=tuple(array(_square(s)) for s in plan.read if _square(s) in record),
    )


def begun(plan: ChainPlan, schedule: Filtering | None, *, keep: bool) -> tuple[Array, Array]:
    """The belief that a sweep begins with, (1, runs or 1, ...).

    Without evidence, and with runs that are all alike, it is the model's own, and kept.
    """
    alike = plan.begin is None and all(link.family.uniform for link in plan.prior)
    own = alike and plan.prior and not any(link.family.inputs for link in plan.prior)
    if own and plan.layout.begun:
        return plan.layout.begun[0]
    first = replace(plan, transition=[], sensors=[])
    if plan.batch and alike:
        first = first.of(slice(0, 1))  # which is as all are
    begin = MomentChain(first, schedule, keep=keep).start()
    found = _by_row(first, begin.mean, 1), _by_row(first, begin.cov, 2)
    if own:
        plan.layout.begun.append(found)
    return found


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
    reverse: bool,
    smooth: bool,
) -> tuple[Conditional | None, tuple[Array, Array] | None, bool] | None:
    """The states given the slices after them, (T, runs, ...), and smoothed moments, as asked for.

    Third is whether smoothed moments surely have the digits that are promised, in all runs. None
    where the plan is not compiled, or a covariance is singular. `transition` and `slices` are as of
    `Reverse`.
    """
    if not is_used(plan):
        return None
    layout = plan.layout
    lead, front, width = (plan.steps, plan.runs), layout.state_size, layout.slice_size
    states = beliefs = None
    if reverse:
        own = (front, width), (front,), (front, front)
        states = Conditional(*(vacant(lead, each) for each in own))
    if smooth:
        every = plan.steps + 1, plan.runs
        beliefs = vacant(every, (width,)), vacant(every, (width, width))
    record = dict(zip(REVERSED, states or (), strict=False))
    record |= zip(SMOOTHED, beliefs or (), strict=False)
    record |= zip(_CONTROLS, (slices or ()) if smooth else (), strict=False)
    owners = ahead, transition, record

    def tell(table: NamedTable) -> told.Backward:
        return told_back(plan, table, *owners)

    ended = _run(plan, ("back", *record), tell, owners, (*(states or ()), *(beliefs or ())))
    left = bool(ended[sweeps.LEFT].any())
    count(plan, [slice(0, plan.runs)] if left else [], _SINGULAR)
    return None if left else (states, beliefs, bool(ended[sweeps.KEPT].all()))


def told_back(
    plan: ChainPlan, table: NamedTable, ahead: Any, transition: Any, record: Record
) -> told.Backward:
    """A sweep back, told; see `backward`."""

    def of(name: str) -> told.Array:
        return table.of(record, itemgetter(name))

    def pair(owner: Any, one: str, other: str) -> tuple[told.Array, told.Array]:
        return table.of(owner, attrgetter(one)), table.of(owner, attrgetter(other))

    return told.Backward(
        size=plan.layout.slice_size,
        states=places(plan.layout.state_places, plan.layout.slice_size),
        known=pair(ahead, "mean", "cov"),
        predicted=pair(ahead, "predicted_mean", "predicted_cov"),
        motion=pair(transition, "matrix", "cov"),
        reversed=tuple(of(name) for name in REVERSED if name in record),
        smoothed=tuple(of(name) for name in SMOOTHED if name in record),
        controls=tuple(of(name) for name in _CONTROLS if name in record),
    )


def _run(
    plan: ChainPlan,
    key: Hashable,
    tell: Callable[[NamedTable], told.Forward | told.Backward],
    owners: Sequence[Any],
    out: Sequence[Array],
    record: Record | None = None,
    calls: Calls | None = None,
    iterations: int = 1,
) -> Array:
    """Run a sweep on all runs of a plan; returns what it tells of each, (`chain.TOLD`, runs).

    `key` is what decides its code, and `tell` tells that, if no such plan was told before. `out`
    are the arrays that it fills.
    """
    lanes = lanes_of(plan)
    first, before = (plan.steps, plan.runs, iterations), plan.layout.told
    # Arrays of one plan may lie in several ways, as those of iterations do.
    known = before.get((key, lanes), ())
    filled: Filled | None = None
    sweep: sweeps.Sweep | OnCard
    for its, form in known:
        filled = form.filled(owners, *first)
        if filled is not None:
            sweep = its
            break
    if filled is None:
        table = NamedTable(plan, lanes, owners, record, calls)
        chain = tell(table)
        filled = table.filled(*first)
        if calls is not None and calls.each:  # which are of this sweep alone
            sweep = _asking(chain, lanes, calls)
        else:
            sweep = made(plan, chain)
            if len(before) >= _TOLD:
                before.clear()
            before[key, lanes] = (sweep, table.form), *known[: _WAYS - 1]
    return run(plan, sweep, *filled, out)


def lanes_of(plan: ChainPlan) -> int:
    """How many runs of a plan are swept together, by a thread."""
    return 1 if plan.runs < sweeps.LANES or is_for_card(plan.layout.compiled) else sweeps.LANES


def made(plan: ChainPlan, chain: sweeps.Chain) -> sweeps.Sweep | OnCard:
    """The sweep of a chain of a plan, for the processor, or a card."""
    if is_for_card(plan.layout.compiled):
        return OnCard(chain)
    return sweeps.made(chain, lanes_of(plan))


def run(
    plan: ChainPlan,
    sweep: sweeps.Sweep | OnCard,
    numbers: Integers64,
    arrays: Mapping[int, npt.NDArray[Any]],
    out: Sequence[Array],
) -> Array:
    """Run a sweep of a table of numbers on all runs of a plan; returns what it tells of each.

    The result is (`chain.TOLD`, runs). The numbers have the addresses of `arrays`, by their places;
    `out` are those among them that it fills.
    """
    choice, lanes = plan.layout.compiled, lanes_of(plan)
    ended = np.zeros((sweeps.TOLD, plan.runs))
    numbers[told.ENDED] = address(ended)
    if isinstance(sweep, OnCard):
        sweep(numbers, {**arrays, told.ENDED: ended}, plan.runs)
        plan.account.on_card = True
        return ended
    threads = choice.threads if isinstance(choice, Compiled) else 1
    threads = max(min(threads, plan.runs // lanes), 1)

    def work(first: int, last: int) -> None:
        # Large pages of fresh memory are cleared once, each by one thread.
        for array in out if threads > 1 else ():
            begin, end = (runs * len(array) // plan.runs for runs in (first, last))
            array[begin:end, first:last:512] = 0.0
        sweep(address(numbers), first, last)

    in_threads(work, plan.runs, threads)
    return ended


def _asking(chain: told.Forward | told.Backward, lanes: int, calls: Calls) -> sweeps.Sweep:
    """The sweep of a chain which calls the functions that are to be called."""
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
