"""The grid that a user asks for: an interval or a circle, and cells, of each component."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple, is_number, is_whole
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.schedules.argument_checks import require_count, require_tolerance
from pgm.variables import Variable

# An interval, (lo, hi, cells), or the number of cells of a full circle.
Extent = tuple[float, float, int] | int
Figure = str | Callable[[Any], Any]
_ADVICE = "give (lo, hi, cells), or of an angle the number of cells of its circle"


@public
class GridSettings(InCode, Immutable):
    """The cells of a grid, how its beliefs are kept, and when it is refined; see `Grid`."""

    cells: Mapping[str | Variable, Extent]
    dtype: Any
    refine: Figure | None
    tolerance: float
    doublings: int

    def __init__(
        self,
        cells: Mapping[str | Variable, Any],
        *,
        dtype: Any = np.float64,
        refine: Figure | None = None,
        tolerance: float = 1e-3,
        doublings: int = 4,
    ) -> None:
        if not isinstance(cells, Mapping) or not cells:
            raise ModelError(
                f"a grid maps components of the states to their cells, "
                f'{{"east": (0.0, 10.0, 100), "heading": 72}}; found {cells!r}'
            )
        found = {key: _extent(key, value) for key, value in cells.items()}
        if dtype not in (np.float64, np.float32):
            raise ModelError(f"a grid's dtype is np.float64 or np.float32, not {dtype!r}")
        if refine is not None and refine != "log_evidence" and not callable(refine):
            raise ModelError(
                f'refine= is "log_evidence" or a function of the posterior, not {refine!r}'
            )
        self._set(cells=MappingProxyType(found), dtype=np.dtype(dtype).type, refine=refine)
        require_tolerance(self, tolerance)
        require_count(self, "doublings", doublings)
        self._set(tolerance=float(tolerance), doublings=int(doublings))

    @public
    def finer(self, times: int = 2) -> Self:
        """The same grid with `times` as many cells along each axis: 2 halves all widths.

        Raises
        ------
        ModelError
            If `times` is no whole number of 1 or more.

        Examples
        --------
        >>> pgm.Grid({"north": (0.0, 6.0, 12), "heading": 36}).finer()
        Grid(north: 24 of 0.25, heading: 72 of 5 degrees)
        """
        require_count(self, "times", times)
        cells = {
            key: value * times if isinstance(value, int) else (*value[:2], value[2] * times)
            for key, value in self.cells.items()
        }
        return type(self)(
            cells,
            dtype=self.dtype,
            refine=self.refine,
            tolerance=self.tolerance,
            doublings=self.doublings,
        )

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        rest = self.dtype, self.refine, self.tolerance, self.doublings
        return (tuple(self.cells.items()), *rest)

    def __repr__(self) -> str:
        each = []
        for key, value in self.cells.items():
            name = key if isinstance(key, str) else repr(key)
            if isinstance(value, int):
                each.append(f"{name}: {value} of {360.0 / value:.3g} degrees")
            else:
                each.append(f"{name}: {value[2]} of {(value[1] - value[0]) / value[2]:.3g}")
        return f"Grid({', '.join(each)})"


def _extent(key: object, value: Any) -> Extent:
    """Check a user's extent of one axis: (lo, hi, cells) of an interval, or the cells of a circle.

    Returned are (float, float, int) or an int. Refused, by a ModelError, are a key that is no name
    or variable, ends that are not finite or not lo < hi, less than 2 cells of an interval or 3 of a
    circle, and cells too narrow for float64 at these ends.
    """
    if not isinstance(key, str | Variable):
        raise ModelError(
            f'a grid\'s axes are components of states, named like "east" or "x.east", or scalar '
            f"variables; found {key!r}"
        )
    what = f"the grid's {key if isinstance(key, str) else repr(key)}"
    if is_whole(value):
        if value < 3:
            raise ModelError(f"{what}: a circle has 3 cells or more, not {value!r}")
        return int(value)
    parts = as_tuple(value)
    if parts is None or len(parts) != 3:
        raise ModelError(f"{what} has {value!r}; {_ADVICE}")
    low, high, cells = parts
    if not (is_number(low) and is_number(high) and np.isfinite([low, high]).all()):
        raise ModelError(f"{what} ends at {low!r} and {high!r}, which are no finite numbers")
    if not low < high:
        raise ModelError(f"{what} goes from {low!r} to {high!r}; lo must be less than hi")
    if not is_whole(cells) or cells < 2:
        raise ModelError(
            f"{what} has {cells!r} cells; their number is whole, and 2 or more: leave out what is "
            "known, as an input with evidence"
        )
    if not (float(high) - float(low)) / int(cells) > 1e-12 * max(abs(low), abs(high)):
        raise ModelError(
            f"{what}: cells of {(high - low) / cells:.3g} at {high!r} are too narrow for the "
            "digits of float64; count its coordinates from a nearer origin"
        )
    return float(low), float(high), int(cells)
