"""The likelihood field: scans judged by how near to obstacles their beams end."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from pgm.cpds.values import Known, Values
from pgm.errors import ModelError
from pgm.kernels import planar, rays
from pgm.kernels.arrays import LOG_2PI, Array
from pgm.maps.given import as_positive, as_share
from pgm.maps.occupancy import OccupancyMap
from pgm.maps.scans import ScanCPD
from pgm.variables import Variable


class LikelihoodField(ScanCPD):
    r"""A scan given a pose, by the distances from its beams' ends to obstacles.

    .. math:: \ln p(z \mid x) = w \sum_b \ln\left(h\, \frac{1}{σ\sqrt{2π}} e^{-d_b^2 / 2σ^2}
        + \frac{u}{z_{max}}\right)

    - :math:`d_b`: the distance from the end of beam b, laid out from the pose, to the nearest
      obstacle's centre [m], at most `distance`; it is that of the cell in which the beam ends,
      found to some ten thousandths of a cell.
    - h, u, σ, :math:`z_{max}`, w: `hit`, `random`, `std`, `most`, `weight`.

    Beams of `most` or more have met nothing and say nothing: they are left out, as are those that
    are NaN, not measured. Ends beyond the map and in cells that are NaN, of which nothing is known,
    have the random part alone; cells that are merely uncertain have their distance as others do.
    Beams pass through obstacles unseen. It is a likelihood of poses for a scan, not a normalised
    density of scans, and cannot be drawn from.

    Beams side by side err together, by what the map has wrong and by people; as independent they
    would make a belief far too certain. ``every=k`` uses each k-th, ``weight`` takes the likelihood
    to a power, as if only that share of the beams were independent.

    Parameters
    ----------
    child : Variable
        The scan, one component a beam, in metres.
    given : Variable
        The pose; its first components are x [m], y [m] and the heading [rad], an angle.
    map : OccupancyMap
    angles : array_like
        (B,): of the beams against the sensor's heading [rad].
    most : float
        The largest range [m].
    std : float
        σ [m]: of the range, and of what the map has wrong.
    hit, random : float
        The shares of beams that end at obstacles of the map, and anywhere: both above 0, together
        at most 1.
    mount : array_like
        (3,): the sensor's pose in the robot's frame.
    distance : float
        How far from obstacles distances are told apart [m].
    every : int
        Each `every`-th beam is used.
    weight : float
        Above 0, at most 1.

    Raises
    ------
    ModelError
        If an argument does not fit, or the map has no obstacle.

    References
    ----------
    S. Thrun, W. Burgard, D. Fox: Probabilistic Robotics, 2005, section 6.4, table 6.3.

    Examples
    --------
    >>> x = pgm.Variable("x", components=("x", "y", "heading"), angles=("heading",))
    >>> z = pgm.Variable("z", components=("left", "ahead"))
    >>> wall = pgm.maps.OccupancyMap([[0, 0, 0, 0, 1]] * 5, resolution=1.0)
    >>> scan = LikelihoodField(z, x, wall, angles=[np.pi / 2, 0.0], most=10.0, std=0.5)
    >>> at = [[0.5, 2.5, 0.0], [2.5, 2.5, 0.0]]
    >>> scan.log_density([10.0, 4.0], {x: at}).round(3)
    array([-0.271, -5.298])
    """

    std: float
    hit: float
    random: float
    distance: float

    def __init__(
        self,
        child: Variable,
        given: Variable,
        map: OccupancyMap,
        *,
        angles: npt.ArrayLike,
        most: float,
        std: float = 0.1,
        hit: float = 0.95,
        random: float = 0.05,
        mount: npt.ArrayLike = (0.0, 0.0, 0.0),
        distance: float = 2.0,
        every: int = 1,
        weight: float = 1.0,
    ) -> None:
        self._set_scan(child, given, map, angles, most, mount, every, weight)
        hit = as_share(hit, f"{self!r}: hit", least=False)
        random = as_share(random, f"{self!r}: random", least=False)
        if hit + random > 1.0 + 1e-9:
            raise ModelError(
                f"{self!r}: hit and random are {hit} and {random}, shares that make more than 1",
                cpd=self,
            )
        self._set(
            std=as_positive(std, f"{self!r}: std"),
            hit=hit,
            random=random,
            distance=as_positive(distance, f"{self!r}: distance"),
        )
        map._require_obstacle()

    def _log_density(self, child: Values, known: Known) -> Array:
        ranges, poses, lead = self._scans(child, known)
        places = np.empty_like(poses)
        # From further away no beam gets to the map: float32 need not hold the distance.
        far = self.most / self.map.resolution + 2.0
        edge = np.array(self.map.shape[::-1]) + far
        with np.errstate(over="ignore"):
            places[:, :2] = np.clip(self.map._to_cells(poses[:, :2]), -far, edge) + 1.0
        places[:, 2] = poses[:, 2] - self.map.origin[2]
        seen = ranges < self.most  # nor is NaN
        cells = np.where(seen, ranges, 0.0) / self.map.resolution
        found = rays.summed(self._table, places, self._units, cells, seen)
        return self.weight * found.reshape(lead)

    def _log_peak(self, child: Values) -> Array:
        """The log-densities of scans whose beams all end at obstacles, (...)."""
        seen = (child[..., :: self.every] < self.most).sum(axis=-1)  # nor is NaN
        return np.asarray(self.weight * seen * float(self._table.max()))

    @cached_property
    def _units(self) -> Array:
        return planar.directions(self._angles).T

    @cached_property
    def _table(self) -> rays.Single:
        """The log-likelihood of a beam that ends in a cell, with one cell around the map."""
        square = (np.minimum(self.map.distances, self.distance) / self.std) ** 2
        normal = np.exp(-0.5 * (square + LOG_2PI)) / self.std
        normal[np.isnan(self.map.occupied)] = 0.0
        density = self.hit * np.pad(normal, 1) + self.random / self.most
        return np.log(density).astype(np.float32)
