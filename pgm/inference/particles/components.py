"""The components of a slice by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pgm.factors.scope import distinct_labels
from pgm.variables import Variable


class Part(NamedTuple):
    """One component of a belief."""

    variable: Variable
    component: int
    label: str
    row: int

    @property
    def angle(self) -> bool:
        """Whether it is an angle."""
        return bool(self.variable.angle_mask[self.component])


def parts(places: Sequence[tuple[Variable, int]]) -> list[Part]:
    """The components of variables whose first rows are given, with a name for each."""
    label = iter(distinct_labels(variable for variable, _ in places))
    return [
        Part(variable, k, next(label), first + k)
        for variable, first in places
        for k in range(variable.dimension)
    ]
