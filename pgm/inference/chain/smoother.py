"""Iterated smoothing: sweep forward and back, relinearise everything, sweep again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.factors.scope import angle_mask
from pgm.inference.chain import backward, forward, grouped
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.schedule import Calibration, Status
from pgm.kernels import moments
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Mask, block


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What a smoothing leaves."""

    forward: Forward
    reverse: Reverse
    beliefs: Beliefs
    status: Status


def smooth(plan: ChainPlan, schedule: Calibration, start: Beliefs | None) -> Smoothed:
    """Run a smoothing schedule; `start` are means of the slices for the first linearisation."""
    if start is not None:
        start = _on_chart(plan, start)
        relinearise(plan, start, _start_pairs(plan, start), None)
    ahead = forward.sweep(plan, linearise=start is None)
    reverse = Reverse.make(plan, ahead)
    beliefs = backward.sweep(ahead, reverse)
    residuals: list[Array] = []
    converged = np.full(plan.runs, plan.exact)
    while len(residuals) + 1 < schedule.iterations and not converged.all():
        relinearise(plan, beliefs, backward.pairs(beliefs, reverse, slice(None)), ~converged)
        before = beliefs
        ahead = forward.sweep(plan, linearise=False)
        reverse = Reverse.make(plan, ahead)
        beliefs = backward.sweep(ahead, reverse)
        std = np.sqrt(np.maximum(np.diagonal(beliefs.cov, axis1=-2, axis2=-1), 0.0))
        residuals.append(moments.marginal_error(beliefs.mean, before.mean, std))
        converged = converged | (residuals[-1] <= schedule.tolerance)
    shape = (len(residuals), *plan.lead)
    status = Status(
        len(residuals) + 1,
        np.array(residuals).reshape(shape),
        converged.reshape(plan.lead),
    )
    return Smoothed(ahead, reverse, beliefs, status)


def relinearise(plan: ChainPlan, beliefs: Beliefs, pairs: Beliefs, active: Mask | None) -> None:
    """Linearise every CPD at given beliefs over its hidden parents, all steps in one call each."""
    layout = plan.layout
    states = layout.state_places
    start = Beliefs(beliefs.mean[:1][..., states], block(beliefs.cov[:1], states, states))
    everything = slice(None)
    for links, at in ((plan.prior, start), (plan.transition, pairs)):
        for link in links:
            family, parents = link.family, link.parents
            if family.exact or not family.step.size:
                continue
            mean = at.mean[..., parents]
            family.linearise(everything, mean, block(at.cov, parents, parents), active)
            family.to_chart(mean, at.mean[..., link.child])
    for sensor in plan.sensors:
        family, parents = sensor.family, sensor.parents
        if not family.step.size:
            continue
        mean = beliefs.mean[family.step][..., parents]
        if sensor.grouped:
            counts = np.diff(sensor.bounds)
            for count in np.unique(counts[counts > 0]):
                steps = np.flatnonzero(counts == count)
                grouped.linearise(sensor, steps, beliefs.mean[steps], beliefs.cov[steps], active)
        elif not family.exact:
            cov = block(beliefs.cov[family.step], parents, parents)
            family.linearise(everything, mean, cov, active)
        kept = sensor.moved.copy()
        sensor.move(everything, family.value(everything, mean))
        if active is not None:
            sensor.moved[:, ~active] = kept[:, ~active]


def _on_chart(plan: ChainPlan, start: Beliefs) -> Beliefs:
    """A start whose angles run on without whole turns, from the prior's on."""
    layout = plan.layout
    angles = angle_mask(layout.slice)
    angles[layout.control_places] = False
    if not angles.any():
        return start
    mean = start.mean.copy()
    first, _ = forward.start(plan, linearise=True)
    prior = mean[0].copy()
    prior[:, layout.state_places] = first
    mean[0] = nearest_branch(mean[0], prior, angles)
    mean[..., angles] = np.unwrap(mean[..., angles], axis=0)
    return Beliefs(mean, start.cov)


def _start_pairs(plan: ChainPlan, start: Beliefs) -> Beliefs:
    mean = np.concatenate([start.mean[:-1][..., plan.layout.state_places], start.mean[1:]], axis=-1)
    return Beliefs(mean, np.zeros((*mean.shape, mean.shape[-1])))
