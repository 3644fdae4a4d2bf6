"""The place where a plane touches the earth, and places on either as those on the other."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple, is_number
from pgm.display import InCode
from pgm.errors import EvidenceError
from pgm.kernels.arrays import Array
from pgm.resources import optional

EXTRA = "sepset[geo]"
# Nearer to a pole than some 100 m [°], the direction east is another one a few steps away.
_POLAR = 90.0 - 1e-3
# Heights on the plane are solved for to this [m], in at most so many steps.
_SETTLED, _STEPS = 1e-6, 50
# Farther than this from the datum [m] there is no plane.
NO_PLANE = 5e6
_TURNS = {"latitude": 90.0, "longitude": 180.0}


@public
@dataclass(frozen=True)
class Datum(InCode):
    """Where a plane touches the ellipsoid of WGS 84: the origin of east, north and up.

    With the axes e, n, u of the directions east, north and up at the datum, a place c that turns
    with the earth is, seen from the datum's place c₀,

        (east, north, up) = (e·(c − c₀), n·(c − c₀), u·(c − c₀)).

    Parameters
    ----------
    latitude, longitude : float
        Degrees, −90 to 90 and −180 to 180.
    height : float, optional
        Above the ellipsoid, metres.
    name : str, optional
        Which place it is, in words.

    Raises
    ------
    EvidenceError
        If a number is none, or beyond its bounds; or at a pole, where no direction is east.
    ImportError
        Where pymap3d is missing, of the extra ``geo``, by `to_plane` and `to_earth`.

    Notes
    -----
    Distances on the plane are short of those along the ground by about d²/6R² of them, 4 µm at
    a kilometre, 4 m at 100 km, and the plane lies d²/2R above the ground. Heights of satellite
    receivers in ROS are above the ellipsoid; those of GPX files are above the sea, some tens of
    metres apart from these.

    Examples
    --------
    >>> datum = pgm.recordings.Datum(48.1371, 11.5754, 519.0)
    >>> datum.to_plane([[48.1372, 11.5754]]).round(2)  # doctest: +SKIP
    array([[ 0.  , 11.12]])
    >>> datum.to_earth([[0.0, 11.12]]).round(6)  # doctest: +SKIP
    array([[48.1372, 11.5754]])
    """

    latitude: float
    longitude: float
    height: float = 0.0
    name: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("latitude", "longitude", "height"):
            value = getattr(self, name)
            bound = _TURNS.get(name, np.inf)
            if not (is_number(value) and np.isfinite(value) and abs(value) <= bound):
                due = f"a number of degrees, −{bound:.0f} to {bound:.0f}," if bound < 999 else ""
                raise EvidenceError(f"datum: {due or 'metres'} were due for {name}, not {value!r}")
            object.__setattr__(self, name, float(value))
        if abs(self.latitude) > _POLAR:
            raise EvidenceError(
                f"datum: latitude {self.latitude:.9g}° is at a pole, where no direction is east; "
                "give a datum beside it, datum=(latitude, longitude)"
            )

    @public
    def to_plane(self, places: npt.ArrayLike) -> Array:
        """Metres east and north, (n, 2), or east, north and up, (n, 3), of places on the earth.

        Parameters
        ----------
        places : array_like
            (n, 2): latitude and longitude [°], at the datum's height; (n, 3): height [m], too.

        Raises
        ------
        EvidenceError
            If a place is more than 5,000 km from the datum: on the other side of the earth others
            have the same coordinates.
        """
        given = _table("places", places)
        height = given[:, 2] if given.shape[1] == 3 else np.full(len(given), self.height)
        found = self.local(given[:, 0], given[:, 1], height)
        away = np.linalg.norm(found, axis=1)
        if (away > NO_PLANE).any():
            row = int(np.nanargmax(away))
            raise EvidenceError(
                f"places, row {row}: {given[row].tolist()} is {away[row] / 1e3:,.0f} km from the "
                f"datum, {self.text}, where no plane is; give a datum nearer by"
            )
        return found[:, : given.shape[1]]

    @public
    def to_earth(self, places: npt.ArrayLike) -> Array:
        """Latitudes and longitudes [°], (n, 2), or heights, too, (n, 3), of places on the plane.

        Parameters
        ----------
        places : array_like
            (n, 2): east and north [m], of places at the datum's height; (n, 3): up, too.
        """
        given = _table("places", places)
        if given.shape[1] == 3:
            return self._world(given[:, 0], given[:, 1], given[:, 2])
        up = np.zeros(len(given))
        for _ in range(_STEPS):
            found = self._world(given[:, 0], given[:, 1], up)
            lower = found[:, 2] - self.height
            up = up - lower
            if not (np.abs(lower) > _SETTLED).any():
                return found[:, :2]
        row = int((np.abs(lower) > _SETTLED).argmax())
        raise EvidenceError(
            f"places, row {row}: {given[row].tolist()} m is on no place of the earth, which is "
            "6,378 km large"
        )

    def local(self, latitude: Array, longitude: Array, height: Array) -> Array:
        """East, north and up, (n, 3), however far from the datum."""
        pymap3d = optional("pymap3d", "a place on the earth", EXTRA)
        found = pymap3d.geodetic2enu(latitude, longitude, height, *self._place)
        return np.column_stack(found)

    def turns(self, latitude: Array, longitude: Array) -> Array:
        """Rotations (n, 3, 3) from east, north and up at places [°] to these at the datum.

        They are the identity at places that are unknown.
        """
        known = np.isfinite(latitude) & np.isfinite(longitude)
        latitude = np.where(known, latitude, self.latitude)
        longitude = np.where(known, longitude, self.longitude)
        own, place = math.radians(self.latitude), np.radians(latitude)
        along = np.radians(longitude - self.longitude)
        across = np.radians(latitude - self.latitude)
        bent = 2.0 * np.sin(0.5 * along) ** 2  # 1 − cos, in all its digits
        s, c = math.sin(own), math.cos(own)
        sines, cosines = np.sin(place), np.cos(place)
        rows = [
            [1.0 - bent, -sines * np.sin(along), cosines * np.sin(along)],
            [
                s * np.sin(along),
                np.cos(across) - s * sines * bent,
                np.sin(across) + s * cosines * bent,
            ],
            [
                -c * np.sin(along),
                c * sines * bent - np.sin(across),
                np.cos(across) - c * cosines * bent,
            ],
        ]
        return np.array(rows).transpose(2, 0, 1)

    def _world(self, east: Array, north: Array, up: Array) -> Array:
        """Latitude, longitude [°] and height, (n, 3)."""
        pymap3d = optional("pymap3d", "a place on the earth", EXTRA)
        found = pymap3d.enu2geodetic(east, north, up, *self._place)
        return np.column_stack(found)

    @property
    def _place(self) -> tuple[float, float, float]:
        return self.latitude, self.longitude, self.height

    @property
    def text(self) -> str:
        """The place in words."""
        north, east = "NS"[self.latitude < 0], "EW"[self.longitude < 0]
        place = f"{abs(self.latitude):.9g}° {north}, {abs(self.longitude):.9g}° {east}"
        return f"{place}, {self.height:.6g} m{', ' * bool(self.name)}{self.name}"


def as_datum(value: Any) -> Datum | None:
    """A datum, or one of (latitude, longitude) or (latitude, longitude, height)."""
    if value is None or isinstance(value, Datum):
        return value
    numbers = as_tuple(value)
    if numbers is None or len(numbers) not in (2, 3):
        raise EvidenceError(
            f"datum= is (latitude, longitude) or (latitude, longitude, height), not {value!r}"
        )
    return Datum(*numbers)


def _table(what: str, value: Any) -> Array:
    table = as_floats(value, what, EvidenceError, missing=True)
    if table.ndim != 2 or table.shape[1] not in (2, 3):
        raise EvidenceError(f"{what} have shape {table.shape}; (n, 2) or (n, 3) was due")
    return table
