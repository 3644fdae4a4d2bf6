"""Marginals of a chain of tables at all steps, joints of slices, and the most probable path."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.display import NoArray, Shown, Summary
from pgm.factors import Table
from pgm.factors.axes import States, discrete, sizes
from pgm.inference.chain.marginals import located
from pgm.inference.markov.chain import StateChain
from pgm.inference.markov.contraction import Move
from pgm.inference.markov.plan import SlicePlan, TableSlices
from pgm.inference.status import Kind
from pgm.inference.summaries import marginals_over_time
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.tables import MAX_PRODUCT
from pgm.progress import counted
from pgm.variables import Variable

# Beliefs over the slice by step, (*states, *runs).
Beliefs = Sequence[Array] | Array


@dataclass(frozen=True, eq=False, repr=False)
class StateMarginals(Shown, NoArray):
    """The marginals of the hidden variables of a discrete chain over all steps, by variable."""

    plan: SlicePlan
    beliefs: Beliefs
    lead: tuple[int, ...]
    kind: Kind

    def __getitem__(self, variable: Variable) -> Table:
        """The marginal of ``x`` at all its steps, stacked; of ``x.at(3)`` at one, (*runs, size)."""
        template, first = located(self.plan.layout, variable, len(self.beliefs) - 1)
        if variable.step is not None:
            values = self._summed(self.beliefs[variable.step], template)
            shape = (*self.lead, *values.shape[:1])
            return Table._plain(discrete((variable,)), frozen(values.T.reshape(shape).copy()))
        if isinstance(self.beliefs, np.ndarray):
            rows = self._summed(self.beliefs[first:], template, 1)
        else:
            rows = np.stack([self._summed(belief, template) for belief in self.beliefs[first:]])
        rows = np.moveaxis(rows, -1, 0) if self.lead else rows  # (runs, steps, size)
        shape = (*self.lead, len(self.beliefs) - first, rows.shape[-1])
        return Table._plain(discrete((template,)), frozen(rows.reshape(shape)))

    def _summed(self, belief: Array, variable: Variable, steps: int = 0) -> Array:
        """The belief over one variable, (size, *runs), behind an axis of steps if there is one."""
        if len(self.plan.slice) == 1:
            return belief
        own = self.plan.labels[variable]
        others = (k + steps for k in range(len(self.plan.slice)) if k != own)
        found: Array = belief.sum(axis=tuple(others))
        return found

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"Marginals({self.kind}, steps 0..{len(self.beliefs) - 1}{runs})"

    def _summary(self) -> Summary:
        last = len(self.beliefs) - 1
        return marginals_over_time(self._title, self, self.plan.layout, self.lead, last)


def pair(chain: StateChain, plan: SlicePlan, step: int, message: Array) -> Array:
    """The states of the step before and the slice of a step: (*states, *slice, *runs), of sum one.

    step: 1 or later.
    message: To the slice of the step, from later ones.
    """
    slices: Any = chain.slices
    semiring = chain.semiring
    belief = chain.known[step - 1]
    if plan.controls:
        belief = semiring.total(belief, plan.controls, None)
    found = plan.pairs.apply(belief, slices.factors(step, "pairs"), semiring)
    weights, _ = slices.likelihood(step)
    own = message if weights is None else semiring.times(message, weights)
    found = semiring.times(found, own)  # the slice's axes are the last before the runs
    return chain.numbers(semiring.over(found, chain.total(found)))


def potential(
    chain: StateChain, plan: SlicePlan, step: int
) -> tuple[Array, Array | None, Array | float]:
    """The transition into a step, or the prior, and the weights of the step's measurements.

    The transition is (*states, *slice, *runs), of step 0 the prior, (*slice, *runs); the weights,
    (*slice, *runs), are None where nothing is measured; last, their log-scale.
    """
    slices: Any = chain.slices
    weights, log_scale = slices.likelihood(step)
    if not step:
        return slices.prior(), weights, log_scale
    runs = chain.known[0].shape[len(plan.shape) :]
    ones = np.full((*sizes(plan.states), *runs), chain.semiring.one)
    found = plan.pairs.apply(ones, slices.factors(step, "pairs"), chain.semiring)
    return found, weights, log_scale


def joint(chain: StateChain, plan: SlicePlan, scope: States, kind: Kind) -> Array:
    """The joint of variables at steps, (sizes..., *runs), in their order.

    Forward messages carry the axes of the variables that have passed, from the first of their steps
    to the last, whose backward message ends it.
    """
    slices: TableSlices = chain.slices  # type: ignore[assignment]
    semiring, axes = chain.semiring, len(plan.shape)
    ordered = sorted(scope, key=lambda v: v.step or 0)
    step, end = ordered[0].step or 0, ordered[-1].step or 0
    array = chain.known[step]
    passed = 0
    for variable in ordered:
        while step < (variable.step or 0):
            step += 1
            array = slices.forward(step, array)
            weights, _ = slices.likelihood(step)
            if weights is not None:
                array = semiring.times(array, _behind(weights, axes, passed))
            top = array.max(axis=tuple(range(array.ndim - chain.batch)))
            array = semiring.over(array, top)
        if step < end:
            array = _kept(array, plan.labels[variable.template], axes + passed, chain)
            passed += 1
    last = kind.last(step, slices.steps)
    message = np.full(chain.known[last].shape, semiring.one)
    for before in range(last - 1, step - 1, -1):
        message = chain.back(before, message)
    array = semiring.times(array, _behind(message, axes, passed))
    here = [plan.labels[v.template] for v in ordered[passed:]]
    others = tuple(axis for axis in range(axes) if axis not in here)
    array = semiring.total(array, others, None) if others else array
    array = chain.numbers(semiring.over(array, chain.total(array)))
    # The axes that are left: variables of the last slice in its order, then those that have passed.
    stand = sorted(ordered[passed:], key=lambda v: plan.labels[v.template])
    stand += ordered[:passed]
    order = [stand.index(v) for v in scope]
    return array.transpose(*order, *range(len(order), array.ndim))


def _behind(values: Array, axes: int, passed: int) -> Array:
    return values.reshape(*values.shape[:axes], *(1,) * passed, *values.shape[axes:])


def _kept(array: Array, axis: int, place: int, chain: StateChain) -> Array:
    """An array with a second axis for a variable, equal to the first, at a place."""
    semiring, size = chain.semiring, array.shape[axis]
    same = np.where(np.eye(size, dtype=bool), semiring.one, semiring.zero)
    wide = np.expand_dims(array, place)
    shape = [1] * wide.ndim
    shape[axis] = shape[place] = size
    found: Array = semiring.times(wide, same.reshape(shape))
    return found


def most_probable_path(slices: TableSlices) -> tuple[list[Integers], Array]:
    """The states of all hidden variables on the path, and its log-probability, by max-product.

        δ_0 = ln p(x_0) l_0,    δ_t(x) = ln l_t(x) + max_x' (ln p(x | x') + δ_{t−1}(x')).

    No pointers are kept: of a state on the path the best one before it is the maximum over a single
    column, looked for on the way back.

    Returns: Of each variable of the slice its states, (runs, T+1); of a control those at step 0 are
    0. (runs,): ln p(path, measurements), of measurements not taken summed over.

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
    return tuple(k + 1 for k in controls)


def _by_run(values: Array, batch: int) -> Array:
    return np.moveaxis(values, -1, 0) if batch else values[None]


def _best(scores: Array) -> Integers:
    """The indices of the largest entry of each run, (axes, runs); the first of equals."""
    runs, *shape = scores.shape
    flat = scores.reshape(runs, -1).argmax(axis=1)
    return np.array(np.unravel_index(flat, shape), dtype=np.intp).reshape(len(shape), runs)


def _with_controls(plan: SlicePlan, before: Array, states: Integers) -> Integers:
    """The states of the whole slice: of the controls the best ones beside the states found."""
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
    """Ln p(slice | states before) of a slice with known states, (runs, *states before)."""
    plan = slices.plan
    count, runs = len(plan.slice), states.shape[1]
    total: Array = np.zeros((runs, *(v.size for v in plan.states)))
    for rows, factor in zip(slices.rows, slices.factors(step, "onward"), strict=True):
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
    return states[labels[0]] if labels[0] < count else None


def _columns(move: Move, children: Integers, parents: Integers | None) -> Array:
    """The logarithms of p(child | parent) for all parents, or for one, (runs, [parents])."""
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
    """A table of logarithms at the known states of its slice, (runs, *parents before)."""
    runs = states.shape[1]
    before = [k for k, x in enumerate(labels) if x >= count]
    now = [k for k, x in enumerate(labels) if x < count]
    by_run = table.ndim > len(labels)
    turned = table.transpose(*(len(labels),) * by_run, *now, *before)
    place = (*(np.arange(runs),) * by_run, *(states[labels[k]] for k in now))
    found: Array = turned[place]
    return found
