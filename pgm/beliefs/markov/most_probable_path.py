"""The most probable path of a chain of tables: max-product messages, traced back.

A *slice* is the hidden variables of a step: states, and controls, which the next slice does not
depend on. An array (runs, *slice) has an axis for each of them after that of runs; an axis in
brackets, [runs], may be absent. A *label* is the number of a variable: those of the slice have the
numbers of their axes, from 0 on; the states of the slice before have the numbers that follow. A
*map* is the table of a CPD with one hidden parent, kept as a matrix (`Move`).
"""

from typing import Any

import numpy as np

from pgm.beliefs.markov.chain import StateChain
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.elimination import Move
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import MAX_PRODUCT
from pgm.progress import counted


def most_probable_path(slices: TableSlices) -> tuple[list[Integers], Array]:
    """The states of all hidden variables on the path, and its log-probability, by max-product.

        δ_0 = ln p(x_0) l_0,    δ_t(x) = ln l_t(x) + max_x' (ln p(x | x') + δ_{t−1}(x')).

    Here l_t(x) = p(z_t | x) is the likelihood of the measurements of step t. No pointers are kept:
    the best state before a state on the path is the maximum over a single column, looked for on the
    way back.

    Returns: A list of the states of each variable of the slice, (runs, T + 1), where controls have
    0 at step 0; and ln p(path, measurements), (runs,), summed over sensors that were not measured.

    Source: Viterbi, Error bounds for convolutional codes, 1967; Koller & Friedman, section 13.3.
    """
    own = slices.within(MAX_PRODUCT)
    chain = StateChain(own, MAX_PRODUCT).run()
    plan, runs = slices.plan, slices.bound.runs
    path = np.zeros((len(plan.slice), runs, slices.steps + 1), dtype=np.intp)
    states = _best(_by_run(chain.known[-1], chain.batch))
    path[:, :, -1] = states
    for step in counted(range(slices.steps, 0, -1), "back"):
        before = _by_run(chain.known[step - 1], chain.batch)
        scores = before.max(axis=_axes(plan.controls), keepdims=True)
        scores = scores.reshape(runs, *(v.size for v in plan.states)) + _scores(own, step, states)
        places = _best(scores)
        states = _with_controls(plan, before, places)
        path[:, :, step - 1] = states
    log_probability = chain.log_density.reshape(slices.steps + 1, -1).sum(axis=0)
    return list(path), np.broadcast_to(log_probability, runs)


def _axes(controls: tuple[int, ...]) -> tuple[int, ...]:
    """The axes of controls in a belief (runs, *slice), from those in a belief (*slice)."""
    return tuple(k + 1 for k in controls)


def _by_run(values: Array, batch: int) -> Array:
    """Values (..., [runs]) as (runs, ...); `batch` counts their axes of runs, 1 or 0."""
    return np.moveaxis(values, -1, 0) if batch else values[None]


def _best(scores: Array) -> Integers:
    """The indices of the largest entry of each run, (axes, runs); the first of equals.

    `scores` is (runs, ...).
    """
    runs, *shape = scores.shape
    flat = scores.reshape(runs, -1).argmax(axis=1)
    return np.array(np.unravel_index(flat, shape), dtype=np.intp).reshape(len(shape), runs)


def _with_controls(plan: SlicePlan, before: Array, states: Integers) -> Integers:
    """The given states of a slice's state variables, with the most probable states of its controls.

    before: The forward message over the slice, as logarithms, (runs, *slice).
    states: The given states, (state variables, runs).

    Returns: The states of all variables of the slice, (variables, runs). Controls have the states
    for which `before` is largest at the given states.
    """
    if not plan.controls:
        return states
    runs = before.shape[0]
    each = np.arange(runs)
    held = [k for k in range(len(plan.slice)) if k not in plan.controls]
    turned = before.transpose(0, *(k + 1 for k in (*held, *plan.controls)))
    found = np.zeros((len(plan.slice), runs), dtype=np.intp)
    found[held] = states
    found[list(plan.controls)] = _best(turned[(each, *states)])
    return found


def _scores(slices: TableSlices, step: int, states: Integers) -> Array:
    """The values ln p(slice | states before) for all states before, (runs, *states before).

    The slice is that of `step`, in known states: `states` (variables of the slice, runs).
    """
    plan = slices.plan
    count, runs = len(plan.slice), states.shape[1]
    total: Array = np.zeros((runs, *(v.size for v in plan.states)))
    for rows, factor in zip(slices.rows, slices.factors(step, plan.onward), strict=True):
        labels: tuple[int, ...] = rows.labels
        before = [x for x in labels if x >= count]
        if isinstance(factor, Move):
            own = _columns(factor, states[labels[-1]], _known_parent(labels, states, count))
        else:
            own = _selected(factor, labels, states, count)
        shape = [runs, *(1,) * len(plan.states)]
        order = np.argsort(before)
        for x in before:
            shape[1 + x - count] = plan.sizes[x]
        total = total + own.transpose(0, *(order + 1)).reshape(shape)
    return total


def _known_parent(labels: tuple[int, ...], states: Integers, count: int) -> Integers | None:
    """The states of a map's parent, (runs,), if it is in the same slice as the child.

    None if it is in the slice before, whose states are not known yet.

    labels: The labels of the map's parent and child.
    states: Of the variables of the slice, (variables, runs).
    count: The number of these variables; labels from it on are of the slice before.
    """
    return states[labels[0]] if labels[0] < count else None


def _columns(move: Move, children: Integers, parents: Integers | None) -> Array:
    """The values ln p(child | parent) of a map, at each run's state of the child.

    children: The states of the child, (runs,).
    parents: The states of the parent, (runs,); None if they are not known yet.

    Returns: The values at these states, (runs,); for all states of the parent if `parents` is None,
    (runs, states of the parent).
    """
    runs = len(children)
    found: Array | None = None
    with np.errstate(divide="ignore"):
        for each, of in move.maps:
            here: Any = slice(None) if of is None else of
            own = np.log(
                each.parents(children[here])
                if parents is None
                else each.entries(parents[here], children[here])
            )
            if found is None:
                found = np.empty((runs, *own.shape[1:]))
            found[here] = own
    assert found is not None
    return found


def _selected(table: Array, labels: tuple[int, ...], states: Integers, count: int) -> Array:
    """A table of logarithms where the variables of a slice have known states.

    It is left with axes of its parents in the slice before, (runs, *parents before).

    table: (size of each label..., [runs]); without an axis of runs it is that of all runs.
    labels: The labels of the variables of its axes.
    states: Of the variables of the slice, (variables, runs).
    count: The number of these variables; labels from it on are of the slice before.
    """
    runs = states.shape[1]
    before = [k for k, x in enumerate(labels) if x >= count]
    now = [k for k, x in enumerate(labels) if x < count]
    by_run = table.ndim > len(labels)
    turned = table.transpose(*(len(labels),) * by_run, *now, *before)
    place = (*(np.arange(runs),) * by_run, *(states[labels[k]] for k in now))
    found: Array = turned[place]
    return found
