"""The slices of a discrete dynamic network with evidence, and the tables of its CPDs at each step.

A *slice* is the hidden variables of a step, states and controls. Arrays have an axis for each
hidden variable, then one of runs, or none where the user gave no axes of runs. A *row* is a step's
place in the values of inputs. A *map* is the table of a CPD with one hidden parent as a matrix that
is applied along the parent's axis (`Move`). Messages are sums of products of tables, by a plan of
elimination. Entries of arrays are numbers or logarithms, added by sums or maxima, as a *semiring*
has it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NoReturn, cast

import numpy as np

from pgm.beliefs.markov.density_weights import DensityWeights
from pgm.beliefs.markov.input_tables import InputTables, smallest_entry
from pgm.beliefs.markov.sensor_weights import SensorWeights
from pgm.beliefs.markov.weights import Weights
from pgm.compile import SliceLayout
from pgm.cpds import TableCPD
from pgm.elimination import (
    Entries,
    Label,
    Move,
    Plan,
    Scope,
    TableAlgebra,
    eliminate,
    next_smallest,
)
from pgm.evidence import BoundEvidence
from pgm.factors.axes import AXES, discrete, sizes
from pgm.factors.scope import in_run
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import SUM_PRODUCT, Semiring
from pgm.kernels.stochastic import Dense
from pgm.schedules.impossible import ImpossibleEvidence
from pgm.variables import Discrete, Variable


class SlicePlan:
    """The sums over the slices of a model: variables with their axes, and plans of elimination.

    A plan is made once for a model, whatever the evidence.

    slice: The hidden variables of a step, states and controls: the axes of a belief. At step 0 the
        axes of controls have length one.
    states: The variables of the slice that are states, in its order.
    labels: A number for each variable. A variable of the slice has the number of its axis; the
        states at the step before, ``x.previous``, have the numbers after these, in the order of
        `states`, and the controls at the step before the last ones, in the order of the slice.
    sizes: The number of states of each variable, by label.
    shape, first_shape: The shape of a belief without runs, at steps from 1 on and at step 0.
    """

    def __init__(self, layout: SliceLayout) -> None:
        self.layout, self.model = layout, layout.model
        self.slice, self.states = discrete(layout.slice), discrete(layout.states)
        now: dict[Variable, Label] = {v: k for k, v in enumerate(self.slice)}
        controls = [v for v in self.slice if v not in self.states]
        before: dict[Variable, Label] = {
            v.previous: len(now) + k for k, v in enumerate((*self.states, *controls))
        }
        self.labels = now | before
        self.sizes = dict(
            zip(self.labels.values(), sizes(discrete(tuple(self.labels))), strict=True)
        )
        self.shape = sizes(self.slice)
        self.first_shape = tuple(v.size if v in self.states else 1 for v in self.slice)

    def hidden(self, cpd: Any) -> tuple[Label, ...]:
        """The labels of a CPD's parents without evidence, and of its child if that is hidden."""
        return tuple(self.labels[v] for v in (*cpd.given, cpd.child) if v in self.labels)

    @cached_property
    def _tables(self) -> list[tuple[Label, ...]]:
        """The labels of each transition CPD's hidden variables: parents, child."""
        return [self.hidden(cpd) for cpd in self.model.transition]

    @cached_property
    def _maps(self) -> list[bool]:
        """Whether each CPD of the transition has one hidden parent, so that it may be a map."""
        return [len(labels) == 2 for labels in self._tables]

    @cached_property
    def onward(self) -> Plan:
        """The sum of a forward message: Σ_x' p(x | x') belief(x'), x' the states before."""
        return self._sum(self._before, self._now, self._maps)

    @cached_property
    def back(self) -> Plan:
        """The sum of a backward message: Σ_x p(x | x') message(x), x' the states before."""
        return self._sum(self._now, self._before, self._maps, back=True)

    @cached_property
    def pairs(self) -> Plan:
        """The product for a joint of neighbours, p(x | x') belief(x'), with axes x', then x."""
        return self._sum(self._before, (*self._before, *self._now))

    def keeping(self, kept: Scope) -> Plan:
        """The sum of a forward message that keeps variables of the slice before.

        `kept` are their labels in the slice. The message is over the whole slice before, controls
        too, and the result over the slice, and then those kept.
        """
        found = self._keeping.get(kept)
        if found is None:
            before = [self.labels[v.previous] for v in self.slice]
            own = tuple([before[k] for k in kept])
            found = self._keeping[kept] = self._sum(tuple(before), (*self._now, *own), self._maps)
        return found

    @cached_property
    def _keeping(self) -> dict[Scope, Plan]:
        """The cache of `keeping`."""
        return {}

    def _sum(
        self, of: Scope, wanted: Scope, maps: Sequence[bool] = (), *, back: bool = False
    ) -> Plan:
        """The plan that multiplies an array over `of` by the transition, and sums to `wanted`."""
        return next_smallest([of, *self._tables], wanted, self.sizes, maps, back=back)

    @cached_property
    def _before(self) -> Scope:
        """The labels of the states one step before."""
        return tuple(self.labels[v.previous] for v in self.states)

    @cached_property
    def _now(self) -> Scope:
        """The labels of the variables of the slice."""
        return tuple(range(len(self.slice)))

    @cached_property
    def prior(self) -> Plan:
        """The product of the prior's CPDs, over the states at step 0."""
        states = tuple(self.labels[v] for v in self.states)
        tables = [self.hidden(cpd) for cpd in self.model.prior]
        return next_smallest(tables, states, self.sizes)

    def scope(self, labels: Scope) -> tuple[Discrete, ...]:
        """The variables of some labels."""
        known = discrete(tuple(self.labels))
        return tuple([known[x] for x in labels])

    def widest(self, more: int = 0) -> tuple[Discrete, ...]:
        """The most variables that a table has on the way from a step to the next, or back.

        The tables of a sensor, which have its observed parents besides the slice, count as well. If
        no table can have too many axes, with `more` of them besides, it is the slice.
        """
        if len(self.labels) + len(self.model.inputs) + more <= AXES:
            return self.slice
        ways = (self.prior, self.onward, self.back)
        found = [self.slice, *(self.scope(step.scope) for way in ways for step in way.steps)]
        for cpd in self.model.observation:
            given = (v for v in cpd.given if isinstance(v, Discrete))
            found.append((*self.slice, *(v for v in given if v not in self.labels)))
        return max(found, key=len)

    @cached_property
    def controls(self) -> tuple[int, ...]:
        """The axes of hidden controls, which the next slice does not depend on."""
        return tuple(k for k, v in enumerate(self.slice) if v not in self.states)


