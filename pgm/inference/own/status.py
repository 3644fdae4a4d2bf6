"""The status of a user's own family of beliefs: its figures, by name, with what warns of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.inference.figures import OwnFigures
from pgm.inference.status import Status

if TYPE_CHECKING:
    from pgm.inference.belief_family import BeliefFamily


def status_of(family: BeliefFamily[Any], beliefs: Sequence[Any], lead: tuple[int, ...]) -> Status:
    """The status of beliefs of all steps, with the family's numbers, (*lead, steps) each.

    A number beyond its threshold in `family.warns` gives a BeliefWarning.
    """
    runs = int(np.prod(lead))
    each = [family.numbers(belief) for belief in beliefs]
    numbers = {}
    for name in each[0] if each else ():
        values = [np.broadcast_to(np.asarray(one[name], dtype=np.float64), (runs,)) for one in each]
        numbers[name] = np.stack(values, axis=-1).reshape(*lead, len(each))
    figures = OwnFigures(numbers, family.warns)
    figures.warn(repr(family))
    return Status.of_figures(figures, lead)
