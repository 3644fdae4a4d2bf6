"""Units of a table's columns."""

from __future__ import annotations

from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.recordings.drives.quantities import quantity
from pgm.units import ANGLE, LENGTH, UNITS, Unit, of_quantity


def unit_of(what: str, part: str, component: str, unit: object) -> Unit:
    """A unit by its name, refused where it is none, or one of another quantity."""
    found = UNITS.get(unit) if isinstance(unit, str) else None
    due = quantity(part, component)
    if found is None:
        raise EvidenceError(f"{what}: {unit!r} is no unit; known are {listed(UNITS, 99)}")
    if due is not None and found.quantity != due:
        hint = ""
        if due == LENGTH and found.quantity == ANGLE:
            hint = (
                "; degrees of a map become metres under the names 'latitude' and 'longitude', "
                f"{{'latitude': ('lat', {unit!r}), ...}}"
            )
        raise EvidenceError(
            f"{what}: {unit!r} is {found.quantity}, and {component!r} {due}, in "
            f"{listed(of_quantity(due), 99)}{hint}"
        )
    return found
