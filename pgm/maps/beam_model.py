"""The beam model: each range against how far the beam gets in the map."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from pgm.cpds.values import Known, Values
from pgm.errors import ModelError
from pgm.kernels.arrays import LOG_2PI, Array
from pgm.maps.given import as_positive, as_share
from pgm.maps.occupancy import OccupancyMap, blocks
from pgm.maps.scans import ScanCPD
from pgm.variables import Variable

# From so many times the largest range on, a deviation leaves no digits of its normal density there.
_FLAT = 1e6


class BeamModel(ScanCPD):
    r"""A scan given a pose, each range by that which the map lets expect.

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
        As of `LikelihoodField`.
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

        Parameters
        ----------
        poses : array_like
            (..., 3), of the sensor: x, y [m], heading [rad].

        Returns
        -------
        ndarray
            (..., beams); `most` where there is no obstacle up to there.

        Raises
        ------
        ModelError
            As of `OccupancyMap.cast`.
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
        return ndtr(-expected / self.std), ndtr((self.most - expected) / self.std)

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Values:
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
