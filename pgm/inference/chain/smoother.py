"""Iterated smoothing: sweep forward and back, relinearise everything, sweep again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.factors.scope import angle_mask
from pgm.inference.chain import backward, cost, forward, grouped
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.iteration import Anchor, Point, iterate
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.damping import LevenbergMarquardt
from pgm.inference.schedule import ONCE, Smoothing
from pgm.inference.status import Status
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Mask, block


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A forward sweep, what reverses it, and the smoothed beliefs."""

    forward: Forward
    reverse: Reverse
    beliefs: Beliefs

    @classmethod
    def of(cls, plan: ChainPlan, ahead: Forward) -> Smoothed:
        """Sweep back."""
        reverse = Reverse.make(plan, ahead)
        return cls(ahead, reverse, backward.sweep(ahead, reverse))

    @property
    def means(self) -> Array:
        """Of the slices."""
        return self.beliefs.mean

    @cached_property
    def point(self) -> Point:
        """Moments of slices and of pairs."""
        pairs = backward.pairs(self.beliefs, self.reverse, slice(None))
        return Point(self.beliefs.mean, self.beliefs.cov, pairs.cov)

    def at(self, plan: ChainPlan, mean: Array) -> Smoothed:
        """The same with other means."""
        reverse = self.reverse.moved(mean, plan.layout.state_places)
        return Smoothed(self.forward, reverse, Beliefs(mean, self.beliefs.cov))


def smooth(plan: ChainPlan, schedule: Smoothing, start: Beliefs | None) -> tuple[Smoothed, Status]:
    """Run a smoothing schedule; `start` are means of the slices for the first linearisation."""
    cost.require_cost(schedule, plan.families)
    chain, first = _Chain(plan), None
    if start is None:
        solution = Smoothed.of(plan, forward.run(plan, ONCE)[0])
    else:
        at = _start(plan, start)
        chain.linearise(at, None)
        solution = chain.solve()
        # A start need not obey exact CPDs, as what is solved for does: it has no cost.
        first = None if isinstance(schedule.damping, LevenbergMarquardt) else at
    if schedule.iterations == 1 or plan.exact:
        return solution, Status.of([], np.full(plan.runs, plan.exact), plan.lead)
    result = iterate(chain, solution, schedule, np.zeros(plan.runs, dtype=bool), first)
    smoothed = result.solution
    if not np.array_equal(result.mean, smoothed.beliefs.mean):
        smoothed = smoothed.at(plan, result.mean)
    return smoothed, Status.of(result.residuals, result.converged, plan.lead)


@dataclass(frozen=True, eq=False)
class _Chain:
    """All CPDs of a chain, to be linearised anywhere and solved."""

    plan: ChainPlan

    def linearise(self, at: Point, active: Mask | None) -> None:
        relinearise(self.plan, at, active)

    def solve(self, anchor: Anchor | None = None) -> Smoothed:
        return Smoothed.of(self.plan, forward.sweep(self.plan, anchor))

    def cost(self, at: Point) -> Array:
        return cost.trajectory(self.plan, at)


def relinearise(plan: ChainPlan, at: Point, active: Mask | None) -> None:
    """Linearise every CPD at given beliefs over its hidden parents, all steps in one call each."""
    states = plan.layout.state_places
    everything = slice(None)
    for links, (mean, cov) in ((plan.prior, at.start(states)), (plan.transition, at.pairs(states))):
        for link in links:
            family, parents = link.family, link.parents
            if family.exact or not family.step.size:
                continue
            family.linearise(everything, mean[..., parents], block(cov, parents, parents), active)
            family.to_chart(mean[..., parents], mean[..., link.child])
    for sensor in plan.sensors:
        family, parents = sensor.family, sensor.parents
        if not family.step.size:
            continue
        mean = at.mean[family.step][..., parents]
        if sensor.grouped:
            counts = np.diff(sensor.bounds)
            for count in np.unique(counts[counts > 0]):
                steps = np.flatnonzero(counts == count)
                grouped.linearise(sensor, steps, at.mean[steps], at.cov[steps], active)
        elif not family.exact:
            cov = block(at.cov[family.step], parents, parents)
            family.linearise(everything, mean, cov, active)
        sensor.move(everything, family.value(everything, mean), active)


def _start(plan: ChainPlan, start: Beliefs) -> Point:
    """A start as a point without spread, its angles without whole turns, from the prior's on."""
    layout = plan.layout
    size = layout.state_size + layout.slice_size
    joint = np.zeros((plan.steps, plan.runs, size, size))
    angles = angle_mask(layout.slice)
    angles[layout.control_places] = False
    if not angles.any():
        return Point(start.mean, start.cov, joint)
    mean = start.mean.copy()
    first, _ = forward.start(plan, linearise=True)
    prior = mean[0].copy()
    prior[:, layout.state_places] = first
    mean[0] = nearest_branch(mean[0], prior, angles)
    mean[..., angles] = np.unwrap(mean[..., angles], axis=0)
    return Point(mean, start.cov, joint)
