"""The components of a belief's variables, by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pgm.factors.scope import distinct_labels
from pgm.variables import Variable


class Part(NamedTuple):
    """One component of a belief.

    component: The index of the component in its variable.
    label: The component's name; where variables share it "x.east", x being the variable.
    row: The row of the component in arrays of states, (d, particles).
    """

    variable: Variable
    component: int
    label: str
    row: int

    @property
    def angle(self) -> bool:
        """Whether the component is an angle."""
        return bool(self.variable.angle_mask[self.component])


def parts(places: Sequence[tuple[Variable, int]]) -> list[Part]:
    """The components of some variables, one after another.

    places: For each variable, a pair of the variable and the row of its first component in arrays
        of states, (d, particles).
    """
    label = iter(distinct_labels(variable for variable, _ in places))
    return [
        Part(variable, k, next(label), first + k)
        for variable, first in places
        for k in range(variable.dimension)
    ]
