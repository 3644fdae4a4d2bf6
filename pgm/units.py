"""Units of components: their quantities, and how numbers of one unit become those of another."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

LENGTH, TIME, ANGLE = "a length", "a time", "an angle"
SPEED, RATE, ACCELERATION = "a speed", "a turn rate", "an acceleration"


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit by its quantity and its size in metres, seconds and radians."""

    quantity: str
    size: float


# The first unit of each quantity is the one of size 1.
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
# Other spellings of these, by the one that is known here.
_SPELT = {
    "m": ("metre", "metres", "meter", "meters"),
    "s": ("sec", "second", "seconds"),
    "rad": ("radian", "radians"),
    "deg": ("°", "degree", "degrees"),
    "us": ("µs", "μs"),
    "m/s": ("mps", "m s^-1"),
    "km/h": ("kph", "kmh"),
    "rad/s": ("rad s^-1", "rads"),
    "deg/s": ("°/s", "dps"),
    "m/s^2": ("m/s2", "m/s²", "m/s**2", "m s^-2"),
}
SPELLINGS = {other: name for name, others in _SPELT.items() for other in others}
RAD = "rad"


def plain_unit(quantity: str) -> str:
    """The unit of a quantity whose size is 1, such as the metre of lengths."""
    return next(name for name, unit in UNITS.items() if unit.quantity == quantity)


def of_quantity(quantity: str) -> list[str]:
    """The units of a quantity."""
    return [name for name, unit in UNITS.items() if unit.quantity == quantity]


def factor(unit: str, other: str) -> float | None:
    """How many of another unit one unit is; None where they are of two quantities.

    Units without a known quantity are equal or of two quantities.
    """
    if unit == other:
        return 1.0
    one, two = UNITS.get(unit), UNITS.get(other)
    if one is None or two is None or one.quantity != two.quantity:
        return None
    return one.size / two.size


def in_words(unit: str) -> str:
    """A unit with its quantity, for messages."""
    return f"{unit!r}, {UNITS[unit].quantity}," if unit in UNITS else repr(unit)


def common(units: Iterable[str]) -> str:
    """The unit that all of several components have; empty where they differ."""
    found = set(units)
    return found.pop() if len(found) == 1 else ""
