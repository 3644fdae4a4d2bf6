"""Passes in twice the digits by machine code.

What machine code does not know is left to NumPy's pass, and told by the plan's account. What it
finds improper NumPy's pass does again, and refuses in its own words.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.compiled.rows import motion_of
from pgm.beliefs.moments.compiled.sensors import sensor_of
from pgm.beliefs.moments.compiled.sweep import is_used
from pgm.beliefs.moments.compiled.table import Table
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.digits import laid_out, written
from pgm.beliefs.moments.digits.careful_belief import Belief, Component, Move, uncorrelated
from pgm.beliefs.moments.digits.careful_chain import regular, start, transition
from pgm.beliefs.moments.digits.careful_pass import Begin, Careful
from pgm.beliefs.moments.digits.laid_out import Maker, flat, mapped, piled, two
from pgm.beliefs.moments.digits.record import Record, Slices, at_all_steps, shown
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.passes.likelihoods import shortened
from pgm.beliefs.moments.steps import gate, refusals
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import CONTROL, Compiled
from pgm.kernels import roots
from pgm.kernels.arrays import LOG_2PI, Array, Integers, address, quiet, vacant, variances
from pgm.kernels.extended import Twofold
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.sweeps import digits, told
from pgm.kernels.machine.sweeps.chain import LANES
from pgm.resources import in_threads
from pgm.schedules.iteration import Anchor
from pgm.schedules.schedule import Filtering

# NumPy's passes take at least so many times as long as those in float64.
_TIMES = 8
# The most components of a slice: steps are straight lines, as long as the cube of it.
_MOST = 6
# A thousand operations take 15 ms to compile, or 65 to run four times faster: steps of few of them,
# or many steps, are worth that.
_SHORT, _MANY = 6_000, 20_000


def sweep(
    plan: ChainPlan,
    schedule: Filtering | None,
    anchor: Anchor | None,
    begin: Begin | None,
    gated: gate.Asked | None,
) -> Careful | None:
    """The forward pass over a plan; None if machine code does not know it, or to refuse it.

    The arguments are those of `careful.sweep`.
    """
    if not is_used(plan, _TIMES):
        return None
    try:
        found = _swept(plan, schedule, anchor, begin, gated)
    except Uncompiled as why:
        plan.account.leave(f"float64 has too few digits, and {why}")
        return None
    if found is not None:
        plan.account.compiled += 1
    return found


def _require_known(
    plan: ChainPlan, schedule: Filtering | None, anchor: Anchor | None, gated: gate.Asked | None
) -> None:
    """Raise Uncompiled for a pass that machine code does not know, but for what it linearises."""
    if anchor is not None:
        raise Uncompiled(CONTROL)
    if (gated if schedule is None else schedule.gate) is not None:
        raise Uncompiled("gates reject sightings")
    for sensor in plan.read:
        if sensor.robust and schedule is not None:
            raise Uncompiled(f"{sensor.family.cpd!r} has robust noise")
        if sensor.is_correlated:
            raise Uncompiled(f"{sensor.family.cpd!r} has several sightings in a group")
    if plan.layout.slice_size > _MOST:
        raise Uncompiled(f"a slice has more than {_MOST} components")


def _require_lines(plan: ChainPlan, schedule: Filtering, unknown: int) -> None:
    """Raise Uncompiled for functions of which machine code in twice the digits makes no lines."""
    if schedule.iterations > 1 and not plan.linear:
        raise Uncompiled("the measurements of a step are linearised again")
    if unknown:
        raise Uncompiled("functions stand beside a flat prior")
    for link in plan.transition:
        if not (link.family.exact or plan.layout.single):
            raise Uncompiled(f"{link.family.cpd!r} is one of several CPDs of a slice")
    for family in plan.families:
        if not (family.exact or family.taylor):
            raise Uncompiled(f"{family.lineariser!r} linearises {family.cpd!r}")
    for sensor in plan.read:
        noise = sensor.family.own_noise
        if np.count_nonzero(noise) > np.count_nonzero(variances(noise)):
            raise Uncompiled(f"{sensor.family.cpd!r} has correlated noise")


@quiet()
def _swept(
    plan: ChainPlan,
    schedule: Filtering | None,
    anchor: Anchor | None,
    begin: Begin | None,
    gated: gate.Asked | None,
) -> Careful | None:
    """The pass of a plan; Uncompiled if machine code does not know it, None to refuse it."""
    _require_known(plan, schedule, anchor, gated)
    if begin is None:
        belief = start(plan, linearise=schedule is not None)
        begin = Begin(belief, Twofold.zeros((plan.runs, *(belief.columns.shape[-1:] * 2))))
    else:
        belief = begin.belief
        belief = belief._replace(largest=variances(belief.cov.hi))  # as far back as the window goes
        begin = begin._replace(belief=belief)
    of = _, unknown = belief.columns.shape[-2], belief.columns.shape[-1] - 1
    bounds, table = _bounds(plan), Table(plan, _lanes(plan))
    each = partial(vacant, (plan.steps + 1, plan.runs))
    own = partial(vacant, (int(bounds[-1]), plan.runs))
    if schedule is None or (plan.exact and not any(s.variable.angles for s in plan.read)):
        lines = Lines(transition(plan, slice(None)), Scalars.of(plan))
    else:
        _require_lines(plan, schedule, unknown)
        lines = Lines.to_be_made(plan, table, own)
    predicted, known = (laid_out.belief(each, *of) for _ in range(2))
    information = two(each, 1 + unknown, 1 + unknown)
    component = laid_out.component(own, *of)._replace(row=lines.scalars.row)
    predictive, improper = own(()), own(())

    def arrays(*value: Any) -> digits.Arrays:
        return tuple(map(table.array, flat(value)))

    chain = digits.Ahead(
        prediction=written.prediction(*of),
        measurement=written.measurement(*of),
        begin=arrays(mapped(lambda part: part[None], begin)),
        move=arrays(lines.every[:3]),
        scalars=arrays(tuple(lines.scalars)),
        taken=arrays(component[1:], predictive, improper),
        bounds=table.at(bounds),
        motion=lines.motion,
        sensors=lines.sensors,
        difference=written.difference(),
        predicted=arrays(predicted),
        known=arrays(known, information),
    )
    _run(plan, chain, table)
    if improper.any() or not _is_proper(plan, predicted, known):
        return None
    now, then = (at_all_steps(each) for each in (information, _earlier(information, begin)))
    log_density = _density(component, predictive, bounds) + now.log_weight - then.log_weight
    for sensor in plan.robust:
        np.add.at(log_density, _steps(plan, sensor), sensor.weights.surplus(slice(None)))
    if not np.isfinite(log_density).all():
        return None
    ahead, after = shown(predicted, then), shown(known, now)
    mean, cov, ahead_cov = after[0], after[1].shown, ahead[1].shown
    if schedule is not None:
        judge(plan, (mean, cov), (ahead[0], ahead_cov), np.ones(plan.runs, dtype=bool))
    _require_consistent(plan, lines.scalars, component, bounds, ahead[0], ahead_cov)
    every = lines.every if lines.motion is None else transition(plan, slice(None))
    beliefs = predicted, known, information, now
    steps = Record(plan, every, *beliefs, *after, log_density, component, bounds)
    diffuse = ahead[1] if ahead[1].open.any() else None
    forward = Forward(ahead[0], ahead_cov, mean, cov, log_density, diffuse=diffuse)
    return Careful(forward, steps, known.error().max(axis=0))


def _earlier(information: Twofold, begin: Begin) -> Twofold:
    """The information before each step, from that at each."""
    first, parts = begin.information, (information.hi, information.lo)
    known = zip((first.hi, first.lo), parts, strict=True)
    return Twofold(*(np.concatenate([one[None], each[:-1]]) for one, each in known))


@quiet()
def smoothed(made: Record, last: int, first: int, count: int = 1) -> Slices:
    """The slices given the measurements up to some step, of a forward pass by machine code.

    There are `count` sweeps back: the first from step `last` to `first`, each other from and to a
    step later. A slice is of the last sweep that comes to it. Returns the slices from `first` on.
    """
    plan, (size, columns) = made.plan, made.known.columns.shape[-2:]
    of, room = (size, columns - 1), partial(vacant, (plan.steps + 1, plan.runs))
    belief, here, parts = laid_out.belief(room, *of), laid_out.later(room, *of), room((size,))
    gain, lost = two(room, size, size), room(())
    lost[...] = 0.0

    def swept(bayes: Function | None) -> None:
        table = Table(plan, _lanes(plan))

        def arrays(*value: Any) -> digits.Arrays:
            return tuple(map(table.array, flat(value)))

        chain = digits.Behind(
            smoothing=written.smoothing(*of),
            bayes=bayes,
            message=written.message(*of),
            carried=written.carried(*of),
            move=arrays(made.every.matrix, made.every.offset, made.every.cov),
            known=arrays(made.known),
            predicted=arrays(made.predicted),
            taken=arrays(made.components),
            bounds=table.at(made.bounds),
            sweeps=table.at(np.array([first, last, count], dtype=np.int64)),
            smoothed=arrays(belief, parts),
            here=arrays(here),
            gain=arrays(gain, lost),
        )
        _run(plan, chain, table)

    swept(None)
    if lost.any():
        swept(written.bayes(*of))
    found = belief, parts, here, gain, lost
    return Slices(first, *mapped(lambda part: part[first : last + count], found))


class Lines(NamedTuple):
    """The CPDs of a chain as lines, or where lines will stand as a sweep makes them.

    `every` has the transitions and `scalars` the measurements; `motion` and `sensors` are what is
    linearised.
    """

    every: Move
    scalars: Scalars
    motion: told.Motion | None = None
    sensors: tuple[told.Sensor, ...] = ()

    @classmethod
    def to_be_made(cls, plan: ChainPlan, table: Table, room: Maker) -> Lines:
        """Lines that a sweep makes of all measurements, and of a transition of one CPD."""
        size = plan.layout.slice_size
        scalars = Scalars(two(room, size), two(room), two(room), room(()))
        sensors = tuple(sensor_of(plan, s, table, stored=False, keep=True) for s in plan.read)
        link = plan.transition[0]
        if link.family.exact:
            return cls(transition(plan, slice(None)), scalars, None, sensors)
        motion = motion_of(plan, link, table, stored=False, keep=True)
        cov = regular(shortened(link.family.noise), np.zeros(size, dtype=bool))
        matrix, offset = (
            Twofold(part, np.zeros((1, 1, *part.shape[2:])))
            for part in (link.family.matrix, link.family.offset)
        )
        every = Move(matrix, offset, cov, Twofold.zeros((1, 1, size, 0)))
        return cls(every, scalars, motion, sensors)


class Scalars(NamedTuple):
    """Measurements as scalars z = h x + e with independent errors, step after step.

    `row` is h (K, runs, n), `value` z and `noise` the variance of e (K, runs); `seen` is one of
    what was measured, else zero.
    """

    row: Twofold
    value: Twofold
    noise: Twofold
    seen: Array

    @classmethod
    def of(cls, plan: ChainPlan) -> Scalars:
        """All measurements of a plan, as they are linearised."""
        size = plan.layout.slice_size
        nothing = Twofold.zeros((0, plan.runs))
        due = [cls(Twofold.zeros((0, plan.runs, size)), nothing, nothing, nothing.hi)]
        steps = [np.zeros(0, dtype=np.intp)]
        for sensor in plan.read:
            found = sensor.reading(slice(None))
            count, runs, height, _ = found.matrix.shape
            rows = Twofold.zeros((count, runs, height, size + 1))
            rows.hi[..., :-1][..., sensor.parents] = found.matrix
            rows[..., -1] = Twofold(found.value) - found.offset
            rows, noise = uncorrelated(rows, found.noise)
            seen = np.ones((count, runs, height))
            if found.taken is not None:
                seen *= found.taken
            made = cls(rows[..., :-1], rows[..., -1], noise, seen)
            due.append(mapped(_one_after_another, made))
            steps.append(np.repeat(_steps(plan, sensor), height))
        order = np.argsort(np.concatenate(steps), kind="stable")

        def ordered(part: Array) -> Array:
            found = vacant((len(order), plan.runs), part.shape[2:])
            found[...] = part[order]
            return found

        every: Scalars = mapped(ordered, piled(due, np.concatenate))
        return every


def _one_after_another(part: Array) -> Array:
    """Numbers of sightings (k, runs, d, ...) as those of their components, (k d, runs, ...)."""
    count, runs, height, *own = part.shape
    return part.swapaxes(1, 2).reshape(count * height, runs, *own)


def _steps(plan: ChainPlan, sensor: Sensor) -> Integers:
    """The step of each sighting of a sensor, counted from the plan's first."""
    return np.repeat(np.arange(plan.steps + 1), np.diff(sensor.bounds))


