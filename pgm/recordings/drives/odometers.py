"""Odometers that tell poses: the motion from each to the next, also where they restart."""

from __future__ import annotations

import numpy as np

from pgm.io.dropped import Dropped
from pgm.io.poses import Poses
from pgm.kernels import twists
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array, Mask
from pgm.recordings.drives import mending
from pgm.recordings.drives.motion import PLANAR
from pgm.recordings.drives.stream import Stream

RESTARTED = "where the odometer begins at zero again: the motion is not known, and taken to be none"
# A restart is a step of so many usual ones, to a place so few of them from zero.
_JUMP, _NEAR = 20.0, 3.0
_POSE = ("east", "north", "heading")


def increments(name: str, poses: Stream | Poses) -> tuple[Stream, list[Dropped]]:
    """The motion (forward, left, turn) between poses, in order of their stamps.

    Of a restart, as of a driver that was started again, the pose before says nothing about the
    motion: it is none there, and told.
    """
    if isinstance(poses, Poses):
        poses = Stream(poses.times, poses.planar, _POSE)
    found, told = mending.ordered(name, poses)
    moved = twists.between(found.values)
    again = restarts(found.values)
    if again.any():
        moved[again[1:]] = 0.0
        rows = np.argsort(poses.stamps, kind="stable")[again]
        told.append(Dropped(name, RESTARTED, np.sort(rows), kept=True))
    units = ("m", "m", "rad")  # a turn is within half a turn
    return Stream(found.stamps[1:], moved, PLANAR, units=units, begin=found.stamps[0]), told


def restarts(poses: Array) -> Mask:
    """The mask of poses (n, 3) at which an odometer has begun at zero again.

    The step to such a pose is `_JUMP` times as long as usual ones, and leads to zero, in place and
    heading up to `_NEAR` of these.
    """
    again = np.zeros(len(poses), dtype=bool)
    steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    usual, turn = _usual(steps), _usual(np.abs(wrap(np.diff(poses[:, 2]))))
    home = np.linalg.norm(poses[1:, :2], axis=1) <= _NEAR * usual
    home &= np.abs(wrap(poses[1:, 2])) <= _NEAR * turn
    again[1:] = home & (steps > _JUMP * usual)
    return again


def _usual(steps: Array) -> float:
    """The median of steps that are none of zero."""
    moved = steps[steps > 0.0]
    return float(np.median(moved)) if moved.size else 0.0
