"""The traces of users' functions that a bound call uses, cleared where its sweep evaluated them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.bound.room import Pair
from pgm.beliefs.moments.compiled.judged import (
    Belief,
    evaluated,
    is_regressed,
    laid_out,
    standing,
)
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.linearisation.family import Family
from pgm.tracing import Program, Tracer
from pgm.tracing.clearing import Clearing, Standing


class Trace(NamedTuple):
    """A trace that a call uses, and the machine code that clears it."""

    tracer: Tracer
    program: Program
    clearing: Clearing
    columns: Sequence[int]

    @classmethod
    def of(cls, family: Family) -> Trace:
        """The trace of a family's function, if that is cleared at once; else `Uncompiled`."""
        answers = family.compiled
        assert answers is not None
        differentiated = not is_regressed(family)
        clearing = answers.slopes.clearing(answers.trace, differentiated=differentiated)
        if clearing is None or answers.every > 1 or answers.thin > 1:
            raise Uncompiled("a trace is not cleared at once")
        return cls(answers.tracer, answers.trace, clearing, answers.places)

    @property
    def stands(self) -> bool:
        """Whether calls would use the trace, and have often found it right."""
        return self.tracer.stands(self.program)

    def prove(self) -> None:
        """Take the trace for right, since a call has found it so."""
        self.tracer.prove(self.program)


class AtBeliefs(NamedTuple):
    """A trace that was evaluated at the means of beliefs, which stand in a call's memory.

    `first` is where the places of its points begin among the numbers, of which some point to what
    is `kept`; `number` and `squared` are as of `Standing`.
    """

    trace: Trace
    first: int
    number: int
    squared: bool
    kept: object

    def clears(self, made: Made, table: int) -> bool:
        """Whether the trace is surely right in a call whose numbers begin at an address."""
        places = table + 8 * self.first
        return self.trace.clearing.clears_at(self.number, places, squared=self.squared)


class LaidOut(NamedTuple):
    """A trace that was evaluated at points that do not stand in memory, and are laid out again.

    `place` is the number of the family, and `again` says that beliefs are those of an iteration.
    """

    trace: Trace
    place: int
    belief: Belief
    again: bool

    def clears(self, made: Made, table: int) -> bool:
        """Whether the trace is surely right in a call."""
        if self.again:
            return self.clears_at(made, None, made.known)
        return self.clears_at(made, made.known, made.predicted)

    def clears_at(self, made: Made, known: Pair | None, predicted: Pair) -> bool:
        """Whether the trace is surely right at beliefs, as of `evaluated`."""
        family = made.plan.families[self.place]
        arguments, std = laid_out(family, self.belief.of_sweep(known, predicted))
        flat = np.concatenate(arguments, axis=-1)
        own = None if std is None else std[:, self.trace.columns]
        return self.trace.clearing.clears(Standing.of(flat, own))


Check = AtBeliefs | LaidOut


def checks(made: Made, numbers: list[int], *, again: bool) -> list[Check]:
    """The checks of all traces of a call's sweep, whose places are added to its numbers.

    `again` says that sensors were linearised at the known beliefs, too.
    """
    found: list[Check] = []
    moments: list[tuple[Pair | None, Pair]] = [(made.known, made.predicted)]
    if again:
        moments.append((None, made.known))
    for each in moments:
        for family, belief in evaluated(made.plan, *each):
            if is_regressed(family):
                found.append(_laid_out(made, family, belief, again=each[0] is None))
                continue
            points = standing(family, belief)
            own = points.number, points.squared, points.kept
            found.append(AtBeliefs(Trace.of(family), len(numbers), *own))
            numbers += points.places
    return found


def laid_out_again(made: Made) -> list[LaidOut]:
    """The checks of all traces of a call at beliefs that are given later."""
    every = evaluated(made.plan, made.known, made.predicted)
    return [_laid_out(made, family, belief, again=False) for family, belief in every]


def _laid_out(made: Made, family: Family, belief: Belief, *, again: bool) -> LaidOut:
    place = next(k for k, each in enumerate(made.plan.families) if each is family)
    return LaidOut(Trace.of(family), place, belief, again)