def _bounds(plan: ChainPlan) -> Integers:
    """The first scalar measurement of each step, and one more, (T+2,)."""
    found = np.zeros(plan.steps + 2, dtype=np.int64)
    for sensor in plan.read:
        found += np.array(sensor.bounds) * sensor.height
    return found


def _lanes(plan: ChainPlan) -> int:
    return LANES if plan.runs >= LANES else 1


def _run(plan: ChainPlan, chain: digits.Ahead | digits.Behind, table: Table) -> None:
    """Run a sweep on all runs of a plan."""
    choice, whole = plan.layout.compiled, table.whole
    many = plan.steps * plan.runs >= _MANY * table.lanes
    short = digits.length(chain) <= _SHORT or many
    made = digits.made(chain, table.lanes, 1 if short else 0)
    threads = choice.threads if isinstance(choice, Compiled) else 1
    threads = max(min(threads, plan.runs // table.lanes), 1)
    in_threads(partial(made, address(whole)), plan.runs, threads)


def _density(component: Component, predictive: Array, bounds: Integers) -> Array:
    """The log-densities (T+1, runs) of each step's measurements, at δ = 0."""
    innovation, weight = component.innovation[..., 0], component.weight
    read = weight.hi > 0.0
    level = (innovation * innovation * weight).hi + np.log(np.where(read, predictive, 1.0))
    each = np.where(read, 0.5 * (level + LOG_2PI), 0.0)
    found, counts = np.zeros((len(bounds) - 1, each.shape[1])), np.diff(bounds)
    for k in range(counts.max(initial=0)):
        steps = counts > k
        found[steps] -= each[bounds[:-1][steps] + k]
    return found


def _is_proper(plan: ChainPlan, *beliefs: Belief) -> bool:
    """Whether all beliefs are such as `refusals.belief` takes."""
    for belief in beliefs:
        for part in (belief.columns, belief.cov):
            if not np.isfinite(part.hi + part.lo).all():
                return False
    if all(family.semidefinite for family in plan.families):
        return True
    return all(roots.is_proper(roots.root(belief.cov.hi)) for belief in beliefs)


def _require_consistent(
    plan: ChainPlan,
    scalars: Scalars,
    component: Component,
    bounds: Integers,
    mean: Array,
    cov: Array,
) -> None:
    """Refuse measurements that contradict what an exact model determines, with a NumericalError.

    `mean` (T+1, runs, n) and `cov` are the predicted moments.
    """
    left = np.where(component.weight.hi > 0.0, 0.0, scalars.seen)
    left = left * np.abs(component.innovation.hi[..., 0])
    chain = MomentChain(plan, None)
    steps = np.searchsorted(bounds, np.flatnonzero(left.any(axis=1)), side="right") - 1
    for step in np.unique(steps):
        at = Moments.of(plan, mean[step], cov[step])
        parts = [part.linearise(at.mean, at.cov) for part in chain.readings(step)]
        off = left[bounds[step] : bounds[step + 1]]
        refusals.contradiction(parts, plan.first + step, at.mean, off if plan.batch else off[:, 0])
