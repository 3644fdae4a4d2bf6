"""Places on the earth as metres in a plane: latitudes and longitudes of satellite receivers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgm.errors import EvidenceError
from pgm.io.dropped import Dropped
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.recordings.drives.quantities import LATITUDE, LONGITUDE, WORLD
from pgm.recordings.drives.stream import Stream

# Names of the height above the ellipsoid [m], of which `UP` is the difference to the origin's.
HEIGHTS = ("up", "altitude", "height")
EAST, NORTH, UP = "east", "north", "up"
NULL = "0°, 0°, as receivers say that have no fix"
# Semi-major axis [m] and flattening of WGS 84.
RADIUS, FLATTENING = 6_378_137.0, 1.0 / 298.257223563
_SQUARED = FLATTENING * (2.0 - FLATTENING)  # of the eccentricity
# Bounds of latitudes and longitudes [°], and a whole turn, up to the rounding of radians.
_POLE, _HALF, _TURN = (bound * (1.0 + 1e-12) for bound in (90.0, 180.0, 360.0))


def on_plane(streams: Mapping[str, Stream]) -> tuple[dict[str, Stream], list[Dropped]]:
    """Streams whose latitudes and longitudes [rad] have become metres on one plane.

    The plane touches the ellipsoid at the first fix of the first of these streams. Variances of
    latitude and longitude are those north and east [m²]. Rows at 0°, 0° are none, and told.
    """
    found, told = dict(streams), []
    origin: Array | None = None
    for name, stream in streams.items():
        if not set(WORLD) & set(stream.components):
            continue
        _require_both(name, stream)
        null = is_null(np.column_stack([stream[one] for one in WORLD]))
        if null.any():
            told.append(Dropped(name, NULL, np.flatnonzero(null)))
            stream = stream.take(~null)
        _require_degrees(name, stream, np.flatnonzero(~null))
        world = np.column_stack([stream[one] for one in WORLD])
        height = _height(stream)
        fixed = np.isfinite(world).all(axis=1)
        if origin is None and fixed.any():
            row = int(fixed.argmax())
            origin = np.append(world[row], height[row])
        found[name] = _flat(stream, world, height, np.zeros(3) if origin is None else origin)
    return found, told


def is_null(world: Array) -> Mask:
    """The mask of latitudes and longitudes (n, 2) that are both exactly zero."""
    null: Mask = (world == 0.0).all(axis=1)
    return null


def _flat(stream: Stream, world: Array, height: Array, origin: Array) -> Stream:
    """A stream with metres east, north and up for latitude, longitude and height."""
    metres = dict(zip((EAST, NORTH, UP), local(world, height, origin).T, strict=True))
    named = {LATITUDE: NORTH, LONGITUDE: EAST} | dict.fromkeys(HEIGHTS, UP)
    order = {EAST: LONGITUDE, NORTH: LATITUDE}
    order |= {named.get(each, each): each for each in stream.components if each not in WORLD}
    places = [stream.place(each) for each in order.values()]
    values = np.column_stack([metres.get(new, stream[old]) for new, old in order.items()])
    values[np.isnan(stream.values[:, places])] = np.nan
    return stream.replace(
        values=values,
        components=tuple(order),
        variances=None if stream.variances is None else stream.variances[:, places],
    )


def _height(stream: Stream) -> Array:
    """Heights [m]; missing ones are set to the first known height."""
    name = next((each for each in HEIGHTS if each in stream.components), None)
    if name is None:
        return np.zeros(len(stream))
    height = stream[name].copy()
    known: Mask = np.isfinite(height)
    height[~known] = height[known][0] if known.any() else 0.0
    return height


def _require_both(name: str, stream: Stream) -> None:
    for one, other in (WORLD, WORLD[::-1]):
        if one not in stream.components:
            raise EvidenceError(f"{name} has a {other} and no {one}; give both")
    twice = {EAST, NORTH} & set(stream.components)
    if twice or len(set(HEIGHTS) & set(stream.components)) > 1:
        raise EvidenceError(
            f"{name} has the components {', '.join(stream.components)}: two of one direction; "
            "leave those out that are derived"
        )


def _require_degrees(name: str, stream: Stream, rows: Integers) -> None:
    """Refuse latitudes beyond a pole, and longitudes beyond half a turn."""
    latitude, longitude = (np.degrees(stream[one]) for one in WORLD)
    beyond = (np.abs(latitude) > _POLE) | (np.abs(longitude) > _HALF)
    if beyond.any():
        row = int(beyond.argmax())
        hint = "are they degrees?"
        if abs(longitude[row]) <= _POLE and abs(latitude[row]) <= _HALF:
            hint = "are latitude and longitude exchanged?"
        elif abs(latitude[row]) <= _POLE and _from_zero(longitude):
            hint = (
                "they seem to go from 0 to 360: subtract 360 from those beyond 180, or 2π where "
                "they are in radians"
            )
        raise EvidenceError(
            f"{name}, row {rows[row]}: latitude {latitude[row]:.9g}°, longitude "
            f"{longitude[row]:.9g}°, where −90 to 90 and −180 to 180 are due; {hint}"
        )


def _from_zero(longitude: Array) -> bool:
    """Whether all known longitudes (n,) [°] are within 0 and a whole turn, as some maps count."""
    known = longitude[np.isfinite(longitude)]
    return bool(((known >= 0.0) & (known <= _TURN)).all())


def local(world: Array, height: Array, origin: Array) -> Array:
    """East, north and up, (n, 3) [m], of latitudes and longitudes, (n, 2) [rad], and heights.

    The axes are those of an origin (3,), latitude, longitude and height:

        [east; north; up] = A (c − c_0),    the rows of A being the directions east, north, up,

    of places c that turn with the earth.
    """
    away = _cartesian(np.sin(world), np.cos(world), height)
    sin, cos = np.sin(origin[None, :2]), np.cos(origin[None, :2])
    away -= _cartesian(sin, cos, origin[2:])
    (sin_lat, sin_lon), (cos_lat, cos_lon) = sin[0], cos[0]
    axes = np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )
    found: Array = away @ axes.T
    return found


def _cartesian(sin: Array, cos: Array, height: Array) -> Array:
    """Coordinates that turn with the earth, of sines and cosines of latitude and longitude.

    With the radius of curvature N = a / √(1 − e² sin² φ),

        c = [(N + h) cos φ cos λ; (N + h) cos φ sin λ; (N (1 − e²) + h) sin φ].
    """
    normal = RADIUS / np.sqrt(1.0 - _SQUARED * sin[:, 0] ** 2)
    level = (normal + height) * cos[:, 0]
    up = (normal * (1.0 - _SQUARED) + height) * sin[:, 0]
    return np.column_stack([level * cos[:, 1], level * sin[:, 1], up])
