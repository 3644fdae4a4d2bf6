"""Expected counts of the states of each CPD's family, given all measurements.

The counts of a CPD are an array with an axis for each parent, in the CPD's order, then one for the
child. A *row* is the place of a step, or of a measurement, along the first axis of the evidence's
values. A belief is (*states, [runs]): an axis for each hidden variable of a step, or of two steps,
then one of runs, which is there only if the user gave axes of runs.
"""

from typing import Any

import numpy as np

from pgm.beliefs.markov.joints import pair
from pgm.beliefs.markov.outcome import StateOutcome
from pgm.cpds import CPD
from pgm.kernels.arrays import Array, Integers


def expected_counts(posterior: StateOutcome, cpds: list[CPD]) -> dict[CPD, Array]:
    """The expected number of times that each CPD's parents and child had their states.

    cpds: CPDs of the posterior's model, for which to count; their tables are arrays of numbers, not
        functions.

    Returns: By CPD its counts, (size of each parent..., size of the child), summed over steps,
        measurements and runs.
    """
    chain, plan, bound = posterior._chain, posterior._plan, posterior._slices.bound
    model = posterior.graph.model
    counts = {cpd: np.zeros(cpd.table.shape) for cpd in cpds}  # type: ignore[attr-defined]
    prior = [cpd for cpd in model.prior if cpd in counts]
    moving = [(cpd, bound.transition[k]) for k, cpd in enumerate(model.transition) if cpd in counts]
    reading = [each for each in bound.readings if each.cpd in counts]
    ends = [np.searchsorted(each.step, np.arange(bound.steps + 2)) for each in reading]
    places = {v: k for k, v in enumerate(plan.slice)}
    message = chain.unit()
    for step in range(bound.steps, -1, -1):
        if step < bound.steps:
            message = chain.back(step, message)
        belief = chain.posterior(step, message)
        for each, end in zip(reading, ends, strict=True):
            for row in range(end[step], end[step + 1]):
                _read(counts[each.cpd], each, row, _by_run(belief, chain.batch), places)
        if not step:
            first = _by_run(belief, chain.batch)
            for cpd in prior:
                _moved(counts[cpd], cpd, {}, 0, first, places)
        elif moving:
            both = _by_run(pair(chain, plan, step, message), chain.batch)
            axes = {v.previous: k for k, v in enumerate(plan.states)}
            axes |= {v: len(axes) + k for k, v in enumerate(plan.slice)}
            for cpd, inputs in moving:
                _moved(counts[cpd], cpd, inputs, step - 1, both, axes)
    return counts


def _by_run(belief: Array, batch: int) -> Array:
    """A belief (*states, [runs]) as (runs, *states); `batch` counts its axes of runs, 1 or 0."""
    return np.moveaxis(belief, -1, 0) if batch else belief[None]


def _marginal(belief: Array, wanted: list[int]) -> Array:
    """The marginal of a belief (runs, *states) over some axes, (runs, ...), in the order given.

    `wanted` are the axes, counted from the first one of states.
    """
    others = tuple(1 + k for k in range(belief.ndim - 1) if k not in wanted)
    left = [k for k in range(belief.ndim - 1) if k in wanted]
    found: Array = belief.sum(axis=others)
    return found.transpose(0, *(1 + left.index(k) for k in wanted))


def _states(rows: Any, row: int, runs: int) -> Integers:
    """The states of a variable at one row of its values, for all runs, (runs,).

    `rows` are the indices of its states at all rows, (rows, runs or 1, 1).
    """
    return np.broadcast_to(rows[row, :, 0], runs)


def _moved(
    counts: Array, cpd: Any, inputs: Any, row: int, belief: Array, axes: dict[Any, int]
) -> None:
    """Add p(parents, child | all measurements) of a CPD at one step to its counts, in place.

    counts: (size of each parent..., size of the child).
    inputs: For each parent that is not hidden the indices of its states, (rows, runs or 1, 1);
        empty if all parents are hidden.
    row: The row of the step in `inputs`.
    belief: (runs, *states), given all measurements, over at least the hidden variables of the CPD.
    axes: The axis of each hidden variable, counted from the first one of states.
    """
    family = (*cpd.given, cpd.child)
    found = _marginal(belief, [axes[v] for v in family if v in axes])
    runs = len(found)
    for run in range(runs) if inputs else (slice(None),):
        at = tuple(
            slice(None) if v in axes else int(_states(inputs[v], row, runs)[run]) for v in family
        )
        counts[at] += found[run] if inputs else found.sum(axis=0)


def _read(counts: Array, reading: Any, row: int, belief: Array, axes: dict[Any, int]) -> None:
    """Add p(parents, z | all measurements) of a sensor z at one measurement to its counts.

    counts: (size of each parent..., size of the sensor), changed in place.
    reading: All measurements of the sensor, with its CPD and, as its inputs, the states of the
        parents that are not hidden.
    row: The place of the measurement among those of the sensor.
    belief: (runs, *states), given all measurements, over at least the hidden parents.
    axes: The axis of each hidden variable, counted from the first one of states.

    Where a state z was measured, its counts grow by p(parents | all measurements). With soft
    evidence, a weight w(z) for each state of the sensor, the counts of each state z grow by a share
    of this instead: p(z | parents) w(z) / Σ_z' p(z' | parents) w(z'). Runs in which the measurement
    is missing add nothing.
    """
    cpd, runs = reading.cpd, len(belief)
    found = _marginal(belief, [axes[v] for v in cpd.given if v in axes])
    taken = np.broadcast_to(reading.taken[row, :, 0], runs)
    soft = reading.values.dtype.kind == "f"
    for run in np.flatnonzero(taken):
        at: tuple[Any, ...] = tuple(
            slice(None) if v in axes else int(_states(reading.inputs[v], row, runs)[run])
            for v in cpd.given
        )
        if soft:
            weights = np.broadcast_to(reading.values[row], (runs, cpd.child.size))[run]
            joint = cpd.table[at] * weights
            total = joint.sum(axis=-1, keepdims=True)
            share = joint / np.where(total > 0.0, total, 1.0)
            counts[at] += found[run][..., None] * share
        else:
            counts[(*at, int(_states(reading.values, row, runs)[run]))] += found[run]
