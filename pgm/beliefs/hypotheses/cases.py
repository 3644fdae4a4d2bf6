"""The CPDs of a mixed chain in the cases that its regimes choose, in batches of runs.

A *role* is a part of the network: its prior, its transition or its sensors. A *choice* is a case of
each switching CPD of a role; regimes often have choices in common. CPDs of choices that differ in
numbers alone are one batch: the axis of runs has the hypotheses that a choice is tried on, the
choices and the user's runs, of which the last vary fastest. Each batch is a chain without discrete
variables, of which the CPDs of one role are used, and all others are stand-ins.

The evidence of several runs is repeated for each hypothesis of a *window* of steps at a time; that
which all runs share, and so all of a single run, is repeated nowhere, and has one window.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.beliefs.moments.passes.backward import between_slices
from pgm.beliefs.moments.steps.chain import MomentChain, largest
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Certain
from pgm.compile import DynamicGraph, SliceGraph
from pgm.cpds import CPD, GaussianCPD, SwitchingCPD
from pgm.cpds.by_run import kind_of, repeated, stacked
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.dynamic import Inputs
from pgm.factors.axes import sizes
from pgm.kernels.arrays import Array, Integers, Kind, Mask
from pgm.kernels.moments import Conditional
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules.schedule import Filtering
from pgm.variables import Variable

# About so many numbers of evidence are repeated for the hypotheses at a time.
_WINDOW = 2**20


@dataclass(frozen=True, eq=False)
class Given:
    """The evidence of a call, and how CPDs are linearised.

    Attributes
    ----------
    hidden : tuple of Variable
        The continuous variables of a slice, in its order.
    states : frozenset of Variable
        Those that have a prior.
    first : int
        The number of the step at which the evidence begins; steps are counted from there.
    """

    bound: BoundEvidence
    hidden: tuple[Variable, ...]
    states: frozenset[Variable]
    lineariser: Lineariser
    schedule: Filtering
    first: int = 0

    def network(
        self,
        prior: Sequence[CPD] = (),
        transition: Sequence[CPD] = (),
        observation: Sequence[CPD] = (),
    ) -> DynamicBayesianNetwork:
        """The network of the CPDs of one role, and stand-ins for the others."""
        return DynamicBayesianNetwork(
            prior or [stand_in(v) for v in self.hidden if v in self.states],
            transition or [stand_in(v) for v in self.hidden],
            observation,
        )


def stand_in(variable: Variable) -> CPD:
    """A CPD in the place of one that is of no concern."""
    size = variable.dimension
    return GaussianCPD(variable, np.zeros(size), np.eye(size))


def case_numbers(regimes: Regimes, cpd: SwitchingCPD) -> Integers:
    """The number of a CPD's case in each regime, (regimes,).

    Where states of the step before choose, it is (memories, regimes), or (memories, 1).
    """
    states = np.broadcast_arrays(*(regimes.states(v) for v in cpd.switches))
    return np.ravel_multi_index(tuple(states), sizes(cpd.switches))


class Choices:
    """The choices of a role, by number, and which of them each regime makes.

    Attributes
    ----------
    cpds : sequence of CPD
        The CPDs of the role, switching ones among them.
    of : ndarray of int
        The number of the choice, (regimes,); of a transition (memories, regimes).
    """

    def __init__(self, regimes: Regimes, cpds: Sequence[CPD], *, later: bool = False) -> None:
        self.cpds = cpds
        shape = (regimes.memories, regimes.size) if later else (regimes.size,)
        numbers = np.zeros((*shape, max(len(cpds), 1)), dtype=np.intp)
        for k, cpd in enumerate(cpds):
            if isinstance(cpd, SwitchingCPD):
                numbers[..., k] = case_numbers(regimes, cpd)
        rows = numbers.reshape(-1, numbers.shape[-1])
        every, of = np.unique(rows, axis=0, return_inverse=True)
        self._numbers = every[:, : len(cpds)]
        self.of: Integers = of.reshape(shape)

    @property
    def count(self) -> int:
        """The number of choices."""
        return len(self._numbers)

    @property
    def alike(self) -> list[Integers]:
        """The choices, by number, in groups whose CPDs differ in numbers alone."""
        groups: dict[tuple[object, ...], list[int]] = {}
        for k, numbers in enumerate(self._numbers):
            cases = (self._case(cpd, int(n)) for cpd, n in zip(self.cpds, numbers, strict=True))
            key = tuple(None if case is None else kind_of(case) for case in cases)
            groups.setdefault(key, []).append(k)
        return [np.array(group) for group in groups.values()]

    def at(self, which: Integers, copies: int, lead: tuple[int, ...]) -> list[CPD]:
        """The CPDs in some choices of one group; their runs are (copies · choices · runs,).

        `lead` are the user's axes of runs.
        """
        runs = math.prod(lead)
        found: list[CPD] = []
        for cpd, numbers in zip(self.cpds, self._numbers[which].T, strict=True):
            if not isinstance(cpd, SwitchingCPD):
                whole = cpd._lead()
                count = copies * which.size
                found.append(repeated(cpd, count, lead, np.arange(runs)) if whole else cpd)
                continue
            used, place = np.unique(numbers, return_inverse=True)
            cases = list(cpd.cases.values())
            if used.size == 1:
                found.append(cases[int(used[0])])
                continue
            own = [cases[k] for k in used]
            found.append(stacked(own, np.tile(np.repeat(place, runs), copies)))
        return found

    @staticmethod
    def _case(cpd: CPD, number: int) -> CPD | None:
        return list(cpd.cases.values())[number] if isinstance(cpd, SwitchingCPD) else None


class Batch:
    """Choices of one group, each tried on some hypotheses, as runs of a chain.

    Attributes
    ----------
    which : ndarray of int
        The numbers of the choices.
    used : bool
        Whether the chain of the window at hand was asked for anything.

    `values` are those of inputs that the batch's runs differ in, (runs, d), whatever the step.
    """

    def __init__(
        self,
        given: Given,
        which: Integers,
        copies: int,
        graph: DynamicGraph,
        inputs: Sequence[Inputs],
        readings: Sequence[Reading],
        *,
        keep: bool = False,
        values: Mapping[Variable, Array] | None = None,
    ) -> None:
        self.which, self._given, self._graph = which, given, graph
        self._values = values or {}
        self._inputs, self._readings, self._keep = inputs, readings, keep
        self._count = copies * which.size
        self._length = max(given.bound.steps, 1)
        widths = [_width(given.bound, rows) for each in inputs for rows in each.values()]
        widths += [_width(given.bound, r.values) for r in readings]
        widths += [_width(given.bound, rows) for r in readings for rows in r.inputs.values()]
        if any(widths):
            self._length = max(1, min(self._length, _WINDOW // (self._count * sum(widths))))
        self.used = False
        self._window = -1
        self._chain: MomentChain | None = None
        self._moved: dict[int, Conditional] = {}
        self._residuals: list[Array] = []
        self._converged = np.ones(given.bound.runs, dtype=bool)

    def at(self, step: int) -> tuple[MomentChain, int]:
        """The chain of the window that a step belongs to, and the number of the step there."""
        window = max(step - 1, 0) // self._length
        if window != self._window or self._chain is None:
            self._close()
            self._window, self._chain = window, self._made(window * self._length)
        return self._chain, step - window * self._length

    def motion(self, step: int) -> Conditional:
        """The motion to a step, as it was linearised there, of slices (runs, n, n)."""
        window = (step - 1) // self._length
        if window not in self._moved:
            self._close()
        own = step - 1 - window * self._length
        return Conditional(*(part[own] for part in self._moved[window]))

    def settled(self) -> tuple[list[Array], Mask]:
        """The largest move of a mean at each relinearisation, and whether all settled, (runs,)."""
        self._close()
        return self._residuals, self._converged

    def _close(self) -> None:
        """Keep how the window's iterations went, and its linearisations if these flow back."""
        chain, runs = self._chain, self._given.bound.runs
        if chain is None:
            return
        moved = [each.reshape(self._count, runs).max(axis=0) for each in chain.residuals]
        self._residuals = largest(self._residuals, moved)
        if self.used:
            every = chain.iterates or chain.plan.exact
            self._converged &= every & chain.converged.reshape(self._count, runs).all(axis=0)
        self.used = False
        if self._keep:
            self._moved[self._window] = between_slices(chain.plan)

    def _made(self, first: int) -> MomentChain:
        given, bound = self._given, self._given.bound
        last = min(first + self._length, bound.steps)

        def rows(values: npt.NDArray[Kind], some: slice) -> npt.NDArray[Kind]:
            part = values[some]
            if part.shape[1] == 1:
                return part
            return np.concatenate([part] * self._count, axis=1)

        def inputs(given: Inputs, some: slice) -> dict[Variable, Array]:
            return {v: rows(values, some) for v, values in given.items()}

        def own(some: slice) -> dict[Variable, Array]:
            count = some.stop - some.start
            each = self._values.items()
            return {v: np.broadcast_to(values, (count, *values.shape)) for v, values in each}

        readings = []
        for reading in self._readings:
            ends = np.searchsorted(reading.step, [first + 1 if first else 0, last + 1])
            some = slice(int(ends[0]), int(ends[1]))
            readings.append(
                replace(
                    reading,
                    step=reading.step[some] - first,
                    order=reading.order[some],
                    values=rows(reading.values, some),
                    taken=rows(reading.taken, some),
                    inputs=inputs(reading.inputs, some) | own(some),
                )
            )
        part = BoundEvidence(
            last - first,
            (self._count * bound.runs,),
            tuple(inputs(each, slice(first, last)) for each in self._inputs),
            tuple(readings),
            bound.first_run,
            own_runs=bound.runs,
        )
        begin = given.first + first
        plan = ChainPlan.make(self._graph, part, given.lineariser, first=begin, prior=False)
        return MomentChain(plan, given.schedule, keep=self._keep, certain=Certain())


