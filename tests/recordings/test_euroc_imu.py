"""Inertial readings of EuRoC, in the odd forms of their files."""

import io

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.recordings import read_euroc_imu

RATES = ",".join(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz")
PULLS = ",".join(f"a_RS_S_{axis} [m s^-2]" for axis in "xyz")
NAMES = f"#timestamp [ns],{RATES},{PULLS}\r\n"
LINES = (
    "1403636579758555392,-0.099134701513277898,0.14730578886832138,0.02722713633111154,"
    "8.1476917083333333,-0.37592158333333331,-2.4026292499999999\r\n"
    "1403636579763555584,-0.099134701513277898,0.14032447186034408,0.029321531433504733,"
    "8.033280791666666,-0.40861041666666664,-2.4026292499999999\r\n"
)


def read(text):
    return read_euroc_imu(io.StringIO(text))


def test_readings_as_they_are_published():
    drive = read(NAMES + LINES)
    due = np.array([line.split(",")[1:] for line in LINES.split()], dtype=float)
    assert_array_equal(drive.imu.values, due)
    assert drive.imu.components[::3] == ("rate_x", "acceleration_x")
    assert_array_equal(drive.imu.stamps, [1403636579.758555392, 1403636579.763555584])
    assert_array_equal(read(LINES).imu.values, due)  # without names
    first, second = LINES.split()
    back = read(f"{NAMES}\n{second}\n{first}\n{first}\n")
    assert_array_equal(np.unique(back.imu.stamps), drive.imu.stamps)
    assert back.dropped


def test_columns_in_another_order_and_other_units():
    """As some tools write them again: by name, degrees and g."""
    names = "#timestamp [ns]," + ",".join(
        [f"a_{axis} [g]" for axis in "xyz"] + [f"w_{axis} [deg/s]" for axis in "zyx"]
    )
    drive = read(f"{names}\n1403636579758555392,1,0,-2,180,90,0\n")
    assert_allclose(drive.imu["acceleration_z"], -2 * 9.80665)
    assert_allclose(drive.imu["rate_z"], np.pi)
    assert_allclose(drive.imu["rate_x"], 0.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (NAMES, "no inertial readings"),
        (LINES[:60], "line 1: it has 3 numbers"),
        (NAMES.replace("[ns]", "[s]") + LINES, r"stamps are in \[s\], where \[ns\] was due"),
        (NAMES.replace("rad s^-1", "bananas") + LINES, "bananas"),
        (NAMES.replace("m s^-2", "rad s^-1") + LINES, "rad/s"),
        (NAMES.replace("a_RS_S_z", "a_RS_S_y") + LINES, "its columns are"),
        (NAMES.replace("w_RS_S_x", "heading") + LINES, "a column is 'heading"),
        ("1.5,0,0,0,0,0,9.8\n", "whole nanoseconds were due"),
        ("1,0,0,0,0,0,9.8\n2,0,0,0,0,0,9.8\n", "inertial readings are 1 ns apart"),
    ],
)
def test_files_that_are_no_inertial_readings(text, said):
    with pytest.raises(pgm.FileError, match=said):
        read(text)
