"""Places on the earth as metres in a plane: latitudes and longitudes of satellite receivers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgm.errors import EvidenceError
from pgm.io.dropped import Dropped
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.recordings.drives import spreads
from pgm.recordings.drives.datum import NO_PLANE, Datum
from pgm.recordings.drives.quantities import LATITUDE, LONGITUDE, WORLD
from pgm.recordings.drives.stream import Stream

# Names of the height above the ellipsoid [m], of which `UP` is the difference to the origin's.
HEIGHTS = ("up", "altitude", "height")
EAST, NORTH, UP = "east", "north", "up"
NULL = "0°, 0°, as receivers say that have no fix"
# Farther than this from the datum [m] a plane is told to be no earth, and then refused.
_FAR = 1e5
RADIUS = 6_371_000.0
# Bounds of latitudes and longitudes [°], and a whole turn, up to the rounding of radians.
_POLE, _HALF, _TURN = (bound * (1.0 + 1e-12) for bound in (90.0, 180.0, 360.0))
_BOUNDS = np.array([90.0, 180.0])


def on_plane(
    streams: Mapping[str, Stream], datum: Datum | None = None
) -> tuple[dict[str, Stream], list[Dropped], Datum | None]:
    """Streams whose latitudes and longitudes [rad] have become metres on one plane, and its datum.

    Without a datum the plane touches the ellipsoid at the first fix of the first of these streams.
    Variances of latitude and longitude are those north and east [m²] at each fix; in the plane,
    whose axes are the datum's, they are turned. Rows at 0°, 0° are none, and told; so are rows that
    are far from the datum.
    """
    found, told = dict(streams), []
    for name, stream in streams.items():
        if not set(WORLD) & set(stream.components):
            continue
        _require_both(name, stream)
        null = is_null(np.column_stack([stream[one] for one in WORLD]))
        if null.any():
            told.append(Dropped(name, NULL, np.flatnonzero(null)))
            stream = stream.take(~null)
        rows = np.flatnonzero(~null)
        _require_degrees(name, stream, rows)
        world = np.column_stack([np.degrees(stream[one]) for one in WORLD])
        world = world.clip(-_BOUNDS, _BOUNDS)  # of radians that were rounded
        fixed = np.isfinite(world).all(axis=1)
        if datum is None and fixed.any():
            first = int(fixed.argmax())
            height = float(_height(stream, 0.0)[first])
            north, east = world[first].tolist()
            datum = Datum(north, east, height, f"the first of {name}")
        plane = datum or Datum(0.0, 0.0)  # of rows of which nothing is known
        metres = plane.local(world[:, 0], world[:, 1], _height(stream, plane.height))
        told += _far(name, metres, rows, plane)
        found[name] = _flat(stream, metres, plane.turns(world[:, 0], world[:, 1]))
    return found, told, datum


def _far(name: str, metres: Array, rows: Integers, datum: Datum) -> list[Dropped]:
    """Rows that are far from the datum; on the other side of the earth they are refused."""
    away = np.linalg.norm(metres, axis=1)
    far = np.flatnonzero(away > _FAR)
    if not far.size:
        return []
    most = int(np.nanargmax(away))
    where = f"{away[most] / 1e3:,.0f} km from the datum, {datum.text}"
    if away[most] > NO_PLANE:
        raise EvidenceError(
            f"{name}, row {rows[most]}: {where}, where no plane is; leave out the rows that are no "
            "fixes, or give datum=(latitude, longitude)"
        )
    short = away[most] ** 2 / (6.0 * RADIUS**2)
    fate = f"up to {where}: distances on the plane are up to {100.0 * short:.2g} % short there"
    return [Dropped(name, fate, rows[far], kept=True)]


def is_null(world: Array) -> Mask:
    """The mask of latitudes and longitudes (n, 2) that are both exactly zero."""
    null: Mask = (world == 0.0).all(axis=1)
    return null


def _flat(stream: Stream, place: Array, turns: Array) -> Stream:
    """A stream with metres east, north and up, (n, 3), for latitude, longitude and height.

    Its covariances are turned from the axes of each fix to those of the plane, (n, 3, 3).
    """
    metres = dict(zip((EAST, NORTH, UP), place.T, strict=True))
    named = {LATITUDE: NORTH, LONGITUDE: EAST} | dict.fromkeys(HEIGHTS, UP)
    order = {EAST: LONGITUDE, NORTH: LATITUDE}
    order |= {named.get(each, each): each for each in stream.components if each not in WORLD}
    places = [stream.place(each) for each in order.values()]
    values = np.column_stack([metres.get(new, stream[old]) for new, old in order.items()])
    values[np.isnan(stream.values[:, places])] = np.nan
    cov = stream.cov
    if cov is not None:
        cov = _turned(cov[:, places][:, :, places], tuple(order), turns)
    return stream.replace(
        values=values,
        components=tuple(order),
        units=["m" if n in metres else stream.units[k] for n, k in zip(order, places, strict=True)],
        cov=cov,
    )


def _turned(cov: Array, components: Sequence[str], turns: Array) -> Array:
    """Covariances of components whose east, north and up, if it is one, are turned."""
    axes = [components.index(each) for each in (EAST, NORTH, UP) if each in components]
    whole = np.broadcast_to(np.eye(cov.shape[1]), cov.shape).copy()
    for row, j in enumerate(axes):
        whole[:, j, axes] = turns[:, row, : len(axes)]
    return spreads.turned(cov, whole)


def _height(stream: Stream, without: float) -> Array:
    """Heights [m]; missing ones are set to the first known height, or a height without any."""
    name = next((each for each in HEIGHTS if each in stream.components), None)
    if name is None:
        return np.full(len(stream), without)
    height = stream[name].copy()
    known: Mask = np.isfinite(height)
    height[~known] = height[known][0] if known.any() else without
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
