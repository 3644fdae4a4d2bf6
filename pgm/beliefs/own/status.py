"""The status of a user's own family of beliefs: its figures, by name, with what warns of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.beliefs.own.kept import closed
from pgm.boundary import as_floats
from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.posteriors.figures import OwnFigures, Threshold
from pgm.posteriors.status import Status

if TYPE_CHECKING:
    from pgm.beliefs.own.family import BeliefFamily


def status_of(
    family: BeliefFamily[Any],
    beliefs: Sequence[Any],
    lead: tuple[int, ...],
    forward: Status | None = None,
    of: str = "",
) -> Status:
    """The status of beliefs of all steps, with the family's numbers, (*lead, steps) each.

    A number beyond its threshold in `family.warns` gives a BeliefWarning, unless that of a
    smoother's `forward` pass has given it. `of` says which beliefs they are, where that is not
    clear.
    """
    runs, numbers = int(np.prod(lead)), {}
    each = [family.numbers(closed(belief)) for belief in beliefs]
    for found in each:
        named = isinstance(found, Mapping) and all(isinstance(name, str) for name in found)
        if not named or set(found) != set(each[0]):
            raise ModelError(
                f"{family!r}: numbers(belief) returns a mapping of the same names for each belief, "
                f"not {found!r}"
            )
    for name in each[0] if each else ():
        if hasattr(Status, name) or name in Status.__annotations__:
            raise ModelError(f"{family!r}: numbers(belief) has {name!r}, which every status has")
        values = np.stack([_by_run(family, name, one[name], runs) for one in each], axis=-1)
        numbers[name] = values.reshape(*lead, len(each))
    for name, threshold in family.warns.items():
        if not isinstance(threshold, Threshold) or (each and name not in numbers):
            raise ModelError(
                f"{family!r}: warns has {name!r}: {threshold!r}; it maps names of numbers(belief) "
                "to pgm.Threshold(...)"
            )
    figures = OwnFigures(numbers, family.warns)
    figures.warn(f"{family!r}{of}", None if forward is None else forward._figures)
    return Status.of_figures(figures, lead)


def _by_run(family: BeliefFamily[Any], name: str, value: Any, runs: int) -> Array:
    """A figure of a belief, (runs,), from a number or an array of these."""
    found = as_floats(value, f"{family!r}: {name} of numbers(belief)", ModelError)
    if found.shape not in ((), (runs,)):
        raise ModelError(
            f"{family!r}: {name} of numbers(belief) has shape {found.shape}; ({runs},), one a run, "
            "or a number was due"
        )
    return np.broadcast_to(found, (runs,))