def settled_of(batches: Iterable[Batch], runs: int) -> tuple[list[Array], Mask]:
    """The largest moves of batches at each relinearisation, (runs,), and whether all settled."""
    residuals: list[Array] = []
    converged = np.ones(runs, dtype=bool)
    for batch in batches:
        moved, own = batch.settled()
        residuals, converged = largest(residuals, moved), converged & own
    return residuals, converged


def _width(bound: BoundEvidence, rows: Array) -> int:
    """The numbers of a step that have to be repeated for each hypothesis."""
    return 0 if rows.shape[1] == 1 else math.ceil(rows.size / max(bound.steps, 1))


def seen(cpd: CPD, inputs: Mapping[Variable, Array]) -> Inputs:
    """The values of a case's own parents."""
    return {v: rows for v, rows in inputs.items() if v in cpd.parents}


def motions(
    given: Given,
    choices: Choices,
    inputs: Sequence[Inputs],
    copies: int,
    *,
    keep: bool,
    mixed: bool = False,
) -> list[Batch]:
    """The batches of a transition, each choice of which is tried on so many hypotheses.

    With `keep` linearisations are stored in the plans of the chains. With `mixed` there is one
    hypothesis a regime, and `which` of each batch are its regimes.
    """
    found = []
    for group in choices.alike:
        which = np.flatnonzero(np.isin(choices.of[0], group)) if mixed else group
        cpds = choices.at(choices.of[0, which] if mixed else which, copies, given.bound.lead)
        graph = SliceGraph(given.network(transition=cpds), given.bound.steps, False)
        own = [seen(cpd, each) for cpd, each in zip(cpds, inputs, strict=True)]
        found.append(Batch(given, which, copies, graph, own, (), keep=keep))
    return found