class RowTables:
    """The tables, or maps, of a CPD at all rows, for the inputs of each row.

    inputs: For each input or observed parent its values at all rows, (rows, runs or 1, d); d = 1
        for a discrete one, whose values are the indices of its states.
    steps: The step of each row.

    labels: The axes of its tables: hidden parents, then the child, unless it is measured.
    observed: The parents that evidence gives.
    by_run: Whether the values of inputs differ by run.
    """

    def __init__(
        self,
        plan: SlicePlan,
        cpd: TableCPD,
        inputs: Mapping[Variable, Any],
        steps: Sequence[int] | Integers,
    ) -> None:
        self.cpd, self.inputs = cpd, inputs
        self.called = InputTables(cpd, inputs, steps)
        self.labels = plan.hidden(cpd)
        self.observed = tuple(v for v in cpd.given if v not in plan.labels)
        self.index: dict[tuple[int, ...], Any] = {}
        self.by_run = any(len(rows) and rows.shape[1] > 1 for rows in inputs.values())

    def factor(self, row: int, semiring: Semiring, *, as_map: bool) -> Entries:
        """The table of a row as entries of a semiring, (size of each hidden variable..., [runs]).

        The axis of runs is there only if tables differ by run. With `as_map` it is a `Move`, of
        numbers whatever the semiring.
        """
        if self.cpd.function is not None:
            return self._called(row, semiring, as_map)
        if not self.by_run:
            key = tuple(int(self.inputs[v][row, 0, 0]) for v in self.observed)
            found: Entries = self._factor(key, semiring, as_map)
            return found
        states = np.stack(np.broadcast_arrays(*(self.inputs[v][row, :, 0] for v in self.observed)))
        return self._joined(states, semiring, as_map)

    def _joined(self, states: Any, semiring: Semiring, as_map: bool) -> Entries:
        """The tables of all runs, where observed parents differ by run, with runs on the last axis.

        With `as_map` the result is a `Move` with the map of each run.

        states: The observed parents' states, (observed parents, runs).
        """
        keys, which = np.unique(states, axis=1, return_inverse=True)
        parts: list[Any] = [self._factor(tuple(map(int, key)), semiring, as_map) for key in keys.T]
        which = which.ravel()
        if not as_map:
            whole: Array = np.stack(parts, axis=-1)[..., which]
            return whole
        return Move(
            tuple((part.maps[0][0], np.flatnonzero(which == k)) for k, part in enumerate(parts))
        )

    def _factor(self, key: tuple[int, ...], semiring: Semiring, as_map: bool) -> Any:
        """The table or map at the states `key` of the observed parents, from a cache.

        What the cache lacks is made by `_made`.
        """
        name = (*key, semiring.linear, as_map)
        found = self.index.get(name)
        if found is None:
            found = self.index[name] = self._made(key, semiring, as_map)
        return found

    def _made(self, key: tuple[int, ...], semiring: Semiring, as_map: bool) -> Entries:
        """The table at the states `key` of the observed parents, without their axes.

        It is an array of entries of the semiring, or, if `as_map`, a `Move`.
        """
        if as_map and self.cpd._maps and self.observed == self.cpd.given[1:]:
            return Move(((self.cpd._maps[key[0] if key else None], None),))
        table = self._selected(self.cpd.table, key)
        return Move(((Dense(table), None),)) if as_map else semiring.entries(table)

    def _selected(self, table: Array, key: tuple[int, ...]) -> Array:
        """A table with its observed parents at the states `key`, without their axes."""
        states = dict(zip(self.observed, key, strict=True))
        found: Array = table[tuple(states.get(v, slice(None)) for v in self.cpd.given)]
        return found

    def _called(self, row: int, semiring: Semiring, as_map: bool) -> Entries:
        """The table at a row, where a function of the inputs gives it.

        It is (size of each hidden variable..., [runs]), in entries of the semiring, or a `Move`.
        """
        tables = self.called.at(row)
        states = [self.inputs[v][row, :, 0] for v in self.observed]
        runs = max([len(tables), *map(len, states)])
        found = []
        for run in range(runs):
            key = tuple(int(own[run % len(own)]) for own in states)
            found.append(self._selected(tables[run % len(tables)], key))
        if as_map:
            if runs == 1:
                return Move(((Dense(found[0]), None),))
            return Move(tuple((Dense(table), np.array([r])) for r, table in enumerate(found)))
        whole = found[0] if runs == 1 else np.stack(found, axis=-1)
        return semiring.entries(whole)

    @property
    def smallest(self) -> float:
        """The smallest positive entry of all tables.

        For a function, only the tables called up to now count.
        """
        return self.called.smallest if self.cpd.function is not None else self._least

    @cached_property
    def _least(self) -> float:
        """The smallest positive entry of the table: it tells whether products may underflow."""
        if self.cpd._maps:
            return min(each.smallest for each in self.cpd._maps.values())
        return smallest_entry(self.cpd.table)


