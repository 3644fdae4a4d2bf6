"""The quantities and units of components that are known by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pgm.boundary import as_tuple, is_unordered
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.units import (
    ACCELERATION,
    ANGLE,
    LENGTH,
    RATE,
    SPEED,
    SPELLINGS,
    TIME,
    UNITS,
    factor,
    in_words,
    of_quantity,
    plain_unit,
)
from pgm.variables import Variable

STAMP = "t"
LATITUDE, LONGITUDE = WORLD = ("latitude", "longitude")
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


def sizes(given: Any, components: Sequence[str]) -> tuple[tuple[str, ...], list[float]]:
    """Units of size 1 of a stream's components, and the sizes of the given ones in these.

    Units that are not given are those of the components' names, or none.
    """
    by_name = [_by_name(name, components) for name in components]
    if given is None:
        return tuple(plain_unit(each) if each else "" for each in by_name), [1.0] * len(by_name)
    told = _told(given, components)
    units, found = [], []
    for name, due, unit in zip(components, by_name, told, strict=True):
        if unit in SPELLINGS:
            raise EvidenceError(
                f"units=: the unit {unit!r} of {name!r} is spelt {SPELLINGS[unit]!r} here"
            )
        own = UNITS[unit].quantity if unit in UNITS else None
        if due and unit and own != due:
            raise EvidenceError(
                f"units=: {unit!r} of {name!r} is no unit of {due}, as {listed(of_quantity(due))} "
                "are"
            )
        own = own or due
        units.append(plain_unit(own) if own else unit)
        found.append(UNITS[unit].size if unit in UNITS else 1.0)
    return tuple(units), found


def _by_name(component: str, components: Sequence[str]) -> str | None:
    """The quantity of a component; the left and right of wheels are lengths or speeds."""
    if component in _DRIVEN and not {"forward", "turn"} & set(components):
        return None
    return _KNOWN.get(component)


def _told(given: Any, components: Sequence[str]) -> tuple[str, ...]:
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in components]
        if unknown:
            raise EvidenceError(f"units= has {unknown[0]!r}; the columns are {listed(components)}")
        found = tuple(given.get(name, "") for name in components)
    else:
        found = (given,) if isinstance(given, str) else as_tuple(given) or ()
    if (
        is_unordered(given)
        or len(found) != len(components)
        or not all(isinstance(unit, str) for unit in found)
    ):
        raise EvidenceError(
            f"units= is a text for each of {listed(components)}, in order or by name, "
            f'{{{components[0]!r}: "m"}}, not {given!r}'
        )
    return found


def converted(variable: Variable, component: str, unit: str, what: str) -> float:
    """How many of a variable's units a recording's unit is; units that are unknown are equal."""
    own = variable.unit_of(component)
    size = 1.0 if not own or not unit else factor(unit, own)
    if size is None:
        raise EvidenceError(
            f"{what}: {component!r} is in {in_words(unit)} and of {variable!r} in "
            f"{in_words(own).rstrip(',')}; one is no multiple of the other",
            variable=variable,
        )
    return size
