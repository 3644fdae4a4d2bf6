"""Units of columns, and the quantities that the components of a recording are."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.recordings.drives.earth import WORLD

LENGTH, TIME, ANGLE = "a length", "a time", "an angle"
SPEED, RATE, ACCELERATION = "a speed", "a turn rate", "an acceleration"


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit by its quantity and its size in metres, seconds and radians."""

    quantity: str
    size: float


UNITS = {
    name: Unit(quantity, size)
    for quantity, units in {
        LENGTH: {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "in": 0.0254},
        TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
        ANGLE: {"rad": 1.0, "deg": math.pi / 180.0, "mrad": 1e-3, "turn": 2.0 * math.pi},
        SPEED: {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "cm/s": 1e-2, "mm/s": 1e-3},
        RATE: {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
        ACCELERATION: {"m/s^2": 1.0, "g": 9.80665},
    }.items()
    for name, size in units.items()
}

STAMP = "t"
# Components that are one quantity wherever they stand, and those of a drive's own velocities.
_KNOWN = {
    STAMP: TIME,
    **dict.fromkeys(("distance", "forward", "left", "right", "trans", "range"), LENGTH),
    **dict.fromkeys(("east", "north", "up", "x", "y", "z", "altitude", "height"), LENGTH),
    **dict.fromkeys(("heading", "turn", "rot1", "rot2", "bearing", "elevation"), ANGLE),
    **dict.fromkeys(("yaw", "pitch", "roll", *WORLD), ANGLE),
    **dict.fromkeys(("v", "v_forward", "v_left", "speed"), SPEED),
    **dict.fromkeys(("omega", "rate_x", "rate_y", "rate_z"), RATE),
    **dict.fromkeys(("acceleration_x", "acceleration_y", "acceleration_z"), ACCELERATION),
}
_DRIVEN = {"left": SPEED, "right": SPEED}


def quantity(part: str, component: str) -> str | None:
    """The quantity that a component of a part of a recording is; None of a name of the user's."""
    if part == "velocities" and component in _DRIVEN:
        return _DRIVEN[component]
    return _KNOWN.get(component)


def size_of(what: str, part: str, component: str, unit: object) -> float:
    """The size of a unit, refused where it is none, or one of another quantity."""
    found = UNITS.get(unit) if isinstance(unit, str) else None
    due = quantity(part, component)
    if found is None:
        raise EvidenceError(f"{what}: {unit!r} is no unit; known are {listed(UNITS, 99)}")
    if due is not None and found.quantity != due:
        fitting = [name for name, each in UNITS.items() if each.quantity == due]
        hint = ""
        if due == LENGTH and found.quantity == ANGLE:
            hint = (
                "; degrees of a map become metres under the names 'latitude' and 'longitude', "
                f"{{'latitude': ('lat', {unit!r}), ...}}"
            )
        raise EvidenceError(
            f"{what}: {unit!r} is {found.quantity}, and {component!r} {due}, in "
            f"{listed(fitting, 99)}{hint}"
        )
    return found.size
