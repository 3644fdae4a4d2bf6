"""Dead reckoning: where motion alone leads."""

from __future__ import annotations

import numpy as np

from pgm.inference.chain import careful_motion
from pgm.inference.chain.iteration import Point
from pgm.inference.chain.moments import on_chart, turns_far
from pgm.inference.chain.plan import ChainPlan
from pgm.kernels.arrays import Array, components_first, components_last


def dead(plan: ChainPlan) -> Point:
    """The means that the transition's functions make of the prior's, one step after another."""
    layout = plan.layout
    front, states = layout.state_size, layout.state_places
    mean = np.zeros((plan.steps + 1, plan.runs, layout.slice_size))
    mean[0][:, states] = careful_motion.prior_mean(plan)
    rows = mean.transpose(0, 2, 1) if plan.batch else mean[:, 0]
    pair = np.empty((front + layout.slice_size, *plan.batch))
    for row in range(plan.steps):
        pair[:front] = rows[row][states]
        for link in plan.transition:
            at, parents = link.family.at(row, row + 1), pair[link.parents]
            if at.function is None:
                pair[link.child] = link.family.line(at, parents, parents).value
            else:
                value = components_first(at.function(components_last(parents, 1)), 1)
                turns = link.turning and turns_far(link, pair, value)
                pair[link.child] = on_chart(link, at, pair, value) if turns else value
        rows[row + 1] = pair[front:]
    return without_spread(plan, mean)


def without_spread(plan: ChainPlan, mean: Array) -> Point:
    """A trajectory as a point of linearisation."""
    size = plan.layout.state_size + plan.layout.slice_size
    return Point(
        mean,
        np.broadcast_to(0.0, (*mean.shape, mean.shape[-1])),
        np.broadcast_to(0.0, (plan.steps, plan.runs, size, size)),
    )
