"""The uniform prior of a pose over free cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.cpds import CPD
from pgm.cpds.base import Known, Values
from pgm.errors import ModelError
from pgm.kernels import rigid
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.maps.occupancy import OccupancyMap


@public
class UniformPose(CPD):
    r"""The prior of a pose that may be anywhere in the free cells of a map, at any heading.

    .. math:: p(x, y, θ) = \frac{1}{2π\, n\, r^2}

    where (x, y) is in one of the n cells, of side r, and 0 elsewhere. Draws are continuous within
    cells, and their headings in [−π, π). `OccupancyMap.uniform` makes one.

    Parameters
    ----------
    child : Variable
        The pose: x, y and a heading, its only angle.
    map : OccupancyMap
    mask : array_like of bool, optional
        (rows, columns): which of the free cells are taken; all without.

    Raises
    ------
    ModelError
        If the variable is no pose, the mask does not fit, or no cell is left.

    Examples
    --------
    >>> from pgm import Variable
    >>> from pgm.maps import OccupancyMap
    >>> x = Variable("x", components=("x", "y", "heading"), angles=("heading",))
    >>> hall = OccupancyMap(np.zeros((4, 50)), resolution=0.5)
    >>> prior = hall.uniform(x)
    >>> prior.log_density([[3.0, 1.0, 0.0], [3.0, 5.0, 0.0]]).round(3)
    array([-5.75,  -inf])
    >>> prior.sample(size=1000, rng=1).max(axis=0).round(2)
    array([24.98,  2.  ,  3.14])
    """

    map: OccupancyMap
    mask: Mask

    def __init__(
        self, child: Variable, map: OccupancyMap, mask: npt.ArrayLike | None = None
    ) -> None:
        self._set_scope(child, ())
        if child.dimension != 3 or child.angles != child.components[2:]:
            raise ModelError(
                f"{child!r} is no pose, whose components are x, y and a heading, its only angle; "
                f"it has {child.components}, angles {child.angles}",
                variable=child,
                cpd=self,
            )
        allowed = map._allowed(mask).copy()
        allowed.flags.writeable = False
        cells = np.flatnonzero(allowed)
        self._set(map=map, mask=allowed, _cells=cells)

    _cells: Integers

    def _log_density(self, child: Values, known: Known) -> Array:
        """Log-densities of poses (..., 3): −ln(2π n r²) in any of n allowed cells, −∞ elsewhere.

        r is the side of a cell; the heading does not matter. The result broadcasts with the axes of
        `known`.
        """
        lead = np.broadcast_shapes(child.shape[:-1], known.lead)
        cells = self.map.at(child[..., :2])
        height, width = self.map.shape
        rows, columns = np.clip(cells.rows, 0, height - 1), np.clip(cells.columns, 0, width - 1)
        possible = cells.inside & self.mask[rows, columns]
        constant = -np.log(TURN * self._cells.size * self.map.resolution**2)
        return np.broadcast_to(np.where(possible, constant, -np.inf), lead).copy()

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Values:
        """Poses (*size, *known.shape, 3): an allowed cell, a place in it and a heading, uniform."""
        shape = (*size, *known.shape)
        chosen = self._cells[rng.integers(self._cells.size, size=shape)]
        rows, columns = np.divmod(chosen, self.map.shape[1])
        place = np.stack([columns, rows], axis=-1) + rng.random((*shape, 2))
        found = np.empty((*shape, 3))
        found[..., :2] = rigid.points_out_of(self.map.origin, place * self.map.resolution)
        found[..., 2] = rng.uniform(-np.pi, np.pi, size=shape)
        return found
