"""A search for the modes of a posterior: what one of a chain has, and of a network without time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np

from pgm.beliefs.modes import arrivals
from pgm.beliefs.modes.arrivals import spread_rule
from pgm.beliefs.modes.laws import Laws, Target
from pgm.beliefs.modes.outcome import Found, ModesOutcome, Part
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers
from pgm.schedules.damping import Damping
from pgm.schedules.options import Call
from pgm.schedules.schedule import Calibration, Smoothing
from pgm.schedules.starting_points import Start
from pgm.variables import Variable


class Search(ABC):
    """A model with its evidence, in whose posterior modes are looked for from several starts.

    Attributes
    ----------
    call : Call
        With the schedule from each start.
    schedule : type
        The kind of schedule from each start.
    """

    call: Call
    schedule: ClassVar[type[Smoothing | Calibration]]

    @property
    @abstractmethod
    def lead(self) -> tuple[int, ...]:
        """The axes of runs."""

    @property
    @abstractmethod
    def runs(self) -> int:
        """How many runs there are."""

    @property
    def first_run(self) -> int:
        """The number of the first run, from which errors count."""
        return 0

    @property
    @abstractmethod
    def steps(self) -> int:
        """T, the last step; 0 of a network without time."""

    @property
    @abstractmethod
    def together(self) -> bool:
        """Whether runs are asked together alone, as CPDs differ by run."""

    @property
    @abstractmethod
    def hidden(self) -> Scope:
        """The hidden variables."""

    @property
    @abstractmethod
    def width(self) -> int:
        """How many components a nonlinear function is averaged over at the most."""

    def of(self, runs: Integers) -> Self:
        """The search in some runs, which then have one axis; in all where they are together."""
        same = runs.size == self.runs and bool((runs == np.arange(self.runs)).all())
        return self if same or self.together else self._of(runs)

    @abstractmethod
    def _of(self, runs: Integers) -> Self:
        """The search in some runs, of any number and in any order."""

    def by(self, iterations: int, tolerance: float, damping: Damping) -> Self:
        """The search by schedules of so many iterations."""
        schedule = self.schedule(iterations, tolerance, damping)
        return self._called(self.call._replace(schedule=schedule))

    def otherwise(self) -> Self:
        """The search by a rule that takes means of nonlinear functions, not their slopes."""
        return self._called(self.call._replace(lineariser=spread_rule(self.width)))

    @abstractmethod
    def _called(self, call: Call) -> Self:
        """The search by another call."""

    def arrived(self, starts: int, before: int = 0) -> list[Part]:
        """The beliefs that points of the prior lead to: so many, less a number `before` of them.

        They are numbered from 1. One that fails in some run goes on in the others, unless runs are
        together.
        """
        begun = self._begun(starts)

        def infer(some: Integers) -> Any:
            return self._inferred(some.size, {v: own[some - 1] for v, own in begun.items()})

        found = arrivals.arrived(infer, np.arange(before, starts) + 1)
        if found.failed.size and self.runs > 1 and not self.together:
            axes = 1 + len(self.lead)
            means = {
                v: own.reshape(starts, self.runs, *own.shape[axes:]) for v, own in begun.items()
            }
            runs = np.tile(np.arange(self.runs), found.failed.size)
            pairs = self._in_pairs(np.repeat(found.failed, self.runs), runs, means, 1)
            found = found._replace(parts=[*found.parts, *pairs])
        return found.some

    def unled(self) -> list[Part]:
        """The beliefs to which a schedule without a start leads, start 0."""
        return arrivals.arrived(lambda some: self._inferred(some.size, None), np.arange(1)).some

    def resumed(self, parts: Sequence[Part]) -> list[Part]:
        """The beliefs of starts that had not settled, which go on from where they stopped.

        They are of the runs in which they had not; where runs are together, of all.
        """
        means, known = {}, np.array(True)
        for variable in self.hidden:
            each = [part.outcome[variable].mean for part in parts]
            mean = means[variable] = arrivals.by_start(parts, self.lead, each)
            known = known & np.isfinite(mean).all(axis=tuple(range(2, mean.ndim)))
        left = known & ~arrivals.heights(parts, self.lead).settled
        if not self.together:
            starts, runs = np.nonzero(left)
            return self._in_pairs(starts, runs, means, 0)

        def infer(some: Integers) -> Any:
            shape = some.size, *self.lead
            start = {v: mean[some].reshape(*shape, *mean.shape[2:]) for v, mean in means.items()}
            return self._inferred(some.size, start)

        starts = np.flatnonzero(left.any(axis=1) & known.all(axis=1))
        return arrivals.arrived(infer, starts).parts if starts.size else []

    def _in_pairs(
        self, starts: Integers, runs: Integers, means: Mapping[Variable, Array], first: int
    ) -> list[Part]:
        """The beliefs of starts each of one run, (P,) and (P,), but of those that fail.

        `means`, (S, runs, ...), are those of the starts from number `first` on.
        """

        def infer(some: Integers) -> Any:
            start = {v: mean[starts[some] - first, runs[some]][None] for v, mean in means.items()}
            return self._of(runs[some])._inferred(1, start)

        if not starts.size:
            return []
        found = arrivals.arrived(infer, np.arange(starts.size)).parts
        return [Part(starts[own], outcome, runs[own]) for own, outcome, _ in found]

    def chosen(self, parts: Sequence[Part], count: int) -> Found:
        """The modes at which starts have arrived, `count` at the most."""
        return arrivals.chosen(parts, self.hidden, self.lead, self.first_run, count)

    @abstractmethod
    def _begun(self, starts: int) -> Mapping[Variable, Array]:
        """So many points of the prior, (starts, *lead, ...)."""

    @abstractmethod
    def _inferred(self, count: int, start: Start | None) -> Any:
        """The outcome of so many starts, with an axis of them before runs."""

    @abstractmethod
    def target(self, laws: Laws) -> Target:
        """The exact density of all hidden variables; a NumericalError where there is none.

        It is of one turn about the laws, in angles of which it knows no turns.
        """

    @abstractmethod
    def laws(self, found: Found) -> Laws:
        """The Gaussian laws of all hidden variables, one of each mode."""

    @abstractmethod
    def beliefs(self, laws: Laws) -> Any:
        """The beliefs of laws, with an axis of modes before runs."""

    @abstractmethod
    def outcome(self, found: Found) -> ModesOutcome:
        """The mixtures of the modes."""
