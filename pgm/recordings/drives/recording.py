"""One recorded drive: odometry, sightings, landmarks and truth, each with its own stamps."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_mapping, is_number
from pgm.display import TITLE, Listing, NoArray, Shown, Summary
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.io.dropped import Dropped
from pgm.io.poses import Poses
from pgm.io.stamped import SAME
from pgm.io.timeline import Timeline, joined
from pgm.kernels import twists
from pgm.kernels.arrays import Array
from pgm.recordings.drives import checks, handing, mending, motion, odometers, reference, summaries
from pgm.recordings.drives.datum import Datum, as_datum
from pgm.recordings.drives.scans import Scans
from pgm.recordings.drives.stream import Stream
from pgm.variables import Variable

POSE, PLACE = ("east", "north", "heading"), ("east", "north")
NO_PLACE = "of a subject without a place"
_PARTS = ("name", "odometry", "velocities", "sightings", "landmarks", "landmark_cov", "truth")
_MORE = ("imu", "fixes", "scans", "mounts", "datum", "dropped")


@public
class Recording(Shown, NoArray, Immutable):
    """A recorded drive in the plane: streams of rows, each with its own stamps.

    Rows are put in order of time. Measurements that are NaN, or repeat another in all that they
    hold, are left out; increments that do are driven. `dropped` and the summary tell of each.

    Parameters
    ----------
    odometry : Stream or Poses, optional
        Increments since the stamp before: (distance, turn) along an arc, (forward, left, turn), or
        (rot1, trans, rot2); metres and radians. Of an odometer's poses, the motion between them;
        where it begins at zero again, none is known, and told.
    velocities : Stream, optional
        Held until the next stamp: (v, omega), or (v_forward, v_left, omega); m/s and rad/s.
    sightings : mapping of str to Stream, optional
        By sensor.
    landmarks, landmark_cov : mapping, optional
        Positions [m], (2,) or (3,), and their covariances, by identity.
    truth : Stream or Poses, optional
        The reference: (east, north, heading) or (east, north).
    imu, fixes : Stream, optional
        Inertial readings; positions, as of satellites, (east, north) or more.
    scans : mapping of str to Scans, optional
        By laser.
    mounts : mapping of str to array_like, optional
        Where a sensor or laser sits on the robot: (forward [m], left [m], turn [rad]).
    datum : Datum or sequence of float, optional
        The place on the earth where east and north are zero: latitude and longitude [°], with the
        height [m] or without. Readers of places on the earth set it.
    name : str, optional
    dropped : sequence of Dropped, optional

    Raises
    ------
    EvidenceError
        If components are not those above, motion is NaN, positions are not finite, or the datum is
        no place.

    Examples
    --------
    >>> from pgm.recordings import Recording, Stream
    >>> arcs = [[1.0, 0.0], [np.pi / 2, np.pi / 2]]
    >>> wheels = Stream([1.0, 2.0], arcs, ("distance", "turn"), begin=0)
    >>> heard = Stream([1.5, 0.2], [4.0, 5.0], ("range",), subject=[7, 7])
    >>> drive = Recording(odometry=wheels, sightings={"radio": heard}, landmarks={7: [5.0, 0.0]})
    >>> drive
    Recording, 0 s to 2 s
      odometry   2 increments of distance, turn; every 1 s (median), 1 s at most
      radio      2 of range, of 1 subject
      landmarks  1
      radio      1 kept: stamped before the row above, put in order (row 1)
    >>> drive.dead_reckoning([0.0, 0.0, 0.0]).values.round(3)
    array([[0.   , 0.   , 0.   ],
           [1.   , 0.   , 0.   ],
           [2.   , 1.   , 1.571]])
    """

    name: str
    odometry: Stream | None
    velocities: Stream | None
    sightings: Mapping[str, Stream]
    landmarks: Mapping[Hashable, Array]
    landmark_cov: Mapping[Hashable, Array]
    truth: Stream | None
    imu: Stream | None
    fixes: Stream | None
    scans: Mapping[str, Scans]
    mounts: Mapping[str, Array]
    datum: Datum | None
    dropped: tuple[Dropped, ...]

    _arrays: ClassVar[str] = "streams' .stamps and .values"

    def __init__(
        self,
        *,
        odometry: Stream | Poses | None = None,
        velocities: Stream | None = None,
        sightings: Mapping[str, Stream] | None = None,
        landmarks: Mapping[Any, npt.ArrayLike] | None = None,
        landmark_cov: Mapping[Any, npt.ArrayLike] | None = None,
        truth: Stream | Poses | None = None,
        imu: Stream | None = None,
        fixes: Stream | None = None,
        scans: Mapping[str, Scans] | None = None,
        mounts: Mapping[str, npt.ArrayLike] | None = None,
        datum: Datum | Sequence[float] | None = None,
        name: str = "",
        dropped: Sequence[Dropped] = (),
    ) -> None:
        told = list(dropped)
        if isinstance(truth, Poses):
            told += [dataclasses.replace(each, stream="truth") for each in truth.dropped]
            truth = Stream(truth.times, truth.planar, POSE)
        if isinstance(odometry, Poses):
            told += [dataclasses.replace(each, stream="odometry") for each in odometry.dropped]
            odometry, fates = odometers.increments("odometry", odometry)
            told += fates
        streams: dict[str, Stream | None] = {}
        for key, given, mend in (
            ("odometry", odometry, mending.increments),
            ("velocities", velocities, mending.ordered),
            ("truth", truth, mending.reference),
            ("imu", imu, mending.sightings),
            ("fixes", fixes, mending.sightings),
        ):
            streams[key] = None
            if given is not None:
                streams[key], fates = mend(key, checks.stream(key, given))
                told += [fate for fate in fates if not mending.known(fate, dropped)]
        for key, known in (("odometry", motion.ODOMETRY), ("velocities", motion.VELOCITIES)):
            if (found := streams[key]) is not None:
                motion.require_motion(key, found, known)
        if streams["truth"] is not None and streams["truth"].components not in (POSE, PLACE):
            raise EvidenceError(
                f"truth has the components ({listed(streams['truth'].components)}); "
                f"({listed(POSE)}) or ({listed(PLACE)}) was due"
            )
        seen = {}
        for key, stream in as_mapping(sightings, "sightings").items():
            seen[key], fates = mending.sightings(key, checks.stream(f"the sensor {key!r}", stream))
            told += [fate for fate in fates if not mending.known(fate, dropped)]
        places = checks.places(landmarks)
        self._set(
            name=name,
            sightings=MappingProxyType(seen),
            scans=MappingProxyType(checks.scans(scans)),
            mounts=MappingProxyType(checks.mounts(mounts, (*seen, *(scans or ())))),
            landmarks=MappingProxyType(places),
            landmark_cov=MappingProxyType(checks.covariances(landmark_cov, places)),
            datum=as_datum(datum),
            dropped=tuple(told),
            **streams,
        )

    def replace(self, **changes: Any) -> Recording:
        """The recording with other attributes."""
        return Recording(**{name: getattr(self, name) for name in (*_PARTS, *_MORE)} | changes)

    @property
    def times(self) -> Array:
        """The times at which rows of the motion begin and end [s]."""
        return self._motion().axis

    @public
    def stamps(self, *sensors: str, tolerance: float = 0.0) -> Array:
        """The stamps of the motion, and of sensors within its time; all sensors and fixes without.

        Those within a tolerance [s] are one.
        """
        spans = self._motion()
        spans.require_time()
        axis = spans.axis
        names = sensors or (*self.sightings, *(["fixes"] if self.fixes is not None else []))
        others = np.sort(np.concatenate([[], *(handing.sensor(self, n).stamps for n in names)]))
        inside = (others >= axis[0]) & (others <= axis[-1])
        return joined(axis, others[inside], tolerance)

    def between(self, first: float, last: float) -> Recording:
        """The part from one time to another, both included; motion is cut there, along its arc.

        Odometry that is cut has no variances. Truth is `truth_at` there, where it reaches so far.
        """
        if not (is_number(first) and is_number(last) and first < last):
            raise EvidenceError(f"between takes two times, the later one last; not {first}, {last}")

        def cut(stream: Stream | None) -> Stream | None:
            if stream is None:
                return None
            return stream.take((stream.stamps >= first) & (stream.stamps <= last))

        changes: dict[str, Any] = {name: cut(getattr(self, name)) for name in ("imu", "fixes")}
        changes["truth"] = self.truth and reference.cut(self.truth, first, last)
        changes["sightings"] = {name: cut(stream) for name, stream in self.sightings.items()}
        changes["scans"] = {name: each.between(first, last) for name, each in self.scans.items()}
        if self.odometry is not None:
            changes["odometry"] = motion.cut_odometry(self.odometry, first, last)
        if self.velocities is not None:
            changes["velocities"] = motion.cut_velocities(self.velocities, first, last)
        return self.replace(**changes)

    @public
    def resampled(
        self, times: npt.ArrayLike | None = None, *, period: float | None = None
    ) -> Recording:
        """The recording with motion between given times (m,) or every `period` seconds.

        Its odometry is (forward, left, turn), composed exactly, of the odometry or else of the
        velocities, which are held; it has no variances. Sightings keep their stamps. Truth is
        `truth_at`, left out where it does not reach over all times.
        """
        spans = self._motion()
        if (times is None) == (period is None):
            raise EvidenceError("resampled takes times or period=, one of them")
        if period is not None:
            times = spans.every(period)
        axis = checks.increasing(times)
        changes: dict[str, Any] = {
            "odometry": Stream(axis[1:], spans.between(axis), motion.PLANAR, begin=axis[0])
        }
        if self.velocities is not None:
            row = np.searchsorted(self.velocities.stamps, axis + SAME) - 1
            held = self.velocities.take(row.clip(0)).values
            changes["velocities"] = Stream(axis, held, self.velocities.components)
        if self.truth is not None:
            inside = (
                len(self.truth)
                and axis[0] >= self.truth.stamps[0]
                and axis[-1] <= self.truth.stamps[-1]
            )
            changes["truth"] = self.truth_at(axis) if inside else None
        return self.replace(**changes)

    def merged(self) -> Recording:
        """The recording `resampled` at `stamps`."""
        return self.resampled(self.stamps())

    @public
    def dead_reckoning(
        self, start: npt.ArrayLike | None = None, times: npt.ArrayLike | None = None
    ) -> Stream:
        """Poses (east, north, heading) by the motion alone, composed exactly, not wrapped.

        Parameters
        ----------
        start : array_like, optional
            (3,), at the first time; the truth's without.
        times : array_like, optional
            (m,), seconds; those of the motion's rows without.
        """
        spans = self._motion()
        axis = spans.axis if times is None else checks.increasing(times)
        if start is None:
            if self.truth is None:
                raise EvidenceError(
                    f"{self._title} has no truth; give start=(east, north, heading)"
                )
            truth = self.truth_at(axis[:1])
            if truth.components != POSE:
                raise EvidenceError("the truth has no headings; give start=(east, north, heading)")
            start = truth.values[0]
        pose = as_floats(start, "start=", EvidenceError)
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise EvidenceError(f"start= is (east, north, heading), not {start!r}")
        return Stream(axis, twists.path(pose, spans.between(axis)), POSE)

    @public
    def truth_at(self, times: npt.ArrayLike, *, longest: float | None = None) -> Stream:
        """The truth at given times (m,), between its own on a line; headings are not wrapped.

        A time outside, or in a gap longer than `longest` [s], raises an `EvidenceError`.
        """
        if self.truth is None or not len(self.truth):
            raise EvidenceError(f"{self._title} has no truth")
        return reference.at(self.truth, times, longest)

    def located(self) -> Recording:
        """The recording without sightings of unlocated subjects; `dropped` lists them."""
        told, seen = list(self.dropped), {}
        for name, stream in self.sightings.items():
            lost = handing.without_place(stream, self.landmarks)
            seen[name] = stream.take(~lost)
            if lost.any():
                told.append(Dropped(name, NO_PLACE, np.flatnonzero(lost)))
        return self.replace(sightings=seen, dropped=told)

    @public
    def calibrated(
        self, sensor: str, scale: float = 1.0, offset: float = 0.0, *, component: str = "range"
    ) -> Recording:
        """The recording with readings = scale · value + offset of a sensor undone."""
        if not (is_number(scale) and np.isfinite(scale) and scale > 0.0):
            raise EvidenceError(f"scale is a positive number, not {scale!r}")
        if not (is_number(offset) and np.isfinite(offset)):
            raise EvidenceError(f"offset is a number, not {offset!r}")
        stream = handing.sensor(self, sensor)
        column = stream.place(component)
        values = stream.values.copy()
        values[:, column] = (values[:, column] - offset) / scale
        shrunk = np.ones(len(stream.components))
        shrunk[column] /= scale
        cov = None if stream.cov is None else stream.cov * np.outer(shrunk, shrunk)
        mended = stream.replace(values=values, cov=cov)
        return self.replace(sightings={**self.sightings, sensor: mended})

    @public
    def timeline(
        self,
        times: npt.ArrayLike | None = None,
        *,
        odometry: Variable | None = None,
        velocities: Variable | None = None,
        sensors: Mapping[Variable, str] | None = None,
        landmark: Variable | None = None,
        variances: Mapping[Variable, Variable] | None = None,
        tolerance: float | None = None,
    ) -> Timeline:
        """Evidence of a network: the streams handed to `pgm.timeline` under its variables.

        Parameters
        ----------
        times : array_like, optional
            (T+1,): of the states; without them `stamps`, so that no measurement is moved.
        odometry, velocities : Variable, optional
            The control that each is evidence of. A variable of (forward, left, turn) has the
            motion of each step composed exactly, of odometry of any kind; of another kind the
            components are the stream's own, and `pgm.timeline` sums or averages them. A component
            ``dt`` is filled in.
        sensors : mapping of Variable to str, optional
            The name of the sensor that each is evidence of; ``fixes`` and ``imu`` are such, too.
        landmark : Variable, optional
            The observed parent of the sensors whose rows have subjects: the place of each, which
            they must have (`located`).
        variances : mapping of Variable to Variable, optional
            For each sensor, the observed parent that the variances of each reading are evidence of,
            whose components are called like the sensor's: with ``variances={z: r}`` and
            ``cov=pgm.noise(lambda r: r, given=r, diagonal=True)`` a reading is as sure as its row.
            A component called like a product, ``"east*north"``, is the covariance of two: of
            ``("east", "east*north", "north")`` noise is the matrix
            ``cov=pgm.noise(lambda r: r[..., [[0, 1], [1, 2]]], given=r)``. Variances of readings
            that are correlated, by more than 0.01, are refused without it.
        tolerance : float, optional
            See `pgm.timeline`.

        """
        named = as_mapping(sensors, "sensors=")
        for variable in named:
            handing.require_variable(variable, "sensors=")
        spread = handing.require_variances(variances, named)
        if times is None:
            axis = self.stamps(*named.values(), tolerance=tolerance or 0.0)
        else:
            axis = checks.increasing(times)
        return handing.timeline(
            self,
            axis,
            odometry=odometry,
            velocities=velocities,
            sensors=named,
            landmark=landmark,
            variances=spread,
            tolerance=tolerance,
        )

    def _motion(self) -> motion.Spans:
        """The rows of motion: of odometry, or else of velocities."""
        if self.odometry is not None:
            return motion.of_odometry(self.odometry)
        if self.velocities is not None:
            return motion.of_velocities(self.velocities)
        raise EvidenceError(f"{self._title} has neither odometry nor velocities")

    @property
    def _title(self) -> str:
        return f"Recording{' ' * bool(self.name)}{self.name}{summaries.span(self)}"

    def _summary(self) -> Summary:
        rows = summaries.rows(self)
        return Summary(self._title, [Listing(("", ""), rows, names=2, cell=TITLE)] * bool(rows))
