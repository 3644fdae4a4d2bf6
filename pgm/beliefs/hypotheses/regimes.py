"""The discrete half of a mixed chain: its regimes, and how probable each is after another.

A *regime* is a joint state of all discrete variables of a slice, an index into `shape`, raveled. A
variable is *remembered* if the next slice depends on it; a *memory* is a joint state of the
remembered ones. Observed variables that choose motions are among those of a regime, as ones that
nothing is known of but their evidence; so a motion is chosen in one way whoever chooses it.
Log-probabilities have the regimes first and the runs last, (regimes, runs or 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.compile import SliceLayout
from pgm.cpds import CPD, ConditionalGaussian, SwitchingCPD, TableCPD
from pgm.errors import GraphError, ModelError
from pgm.evidence import BoundEvidence
from pgm.factors.axes import States, discrete
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.networks import DynamicBayesianNetwork
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable

_NOTHING = Discrete("nothing", states=("whatever",))


class Regimes:
    """The regimes of a mixed chain, with what the tables and the evidence say of them.

    Attributes
    ----------
    variables : tuple of Discrete
        The hidden discrete variables of a slice, and the observed ones that choose motions.
    hidden : tuple of Discrete
        The first of these, which are hidden.
    shape : tuple of int
        The number of states of each.
    size : int
        The number of regimes.
    remembered : tuple of Discrete
        Those that the next slice depends on.
    memory : ndarray of int
        (size,): the memory of each regime.
    memories : int
        The number of memories.
    example : ndarray of int
        (memories,): a regime of each memory.
    plan : SlicePlan
        Of the tables, whose beliefs have an axis for each of the variables.

    `first` is the number of the step at which the evidence begins; steps are counted from there.
    """

    def __init__(self, model: DynamicBayesianNetwork, bound: BoundEvidence, first: int = 0) -> None:
        chosen = _observed(model)
        # Where nothing is discrete there is one regime: that of a variable of one state.
        alone = [] if chosen or any(cpd.discrete for cpd in model.transition) else [_NOTHING]
        tables = _tables(model, [*alone, *(stand_in for stand_in, _ in chosen)])
        plan = SlicePlan(SliceLayout.of(tables))
        originals = dict(chosen)
        slice_ = discrete(plan.slice)
        self.variables = tuple(originals.get(v, v) for v in slice_)
        self.hidden = tuple(v for v in slice_ if v not in originals and v is not _NOTHING)
        self.shape, self.size = plan.shape, math.prod(plan.shape)
        require_memory(
            self.size * math.prod(v.size for v in plan.states) * bound.runs,
            f"the table of {self.size:,} joint states of ({listed(self.variables)}) at one step, "
            "given those at the step before,",
            "give the discrete variables fewer states",
            error=GraphError,
        )
        self._each = np.unravel_index(np.arange(self.size), self.shape)
        kept = _remembered(model, self.variables)
        self.remembered = tuple(self.variables[k] for k in kept)
        counts = tuple(self.shape[k] for k in kept)
        self.memories = math.prod(counts)
        self.memory: Integers = np.zeros(self.size, dtype=np.intp)
        if kept:
            own = tuple(self._each[k] for k in kept)
            self.memory = np.asarray(np.ravel_multi_index(own, counts))
        # A regime of each memory, and its place among the joint states of a slice's states.
        _, self.example = np.unique(self.memory, return_index=True)
        among = [k for k, v in enumerate(slice_) if v in plan.states]
        shape = tuple(self.shape[k] for k in among)
        places = tuple(self._each[k][self.example] for k in among)
        self._column = np.ravel_multi_index(places, shape) if among else np.zeros(1, np.intp)
        self._columns = math.prod(shape)
        self.plan = plan
        self._first = first
        self._slices = TableSlices(plan, _own(bound, model, tables), 1 + first)
        # Of the observed variables: their states in each regime, how many, and those observed.
        self._evidence = [(self.states(v), v.size, _rows_of(bound, v)) for _, v in chosen]

    def states(self, variable: Variable) -> Integers:
        """The state of a discrete variable in each regime, (size,).

        Of the step before, `x.previous`, it is that in each memory, (memories, 1).
        """
        each = self._each[self.variables.index(variable.template)]
        return each[self.example][:, None] if variable.lag else each

    def prior(self) -> Array:
        """Ln p(regime at step 0), where controls, which begin at step 1, are in their first state.

        It is (size, runs or 1).
        """
        found = np.zeros((*self.shape, self._runs))
        first = tuple(slice(0, n) for n in self.plan.first_shape)
        alone = not self.plan.states  # nothing is discrete at step 0
        prior = np.ones(1) if alone else self._slices.prior()
        found[first] = prior.reshape(*self.plan.first_shape, -1)
        return _logs(found.reshape(self.size, -1))

    def onward(self, step: int) -> Array:
        """Ln p(regime at a step | memory at the step before), (memories, size, runs or 1)."""
        logs = self._same if self._fixed else self._onward(step)
        for own_states, size, rows in self._evidence:
            own = own_states[:, None] == rows[step - 1, :, 0]
            # Each state has the probability 1 / size in the tables, and is known.
            logs = logs + np.where(own, math.log(size), -np.inf)
        return logs

    def given(self, step: int, memory: Integers) -> Array:
        """Ln p(regime at a step | memories before it), (hypotheses, size, runs).

        `memory` is (hypotheses, runs).
        """
        onward = self.onward(step)
        if onward.shape[-1] == 1:
            return onward[memory][..., 0].swapaxes(1, 2)
        return np.moveaxis(onward[memory, :, np.arange(memory.shape[-1])], -1, 1)

    @property
    def is_constant(self) -> bool:
        """Whether `onward` is the same at all steps."""
        return self._fixed and not self._evidence

    def likelihood(self, step: int) -> Array | None:
        """Ln p(discrete measurements of a step | regime), (size, runs or 1); None without any."""
        found, scale = self._in_logs.likelihood(step)
        if found is None:
            return None
        shape = (*self.shape, self._runs)
        whole = np.broadcast_to(found.reshape(*found.shape[: len(self.shape)], -1), shape)
        likelihood: Array = whole.reshape(self.size, -1) + scale
        return likelihood

    @cached_property
    def _in_logs(self) -> TableSlices:
        """The slices in logarithms: soft evidence may have weights that are no numbers."""
        return self._slices.within(LOG_SUM_PRODUCT)

    @property
    def _runs(self) -> int:
        return self._slices.bound.runs

    @cached_property
    def _fixed(self) -> bool:
        """Whether the tables are the same at all steps."""
        return self._slices.constant is not None

    @cached_property
    def _same(self) -> Array:
        """The table of all steps, where it is the same."""
        return self._onward(1)

    def _onward(self, step: int) -> Array:
        slices, columns = self._slices, self._columns
        shape = tuple(
            n if v in self.plan.states else 1
            for v, n in zip(self.variables, self.shape, strict=True)
        )
        belief = np.eye(columns).reshape(*shape, columns)
        if slices.lead:
            belief = np.repeat(belief[..., None], self._runs, axis=-1)
        found = slices.forward(step, belief)
        whole = np.broadcast_to(
            found.reshape(*self.shape, columns, -1), (*self.shape, columns, self._runs)
        )
        chosen = whole.reshape(self.size, columns, -1)[:, self._column]
        return np.ascontiguousarray(_logs(chosen).swapaxes(0, 1))


def is_regime_sensor(model: DynamicBayesianNetwork, cpd: CPD) -> bool:
    """Whether the readings of a sensor weigh the regimes alone, by their densities.

    So do those of tables; and those of CPDs without continuous hidden parents of which some are
    mixtures, or have robust noise, so that no Gaussian belief takes them in.
    """
    if cpd.discrete or not isinstance(cpd, SwitchingCPD):
        return cpd.discrete
    continuous = {each.child for each in model.transition if not each.discrete}
    if any(v in continuous for v in cpd.given):
        return False
    return not all(is_plain(case) for case in cpd.cases.values())


def is_plain(case: CPD) -> bool:
    """Whether a CPD is Gaussian, linearised or not, without robust noise."""
    return isinstance(case, ConditionalGaussian) and case.noise is None


def _observed(model: DynamicBayesianNetwork) -> list[tuple[Discrete, Discrete]]:
    """The observed variables that choose motions, each with a stand-in among the hidden ones."""
    found: dict[Discrete, Discrete] = {}
    for cpd in model.transition:
        for variable in cpd.switches if isinstance(cpd, SwitchingCPD) else ():
            if variable.template not in model.inputs:
                continue
            if variable.lag:
                raise ModelError(
                    f"{cpd!r}: {variable!r} is observed, and chooses by its state at the step "
                    "before; give it as evidence of the step that it is for",
                    variable=variable,
                    cpd=cpd,
                )
            stand_in = Discrete(f"{variable.name} as observed", states=variable.states)
            found.setdefault(variable, stand_in)
    return [(stand_in, variable) for variable, stand_in in found.items()]


def _rows_of(bound: BoundEvidence, variable: Discrete) -> Integers:
    """The observed states of a variable that chooses motions, (T, runs or 1, 1)."""
    for inputs in bound.transition:
        if variable in inputs:
            return inputs[variable]
    return np.zeros((0, 1, 1), dtype=np.intp)  # of an online update, which predicts nothing


def _tables(model: DynamicBayesianNetwork, observed: Sequence[Discrete]) -> DynamicBayesianNetwork:
    """The network of the discrete variables alone, with the sensors of these."""
    even = [TableCPD(v, table=np.full(v.size, 1.0 / v.size)) for v in observed]
    return DynamicBayesianNetwork(
        prior=[cpd for cpd in model.prior if cpd.discrete],
        transition=[*(cpd for cpd in model.transition if cpd.discrete), *even],
        observation=[cpd for cpd in model.observation if is_regime_sensor(model, cpd)],
    )


def _own(
    bound: BoundEvidence, model: DynamicBayesianNetwork, tables: DynamicBayesianNetwork
) -> BoundEvidence:
    """The evidence of the discrete variables' CPDs; without runs where all runs share it."""
    by_cpd = dict(zip(model.transition, bound.transition, strict=False))
    transition = tuple(by_cpd.get(cpd, {}) for cpd in tables.transition)
    sensors = frozenset(tables.observation)
    readings = tuple(each for each in bound.readings if each.cpd in sensors)
    own = replace(bound, transition=transition, readings=readings, form=None)
    widths = [rows.shape[1] for inputs in transition for rows in inputs.values()]
    for reading in readings:
        each = [reading.values, reading.taken, *reading.inputs.values()]
        widths += [rows.shape[1] for rows in each]
    return own if max(widths, default=1) > 1 else replace(own, lead=())


def _remembered(model: DynamicBayesianNetwork, variables: States) -> Sequence[int]:
    """The places of the variables that the next slice depends on."""
    asked = {parent.template for cpd in model.transition for parent in cpd.parents if parent.lag}
    return [k for k, v in enumerate(variables) if v in asked]


def _logs(values: Array) -> Array:
    with np.errstate(divide="ignore"):
        found: Array = np.log(values)
    return found
