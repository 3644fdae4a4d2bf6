"""Poses over time, as files of trajectories hold them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats
from pgm.display import NoArray, Shown, Summary, count, few, table, titled
from pgm.errors import EvidenceError, ModelError
from pgm.immutable import Immutable
from pgm.io import alignment
from pgm.io.alignment import PoseErrors
from pgm.io.dropped import BACKWARDS, Dropped
from pgm.io.sources import Origin
from pgm.io.stamped import as_stamps, clock
from pgm.io.trajectories import along, increasing, trajectory
from pgm.kernels import quaternions
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.variables import Variable

BEFORE = "of the frame before the trajectory was aligned"
REPEATED = "of a stamp seen before"
# How far from one the length of a quaternion may be, whose numbers may be printed to four decimals.
UNIT = 1e-3
ROUNDING = 1e-14


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

    Raises
    ------
    EvidenceError
        If there are no poses, times are not finite or do not increase, arrays have other shapes or
        numbers that are not finite, a quaternion is no unit one, or only one of `components` and
        `cov` is given.

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

    @public
    def __init__(
        self,
        times: npt.ArrayLike,
        position: npt.ArrayLike,
        orientation: npt.ArrayLike,
        components: Sequence[str] = (),
        cov: npt.ArrayLike | None = None,
        dropped: Sequence[Dropped] = (),
    ) -> None:
        stamps, names = increasing(times), tuple(components)
        size = stamps.size
        if not size:
            raise EvidenceError("there are no poses: times= is empty")
        turns = _rows("orientation=", orientation, (size, 4))
        far = np.abs(np.linalg.norm(turns, axis=1) - 1.0) > UNIT
        if far.any():
            row = int(far.argmax())
            raise EvidenceError(
                f"orientation= has {turns[row].tolist()} in row {row}, of length "
                f"{np.linalg.norm(turns[row]):.6g}; unit quaternions, w last, were due"
            )
        if (cov is None) != (not names):
            raise EvidenceError("components= and cov= come together: cov= is of those components")
        due = (size, len(names), len(names))
        self._set(
            times=frozen(stamps),
            position=frozen(_rows("position=", position, (size, 3))),
            orientation=frozen(turns),
            components=names,
            cov=None if cov is None else frozen(_rows("cov=", cov, due)),
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

    @public
    def align(
        self,
        reference: Poses,
        *,
        scale: bool = False,
        planar: bool = False,
        tolerance: float = 0.01,
    ) -> Poses:
        """The trajectory moved so that its places are nearest to a reference's, in squares.

        Poses of either that are nearest in time, and within a tolerance, are pairs; the motion
        y = s R x + t of all poses is Umeyama's of their places.

        Parameters
        ----------
        reference : Poses
            The trajectory to be laid upon.
        scale : bool, optional
            Whether the scale s is found, as of a single camera; it is 1 without.
        planar : bool, optional
            Whether R turns about the upward axis alone, as of robots in the plane.
        tolerance : float, optional
            How far apart in time the poses of a pair may be, seconds.

        Returns
        -------
        Poses
            Without covariances, which are of the frame before; `dropped` tells of that.

        Raises
        ------
        EvidenceError
            If no poses are pairs, or the tolerance is none.
        ModelError
            If the reference is none, or places lie on a line, or a place, which leaves R open.

        References
        ----------
        Umeyama, Least-squares estimation of transformation parameters between two point patterns,
        1991.

        Examples
        --------
        >>> times, still = np.arange(4.0), np.tile([0.0, 0.0, 0.0, 1.0], (4, 1))
        >>> path = np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 3]])
        >>> turned = pgm.Poses(times, path @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] + 5.0, still)
        >>> turned.align(pgm.Poses(times, path, still)).position[3].round(9)
        array([0., 2., 3.])
        """
        from scipy.spatial.transform import Rotation

        rows, others = self._pairs(reference, tolerance)
        found = alignment.umeyama(
            self.position[rows], reference.position[others], scale=scale, planar=planar
        )
        turns = Rotation.from_matrix(found.rotation) * Rotation.from_quat(
            np.array(self.orientation)
        )
        told = [] if self.cov is None else [Dropped("covariances", BEFORE, np.arange(len(self)))]
        return Poses(
            self.times,
            found.moved(self.position),
            turns.as_quat(),
            dropped=(*self.dropped, *told),
        )

    @public
    def ate(self, reference: Poses, *, tolerance: float = 0.01) -> PoseErrors:
        """The absolute errors of poses against a reference's, as they are: `align` comes before.

        Parameters
        ----------
        reference : Poses
            The truth.
        tolerance : float, optional
            How far apart in time the poses of a pair may be, seconds.

        Raises
        ------
        EvidenceError
            If no poses are pairs, or the tolerance is none.
        ModelError
            If the reference is none.

        References
        ----------
        Sturm, Engelhard, Endres, Burgard and Cremers, A benchmark for the evaluation of RGB-D SLAM
        systems, 2012.
        """
        rows, others = self._pairs(reference, tolerance)
        places = self.position[rows], reference.position[others]
        turns = self.orientation[rows], reference.orientation[others]
        left = len(self.times) - rows.size
        return PoseErrors("absolute", self.times[rows], *alignment.absolute(places, turns), left)

    @public
    def rpe(self, reference: Poses, *, step: int = 1, tolerance: float = 0.01) -> PoseErrors:
        """The errors of the motion from each pose to a later one, against a reference's.

        Parameters
        ----------
        reference : Poses
            The truth.
        step : int, optional
            How many of the pairs of poses the later one is behind.
        tolerance : float, optional
            How far apart in time the poses of a pair may be, seconds.

        Raises
        ------
        EvidenceError
            If no poses are pairs, the step is none, or longer than the trajectory.
        ModelError
            If the reference is none.

        References
        ----------
        Sturm, Engelhard, Endres, Burgard and Cremers, A benchmark for the evaluation of RGB-D SLAM
        systems, 2012.
        """
        rows, others = self._pairs(reference, tolerance)
        alignment.require_step(step, rows.size)
        places = self.position[rows], reference.position[others]
        turns = self.orientation[rows], reference.orientation[others]
        errors = alignment.relative(places, turns, int(step))
        kind = f"of the motion over {count(int(step), 'row')}"
        return PoseErrors(kind, self.times[rows[int(step) :]], *errors, len(self.times) - rows.size)

    @public
    def along(
        self,
        variable: Variable,
        *,
        times: npt.ArrayLike,
        position: Sequence[str],
        heading: str | None,
        pitch: str | None = None,
        roll: str | None = None,
        tolerance: float = 0.01,
    ) -> Array:
        """The values of a state at the times of its steps, as a truth or a row of `pgm.compare`.

        A step has the pose that is nearest in time, within a tolerance. `align` comes before, where
        the trajectory is in a frame of its own.

        Parameters
        ----------
        variable : Variable
            The state, of d components.
        times : array_like
            (T+1,): of its steps, seconds, increasing; `Timeline` has them as ``times``.
        position : sequence of str
            The components that are x and y, or x, y and z, in units of length.
        heading : str or None
            The component that is yaw; None for a state without.
        pitch, roll : str, optional
            The components that are the other angles.
        tolerance : float, optional
            How far apart in time a step and its pose may be, seconds.

        Returns
        -------
        ndarray
            (T+1, d): NaN at steps without a pose, and in components that are not named.

        Raises
        ------
        ModelError
            If a component is not there, is named twice or, of an angle, was not declared as one; or
            if a position is in no unit of length.
        EvidenceError
            If times are not finite or do not increase, no pose is near a step, or the tolerance is
            none.

        Examples
        --------
        >>> x = pgm.Variable("x", components=("east", "north", "speed"))
        >>> still = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
        >>> drive = pgm.Poses([0.0, 1.0], [[1.0, 2.0, 0.0], [3.0, 4.0, 0.0]], still)
        >>> drive.along(x, times=[1.0, 2.0], position=("east", "north"), heading=None)
        array([[ 3.,  4., nan],
               [nan, nan, nan]])
        """
        if not isinstance(variable, Variable):
            raise ModelError(f"along takes a state, a pgm.Variable, not {titled(variable)}")
        stamps = increasing(times)
        steps, rows = alignment.matched(stamps, self.times, tolerance)
        each = self.position[rows], quaternions.angles(self.orientation[rows])
        values = np.full((stamps.size, variable.dimension), np.nan)
        values[steps] = along(variable, each, position, heading, pitch, roll)
        return values

    def _pairs(self, reference: Any, tolerance: float) -> tuple[Integers, Integers]:
        if not isinstance(reference, Poses):
            raise ModelError(f"a reference is Poses, not {titled(reference)}")
        return alignment.matched(self.times, reference.times, tolerance)

    def __len__(self) -> int:
        return self.times.size

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


def _rows(what: str, value: Any, due: tuple[int, ...]) -> Array:
    """A copy of finite numbers of a shape, a row for each pose."""
    array = as_floats(value, what, EvidenceError).copy()
    if array.shape != due:
        raise EvidenceError(f"{what} has shape {array.shape}; {due} was due, a row for each time")
    fine = np.isfinite(array.reshape(len(array), -1)).all(axis=1)
    if not fine.all():
        raise EvidenceError(f"{what} has no finite numbers in row {int(fine.argmin())}")
    return array


def made(
    table: Array,
    lines: Sequence[int],
    origin: Origin,
    hint: str,
    names: tuple[str, ...] = (),
    cov: Array | None = None,
) -> Poses:
    """Poses in order of rows t x y z qx qy qz qw, (n, 8), that stand in lines of a file.

    Times that are none, and quaternions that are no unit ones, are refused; `hint` asks about the
    latter.
    """
    try:
        as_stamps("t", table[:, 0])
    except EvidenceError as error:
        raise origin.fault(str(error)) from error
    with np.errstate(over="ignore"):  # an infinite length is refused below
        length = np.linalg.norm(table[:, 4:], axis=1)
    if (far := np.abs(length - 1.0) > UNIT).any():
        row = int(far.argmax())
        raise origin.fault(
            f"its quaternion's numbers have the length {length[row]:.6g}, and were to be a unit one"
            f"; {hint}",
            lines[row],
        )
    # A length that is one but for rounding is left as it is, so that numbers stay what they were.
    length[np.abs(length - 1.0) < ROUNDING] = 1.0
    turns = table[:, 4:] / length[:, None]
    order, told = in_order(table[:, 0])
    return Poses(
        table[order, 0],
        table[order, 1:4],
        turns[order],
        names,
        None if cov is None else cov[order],
        dropped=told,
    )


def in_order(times: Array) -> tuple[Integers, list[Dropped]]:
    """The rows in order of time, the first of several at one time, and those that this mends."""
    found, told = np.argsort(times, kind="stable"), []
    if (back := np.flatnonzero(np.diff(times) < 0.0) + 1).size:
        told.append(Dropped("poses", BACKWARDS, back, kept=True))
    again = found[1:][np.diff(times[found]) == 0.0]
    if again.size:
        told.append(Dropped("poses", REPEATED, np.sort(again)))
        found = found[np.append(True, np.diff(times[found]) > 0.0)]
    return found, told
