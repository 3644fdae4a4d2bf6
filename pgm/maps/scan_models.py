"""The models of a scan in a map: the likelihood field, and the beam model."""

from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from pgm.arguments import public
from pgm.cpds.base import Known, Values
from pgm.errors import ModelError
from pgm.kernels import rays, rigid
from pgm.kernels.arrays import LOG_2PI, Array
from pgm.maps.cells import as_positive, as_share
from pgm.maps.occupancy import OccupancyMap, blocks
from pgm.maps.scans import ScanCPD
from pgm.variables import Variable


@public
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
        return rigid.directions(self._angles).T

    @cached_property
    def _table(self) -> rays.Single:
        """The log-likelihood of a beam that ends in a cell, with one cell around the map."""
        square = (np.minimum(self.map.distances, self.distance) / self.std) ** 2
        normal = np.exp(-0.5 * (square + LOG_2PI)) / self.std
        normal[np.isnan(self.map.occupied)] = 0.0
        density = self.hit * np.pad(normal, 1) + self.random / self.most
        return np.log(density).astype(np.float32)


# From so many times the largest range on, a deviation leaves no digits of its normal density there.
_FLAT = 1e6


@public
class BeamModel(ScanCPD):
    r"""The beam model of a scan: each range given the range expected by ray casting in the map.

    With the expected range :math:`z^*` of a beam, its range has the density

    .. math:: p(z \mid x) = h \frac{N(z; z^*, σ^2)}{Φ(\frac{z_{max} - z^*}{σ}) -
        Φ(-\frac{z^*}{σ})} + s \frac{λ e^{-λz}}{1 - e^{-λz^*}} [z \le z^*] + \frac{u}{z_{max}}

    on :math:`[0, z_{max})`, and the probability m of a range of :math:`z_{max}` or more.

    - h, s, m, u: `hit`, `short`, `maximum`, `random`, the shares of ranges to the obstacle that is
      expected, to an unmapped one before it, to nothing, and of anything else. Where no obstacle
      is expected up to :math:`z_{max}`, h goes to m; in an obstacle, where :math:`z^* = 0` and
      nothing can be shorter, s goes to h.
    - σ, λ, :math:`z_{max}`: `std`, `decay`, `most`.

    The log-density of a scan is `weight` times the sum over each `every`-th beam, without those
    that are NaN, not measured; beams side by side are not independent, as `LikelihoodField` says.
    Draws are of all beams, independent, `most` where a beam has met nothing.

    Parameters
    ----------
    child, given, map, angles, most, mount, every, weight
        See `LikelihoodField`.
    std : float
        σ [m]: of ranges to obstacles of the map.
    hit, short, maximum, random : float
        Shares, from 0 on, that sum to 1.
    decay : float
        λ [1/m]: how many unmapped obstacles a metre there are.
    through_unknown : bool
        Whether beams pass unknown cells, as of `OccupancyMap.cast`.

    Raises
    ------
    ModelError
        If an argument does not fit.

    References
    ----------
    S. Thrun, W. Burgard, D. Fox: Probabilistic Robotics, 2005, section 6.3, table 6.1.

    Examples
    --------
    >>> x = pgm.Variable("x", components=("x", "y", "heading"), angles=("heading",))
    >>> z = pgm.Variable("z", components=("left", "ahead"))
    >>> wall = pgm.maps.OccupancyMap([[0, 0, 0, 0, 1]] * 5, resolution=1.0)
    >>> scan = BeamModel(z, x, wall, angles=[np.pi / 2, 0.0], most=10.0, std=0.1)
    >>> scan.log_density([10.0, 3.5], {x: [0.5, 2.5, 0.0]}).round(3)
    np.float64(0.88)
    >>> scan.sample({x: [0.5, 2.5, 0.0]}, rng=4).round(2)
    array([10.  ,  3.36])
    """

    std: float
    hit: float
    short: float
    maximum: float
    random: float
    decay: float
    through_unknown: bool

    def __init__(
        self,
        child: Variable,
        given: Variable,
        map: OccupancyMap,
        *,
        angles: npt.ArrayLike,
        most: float,
        std: float = 0.1,
        hit: float = 0.75,
        short: float = 0.1,
        maximum: float = 0.05,
        random: float = 0.1,
        decay: float = 0.5,
        mount: npt.ArrayLike = (0.0, 0.0, 0.0),
        every: int = 1,
        weight: float = 1.0,
        through_unknown: bool = True,
    ) -> None:
        self._set_scan(child, given, map, angles, most, mount, every, weight)
        shares = {"hit": hit, "short": short, "maximum": maximum, "random": random}
        shares = {name: as_share(each, f"{self!r}: {name}") for name, each in shares.items()}
        if abs(sum(shares.values()) - 1.0) > 1e-9:
            raise ModelError(
                f"{self!r}: the shares {shares} sum to {sum(shares.values()):g}; 1 was due",
                cpd=self,
            )
        deviation = as_positive(std, f"{self!r}: std")
        if deviation > _FLAT * self.most:
            raise ModelError(
                f"{self!r}: std is {deviation} m, where ranges are {self.most} m at the most: such "
                "ranges are as good as uniform; give random= their share",
                cpd=self,
            )
        self._set(
            std=deviation,
            decay=as_positive(decay, f"{self!r}: decay"),
            through_unknown=bool(through_unknown),
            **shares,
        )

    def expected(self, poses: npt.ArrayLike) -> Array:
        """The ranges that the map lets expect of the beams in use, (..., beams) [m].

        They are `most` where there is no obstacle up to there.

        Parameters
        ----------
        poses : array_like
            (..., 3), of the sensor: x, y [m], heading [rad].

        Raises
        ------
        ModelError
            See `OccupancyMap.cast`.
        """
        return self.map.cast(poses, self._angles, self.most, through_unknown=self.through_unknown)

    def _log_density(self, child: Values, known: Known) -> Array:
        ranges, poses, lead = self._scans(child, known)
        found = np.empty(len(poses))
        for place in blocks(len(poses), self.beams):
            own = ranges if len(ranges) == 1 else ranges[place]
            found[place] = self._summed(own, poses[place])
        total: Array = self.weight * found.reshape(lead)
        return total

    def _summed(self, ranges: Array, poses: Array) -> Array:
        """The log-densities of scans (m or 1, beams) at the sensor's poses (m, 3)."""
        expected = self.map._cast(poses, self._angles, self.most, self.through_unknown)
        measured = ~np.isnan(ranges)
        density = self._density(np.where(measured, ranges, self.most), expected)
        with np.errstate(divide="ignore"):
            logarithm = np.log(density)
        found: Array = np.where(measured, logarithm, 0.0).sum(axis=-1)
        return found

    def _density(self, ranges: Array, expected: Array) -> Array:
        """The densities of ranges, (m, beams); from `most` on their probability."""
        hit, short, maximum = self._shares(expected)
        residual = (ranges - expected) / self.std
        low, high = self._ends(expected)
        with np.errstate(over="ignore"):  # of what is far off, and impossible
            normal = np.exp(-0.5 * (residual * residual + LOG_2PI)) / self.std
        within = np.where(expected > 0.0, expected, 1.0)
        exponential = self.decay * np.exp(-self.decay * ranges) / -np.expm1(-self.decay * within)
        found = hit * normal / (high - low) + self.random / self.most
        found += np.where(ranges <= expected, short * exponential, 0.0)
        density: Array = np.where(ranges < self.most, found, maximum)
        return density

    def _shares(self, expected: Array) -> tuple[Array, Array, Array]:
        """The shares of ranges to the obstacle expected, to one before it, and to none."""
        inside, nothing = expected <= 0.0, expected >= self.most
        hit = np.where(nothing, 0.0, self.hit + np.where(inside, self.short, 0.0))
        short = np.where(inside, 0.0, self.short)
        return hit, short, self.maximum + np.where(nothing, self.hit, 0.0)

    def _ends(self, expected: Array) -> tuple[Array, Array]:
        """The normal's distribution function at 0 and at `most`, about ranges expected (...)."""
        return ndtr(-expected / self.std), ndtr((self.most - expected) / self.std)

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Values:
        """Scans (*size, *known.shape, beams) at known poses, each range drawn on its own.

        One uniform number chooses the kind of a range by the shares h, s, u, m, and another is put
        through the inverse distribution of that kind: the normal cut to [0, most], the exponential
        cut to [0, z*], the uniform on [0, most), or `most` itself.
        """
        poses = self._sensor_poses(known, known.shape, known.shape)
        expected = self.map._cast(poses, self.angles, self.most, self.through_unknown)
        shape = (*size, *known.shape, len(self.angles))
        expected = np.broadcast_to(expected.reshape(*known.shape, -1), shape)
        hit, short, _ = self._shares(expected)
        kind, place = rng.random(shape), rng.random(shape)
        low, high = self._ends(expected)
        near = expected + self.std * ndtri(low + place * (high - low))
        early = -np.log1p(place * np.expm1(-self.decay * expected)) / self.decay
        found = np.where(kind < hit + short + self.random, place * self.most, self.most)
        found = np.where(kind < hit + short, early, found)
        found = np.where(kind < hit, near, found)
        return np.clip(found, 0.0, self.most)
