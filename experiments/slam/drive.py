"""A drive through a house: where the robot is, what its odometer says, and what it sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from experiments.slam.rooms import Rooms
from models import motion, sensors
from pgm.errors import EvidenceError

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.intp]

REACH = 3.0  # m, how far the robot sees
# Of the odometer after one metre [m, rad]; its variance grows with the way.
DRIFT_STD, TURN_STD = 0.03, 0.015
SENSOR_STD = (0.1, 0.02)  # m, rad


@dataclass(frozen=True, eq=False)
class Drive:
    """One way through the house, driven in several runs whose readings alone differ.

    Attributes
    ----------
    house : Rooms
    truth : ndarray
        (T+1, 3): the poses [m, m, rad], headings unwrapped.
    landmarks : ndarray
        (L, 2) [m].
    motion_std : tuple of float
        Of a step [m, m, rad].
    odometry : ndarray
        (runs, T, 3): forward [m], left [m] and turn [rad] of each step.
    step, landmark : ndarray of int
        (M,): from which pose a sighting is, and of which landmark; in the order of the drive.
    sightings : ndarray
        (runs, M, 2): range [m] and bearing [rad].
    """

    house: Rooms
    truth: Array
    landmarks: Array
    motion_std: tuple[float, float, float]
    odometry: Array
    step: Integers
    landmark: Integers
    sightings: Array

    @property
    def steps(self) -> int:
        """T."""
        return len(self.truth) - 1

    @property
    def seen(self) -> Integers:
        """The landmarks that are seen at all, increasing."""
        return np.unique(self.landmark)

    @property
    def way(self) -> Array:
        """How far the robot has come at each pose, (T+1,) [m]."""
        each = np.linalg.norm(np.diff(self.truth[:, :2], axis=0), axis=-1)
        return np.concatenate([[0.0], np.cumsum(each)])

    @property
    def closing(self) -> int:
        """The step at which the robot first sees a landmark again that it has not seen for long.

        Long is half of the drive.

        Raises
        ------
        EvidenceError
            If there is none.
        """
        last: dict[int, int] = {}
        for step, mark in zip(self.step.tolist(), self.landmark.tolist(), strict=True):
            if step - last.get(mark, step) > self.steps // 2:
                return int(step)
            last[mark] = step
        raise EvidenceError(
            f"no landmark of {len(self.landmarks)} is seen again after half of the drive, so that "
            "no loop is closed; ask for more landmarks or poses"
        )

    def until(self, step: int) -> Drive:
        """The drive up to a step: what the robot knew then."""
        known = self.step <= step
        return Drive(
            self.house,
            self.truth[: step + 1],
            self.landmarks,
            self.motion_std,
            self.odometry[:, :step],
            self.step[known],
            self.landmark[known],
            self.sightings[:, known],
        )

    def run(self, run: int) -> Drive:
        """One of the runs, as the only one."""
        return Drive(
            self.house,
            self.truth,
            self.landmarks,
            self.motion_std,
            self.odometry[run : run + 1],
            self.step,
            self.landmark,
            self.sightings[run : run + 1],
        )

    def reckoned(self) -> Array:
        """Poses by the odometer alone from the true start, (runs, T+1, 3)."""
        poses = np.empty((len(self.odometry), self.steps + 1, 3))
        poses[:, 0] = self.truth[0]
        for t in range(self.steps):
            poses[:, t + 1] = motion.increment(poses[:, t], self.odometry[:, t])
        return poses

    def placed(self, poses: Array) -> Array:
        """Where their first sightings put the landmarks that are seen, (runs, len(seen), 2)."""
        _, first = np.unique(self.landmark, return_index=True)
        far, bearing = self.sightings[:, first, 0], self.sightings[:, first, 1]
        sight = far[..., None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        found: Array = motion.place(poses[:, self.step[first]], sight)
        return found


def drive(house: Rooms, poses: int, landmarks: int, runs: int, rng: np.random.Generator) -> Drive:
    """Drive through all rooms.

    What is seen follows from the true way, which is the same in all runs. That a landmark is seen,
    or is not, is no evidence to the network.

    Parameters
    ----------
    house : Rooms
    poses : int
        T + 1, equally far apart along the way.
    landmarks : int
    runs : int
    rng : numpy.random.Generator
    """
    truth = _along(house.way, poses)
    marks = house.places(landmarks, rng)
    step, mark = np.nonzero(house.seen(truth[:, :2], marks, REACH))
    metres = float(np.linalg.norm(np.diff(house.way, axis=0), axis=-1).sum()) / (poses - 1)
    drift, turn = DRIFT_STD * np.sqrt(metres), TURN_STD * np.sqrt(metres)
    motion_std = (float(drift), float(drift), float(turn))
    # The step leads from each pose to the next less the noise, as the model has it.
    noise = rng.normal(size=(runs, poses - 1, 3)) * motion_std
    odometry = motion.relative(np.broadcast_to(truth[:-1], noise.shape), truth[1:] - noise)
    seen = sensors.range_bearing(truth[step], marks[mark])
    sightings = seen + rng.normal(size=(runs, len(step), 2)) * SENSOR_STD
    return Drive(house, truth, marks, motion_std, odometry, step, mark, sightings)


def _along(way: Array, poses: int) -> Array:
    """Poses equally far apart along a way, each heading for the next."""
    ends = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=-1))])
    at = np.linspace(0.0, ends[-1], poses)
    places = np.stack([np.interp(at, ends, column) for column in way.T], axis=-1)
    ahead = np.diff(places, axis=0)
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return np.column_stack([places, np.append(heading, heading[-1])])
