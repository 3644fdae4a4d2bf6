"""Feature maps: landmarks at known positions."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.maps.cells import as_finite


@public
class FeatureMap(InCode, Immutable):
    """Landmarks at known positions, each with a name where it can be told by its signature.

    It converts to the array of its positions, as ``pgm.plot.trajectory(..., landmarks=features)``
    does, and `at` gives the positions of landmarks that were seen, the evidence of ``pgm.sightings(
    values, step=, given={m: features.at(names)})``.

    Parameters
    ----------
    positions : array_like
        (k, d), d two or more: the coordinates [m].
    names : sequence of str, optional
        k of them, no two alike.

    Attributes
    ----------
    positions : ndarray
        (k, d), read-only.
    names : tuple of str
        Empty where they have none.

    Raises
    ------
    ModelError
        If positions have another shape or are not finite, or names do not fit or repeat.

    Examples
    --------
    >>> features = FeatureMap([[0.0, 0.0], [4.0, 3.0]], names=("door", "pillar"))
    >>> features.at("pillar")
    array([4., 3.])
    >>> features.nearest([[3.0, 3.0], [1.0, 0.0]])
    array([1, 0])
    """

    positions: Array
    names: tuple[str, ...]

    def __init__(self, positions: npt.ArrayLike, names: Iterable[str] | None = None) -> None:
        array = as_floats(positions, "the positions of landmarks")
        if array.ndim != 2 or not len(array) or array.shape[1] < 2:
            raise ModelError(
                f"the positions of landmarks have shape {array.shape}; (landmarks, 2 or more "
                "coordinates) was due, one landmark or more"
            )
        as_finite(array, "the positions of landmarks", array.shape[1])
        given = () if names is None else as_tuple(names)
        if given is None or not all(isinstance(name, str) for name in given):
            raise ModelError(f"names of landmarks are a sequence of texts, not {names!r}")
        if names is not None and len(given) != len(array):
            raise ModelError(f"{len(given)} names of {len(array)} landmarks; each has one, or none")
        places = {name: k for k, name in enumerate(given)}
        if len(places) < len(given):
            twice = next(name for name in given if given.count(name) > 1)
            raise ModelError(f"two landmarks are called {twice!r}; each needs a name of its own")
        self._set(positions=frozen(array.copy()), names=given, _places=places)

    _places: Mapping[str, int]

    @property
    def bounds(self) -> Array:
        """The least and the largest coordinates, (2, d) [m]."""
        return np.stack([self.positions.min(axis=0), self.positions.max(axis=0)])

    def at(self, names: str | Iterable[str]) -> Array:
        """The positions [m] of landmarks by name: (d,) for one, (n, d) for several.

        Raises
        ------
        ModelError
            If no landmark is called so.
        """
        wanted = (names,) if isinstance(names, str) else as_tuple(names)
        if wanted is None:
            raise ModelError(f"landmarks are asked for by name, or by several, not by {names!r}")
        for name in wanted:
            if not isinstance(name, str) or name not in self._places:
                raise ModelError(
                    f"{self!r} has no landmark called {name!r}"
                    + ("" if self.names else "; its landmarks have no names")
                )
        if isinstance(names, str):
            position: Array = self.positions[self._places[names]]
            return position
        found: Array = self.positions[[self._places[name] for name in wanted]]
        return found.reshape(-1, self.positions.shape[1])

    def nearest(self, points: npt.ArrayLike) -> Integers:
        """The landmarks nearest to points (..., d) [m], as the rows (...) of `positions`.

        Raises
        ------
        ModelError
            If points have another shape, or are not finite.
        """
        array = as_finite(points, "points", self.positions.shape[1])
        _, found = cKDTree(self.positions).query(array)
        return np.asarray(found, dtype=np.intp)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return (
            np.array(self.positions, dtype=dtype)
            if copy
            else self.positions.astype(dtype or np.float64, copy=False)
        )

    def __len__(self) -> int:
        return len(self.positions)

    def __iter__(self) -> Iterator[Array]:
        return iter(self.positions)

    def __repr__(self) -> str:
        named = f", {', '.join(self.names[:3])}{', ...' if len(self) > 3 else ''}"
        return f"FeatureMap({len(self)} landmarks{named if self.names else ''})"
