"""A search for the modes of a posterior: what one of a chain has, and of a network without time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, Self

from pgm.beliefs.modes.laws import Laws, Target
from pgm.beliefs.modes.outcome import Found, ModesOutcome, Part
from pgm.kernels.arrays import Integers
from pgm.schedules.damping import Damping


class Search(Protocol):
    """A model with its evidence, in whose posterior modes are looked for from several starts.

    Attributes
    ----------
    lead : tuple of int
        The axes of runs.
    runs : int
        How many runs there are.
    together : bool
        Whether runs are asked together alone, as CPDs differ by run.
    """

    @property
    def lead(self) -> tuple[int, ...]:
        """The axes of runs."""
        ...

    @property
    def runs(self) -> int:
        """How many runs there are."""
        ...

    @property
    def together(self) -> bool:
        """Whether runs are asked together alone, as CPDs differ by run."""
        ...

    def of(self, runs: Integers) -> Self:
        """The search in some runs, which then have one axis; in all where they are together."""
        ...

    def by(self, iterations: int, tolerance: float, damping: Damping) -> Self:
        """The search by schedules of so many iterations."""
        ...

    def otherwise(self) -> Self:
        """The search by a rule that takes means of nonlinear functions, not their slopes."""
        ...

    def arrived(self, starts: int) -> list[Part]:
        """The beliefs that so many starts, points of the prior, lead to."""
        ...

    def unled(self) -> list[Part]:
        """The beliefs to which a schedule without a start leads."""
        ...

    def chosen(self, parts: Sequence[Part], count: int) -> Found:
        """The modes at which starts have arrived, `count` at the most."""
        ...

    def laws(self, found: Found) -> Laws:
        """The Gaussian laws of all hidden variables, one of each mode."""
        ...

    def target(self, laws: Laws) -> Target:
        """The exact density of all hidden variables; a NumericalError where there is none.

        It is of one turn about the laws, in angles of which it knows no turns.
        """
        ...

    def outcome(self, found: Found) -> ModesOutcome:
        """The mixtures of the modes."""
        ...

    def beliefs(self, laws: Laws) -> Any:
        """The beliefs of laws, with an axis of modes before runs."""
        ...
