"""The errors of a map against the truth, and its deviations before and after a loop is closed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

import pgm
from experiments.slam.drive import SENSOR_STD, Drive
from experiments.slam.network import Map
from models import motion, sensors
from pgm import consistency

Array = npt.NDArray[np.float64]

PLANE = ("east", "north")
CONFIDENCE = 0.95
# A deviation has shrunk if it is at least so much smaller, as a part of what it was.
SHRUNK = 0.1


def judged(belief: pgm.Gaussian, truth: Array) -> dict[str, float]:
    """RMSE in the plane, normalised errors and coverage, of stacked beliefs (runs, N).

    Poses and landmarks of a run hang together, so that only runs are independent: the error of the
    mean NEES is that over runs.
    """
    nees = consistency.nees(belief, truth).mean(axis=-1) / belief.mean.shape[-1]
    return {
        "rmse": float(consistency.rmse(belief, truth, PLANE)),
        "nees": float(nees.mean()),
        "nees_error": float(nees.std(ddof=1) / np.sqrt(nees.size)),
        "coverage": float(consistency.coverage(belief, truth, CONFIDENCE).actual),
    }


def misfit(drive: Drive, found: Map) -> dict[str, float]:
    """χ² of all steps and sightings at the means, a degree of freedom, and its 95 % band.

    Of a right model it is χ² with as many degrees as readings exceed unknowns, over all runs.
    """
    poses = found.poses.mean
    column = np.searchsorted(drive.seen, drive.landmark)
    steps = poses[:, 1:] - motion.increment(poses[:, :-1], drive.odometry)
    seen = sensors.range_bearing(poses[:, drive.step], found.landmarks.mean[:, column])
    away = drive.sightings - seen
    away[..., 1] = np.remainder(away[..., 1] + np.pi, 2.0 * np.pi) - np.pi
    square = np.sum((steps / drive.motion_std) ** 2) + np.sum((away / SENSOR_STD) ** 2)
    degrees = 2 * (len(drive.step) - len(drive.seen)) * len(poses)
    low, high = stats.chi2(degrees).ppf([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2]) / degrees
    return {"chi2": float(square / degrees), "low": float(low), "high": float(high)}


def compared(drive: Drive, maps: Mapping[int, Map], smoothed: Map) -> list[dict[str, float]]:
    """The last pose of each part of the drive by what was known then, and by all of the drive."""
    found = []
    for step, known in maps.items():
        truth = drive.truth[step : step + 1]
        beliefs = {
            "filter": known.poses[:, -1:],
            "smoother": smoothed.poses[:, step : step + 1],
        }
        row: dict[str, float] = {"step": step, "way": float(drive.way[step])}
        for kind, belief in beliefs.items():
            row[f"{kind}_std"] = float(deviations(belief).mean())
            row[f"{kind}_rmse"] = float(consistency.rmse(belief, truth, PLANE))
        found.append(row)
    return found


def deviations(belief: pgm.Gaussian) -> Array:
    """The root of the mean variance east and north, of each of stacked beliefs [m]."""
    found: Array = np.sqrt(0.5 * np.trace(belief.cov[..., :2, :2], axis1=-2, axis2=-1))
    return found


def shrinking(drive: Drive, before: Map, after: Map) -> dict[str, Any]:
    """Deviations before and after the closing sighting, along the way, of the first run.

    Poses are those before the closing, landmarks those that were seen before it, each at the way
    of its first sighting. ``reach`` is how far back along the way, from the closing, deviations of
    poses have shrunk [m].
    """
    closing = drive.closing
    poses = [deviations(each.poses[0, 1:closing]) for each in (before, after)]
    known = np.isin(drive.until(closing).seen, drive.until(closing - 1).seen)
    marks = [deviations(before.landmarks[0]), deviations(after.landmarks[0])[known]]
    way = drive.way[1:closing]
    _, first = np.unique(drive.until(closing - 1).landmark, return_index=True)
    less = 1.0 - poses[1] / poses[0]
    shrunk = np.flatnonzero(less >= SHRUNK)
    return {
        "way": way,
        "poses": poses,
        "landmarks_way": drive.way[drive.step[first]],
        "landmarks": marks,
        "reach": float(drive.way[closing] - way[shrunk[0]]) if shrunk.size else 0.0,
    }


def quarters(found: Mapping[str, Any], until: float) -> list[tuple[str, float, float, float]]:
    """Median deviations before and after in each quarter of the way to the closing, and ratios."""
    rows = []
    for k in range(4):
        low, high = 0.25 * k * until, 0.25 * (k + 1) * until
        within = (found["way"] >= low) & (found["way"] < high)
        before, after = (float(np.median(each[within])) for each in found["poses"])
        rows.append((f"{low:.0f} to {high:.0f}", before, after, after / before))
    return rows
