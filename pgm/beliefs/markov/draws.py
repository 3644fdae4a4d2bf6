"""Draws of whole paths of a chain of tables, from its last step back to the first.

The slice of the last step is drawn from its belief; each slice before from the joint of two steps
given the measurements up to the later one, in the column of the slice that was drawn there. Paths
are (T + 1, count, runs), each slice by the number of its joint state.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pgm.beliefs.markov.joints import pair
from pgm.errors import EvidenceError
from pgm.factors.axes import sizes
from pgm.kernels.arrays import Array, Integers, unravelled
from pgm.kernels.stochastic import Dense
from pgm.resources import require_memory
from pgm.schedules.limits import require_runs
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.markov.outcome import StateOutcome
    from pgm.beliefs.markov.plan import SlicePlan


def draws(outcome: StateOutcome, count: int, rng: np.random.Generator) -> dict[Variable, Integers]:
    """So many paths of each variable, (steps, count, runs): states of 0..T, controls of 1..T."""
    if outcome._lost is not None:
        raise EvidenceError(
            "the measurements of some runs have probability zero, of which there are no draws; "
            "leave these runs out"
        )
    plan, chain, steps = outcome._plan, outcome._chain, outcome.graph.steps
    runs = outcome._slices.bound.runs
    size, width = math.prod(plan.shape), math.prod(sizes(plan.states))
    require_memory(
        count * runs * (steps + 1) * len(plan.slice),
        f"{count:,} paths of {steps + 1:,} steps in {runs:,} runs",
        "draw fewer at a time",
    )
    if steps:
        require_runs(width * size, runs, "the joint of two steps")
    path = np.empty((steps + 1, count, runs), dtype=np.intp)
    belief = outcome._beliefs[steps].reshape(1, size, -1)
    path[steps] = _picked(belief, np.zeros((count, runs), dtype=np.intp), rng)
    message = chain.unit()
    places = [plan.slice.index(v) for v in plan.states]
    for step in range(steps - 1, -1, -1):
        joint = pair(chain, plan, step + 1, message).reshape(width, size, -1).swapaxes(0, 1)
        states = _picked(joint, path[step + 1], rng)
        if not plan.controls:
            path[step] = states
            continue
        if not step:  # at which there are no controls
            path[0] = _together(plan, places, states, np.zeros_like(states))
            continue
        # The controls of the step, given its states, by the belief before later measurements.
        known = outcome._filtered[step].reshape(*plan.shape, -1)
        known = np.moveaxis(known, places, range(len(places))).reshape(width, size // width, -1)
        rest = _picked(known, states, rng)
        path[step] = _together(plan, places, states, rest)
    found: dict[Variable, Integers] = {}
    for place, (variable, own) in enumerate(
        zip(plan.slice, unravelled(path, plan.shape), strict=True)
    ):
        found[variable] = own if place in places else own[1:]
    return found


def _together(plan: SlicePlan, places: list[int], states: Integers, rest: Integers) -> Integers:
    """The numbers of slices whose states, and whose controls, have these numbers."""
    shape = plan.shape
    others = [k for k in range(len(shape)) if k not in places]
    each = np.empty((len(shape), *states.shape), dtype=np.intp)
    each[places] = unravelled(states, tuple(shape[k] for k in places))
    each[others] = unravelled(rest, tuple(shape[k] for k in others))
    found: Integers = np.ravel_multi_index(tuple(each), shape)
    return found


def _picked(table: Array, column: Integers, rng: np.random.Generator) -> Integers:
    """Draws of the rows of columns (count, runs), by a table (columns, rows, runs or 1)."""
    columns, rows, own = table.shape
    by_column = Dense(np.moveaxis(table, -1, 0).reshape(own * columns, rows))
    run = np.arange(own)
    return by_column.draw(run * columns + column, rng)