class TableSlices:
    """The slices of a discrete dynamic network with its evidence, as a `StateChain` needs them.

    They are `Slices` whose transitions are sums of products of tables.

    first: The step of row 0 of the transition's inputs: 1 where evidence is of all steps; the
        filter's own step online, where it is of a single one.
    semiring: The semiring of all entries: `SUM_PRODUCT`, unless the slices were made by `within`.
    rows: The tables of each transition CPD.
    weights: The weights of states by each sensor's measurements.
    of_runs: The end of the error's text for impossible measurements where there are axes of runs:
        what else to do about such runs, as "; leave those runs out".
    lost: ([runs]), from `until`: the step from which on a run's measurements are left out; T + 1 of
        a run that keeps all. None if all do.
    """

    lost: Integers | None = None

    def __init__(
        self, plan: SlicePlan, bound: BoundEvidence, first: int = 1, of_runs: str = ""
    ) -> None:
        self.plan, self.bound, self.first, self.of_runs = plan, bound, first, of_runs
        self.semiring = SUM_PRODUCT
        self.steps, self.lead = bound.steps, bound.lead
        self.rows = [
            RowTables(plan, cast(TableCPD, cpd), inputs, range(first, first + max(bound.steps, 1)))
            for cpd, inputs in zip(plan.model.transition, bound.transition, strict=False)
        ]
        self.weights: list[SensorWeights] = []
        for reading in bound.readings:
            kind = Weights if isinstance(reading.cpd, TableCPD) else DensityWeights
            self.weights.append(kind(plan, reading, bound.runs, bool(bound.lead)))

    def within(self, semiring: Semiring) -> TableSlices:
        """The same slices with entries of another semiring."""
        other = copy.copy(self)
        other.semiring = semiring
        for name in ("_fixed", "_algebra"):
            other.__dict__.pop(name, None)
        return other

    def until(self, lost: Integers) -> TableSlices:
        """The same slices without the measurements of each run from step `lost` on."""
        other = copy.copy(self)
        other.lost = lost
        return other

    @property
    def smallest(self) -> float:
        """A lower bound of the positive factors by which one step multiplies a probability.

        Such a factor is an entry of the prior or of the transition, times the weights of all
        measurements of the step. Tables that are functions of inputs count as far as they have
        been called.
        """
        first = math.prod(smallest_entry(cpd.table) for cpd in self._prior_cpds)
        onward = math.prod(row.smallest for row in self.rows)
        return min(first, onward) * math.prod(weights.smallest for weights in self.weights)

    @property
    def _prior_cpds(self) -> tuple[TableCPD, ...]:
        return cast(tuple[TableCPD, ...], self.plan.model.prior)

    def prior(self) -> Array:
        """The probabilities of the states at step 0, (*slice, *runs); controls have length 1."""
        semiring = self.semiring
        tables = [semiring.entries(cpd.table) for cpd in self._prior_cpds]
        found: Array = eliminate(self.plan.prior, tables, self._algebra)
        found = found.reshape(self.plan.first_shape)
        return np.repeat(found[..., None], self.bound.runs, axis=-1) if self.lead else found

    def forward(self, step: int, belief: Array) -> Array:
        """The predicted belief over the slice of a step, from that over the slice before.

        Axes between those of the slice and of the runs are kept.
        """
        if self.plan.controls:
            belief = self.semiring.total(belief, self.plan.controls)
        return self.through(self.plan.onward, step, belief)

    def keeping(self, step: int, belief: Array, kept: Scope) -> Array:
        """The predicted belief with some variables of the slice before, (*slice, *kept, ...).

        kept: Their labels in the slice.
        """
        return self.through(self.plan.keeping(kept), step, belief)

    def backward(self, step: int, message: Array) -> Array:
        """The sum Σ_x p(x | x') message(x), x being the slice of `step` and x' the one before.

        The controls of x', which x does not depend on, get axes of length one.
        """
        if self.plan.controls:
            rest = message.shape[len(self.plan.shape) :]
            message = np.broadcast_to(message, (*self.plan.shape, *rest))
        found = self.through(self.plan.back, step, message)
        return np.expand_dims(found, self.plan.controls) if self.plan.controls else found

    def through(self, plan: Plan, step: int, array: Array) -> Array:
        """An array times the tables of the transition into a step, summed as a plan has it.

        The plan is one of `SlicePlan`. Axes between those of variables and of runs are kept.
        """
        tables: tuple[Any, ...] = (array, *self.factors(step, plan))
        found: Array = eliminate(plan, tables, self._algebra)
        return found

    @cached_property
    def _algebra(self) -> TableAlgebra:
        """The arithmetic of the tables; that they do not underflow is seen by `smallest`."""
        return TableAlgebra(self.semiring, self.plan.sizes, watched=False)

    def factors(self, step: int, plan: Plan) -> Sequence[Entries]:
        """The tables of the transition into a step, as `through` takes them for a plan."""
        fixed = self._fixed.get(plan)
        if fixed is not None:
            return fixed
        maps, row = plan.maps, step - self.first
        found = [r.factor(row, self.semiring, as_map=k in maps) for k, r in enumerate(self.rows, 1)]
        if not any(rows.inputs for rows in self.rows):
            self._fixed[plan] = found
        return found

    @cached_property
    def single(self) -> bool:
        """Whether the slice is one state, whose transition is a map that all runs share."""
        only = len(self.plan.slice) == 1 and len(self.plan.states) == 1
        return only and self.plan.onward.maps == {1} and not self.rows[0].by_run

    @property
    def constant(self) -> Sequence[Entries] | None:
        """The tables of the transition, as forward messages use them, if all steps share them.

        They are None where the tables may differ by step.
        """
        return None if any(rows.inputs for rows in self.rows) else self.factors(1, self.plan.onward)

    def weights_of(self, part: range) -> tuple[Array, Array]:
        """The weights of the measurements of some steps, (steps, *slice, [runs]), and log-scales.

        `part` are the steps, consecutive ones; log-scales are (steps, [runs]). The largest weight
        of each step and run is one. Where measurements are left out (`lost`) all weights are one.
        """
        found, scales = self._given_weights_of(part)
        if self.lost is not None:
            left_out = self.lost <= np.array(part).reshape(-1, *(1,) * self.lost.ndim)
            axes = tuple(range(1, len(self.plan.shape) + 1))
            np.copyto(found, 1.0, where=np.expand_dims(left_out, axes))
            np.copyto(scales, 0.0, where=left_out)
        return found, scales

    def _given_weights_of(self, part: range) -> tuple[Array, Array]:
        """The weights of all measurements at some steps, those that `lost` leaves out included.

        `part` are the steps, consecutive ones. The weights are a new array, (steps, *slice,
        [runs]), the largest of each step and run being one; their log-scales are (steps, [runs]).
        """
        if len(self.weights) == 1 and self.weights[0].shape == self.plan.shape:
            picked = self.weights[0].picked(part)
            if picked is not None:
                return picked
        axes = tuple(range(1, len(self.plan.shape) + 1))
        runs = (self.bound.runs,) if self.lead else ()
        found = np.ones((len(part), *runs, *self.plan.shape))
        if runs:  # by runs in memory, as columns of tables are picked for them
            found = np.moveaxis(found, 1, -1)
        scales = np.zeros((len(part), *runs))
        for weights in self.weights:
            weights.multiply(found, scales, part)
        top = found.max(axis=axes)
        top = np.where(top > 0.0, top, 1.0)
        found /= top.reshape(len(part), *(1,) * len(axes), *runs)
        return found, scales + np.log(top)

    @cached_property
    def _fixed(self) -> dict[Plan, list[Entries]]:
        """The cache of `factors`: by plan, the tables of the transition.

        It is filled where no CPD of the transition has inputs: all steps have the same tables.
        """
        return {}

    def likelihood(self, step: int) -> tuple[Array | None, Array | float]:
        """The weights of a step's measurements, and their log-scale; None without measurements.

        The weights are entries of the semiring, (*slice, [runs]); in runs whose measurements are
        left out from this step or an earlier one (`lost`) they are the semiring's one. p(z_t | x)
        is the weights, which broadcast with a belief, times the exponential of the scale.
        """
        found, log_scale = self.given_likelihood(step)
        if found is None or self.lost is None:
            return found, log_scale
        left_out = self.lost <= step
        return np.where(left_out, self.semiring.one, found), np.where(left_out, 0.0, log_scale)

    def given_likelihood(self, step: int) -> tuple[Array | None, Array | float]:
        """The weights of all measurements of a step, (*slice, [runs]), and their log-scale.

        Measurements that `lost` leaves out are included. The weights are entries of the semiring;
        without measurements they are None.
        """
        found: Array | None = None
        log_scale: Array | float = 0.0
        for own, scale in self._weights_at(step):
            log_scale = log_scale + scale
            if found is None:
                found = own
                continue
            found = self.semiring.times(found, own)
            # So that the product of many small numbers stays above zero, and that of logarithms
            # near it: beside large ones those of a belief would lose their digits.
            top = self.semiring.divisor(found.max(axis=tuple(range(len(self.plan.shape)))))
            found, log_scale = self.semiring.over(found, top), log_scale + self.semiring.logs(top)
        return found, log_scale

    def _weights_at(self, step: int) -> Iterator[tuple[Array, Array | float]]:
        """The weights of each measurement of a step, (*slice, [runs]), and their log-scale."""
        for weights in self.weights:
            for row in weights.at(step):
                own = weights.row(row, self.semiring)
                if own is not None:
                    yield own, weights.log_scale(row, self.semiring)

    def refuse(self, step: int, belief: Array, run: int) -> NoReturn:
        """Raise `ImpossibleEvidence` for measurements that a predicted belief makes impossible.

        `belief` is the predicted belief, (*slice, [runs]); `run` counts the flattened runs. The
        error names the sensor of the first measurement after which no state is possible in this
        run, and marks all runs in which the step's measurements are impossible.
        """
        left: Array = belief
        culprit: SensorWeights | None = None
        for weights in self.weights:
            for row in weights.at(step):
                own = weights.row(row, self.semiring)
                if own is None:
                    continue
                left = self.semiring.times(left, own)
                here = (left[..., run] if self.lead else left).max()
                if culprit is None and here == self.semiring.zero:
                    culprit = weights
        lost = np.asarray(left.max(axis=tuple(range(len(self.plan.shape)))) == self.semiring.zero)
        where = in_run(lost.reshape(self.lead))
        cpd = None if culprit is None else culprit.cpd
        variable = None if cpd is None else cpd.child
        advice = (culprit or SensorWeights).advice
        raise ImpossibleEvidence(
            f"the measurement of {variable!r} at step {step} has probability zero given those "
            f"before it{where}. {advice}{self.of_runs if self.lead else ''}",
            lost,
            self.lead,
            variable=variable,
            cpd=cpd,
            step=step,
        )
