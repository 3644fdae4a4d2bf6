"""Slices of a chain as a page shows them: arrays of each run, with a row a step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pgm.cpds import CPD
from pgm.errors import EvidenceError
from pgm.evidence import Reading
from pgm.factors import Gaussian, GaussianMixture
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete, Variable

# Draws at each step that a page shows of beliefs that are not Gaussian, and the most Gaussians.
_DRAWS, GAUSSIANS = 60, 8


class Room(NamedTuple):
    """The most numbers that a page holds, and the most entries of a table."""

    numbers: int
    entries: int


class Sighted(NamedTuple):
    """The measurements of a sensor.

    step: Of each measurement, (M,) ascending.
    values: (M, runs or 1, d); missing components are NaN.
    inputs: The values of its observed parents, (M, runs or 1, d) each.
    """

    step: Integers
    values: Array
    inputs: Mapping[Variable, Array]


class ShownSlices(ABC):
    """The numbers of a chain's slices at some steps, as a page is handed them.

    A page reads the arrays by `reading`, which tells what their names stand for: of beliefs in
    ``gaussian`` form or as ``table``, forward and backward messages and potentials, or ``moments``
    of marginals alone.

    first: The step of the arrays' first row.
    hidden: The variables whose components, or states, are the arrays' columns.
    words: Why something is not shown, in words, by what it is: ``messages``, ``back`` messages,
        ``singular`` factors, or what is too ``large``.
    sensors: The measurements, by the sensor's CPD.
    discrete: Variables whose probabilities are shown beside moments, as arrays ``states.0``, ....
    """

    reading: ClassVar[str]
    first: int
    hidden: Scope
    words: dict[str, str]
    sensors: Mapping[CPD, Sighted]
    discrete: tuple[Discrete, ...] = ()

    @abstractmethod
    def arrays(self, run: tuple[int, ...]) -> dict[str, Array]:
        """The arrays of a run, by name, with a row a step; ``cov`` and ``K`` are symmetric."""

    def exact(self, name: str) -> bool:
        """Whether a page computes other numbers from an array, and does not show it alone."""
        return True


def sensors_of(readings: Iterable[Reading]) -> dict[CPD, Sighted]:
    """The measurements of sensors, as evidence holds them."""
    found = {}
    for each in readings:
        values = each.values.astype(np.float64)
        if each.taken.shape[-1] == values.shape[-1]:
            values = np.where(each.taken, values, np.nan)
        found[each.cpd] = Sighted(each.step, values, each.inputs)
    return found


def held(span: range) -> range:
    """The steps of the slices that the clusters of some steps hold: the step before, too."""
    return range(max(span[0] - 1, 0), span[-1] + 1)


class ShownMarginals(ShownSlices):
    """The moments of marginals at some steps, and draws of beliefs that are not Gaussian.

    Of mixtures the heaviest Gaussians are shown, too, with their weights; and of discrete variables
    the probabilities of their states. A variable without moments is left out: a hidden control, one
    that was not kept, or one of a family's own form.
    """

    reading: ClassVar[str] = "moments"

    def __init__(self, outcome: Any, span: range, room: Room) -> None:
        self.outcome, self.span, self.room = outcome, span, room
        self.first, self.words = span[0], {"messages": outcome.silent}
        self.sensors = sensors_of(outcome.readings)
        self.beliefs: dict[Variable, Any] = {}
        self.tables: dict[Discrete, Any] = {}
        for variable in outcome.graph.layout.slice:
            try:
                belief = outcome._moments(variable)
            except EvidenceError:
                continue
            if isinstance(variable, Discrete):
                self.tables[variable] = belief
            else:
                self.beliefs[variable] = belief
        self.hidden, self.discrete = tuple(self.beliefs), tuple(self.tables)

    def exact(self, name: str) -> bool:
        """Whether other numbers are computed from an array: of marginals none are."""
        return False

    def arrays(self, run: tuple[int, ...]) -> dict[str, Array]:
        """The moments of all variables together, and ``draws`` of the first one.

        Of mixtures also the ``weights`` and moments, ``gaussian.0.mean`` and so on, of each
        Gaussian; and the probabilities of discrete variables.
        """
        own = {v: self._of_run(belief, v, run) for v, belief in self.beliefs.items()}
        found = self._stacked(own) | self._mixture(own) | self._states(run)
        draws = self._drawn(next(iter(own.values()), None))
        return found if draws is None else found | {"draws": draws}

    def _of_run(self, belief: Any, variable: Variable, run: tuple[int, ...]) -> Any:
        first = 0 if variable in self.outcome.graph.layout.states else 1
        return belief[(*run, slice(max(self.span[0] - first, 0), self.span[-1] + 1 - first))]

    def _stacked(self, beliefs: Mapping[Variable, Any]) -> dict[str, Array]:
        """The moments of all variables together, a row a step; NaN where one has none."""
        size, count = sum(v.dimension for v in beliefs), len(self.span)
        mean, cov = np.full((count, size), np.nan), np.zeros((count, size, size))
        start = 0
        for variable, belief in beliefs.items():
            own = slice(start, start := start + variable.dimension)
            late = count - len(belief.mean)
            cov[:late, own, own] = np.nan
            mean[late:, own], cov[late:, own, own] = belief.mean, belief.cov
        return {"mean": mean, "cov": cov}

    def _mixture(self, beliefs: Mapping[Variable, Any]) -> dict[str, Array]:
        """The Gaussians of a mixture, the heaviest ones of all steps; empty of other beliefs."""
        every = list(beliefs.values())
        if not every or not all(isinstance(each, GaussianMixture) for each in every):
            return {}
        count = {each.weights.shape[-1] for each in every}
        if count == {1} or len(count) > 1:
            return {}
        weights = max((each.weights for each in every), key=len)
        order = np.argsort(-weights.sum(axis=0), kind="stable")[:GAUSSIANS]
        found = {"weights": np.full((len(self.span), len(order)), np.nan)}
        found["weights"][len(self.span) - len(weights) :] = weights[:, order]
        for k, place in enumerate(order.tolist()):
            parts = {
                v: Gaussian._make(
                    (v,), each.components.mean[:, place], each.components.cov[:, place]
                )
                for v, each in beliefs.items()
            }
            found |= {f"gaussian.{k}.{name}": own for name, own in self._stacked(parts).items()}
        return found

    def _states(self, run: tuple[int, ...]) -> dict[str, Array]:
        """The probabilities of the states of discrete variables; NaN where one has none."""
        found = {}
        for k, (variable, table) in enumerate(self.tables.items()):
            values = self._of_run(table.probabilities, variable, run)
            whole = np.full((len(self.span), variable.size), np.nan)
            whole[len(self.span) - len(values) :] = values
            found[f"states.{k}"] = whole
        return found

    def _drawn(self, belief: Any) -> Array | None:
        """Draws of a belief at each step, (steps, draws * components); None of Gaussians."""
        if belief is None or isinstance(belief, Gaussian) or len(belief.mean) < len(self.span):
            return None
        if belief.mean.size * _DRAWS > self.room.numbers:
            return None
        draws: Array = belief.sample(_DRAWS, rng=0)
        return np.moveaxis(draws, 0, 1).reshape(len(self.span), -1)
