"""Draws of whole trajectories of a smoothed chain, from its last step back to the first.

The slice of the last step is drawn from its belief, and each slice before from the reversed chain,
p(slice at t | slice at t + 1, measurements up to t). Arrays are (T + 1, runs, draws, n), a slice
having n components.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgm.kernels import normal_density, roots
from pgm.kernels.arrays import Array, transpose
from pgm.resources import require_memory

if TYPE_CHECKING:
    from pgm.beliefs.moments.outcomes.outcome import ChainOutcome


def draws(outcome: ChainOutcome, count: int, rng: np.random.Generator) -> Array:
    """So many trajectories of slices for each run, (T + 1, runs, draws, n)."""
    mean, cov = outcome._beliefs.mean, outcome._beliefs.cov
    steps, runs, size = mean.shape
    require_memory(
        count * mean.size,
        f"{count:,} trajectories of {steps:,} steps in {runs:,} runs",
        "draw fewer at a time",
    )
    found = rng.standard_normal((steps, runs, count, size))
    if outcome._careful is not None:
        return _by_pairs(outcome, found)
    back = outcome._reverse.whole
    covs = np.concatenate([np.broadcast_to(back.cov, cov[:-1].shape), cov[-1:]])
    matrix, spread = transpose(back.matrix), transpose(roots.root(covs))
    after = np.zeros((runs, count, size))  # the slice after, less its mean
    for step in range(steps - 1, -1, -1):
        noise = found[step] @ spread[step]
        if step < steps - 1:
            noise += after @ matrix[step]
        after = noise
        np.add(noise, mean[step][:, None], out=found[step])
    return found


def _by_pairs(outcome: ChainOutcome, found: Array) -> Array:
    """The same of a pass in twice the digits, of which joints of two slices are found.

    `found` is white noise, (T + 1, runs, draws, n), in whose place the trajectories are put.
    """
    layout, steps = outcome.graph.layout, outcome.graph.steps
    mean, runs = outcome._beliefs.mean, found.shape[1]
    for step in range(steps, -1, -1):
        # A control has no step 0.
        places = np.arange(layout.slice_size) if step else layout.state_places
        own = [v.at(step) for v in (layout.slice if step else layout.states)]
        given = [v.at(step + 1) for v in layout.slice] if step < steps else []
        joint = outcome.joint(*given, *own)
        before, size = len(given) and layout.slice_size, joint.mean.shape[-1]
        lower = roots.root(joint.cov.reshape(runs, size, size))
        values = found[step][..., places] @ transpose(lower[:, before:, before:])
        if before:
            residual = found[step + 1] - mean[step + 1][:, None]
            whitened, _ = normal_density.whitened(lower[:, :before, :before], residual)
            values += whitened @ transpose(lower[:, before:, :before])
        found[step][..., places] = mean[step][:, None, places] + values
    return found
