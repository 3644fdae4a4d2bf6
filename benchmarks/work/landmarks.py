"""Maps: robots that see landmarks whose places nobody knows, by range and bearing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from benchmarks.work.asked import Array, Asked, Integers
from models import motion, sensors
from models.networks import landmark, pose, sighting
from pgm.cpds import CPD

A_LANDMARK = 20 / 3  # poses for each
STEP = 1.0  # from pose to pose, along the way [m]
ODOMETRY_STD = (0.05, 0.05, 0.01)  # [m, m, rad]
SIGHT_STD = (0.1, 0.02)  # [m, rad]
PLACE_STD = 100.0  # of a landmark before it is seen [m]
REACH = 12.0  # how far landmarks are seen [m]
SEEN = 5  # the most that are, the nearest ones
CLEAR = 1.5  # how far from the way they are at the least [m]
ROOM = 40.0  # square metres for each
START_STD = (0.3, 0.3, 0.03)  # of a start that is the truth, disturbed [m, m, rad]
_LOBES = 3, 4  # of the way: how often it comes and goes, east and north, in a lap


@dataclass(frozen=True, eq=False)
class Map:
    """One robot that starts at a known pose, and what it has seen.

    Attributes
    ----------
    odometry : ndarray
        (N − 1, 3): from pose to pose [m, m, rad].
    who, what : ndarray of int
        (S,): the pose and the landmark of each sighting.
    sights : ndarray
        (S, 2): range [m] and bearing [rad].
    poses, places : ndarray
        (N, 3), (L, 2): where everything is taken to be at first.
    """

    odometry: Array
    who: Integers
    what: Integers
    sights: Array
    poses: Array
    places: Array

    @property
    def units(self) -> int:
        """How many poses there are."""
        return len(self.poses)

    def asked(self) -> Asked:
        """All poses but the known one, and all landmarks."""
        x = [pgm.Variable(f"x{k}", pose.components, pose.angles) for k in range(self.units)]
        m = [pgm.Variable(f"m{k}", landmark.components) for k in range(len(self.places))]
        moved, seen = np.diag(np.square(ODOMETRY_STD)), np.diag(np.square(SIGHT_STD))
        cpds: list[CPD] = [pgm.GaussianCPD(place, [0.0, 0.0], PLACE_STD**2) for place in m]
        evidence = {x[0]: self.poses[0]}
        for k, step in enumerate(self.odometry):
            u = pgm.Variable(f"u{k}", ("forward", "left", "turn"), ("turn",))
            evidence[u] = step
            cpds.append(
                pgm.NonlinearGaussianCPD(
                    x[k + 1],
                    given=(x[k], u),
                    function=motion.increment,
                    cov=moved,
                    jacobian={x[k]: motion.increment_by_state, u: motion.increment_by_control},
                )
            )
        for k, (i, j) in enumerate(zip(self.who.tolist(), self.what.tolist(), strict=True)):
            z = pgm.Variable(f"z{k}", sighting.components, sighting.angles)
            evidence[z] = self.sights[k]
            cpds.append(
                pgm.NonlinearGaussianCPD(
                    z,
                    given=(x[i], m[j]),
                    function=sensors.range_bearing,
                    cov=seen,
                    jacobian={
                        x[i]: sensors.range_bearing_by_state,
                        m[j]: sensors.range_bearing_by_landmark,
                    },
                )
            )
        start = dict(zip(x[1:], self.poses[1:], strict=True))
        start |= dict(zip(m, self.places, strict=True))
        return Asked(pgm.BayesianNetwork(cpds), evidence, (tuple(x[1:]), tuple(m)), start)


def draw(poses: int, *, reckoned: bool, seed: int = 0) -> Map:
    """A robot that goes round among landmarks, three for every twenty poses.

    Parameters
    ----------
    poses : int
    reckoned : bool
        Whether the start is by odometry alone, from where landmarks were first seen; else it is the
        truth, disturbed.
    seed : int
    """
    rng = np.random.default_rng(seed)
    count = max(round(poses / A_LANDMARK), 1)
    true = _way(poses, np.sqrt(ROOM * count))
    places = _places(true, count, rng)
    odometry = motion.relative(true[:-1], true[1:])
    odometry += np.array(ODOMETRY_STD) * rng.standard_normal(odometry.shape)
    who, what = _sighted(true, places, rng)
    sights = sensors.range_bearing(true[who], places[what])
    sights += np.array(SIGHT_STD) * rng.standard_normal(sights.shape)
    if reckoned:
        path = [true[0]]
        for step in odometry:
            path.append(motion.increment(path[-1], step))
        start = np.array(path)
        first = np.unique(what, return_index=True)[1]
        start_places = _placed(start[who[first]], sights[first])
    else:
        start = true + np.array(START_STD) * rng.standard_normal(true.shape)
        start[0] = true[0]
        start_places = places + START_STD[0] * rng.standard_normal(places.shape)
    return Map(odometry, who, what, sights, start, start_places)


def _way(poses: int, side: float) -> Array:
    """Steps of one length along a curve that crosses itself, and is gone along again and again."""
    turns = np.linspace(0.0, 2.0 * np.pi, 100_000)
    curve = 0.45 * side * np.stack([np.sin(lobes * turns) for lobes in _LOBES], axis=1)
    gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    at = np.interp((STEP * np.arange(poses + 1)) % gone[-1], gone, turns)
    places = 0.45 * side * np.stack([np.sin(lobes * at) for lobes in _LOBES], axis=1)
    ahead = np.diff(places, axis=0)
    headings = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return np.concatenate([places[:-1], headings[:, None]], axis=1)


def _places(way: Array, count: int, rng: np.random.Generator) -> Array:
    """Landmarks in reach of the way, and not on it."""
    half = np.abs(way[:, :2]).max() + REACH
    found: list[Array] = []
    while len(found) < count:
        place = rng.uniform(-half, half, 2)
        if CLEAR < np.linalg.norm(way[:, :2] - place, axis=1).min() < 0.5 * REACH:
            found.append(place)
    return np.array(found)


def _sighted(way: Array, places: Array, rng: np.random.Generator) -> tuple[Integers, Integers]:
    """The poses and landmarks of sightings, of each landmark at least one."""
    away = np.linalg.norm(way[:, None, :2] - places, axis=-1)
    pairs = {(int(k), j) for j, k in enumerate(away.argmin(axis=0))}
    for k, distances in enumerate(away):
        near = np.flatnonzero(distances < REACH)
        chosen = rng.choice(near, min(len(near), SEEN), replace=False)
        pairs |= {(k, j) for j in chosen.tolist()}
    who, what = np.array(sorted(pairs)).T
    return who, what


def _placed(poses: Array, sights: Array) -> Array:
    """Where poses see what they see."""
    course = poses[:, 2] + sights[:, 1]
    ahead = np.stack([np.cos(course), np.sin(course)], axis=1)
    placed: Array = poses[:, :2] + sights[:, :1] * ahead
    return placed
