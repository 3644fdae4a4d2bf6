"""Slices of a chain as a page shows them: arrays of each run, with a row a step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pgm.cpds import CPD
from pgm.errors import EvidenceError
from pgm.evidence import Reading
from pgm.factors import Gaussian
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete, Variable

# Draws at each step that a page shows of beliefs that are not Gaussian.
_DRAWS = 60


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
    """

    reading: ClassVar[str]
    first: int
    hidden: Scope
    words: dict[str, str]
    sensors: Mapping[CPD, Sighted]

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

    A variable without moments is left out: a hidden control, one that was not kept, or one of a
    family's own form.
    """

    reading: ClassVar[str] = "moments"

    def __init__(self, outcome: Any, span: range, room: Room) -> None:
        self.outcome, self.span, self.room = outcome, span, room
        self.first, self.words = span[0], {"messages": outcome.silent}
        self.sensors = sensors_of(outcome.readings)
        self.beliefs: dict[Variable, Any] = {}
        for variable in outcome.graph.layout.slice:
            try:
                belief = outcome._moments(variable)
            except EvidenceError:
                continue
            if not isinstance(variable, Discrete):
                self.beliefs[variable] = belief
        self.hidden = tuple(self.beliefs)

    def exact(self, name: str) -> bool:
        """Whether other numbers are computed from an array: of marginals none are."""
        return False

    def arrays(self, run: tuple[int, ...]) -> dict[str, Array]:
        """The moments of all variables together, and ``draws`` of the first one."""
        own = {v: self._of_run(belief, v, run) for v, belief in self.beliefs.items()}
        found = self._stacked(own)
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

    def _drawn(self, belief: Any) -> Array | None:
        """Draws of a belief at each step, (steps, draws * components); None of Gaussians."""
        if belief is None or isinstance(belief, Gaussian) or len(belief.mean) < len(self.span):
            return None
        if belief.mean.size * _DRAWS > self.room.numbers:
            return None
        draws: Array = belief.sample(_DRAWS, rng=0)
        return np.moveaxis(draws, 0, 1).reshape(len(self.span), -1)
