"""Passes in twice the digits by machine code.

What machine code does not know is left to NumPy's pass, and told by the plan's account. What it
finds improper NumPy's pass does again, and refuses in its own words.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.compiled.plans import (
    Table,
    Uncompiled,
    address,
    motion_of,
    sensor_of,
)
from pgm.beliefs.moments.compiled.sweep import is_used
from pgm.beliefs.moments.digits import laid_out, written
from pgm.beliefs.moments.digits.careful_belief import Belief, Component, Move, uncorrelated
from pgm.beliefs.moments.digits.careful_chain import start, transition
from pgm.beliefs.moments.digits.careful_pass import Begin, Careful
from pgm.beliefs.moments.digits.laid_out import flat, mapped, two
from pgm.beliefs.moments.digits.record import Record, Slices, at_all_steps, shown
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.steps import gate, refusals
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.compile.machine import CONTROL, Compiled
from pgm.kernels import roots
from pgm.kernels.arrays import LOG_2PI, Array, Integers, quiet, vacant, variances
from pgm.kernels.extended import Twofold
from pgm.kernels.machine import digits, told
from pgm.kernels.machine.sweeps import LANES
from pgm.resources import in_threads
from pgm.schedules.iteration import Anchor
from pgm.schedules.schedule import Filtering

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
    if not is_used(plan):
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
        if sensor.robust:
            raise Uncompiled(f"{sensor.family.cpd!r} has robust noise")
        if sensor.grouped and max(np.diff(sensor.bounds)) > 1:
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
    steps, runs = plan.steps + 1, plan.runs
    if begin is None:
        belief = start(plan, linearise=schedule is not None)
        begin = Begin(belief, Twofold.zeros((runs, *(belief.columns.shape[-1:] * 2))))
    else:
        belief = begin.belief
        belief = belief._replace(largest=variances(belief.cov.hi))  # as far back as the window goes
        begin = begin._replace(belief=belief)
    size, unknown = belief.columns.shape[-2], belief.columns.shape[-1] - 1
    every, bounds = transition(plan, slice(None)), _bounds(plan)
    each, own = partial(vacant, (steps, runs)), partial(vacant, (int(bounds[-1]), runs))
    table = Table(plan, _lanes(plan))
    motion, sensors = None, ()
    turned = any(sensor.variable.angles for sensor in plan.read)
    if schedule is None or (plan.exact and not turned):
        scalars = Scalars.of(plan)
    else:
        _require_lines(plan, schedule, unknown)
        scalars = Scalars(two(own, size), two(own), two(own), own(()))
        cpds = {"stored": False, "keep": True}
        sensors = tuple(sensor_of(plan, sensor, table, **cpds) for sensor in plan.read)
        if plan.transition and not plan.transition[0].family.exact:
            link = plan.transition[0]
            motion = motion_of(plan, link, table, **cpds)
            every = every._replace(
                matrix=_bare(link.family.matrix), offset=_bare(link.family.offset)
            )
    predicted, known = (laid_out.belief(each, size, unknown) for _ in range(2))
    information = two(each, 1 + unknown, 1 + unknown)
    component = laid_out.component(own, size, unknown)._replace(row=scalars.row)
    predictive, improper = own(()), own(())

    def arrays(*value: Any) -> digits.Arrays:
        return tuple(map(table.array, flat(value)))

    chain = digits.Ahead(
        prediction=written.prediction(size, unknown),
        measurement=written.measurement(size, unknown),
        begin=arrays(mapped(lambda part: part[None], begin)),
        move=arrays(every.matrix, every.offset, every.cov),
        scalars=arrays(scalars.row, scalars.value, scalars.noise, scalars.seen),
        taken=arrays(component[1:], predictive, improper),
        bounds=table.at(bounds),
        motion=motion,
        sensors=sensors,
        difference=written.difference(),
        predicted=arrays(predicted),
        known=arrays(known, information),
    )
    _run(plan, chain, table)
    first = begin.information
    earlier = Twofold(
        np.concatenate([first.hi[None], information.hi[:-1]]),
        np.concatenate([first.lo[None], information.lo[:-1]]),
    )
    now, then = at_all_steps(information), at_all_steps(earlier)
    log_density = _density(component, predictive, bounds) + now.log_weight - then.log_weight
    moments = *shown(predicted, then), *shown(known, now)
    sound = np.isfinite(log_density).all() and not improper.any()
    if not sound or not _is_proper(plan, predicted, known):
        return None
    if schedule is not None:
        judge(
            plan,
            (moments[2], moments[3].cov),
            (moments[0], moments[1].cov),
            np.ones(runs, dtype=bool),
        )
    _require_consistent(plan, scalars, component, bounds, moments[0], moments[1])
    if motion is not None:
        every = transition(plan, slice(None))
    made = Record(
        plan,
        every,
        predicted,
        known,
        information,
        now,
        *moments[2:],
        log_density,
        component,
        bounds,
    )
    ahead = moments[1] if moments[1].open.any() else None
    covs = moments[1].shown, moments[3].shown
    forward = Forward(moments[0], covs[0], moments[2], covs[1], log_density, diffuse=ahead)
    return Careful(forward, made, known.error().max(axis=0))


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

    def swept(bayes: told.Function | None) -> None:
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
        size, due = plan.layout.slice_size, []
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
            steps = np.repeat(np.arange(plan.steps + 1), np.diff(sensor.bounds))
            due.append((np.repeat(steps, height), rows[..., :-1], rows[..., -1], noise, seen))
        if not due:
            nothing = np.zeros((0, plan.runs))
            return cls(Twofold(np.zeros((0, plan.runs, size))), *(Twofold(nothing),) * 2, nothing)
        order = np.argsort(np.concatenate([steps for steps, *_ in due]), kind="stable")

        def joined(*parts: Array) -> Array:
            wide = [part.swapaxes(1, 2).reshape(-1, plan.runs, *part.shape[3:]) for part in parts]
            found = vacant((len(order), plan.runs), wide[0].shape[2:])
            found[...] = np.concatenate(wide)[order]
            return found

        def both(*parts: Twofold) -> Twofold:
            return Twofold(*(joined(*(getattr(each, k) for each in parts)) for k in ("hi", "lo")))

        _, rows, values, noises, seen = zip(*due, strict=True)
        return cls(both(*rows), both(*values), both(*noises), joined(*seen))


def _bare(array: Array) -> Twofold:
    """Numbers of float64 as pairs, whose low parts are one zero for all rows and runs."""
    return Twofold(array, np.zeros((1, 1, *array.shape[2:])))


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
    short = digits.length(chain) <= _SHORT or plan.steps * plan.runs >= _MANY
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
    spread: Diffuse,
) -> None:
    """Refuse measurements that contradict what an exact model determines, with a NumericalError.

    `mean` (T+1, runs, n) and `spread` are the predicted moments.
    """
    left = np.where(component.weight.hi > 0.0, 0.0, scalars.seen)
    left = left * np.abs(component.innovation.hi[..., 0])
    chain = MomentChain(plan, None)
    steps = np.searchsorted(bounds, np.flatnonzero(left.any(axis=1)), side="right") - 1
    for step in np.unique(steps):
        at = Moments.of(plan, mean[step], spread.at(step).shown)
        parts = [part.linearise(at.mean, at.cov) for part in chain.readings(step)]
        off = left[bounds[step] : bounds[step + 1]]
        refusals.contradiction(parts, plan.first + step, at.mean, off if plan.batch else off[:, 0])
