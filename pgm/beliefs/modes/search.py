"""A search for the modes of a posterior: what one of a chain has, and of a network without time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
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

# One in so many starts may fail by trial.
SPARE = 10


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
        together. Where more than one in ten fail by trial, in float64, they are tried with care.
        """
        begun = self._begun(starts)
        numbers, spare = np.arange(before, starts) + 1, (starts - before) // SPARE

        def infer(search: Self, some: Integers) -> Any:
            return search._inferred(some.size, {v: own[some - 1] for v, own in begun.items()})

        if self.runs == 1 or self.together:
            return self._tried(infer, numbers, spare).some
        found = arrivals.arrived(partial(infer, self._by_trial()), numbers)
        axes = 1 + len(self.lead)
        means = {v: own.reshape(starts, self.runs, *own.shape[axes:]) for v, own in begun.items()}
        runs = np.tile(np.arange(self.runs), found.failed.size)
        pairs = self._in_pairs(np.repeat(found.failed, self.runs), runs, means, 1, spare)
        return found._replace(parts=[*found.parts, *pairs]).some

    def unled(self) -> list[Part]:
        """The beliefs to which a schedule without a start leads, start 0."""
        return arrivals.arrived(lambda some: self._inferred(some.size, None), np.arange(1)).some

    def _by_trial(self) -> Self:
        """The search by starts of which each is one among many."""
        return self._called(self.call._replace(trial=True))

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
        spare = len(left) // SPARE
        if not self.together:
            starts, runs = np.nonzero(left)
            return self._in_pairs(starts, runs, means, 0, spare)

        def infer(search: Self, some: Integers) -> Any:
            shape = some.size, *self.lead
            start = {v: mean[some].reshape(*shape, *mean.shape[2:]) for v, mean in means.items()}
            return search._inferred(some.size, start)

        starts = np.flatnonzero(left.any(axis=1) & known.all(axis=1))
        return self._tried(infer, starts, spare).parts

    def _in_pairs(
        self,
        starts: Integers,
        runs: Integers,
        means: Mapping[Variable, Array],
        first: int,
        spare: int,
    ) -> list[Part]:
        """The beliefs of starts each of one run, (P,) and (P,), but of those that fail.

        `means`, (S, runs, ...), are those of the starts from number `first` on. Of a run so many
        may fail by trial as are `spare`.
        """

        def infer(search: Self, some: Integers) -> Any:
            start = {v: mean[starts[some] - first, runs[some]][None] for v, mean in means.items()}
            return search._of(runs[some])._inferred(1, start)

        found = self._tried(infer, np.arange(starts.size), spare, runs).parts
        return [Part(starts[own], outcome, runs[own]) for own, outcome, _ in found]

    def _tried(
        self,
        infer: Callable[[Self, Integers], Any],
        starts: Integers,
        spare: int,
        runs: Integers | None = None,
    ) -> arrivals.Arrived:
        """The outcomes from starts by trial; with care where more fail than a number to `spare`.

        It is of each run where each start is of one of the `runs`, (P,). `infer` takes the search,
        by trial or not, and some of the starts.
        """
        found = arrivals.arrived(partial(infer, self._by_trial()), starts)
        failed = found.failed
        if runs is not None:
            of = runs[failed]
            failed = failed[np.bincount(of, minlength=self.runs)[of] > spare]
        elif failed.size <= spare:
            failed = failed[:0]
        return found.with_others(arrivals.arrived(partial(infer, self), failed))

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
