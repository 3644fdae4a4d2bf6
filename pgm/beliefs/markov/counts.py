"""Expected counts of the states of each CPD's family, given all measurements.

The counts of a CPD are an array with an axis for each parent, in the CPD's order, then one for the
child. A *row* is the place of a step, or of a measurement, along the first axis of the evidence's
values. A belief is (*states, [runs]): an axis for each hidden variable of a step, or of two steps,
then one of runs, which is there only if the user gave axes of runs.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgm.beliefs.markov.joints import pair
from pgm.beliefs.markov.outcome import StateOutcome
from pgm.cpds import CPD, SwitchingCPD, TableCPD
from pgm.evidence import BoundEvidence, Reading
from pgm.factors.axes import sizes
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT, exp, log_sum
from pgm.linearisation.family import Family
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.expectations import (
    OBSERVATION,
    PRIOR,
    TRANSITION,
    Expectations,
    FamilyBelief,
    Learnable,
)


def expectations(
    posterior: StateOutcome, parts: Sequence[Learnable], lineariser: Lineariser
) -> Expectations:
    """The expected counts of tables, and the weights of cases of sensors that read numbers.

    parts: CPDs of the posterior's model, or cases of them; tables are arrays, not functions.
    """
    chain, plan, bound = posterior._chain, posterior._plan, posterior._slices.bound
    tally = Tally(posterior.graph.model, bound, parts)
    places = {v: k for k, v in enumerate(plan.slice)}
    axes = {v.previous: k for k, v in enumerate(plan.states)}
    axes |= {v: len(axes) + k for k, v in enumerate(plan.slice)}
    message = chain.unit()
    for step in range(bound.steps, -1, -1):
        if step < bound.steps:
            message = chain.back(step, message)
        tally.add_readings(step, _by_run(chain.posterior(step, message), chain.batch), places)
        if not step:
            tally.add_prior(_by_run(chain.posterior(0, message), chain.batch), places)
        elif tally.moving:
            tally.add_motion(step, _by_run(pair(chain, plan, step, message), chain.batch), axes)
    beliefs = {}
    for part in parts:
        reading = next((each for each in bound.readings if each.cpd is part.cpd), None)
        if part in tally.counts or reading is None:
            continue
        weights = np.ones((reading.step.size, bound.runs))
        if part.case is not None:
            weights = tally.shares[part.cpd]
            for state in reversed(part.case):
                weights = weights[..., state]
        beliefs[part] = _weighted(part, reading, bound, lineariser, weights)
    return Expectations(tally.counts, beliefs)


def _weighted(
    part: Learnable, reading: Reading, bound: BoundEvidence, lineariser: Lineariser, weights: Array
) -> FamilyBelief:
    """The belief of a case without hidden parents, whose measurements have these weights."""
    own: Any = part.own
    inputs = {v: rows for v, rows in reading.inputs.items() if v in own.parents}
    known = own, (), reading.step, inputs, lineariser, bound.lead
    family = Family.make(*known, numbering=bound.numbering)
    shape = *weights.shape, 0
    mean, cov = np.zeros(shape), np.zeros((*shape, 0))
    return FamilyBelief(family, mean, cov, reading.values, reading.taken, weights)


class Tally:
    """Expected counts of CPDs, to which the beliefs of one step after another are added.

    A belief is (runs, *states), given all measurements, over at least the hidden variables of the
    CPDs, with `axes`: of each of these its axis, counted from the first one of states.

    counts: By table, (size of each parent..., size of the child), summed over steps, measurements
        and runs.
    shares: By sensor that discrete variables choose the CPD of, the probability of each case at
        each of its measurements, (rows, runs, size of each variable that chooses...).
    """

    def __init__(
        self, model: DynamicBayesianNetwork, bound: BoundEvidence, parts: Sequence[Learnable]
    ) -> None:
        self.counts: dict[Learnable, Array] = {
            part: np.zeros(part.cpd.table.shape) for part in parts if isinstance(part.cpd, TableCPD)
        }
        self._prior = [part for part in self.counts if part.role == PRIOR]
        # Not those of an online update, which has no inputs.
        known = dict(zip(model.transition, bound.transition, strict=False))
        moving = (part for part in self.counts if part.role == TRANSITION)
        self._motions = [(part, known[part.cpd]) for part in moving if part.cpd in known]
        seen = {part.cpd for part in parts if part.role == OBSERVATION}
        self._readings = [each for each in bound.readings if each.cpd in seen]
        self.shares: dict[CPD, Array] = {
            each.cpd: np.zeros((each.step.size, bound.runs, *sizes(each.cpd.switches)))
            for each in self._readings
            if isinstance(each.cpd, SwitchingCPD)
        }
        steps = np.arange(bound.steps + 2)
        self._ends = [np.searchsorted(each.step, steps) for each in self._readings]

    @property
    def moving(self) -> bool:
        """Whether any CPD is of a transition."""
        return bool(self._motions)

    def add_prior(self, belief: Array, axes: dict[Any, int]) -> None:
        """Add the belief of step 0."""
        for part in self._prior:
            _moved(self.counts[part], part.cpd, {}, 0, belief, axes)

    def add_motion(self, step: int, belief: Array, axes: dict[Any, int]) -> None:
        """Add the belief of a step and the one before."""
        for part, inputs in self._motions:
            _moved(self.counts[part], part.cpd, inputs, step - 1, belief, axes)

    def add_readings(self, step: int, belief: Array, axes: dict[Any, int]) -> None:
        """Add the belief of a step to the counts of its measurements."""
        for each, end in zip(self._readings, self._ends, strict=True):
            for row in range(end[step], end[step + 1]):
                counts = self.counts.get(Learnable(each.cpd, OBSERVATION))
                if counts is not None:
                    _read(counts, each, row, belief, axes)
                elif each.cpd in self.shares:
                    _chosen(self.shares[each.cpd][row], each, row, belief, axes)


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
    evidence, ln w(z) for each state of the sensor, the counts of each state z grow by a share
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
            # Of logarithms, as a weight may be small beside one that the table excludes.
            joint = LOG_SUM_PRODUCT.entries(cpd.table[at]) + weights
            total = log_sum(joint, -1)[..., None]
            share = exp(joint - np.where(total > -np.inf, total, 0.0))
            counts[at] += found[run][..., None] * share
        else:
            counts[(*at, int(_states(reading.values, row, runs)[run]))] += found[run]


def _chosen(shares: Array, reading: Any, row: int, belief: Array, axes: dict[Any, int]) -> None:
    """Set p(states that choose a sensor's CPD | all measurements), (runs, sizes...), in place."""
    switches = reading.cpd.switches
    found = _marginal(belief, [axes[v] for v in switches if v in axes])
    for run in range(len(found)):
        at = tuple(
            slice(None) if v in axes else int(_states(reading.inputs[v], row, len(found))[run])
            for v in switches
        )
        shares[run][at] = found[run]
