"""Drives from which smoothers of a chain look for other modes.

The smoothers look for modes of the posterior besides the one that the Gaussian answer fits. A
*drive* is a trajectory that the model's own CPDs make of white noise, measurements left aside. C is
the number of drives or starts for each run, T the last step, n the number of components of a slice,
n₀ that of its states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.trajectories.density import Term
from pgm.inference.audit.starts import images, white_points
from pgm.kernels.arrays import Array, Integers

# Numbers of drives from points of the prior, without the motion's noise and with it.
STEADY, NOISY = 8, 4


@dataclass(frozen=True, eq=False)
class Lanes:
    """C drives to be made: their white noise, and how long each follows the answer's means.

    first : ndarray
        (C, n₀): the white noise of the states at step 0.
    noise : ndarray
        (C,): the factor of the white noise at later steps, from 0 to 1; the noise itself is drawn
        when the drives are made.
    leave : ndarray
        (C,): the last step up to which a drive equals the answer's means; −1 for a drive that
        begins in the prior.
    """

    first: Array
    noise: Array
    leave: Integers


def starts(plan: ChainPlan, answer: Array) -> Array:
    """Trajectories (T+1, runs, C, n) from which smoothers start, the answer's means first.

    Let μ be the answer's means, `answer` (T+1, runs, n). Let ρ be the drive that begins at the
    prior's mean and has no noise, and ρ_k the drive without noise that leaves μ after step k. The
    trajectories are

    - μ itself, and ρ;
    - mirror images 2ρ − μ in all components, and in one component alone for each of the first
      four; the same about ρ_k in place of ρ, for the middle step k;
    - drives from points that fill the prior, without noise and with it.

    The same noise is drawn in each call. A trajectory that is not finite is replaced by μ.
    """
    half = plan.steps // 2
    first = np.zeros((2 + STEADY + NOISY, plan.layout.state_size))
    first[2:] = white_points(STEADY + NOISY, plan.layout.state_size)
    noise, leave = np.repeat([0.0, 1.0], [2 + STEADY, NOISY]), np.full(len(first), -1)
    leave[1] = half
    driven = drives(plan, answer, Lanes(first, noise, leave))
    reckoned, late = driven[:, :, 0], driven[:, :, 1]
    mirrored = images(answer, reckoned)
    if half:
        mirrored += images(answer, late)
    found = np.concatenate(
        [np.stack([answer, reckoned, *mirrored], axis=2), driven[:, :, 2:]], axis=2
    )
    finite = np.isfinite(found).all(axis=(0, 3))
    return np.where(finite[..., None], found, answer[:, :, None])


def drives(plan: ChainPlan, answer: Array, lanes: Lanes) -> Array:
    """The drives (T+1, runs, C, n) that `lanes` describes, from the prior or the answer's means.

    plan: The chain, whose CPDs make the drives.
    answer: The smoothed means of the Gaussian answer, (T+1, runs, n).
    """
    layout, count = plan.layout, len(lanes.first)
    size, front, places = layout.slice_size, layout.state_size, layout.state_places
    prior, transition = (
        [(link, Term.make(link.family, relative=False)) for link in links]
        for links in (plan.prior, plan.transition)
    )
    rng, found = np.random.default_rng(0), np.zeros((plan.steps + 1, plan.runs, count, size))
    states = np.zeros((plan.runs, count, 0))
    for step in range(plan.steps + 1):
        links, row = (transition, step - 1) if step else (prior, 0)
        white = lanes.noise[:, None] * rng.standard_normal((count, size)) if step else lanes.first
        start = states.shape[-1]
        vector = np.concatenate([states, np.zeros((plan.runs, count, white.shape[1]))], axis=-1)
        for link, term in links:
            own = white[:, link.child.start - start : link.child.stop - start]
            vector[..., link.child] = term.sampled(row, vector[..., link.parents], own)
        if step:
            found[step] = vector[..., front:]
        else:
            found[0][..., places] = vector
        held = lanes.leave >= step
        found[step][:, held] = answer[step][:, None]
        states = found[step][..., places]
    return found
