"""Joints of the variables of several slices, made only where they are asked for.

A *slice* is the hidden variables of a step: states, and controls, which the next slice does not
depend on. Arrays have an axis for each hidden variable, then one of runs, or none where the user
gave none; in (*states, *slice, *runs) the first axes are those of the states one step before. Their
entries are numbers or logarithms, as the *semiring* of the chain has them.
"""

from typing import Any

import numpy as np

from pgm.beliefs.markov.chain import StateChain
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.factors.axes import States, discrete, require_axes, sizes
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import Kind


def pair(chain: StateChain, plan: SlicePlan, step: int, message: Array) -> Array:
    """The joint of the states one step before and a step's slice, (*states, *slice, *runs).

    Its entries are probabilities, of sum one, given the measurements up to the step, and the later
    ones from which the message was made.

    step: The step of the slice, 1 or later.
    message: The backward message to the slice, from measurements after the step, (*slice, *runs).
    """
    _require_pairs(plan)
    slices: Any = chain.slices
    semiring = chain.semiring
    belief = chain.known[step - 1]
    if plan.controls:
        belief = semiring.total(belief, plan.controls)
    found = slices.through(plan.pairs, step, belief)
    weights, _ = slices.likelihood(step)
    own = message if weights is None else semiring.times(message, weights)
    found = semiring.times(found, own)  # the slice's axes are the last before the runs
    return chain.numbers(semiring.over(found, chain.total(found)))


def _require_pairs(plan: SlicePlan) -> None:
    """Refuse, by a `GraphError`, slices two of which have more variables than arrays have axes."""
    before = discrete(tuple(v.previous for v in plan.states))
    require_axes((*before, *plan.slice), "the joint of two steps")


def potential(
    chain: StateChain, plan: SlicePlan, step: int
) -> tuple[Array, Array | None, Array | float]:
    """The transition into a step, or the prior, and the weights of the step's measurements.

    All measurements of the evidence count, even impossible ones that the chain has left out.

    Returns, in entries of the chain's semiring: p(slice | states before), (*states, *slice, *runs),
    or at step 0 p(states), (*slice, *runs); the weights, (*slice, *runs), None where nothing is
    measured; the log-scale of the weights.
    """
    slices: Any = chain.slices
    weights, log_scale = slices.given_likelihood(step)
    if not step:
        return slices.prior(), weights, log_scale
    _require_pairs(plan)
    runs = chain.known[0].shape[len(plan.shape) :]
    ones = np.full((*sizes(plan.states), *runs), chain.semiring.one)
    found = slices.through(plan.pairs, step, ones)
    return found, weights, log_scale


def joint(chain: StateChain, plan: SlicePlan, scope: States, kind: Kind) -> Array:
    """The joint probabilities of variables at steps, (sizes..., *runs), in the order of `scope`.

    `scope` are hidden variables, each at a step, as ``x.at(3)``. The joint is given the
    measurements that a belief of the same `kind` (filtered, fixed-lag, smoothed) is given at the
    latest of these steps. A forward message goes from the first of the steps to the latest, and
    keeps the variables of the scope that it passes. At the latest step it is multiplied by the
    backward message.
    """
    slices: TableSlices = chain.slices  # type: ignore[assignment]
    semiring, axes = chain.semiring, len(plan.shape)
    at: dict[int, States] = {}
    for variable in scope:
        at[variable.step or 0] = (*at.get(variable.step or 0, ()), variable)
    passed: States = ()
    array = chain.known[min(at)]
    end = max(at)
    for step in range(min(at) + 1, end + 1):
        kept = at.get(step - 1, ())
        if kept:
            array = slices.keeping(step, array, tuple([plan.labels[v.template] for v in kept]))
            passed = (*kept, *passed)
        else:
            array = slices.forward(step, array)
        weights, _ = slices.likelihood(step)
        if weights is not None:
            array = semiring.times(array, _behind(weights, axes, len(passed)))
        top = array.max(axis=tuple(range(array.ndim - chain.batch)))
        array = semiring.over(array, top)
    last = kind.last(end, slices.steps)
    message = np.full(chain.known[last].shape, semiring.one)
    for before in range(last - 1, end - 1, -1):
        message = chain.back(before, message)
    array = semiring.times(array, _behind(message, axes, len(passed)))
    here = {plan.labels[v.template]: v for v in at[end]}
    others = tuple(axis for axis in range(axes) if axis not in here)
    array = semiring.total(array, others) if others else array
    array = chain.numbers(semiring.over(array, chain.total(array)))
    # The axes that are left: variables of the last slice in its order, then those that have passed.
    stand = [*(here[label] for label in sorted(here)), *passed]
    order = [stand.index(v) for v in scope]
    return array.transpose(*order, *range(len(order), array.ndim))


def _behind(values: Array, axes: int, passed: int) -> Array:
    """Values over a slice with further axes of length one, for variables of earlier slices.

    values: (*slice, *runs), with `axes` axes of the slice; they become (*slice, 1..., *runs).
    passed: The number of variables of earlier slices, and of new axes.
    """
    return values.reshape(*values.shape[:axes], *(1,) * passed, *values.shape[axes:])
