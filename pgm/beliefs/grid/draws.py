"""Draws of whole trajectories on a grid, from the last step back to the first.

The cell of the last step is drawn from its belief; each before from the filtered belief of its
step, given the cell that was drawn after it: through the operators of the motion, from the last one
back (`moves`). Trajectories stand at the centres of cells, where the probabilities of beliefs do,
and so have the moments of these.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgm.beliefs.grid.lattice import Lattice, Window
from pgm.beliefs.grid.slices import GridModel, active, marginals
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.stochastic import Dense
from pgm.resources import require_memory

if TYPE_CHECKING:
    from pgm.beliefs.grid.outcome import GridOutcome


def draws(outcome: GridOutcome, count: int, rng: np.random.Generator) -> Array:
    """So many trajectories of each run, (T + 1, axes, draws, runs), of centres along each axis."""
    lattice, bound = outcome._lattice, outcome._bound
    steps, axes = outcome.graph.steps, len(lattice.axes)
    require_memory(
        2 * count * bound.runs * (steps + 1) * axes,
        f"{count:,} trajectories of {steps + 1:,} steps in {bound.runs:,} runs",
        "draw fewer at a time",
    )
    shape = bound.runs, steps + 1, *lattice.shape
    smoothed, filtered = (
        values.reshape(shape) for values in (outcome._values, outcome.filtered._values)
    )
    model = GridModel(lattice, outcome.graph.model, bound)
    found = np.empty((steps + 1, axes, count, bound.runs))
    for run in range(bound.runs):
        last = np.asarray(smoothed[run, -1], dtype=np.float64).reshape(1, -1)
        flat = Dense(last).draw(np.zeros(count, dtype=np.intp), rng)
        cells = np.stack(np.unravel_index(flat, lattice.shape))
        for step in range(steps, -1, -1):
            if step < steps:
                belief = np.asarray(filtered[run, step], dtype=np.float64)
                cells = _before(model, step + 1, run, belief, cells, rng)
            for k, axis in enumerate(lattice.axes):
                found[step, k, :, run] = axis.centres[cells[k]]
    return found


def _before(
    model: GridModel, step: int, run: int, belief: Array, cells: Integers, rng: np.random.Generator
) -> Integers:
    """The cells (axes, draws) of the step before, given those of a step.

    `belief` (*cells) is the filtered belief of the step before.
    """
    lattice = model.lattice
    source, _ = active(lattice, marginals(belief))
    made = model.motion.at(step, run, source)
    places = (cells - _first(made.target)) % _counts(lattice)
    places = made.sources(lattice.cut(belief, source), places, rng)
    found: Integers = (places + _first(source)) % _counts(lattice)
    return found


def _first(window: Window) -> Integers:
    """The first cell of a window along each axis, (axes, 1)."""
    return np.array([span.first for span in window])[:, None]


def _counts(lattice: Lattice) -> Integers:
    """The number of cells along each axis, (axes, 1)."""
    return np.array(lattice.shape)[:, None]
