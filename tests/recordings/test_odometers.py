"""Odometers that tell poses, and begin at zero again: the motion that is known, and is not."""

import io

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.kernels import quaternions
from pgm.recordings import Recording
from pgm.recordings.drives.odometers import restarts


def circle(rows, radius=3.0):
    turn = np.linspace(0.0, 2.0, rows)
    return np.column_stack([radius * np.sin(turn), radius * (1 - np.cos(turn)), turn])


def poses(planar, times=None):
    angles = np.zeros((len(planar), 3))
    angles[:, 2] = planar[:, 2]
    place = np.column_stack([planar[:, :2], np.zeros(len(planar))])
    times = np.arange(len(planar), dtype=float) if times is None else times
    return pgm.Poses(times, place, quaternions.of_angles(angles))


def test_the_motion_between_poses_leads_from_each_to_the_next():
    path = circle(40)
    drive = Recording(odometry=poses(path))
    assert_allclose(drive.dead_reckoning(path[0]).values, path, atol=1e-12)
    assert drive.dropped == ()


def test_an_odometer_that_restarts_is_told_and_does_not_move():
    path, again = circle(40), circle(30) + np.array([0.01, 0.0, 0.001])
    drive = Recording(odometry=poses(np.vstack([path, again])))
    (told,) = drive.dropped
    assert told.kept
    assert told.rows.tolist() == [40]
    assert "begins at zero again" in repr(drive)
    assert_array_equal(drive.odometry.values[39], 0.0)
    found = drive.dead_reckoning(path[0]).values
    assert_allclose(found[:40], path, atol=1e-12)
    # From where it was, the second drive goes on as from its own beginning.
    alone = Recording(odometry=poses(again)).dead_reckoning(path[-1])
    assert_allclose(found[40:], alone.values, atol=1e-12)


@pytest.mark.parametrize(
    "path",
    [
        circle(200)[::-1],  # home again, step by step
        np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, 0]], dtype=float),
        np.vstack([circle(40), [[2.0, 2.0, 1.0]]]),  # a jump to elsewhere, as of a loop closure
        np.zeros((1, 3)),
        np.zeros((5, 3)),
    ],
)
def test_other_motion_is_no_restart(path):
    assert not restarts(path).any()


def test_files_of_trajectories_are_odometers():
    rows = "".join(f"{k} {0.5 * k!r} 0 0 0 0 0 1\n" for k in range(30))
    rows += "".join(f"{k} {0.5 * (k - 29)!r} 0 0 0 0 0 1\n" for k in range(30, 40))
    drive = Recording(odometry=pgm.read_tum(io.StringIO("# x\n29 14.5 0 0 0 0 0 1\n" + rows)))
    assert {each.fate.split(",")[0] for each in drive.dropped} == {
        "stamped before the row above",
        "of a stamp seen before",
        "where the odometer begins at zero again: the motion is not known",
    }
