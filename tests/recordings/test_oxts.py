"""Packets of KITTI's raw recordings, made here: a drive to the north-west, in its odd forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pgm.errors import FileError
from pgm.recordings import read_oxts

pytest.importorskip("pymap3d")


def packet(k, latitude=49.0, accuracy=0.05):
    numbers = [latitude + 1e-5 * k, 8.4, 112.8, 0.03, 0.02, 2.3, 8.0, -8.0, 11.3, -0.1, 0.05]
    numbers += [0.1, 0.2, 9.8, 0.1, 0.2, 9.8, 0.01, 0.02, 0.03, 0.01, 0.02, 0.04, accuracy, 0.1]
    return " ".join(f"{n!r}" for n in numbers) + " 4 10 4 4 0\n"


@pytest.fixture
def drive(tmp_path):
    folder = tmp_path / "2011_09_26_drive_0001_sync"
    data = folder / "oxts" / "data"
    data.mkdir(parents=True)
    stamps = [f"2011-09-26 13:02:2{k}.964389445\n" for k in range(6)]
    (folder / "oxts" / "timestamps.txt").write_text("".join(stamps) + "\n")
    for k in (0, 1, 2, 4, 5):
        text = packet(k)
        if k == 4:
            text = text.replace("11.3", "nan")
        if k == 0:
            text = "0.0 0.0 " + text.split(" ", 2)[2]
        (data / f"{k:010d}.txt").write_text(text)
    return folder


def test_packets_are_read_and_what_they_lack_is_told(drive):
    found = read_oxts(drive)
    assert found.name == drive.name
    seconds = np.array([20, 21, 22, 25]) + 0.964389445
    assert_allclose(found.velocities.stamps % 60, seconds, rtol=0, atol=3e-7)
    assert_allclose(found.velocities.values, np.tile([11.3, -0.1, 0.04], (4, 1)))
    assert_allclose(found.imu.values[0], [0.01, 0.02, 0.03, 0.1, 0.2, 9.8, 2.3])
    assert_allclose(np.diff(found.fixes["north"]), [1.112, 3.336], rtol=1e-3)
    assert_allclose(found.fixes.variances[:, :2], 0.0025)
    told = {each.fate.partition(",")[0]: each.rows.tolist() for each in found.dropped}
    assert told == {
        "without a packet's file": [3],
        "with numbers that are not finite": [4],
        "0°": [0],
    }
    again = read_oxts(drive / "oxts", datum=(49.0, 8.4))
    assert_allclose(again.fixes["north"][0], 1.112, rtol=1e-3)


def test_recordings_that_are_none(drive, tmp_path):
    oxts = drive / "oxts"
    (oxts / "data" / "0000000005.txt").write_text("1 2 3\n")
    with pytest.raises(FileError, match="it has 3 numbers; 30 were due"):
        read_oxts(drive)
    (oxts / "data" / "0000000005.txt").write_text(packet(5).replace("8.4", "east"))
    with pytest.raises(FileError, match="east"):
        read_oxts(drive)
    (oxts / "data" / "0000000009.txt").write_text(packet(9))
    with pytest.raises(FileError, match="6 stamps, and the packets go to number 9"):
        read_oxts(drive)
    (oxts / "timestamps.txt").write_text("13:02\n")
    with pytest.raises(FileError, match="line 1: '13:02'; a time like"):
        read_oxts(drive)
    with pytest.raises(FileError):
        read_oxts(tmp_path)