def sensors(
    given: Given, choices: Choices, readings: Sequence[Reading], copies: int
) -> list[Batch]:
    """The batches of sensors; `which` of each are its regimes, tried on so many components."""
    found = []
    for group in choices.alike:
        which = np.flatnonzero(np.isin(choices.of, group))
        cpds = choices.at(choices.of[which], copies, given.bound.lead)
        graph = SliceGraph(given.network(observation=cpds), given.bound.steps, False)
        own = [
            replace(reading, cpd=cpd, inputs=seen(cpd, reading.inputs))
            for cpd, reading in zip(cpds, readings, strict=True)
        ]
        found.append(Batch(given, which, copies, graph, (), own))
    return found


def starts(given: Given, choices: Choices) -> list[tuple[Integers, MomentChain]]:
    """The priors of all regimes: the numbers of regimes, and a chain that begins with theirs."""
    found = []
    for group in choices.alike:
        which = np.flatnonzero(np.isin(choices.of, group))
        cpds = choices.at(choices.of[which], 1, given.bound.lead)
        graph = SliceGraph(given.network(prior=cpds), 0, False)
        own, first = given.bound.runs, given.bound.first_run
        part = BoundEvidence(0, (which.size * own,), (), (), first, own_runs=own)
        plan = ChainPlan.make(graph, part, given.lineariser)
        found.append((which, MomentChain(plan, given.schedule, keep=False)))
    return found
