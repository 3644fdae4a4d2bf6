"""Dead reckoning: where motion alone leads."""

from __future__ import annotations

import numpy as np

from pgm.inference.chain import careful
from pgm.inference.chain.forward import keep_chart
from pgm.inference.chain.iteration import Point
from pgm.inference.chain.plan import ChainPlan
from pgm.kernels.arrays import Array


def dead(plan: ChainPlan) -> Point:
    """The means that the transition's functions make of the prior's, one step after another."""
    layout = plan.layout
    front, states = layout.state_size, layout.state_places
    mean = np.zeros((plan.steps + 1, plan.runs, layout.slice_size))
    mean[0][:, states] = careful.prior_mean(plan)
    pair = np.empty((plan.runs, front + layout.slice_size))
    for row in range(plan.steps):
        pair[:, :front] = mean[row][:, states]
        for link in plan.transition:
            family, parents = link.family, pair[:, link.parents]
            if family.exact:
                pair[:, link.child] = family.value(row, parents)
            else:
                pair[:, link.child] = family.bound(row, 1, parents.shape[:1])(parents)
                keep_chart(link, row, pair, pair[:, link.child])
        mean[row + 1] = pair[:, front:]
    return without_spread(plan, mean)


def without_spread(plan: ChainPlan, mean: Array) -> Point:
    """A trajectory as a point of linearisation."""
    size = plan.layout.state_size + plan.layout.slice_size
    return Point(
        mean,
        np.broadcast_to(0.0, (*mean.shape, mean.shape[-1])),
        np.broadcast_to(0.0, (plan.steps, plan.runs, size, size)),
    )
