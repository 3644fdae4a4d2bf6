"""Poses over time, as files of trajectories hold them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.display import NoArray, Shown, Summary, few, table
from pgm.immutable import Immutable
from pgm.io.dropped import Dropped
from pgm.io.stamped import clock
from pgm.io.trajectories import trajectory
from pgm.kernels import quaternions
from pgm.kernels.arrays import Array, frozen


class Poses(Shown, NoArray, Immutable):
    """Positions and orientations at moments in time, and how well they are known.

    Attributes
    ----------
    times : ndarray
        (n,), seconds, increasing.
    position : ndarray
        (n, 3): x, y, z, in metres.
    orientation : ndarray
        (n, 4): unit quaternions qx, qy, qz, qw, of the turn from the body to the world.
    components : tuple of str
        The components that `cov` is of, by name; empty without one.
    cov : ndarray or None
        (n, k, k), in metres and radians; None where none are known.
    dropped : tuple of Dropped
        Poses of the file that were left out or put in order, and why.

    Examples
    --------
    >>> here, turned = np.array([[1.0, 2.0, 0.5]]), np.array([[0.0, 0.0, 1.0, 1.0]]) / np.sqrt(2.0)
    >>> drive = pgm.Poses(times=np.array([0.0]), position=here, orientation=turned)
    >>> drive.planar.round(3)
    array([[1.   , 2.   , 1.571]])
    """

    times: Array
    position: Array
    orientation: Array
    components: tuple[str, ...]
    cov: Array | None
    dropped: tuple[Dropped, ...]

    _arrays: ClassVar[str] = ".position, .orientation and .times"

    def __init__(
        self,
        times: Array,
        position: Array,
        orientation: Array,
        components: tuple[str, ...] = (),
        cov: Array | None = None,
        dropped: Sequence[Dropped] = (),
    ) -> None:
        self._set(
            times=frozen(times),
            position=frozen(position),
            orientation=frozen(orientation),
            components=components,
            cov=None if cov is None else frozen(cov),
            dropped=tuple(dropped),
        )

    @classmethod
    @public
    def of(
        cls,
        belief: Any,
        *,
        times: npt.ArrayLike,
        position: Sequence[str],
        heading: str | None,
        pitch: str | None = None,
        roll: str | None = None,
    ) -> Poses:
        """The mean poses of a belief over time, with the covariances of their components.

        Parameters
        ----------
        belief : Gaussian, GridBelief or ParticleBelief
            Of one run, over time: ``posterior[x]``.
        times : array_like
            (n,): of each of its steps, seconds, increasing; `Timeline` has them as ``times``.
        position : sequence of str
            Two components, east and north, where the height is zero, or three. In another unit than
            metres, as their variable says, they become metres.
        heading : str or None
            The angle about the upward axis, from the first component of the position towards the
            second; None for a body without orientation, whose quaternion is that of no turn.
        pitch, roll : str, optional
            The other angles; zero without.

        Raises
        ------
        ModelError
            If the belief is none or of several runs; if a component is not there, is named twice
            or, of an angle, was not declared as one; if a position is in no unit of length; or if
            one of them has an infinite variance.
        EvidenceError
            If times are not finite, do not increase, or are not as many as there are steps.

        Examples
        --------
        >>> x = pgm.Variable("x", components=("east", "north"), units=("km", "km"))
        >>> belief = pgm.Gaussian(x, [[0.0, 0.0], [1.0, 2.0]], cov=0.01, steps=[0, 1])
        >>> path = pgm.Poses.of(belief, times=[0, 60], position=("east", "north"), heading=None)
        >>> path.position[1], path.cov[1, 0, 0].round(6)
        (array([1000., 2000.,    0.]), np.float64(10000.0))
        """
        found = trajectory(belief, times, position, heading, pitch, roll)
        turns = quaternions.of_angles(found.angles)
        return cls(found.times, found.xyz, turns, found.names, found.cov)

    @property
    def angles(self) -> Array:
        """Roll, pitch and yaw, (n, 3), radians: the turn is R_z(yaw) R_y(pitch) R_x(roll)."""
        return quaternions.angles(self.orientation)

    @property
    def planar(self) -> Array:
        """East, north and heading, (n, 3): x, y and yaw, as they are seen from above."""
        found = self.position.copy()
        found[:, 2] = self.angles[:, 2]
        return found

    @property
    def _title(self) -> str:
        known = f", covariances of {', '.join(self.components)}" if self.components else ""
        first, last = clock(self.times[0]), clock(self.times[-1])
        return f"Poses({len(self.times)} of them, {first} to {last}{known})"

    def _summary(self) -> Summary:
        names = ("x", "y", "z", "roll [rad]", "pitch [rad]", "yaw [rad]")
        ends = [k for k in few(len(self.times)) if k is not None]
        numbers = np.full((len(self.times), 6), np.nan)
        numbers[ends] = np.concatenate(
            [self.position[ends], quaternions.angles(self.orientation[ends])], axis=1
        )
        columns = [("time", self.times), *zip(names, numbers.T, strict=True)]
        told = [each._title for each in self.dropped]
        return Summary(self._title, [table(columns, digits=15), *told])
