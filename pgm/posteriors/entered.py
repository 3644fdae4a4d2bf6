"""The evidence of a network without time, as its posterior asks for it."""

from __future__ import annotations

from typing import Any, Protocol

from pgm.evidence.cells import Cells
from pgm.posteriors.outcome import Outcome


class Entered(Protocol):
    """Evidence with gaps, and the beliefs of these."""

    @property
    def cells(self) -> Cells:
        """The evidence, checked, by run."""
        ...

    def leaves_out(self, variable: object) -> bool:
        """Whether the posterior's outcome lacks a belief of a variable not observed in full."""
        ...

    @property
    def left_out(self) -> bool:
        """Whether it lacks the belief of some variable."""
        ...

    @property
    def by_pattern(self) -> Outcome[Any]:
        """The beliefs of the same evidence, each pattern of gaps solved by itself."""
        ...
