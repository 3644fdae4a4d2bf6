"""The base of sensors that scan an occupancy grid by beams."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.boundary import is_whole
from pgm.cpds import CPD
from pgm.cpds.base import Known, Values
from pgm.errors import EvidenceError, LinearisationError, ModelError
from pgm.kernels import rigid
from pgm.kernels.arrays import Array, Mask, frozen
from pgm.maps.cells import as_angles, as_pose, as_positive, as_share
from pgm.maps.occupancy import OccupancyMap
from pgm.variables import Variable


class Scans(NamedTuple):
    """Scans, and the poses that they are to be of.

    ranges: (m, beams), or (1, beams) where all poses share one scan; of the beams in use, NaN where
        not measured.
    poses: (m, 3), of the sensor.
    lead: The axes that the m have.
    """

    ranges: Array
    poses: Array
    lead: tuple[int, ...]


class ScanCPD(CPD):
    """Base of the CPDs of a scan, one component a beam, given a pose and a map.

    angles: (B,): of all beams against the sensor's heading [rad].
    most: The range from which on a beam has met nothing [m].
    mount: (3,): the sensor's pose in the robot's frame.
    every: Each `every`-th beam is used, from the first on.
    weight: The exponent of the likelihood of the beams in use.
    """

    # A beam that is NaN is left out: others are independent of it, given the pose.
    partial = True

    map: OccupancyMap
    angles: Array
    most: float
    mount: Array
    every: int
    weight: float

    def _set_scan(
        self,
        child: Variable,
        given: Any,
        map: OccupancyMap,
        angles: npt.ArrayLike,
        most: float,
        mount: npt.ArrayLike,
        every: int,
        weight: float,
    ) -> None:
        self._set_scope(child, given)
        if len(self.given) != 1:
            raise ModelError(f"{self!r}: a scan is given one variable, the pose", cpd=self)
        (pose,) = self.given
        if pose.dimension < 3 or pose.components[2] not in pose.angles:
            raise ModelError(
                f"{self!r}: {pose!r} is no pose, whose first components are x, y and a heading, an "
                f"angle; it has {pose.components}, angles {pose.angles}",
                variable=pose,
                cpd=self,
            )
        if not isinstance(map, OccupancyMap):
            raise ModelError(f"{self!r}: its map is an OccupancyMap, not {map!r}", cpd=self)
        beams = as_angles(angles, f"{self!r}: the angles of beams")
        if beams.size != child.dimension:
            raise ModelError(
                f"{self!r}: {beams.size} angles of {child.dimension} beams, the components of "
                f"{child!r}; each needs one",
                variable=child,
                cpd=self,
            )
        if not is_whole(every) or every < 1:
            raise ModelError(f"{self!r}: every is a whole number, 1 or more, not {every!r}")
        self._set(
            map=map,
            angles=beams,
            most=as_positive(most, f"{self!r}: the largest range, most,"),
            mount=as_pose(mount, f"{self!r}: mount"),
            every=int(every),
            weight=as_share(weight, f"{self!r}: weight", least=False),
        )

    @property
    def beams(self) -> int:
        """The number of beams in use."""
        return len(self._angles)

    @property
    def _angles(self) -> Array:
        return frozen(self.angles[:: self.every])

    def _counted(self, taken: Mask) -> Array:
        return np.asarray(self.weight * taken[..., :: self.every].sum(axis=-1))

    def _scans(self, child: Values, known: Known) -> Scans:
        """Scans and poses, flattened together; a scan that all share stays one."""
        lead = np.broadcast_shapes(child.shape[:-1], known.lead)
        ranges = child[..., :: self.every]
        alone = all(n == 1 or s == 0 for n, s in zip(child.shape[:-1], child.strides, strict=False))
        if alone and ranges.size:
            ranges = ranges[(0,) * (child.ndim - 1)][None]
        else:
            ranges = np.broadcast_to(ranges, (*lead, self.beams)).reshape(-1, self.beams)
        if (ranges < 0.0).any():
            raise EvidenceError(
                f"{self!r}: a scan has the range {np.nanmin(ranges)}; ranges are 0 or more, NaN "
                "where not measured",
                variable=self.child,
                cpd=self,
                step=_step(known),
            )
        return Scans(ranges, self._sensor_poses(known, known.lead, lead), lead)

    def _sensor_poses(self, known: Known, own: tuple[int, ...], lead: tuple[int, ...]) -> Array:
        """The sensor's poses (n, 3) at values of the robot's, of leading axes of their own."""
        (pose,) = self.given
        values = known.values[pose][..., :3]
        if values.shape[:-1] == known.shape:
            values = values.reshape(*own, 3)
        poses = np.broadcast_to(values, (*lead, 3)).reshape(-1, 3).astype(np.float64)
        if not np.isfinite(poses.sum()) and not np.isfinite(poses).all():
            found = poses[~np.isfinite(poses).all(axis=1)][0].tolist()
            raise LinearisationError(
                f"{self!r}: a pose is {found}, from which nothing can be measured; look for what "
                "the motion makes of it",
                variable=pose,
                cpd=self,
                step=_step(known),
            )
        return rigid.mounted(poses, self.mount) if self.mount.any() else poses


def _step(known: Known) -> int | None:
    return known.step if isinstance(known.step, int) else None
