"""Recordings of every reader, with settings of the user's own: small files, written here."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import pgm
from experiments import recordings
from experiments.recordings import drives, setting_file
from experiments.recordings.setting_file import described
from experiments.recordings.settings import Sensor
from models import motion
from models.networks import distance, pose
from pgm import consistency

TURN = 0.3
TRUE = np.zeros((41, 3))
for _k in range(40):
    TRUE[_k + 1] = motion.increment(TRUE[_k], np.array([1.0, 0.0, TURN * (_k % 2)]))
TIMES = 100.0 + 0.5 * np.arange(41)
BEACONS = {"a": (0.0, 8.0), "b": (-6.0, 2.0), "c": (6.0, 2.0)}
NOISE = """
[motion]
std = [0.1, 0.1, 0.05]
"""


def tum(path, times, poses):
    rows = np.zeros((len(times), 8))
    rows[:, 0], rows[:, 1:3] = times, poses[:, :2]
    rows[:, 6], rows[:, 7] = np.sin(poses[:, 2] / 2), np.cos(poses[:, 2] / 2)
    np.savetxt(path, rows, fmt="%.12f")


def driven(seed=0):
    """Poses by odometry that errs, from the true start."""
    rng = np.random.default_rng(seed)
    poses = TRUE.copy()
    for k in range(40):
        step = motion.relative(TRUE[k], TRUE[k + 1]) + rng.normal(0.0, [0.07, 0.07, 0.035])
        poses[k + 1] = motion.increment(poses[k], step)
    return poses


def trajectories(folder, more=""):
    """Odometry, truth from the fifth pose on, and poses that were read."""
    away = np.array([20.0, -30.0, 1.0])  # odometry has a frame of its own
    tum(folder / "odometry.txt", TIMES, motion.increment(np.tile(away, (41, 1)), driven()))
    tum(folder / "truth.txt", TIMES[4:], TRUE[4:])
    read = TRUE + np.random.default_rng(1).normal(0.0, [0.2, 0.2, 0.1], TRUE.shape)
    tum(folder / "slam.txt", TIMES[::4], read[::4])
    file = folder / "tum.toml"
    file.write_text('path = "odometry.txt"\n[reader]\ntruth = "truth.txt"\n' + more + NOISE)
    return file


def table(folder, columns="", more=""):
    """Odometry, ranges of beacons and truth, in one table."""
    rng = np.random.default_rng(2)
    lines = ["time,ahead,left,turn,beacon,range [cm],east,north,direction"]
    odometry = driven(3)
    for k, t in enumerate(TIMES):
        if k:
            step = motion.relative(odometry[k - 1], odometry[k])
            lines.append(f"{t},{step[0]},{step[1]},{np.degrees(step[2])},,,,,")
        name = "abc"[k % 3]
        apart = np.hypot(*(TRUE[k, :2] - BEACONS[name])) + rng.normal(0.0, 0.1)
        lines.append(f"{t},,,,{name},{100 * (1.1 * apart + 0.2)},,,")
        east, north, heading = TRUE[k]
        lines.append(f"{t},,,,,,{east},{north},{heading}")
    (folder / "log.csv").write_text("\n".join(lines))
    file = folder / "csv.toml"
    marks = "".join(f"{name} = {list(place)}\n" for name, place in BEACONS.items())
    file.write_text(
        'path = "log.csv"\nname = "my_log"\n[reader]\nbegin = 100.0\n[reader.columns]\n'
        'odometry = {t = "time", forward = "ahead", left = "left", turn = ["turn", "deg"]}\n'
        'radio = {t = "time", subject = "beacon", range = ["range [cm]", "cm"]}\n'
        'truth = {t = "time", east = "east", north = "north", heading = "direction"}\n'
        f"{columns}[landmarks]\n{marks}[sensors.radio]\nreads = 'range'\nstd = 0.1\n"
        f"scale = 1.1\noffset = 0.2\n{more}{NOISE}"
    )
    return file


def results(out, data, file=None, **more):
    recordings.run(data=data, settings=file, out=out, linearisers="Taylor", **more)
    return json.loads((out / "summary.json").read_text())


def test_dead_reckoning_of_one_trajectory_against_another(tmp_path):
    file = trajectories(tmp_path)
    found = results(tmp_path / "out", "tum", file)["results"]["odometry"]
    assert list(found) == ["dead reckoning"]
    # By hand: odometry put on the truth's first pose.
    odometry = driven()[4:]
    seen = motion.relative(np.tile(odometry[0], (37, 1)), odometry)
    placed = motion.increment(np.tile(TRUE[4], (37, 1)), seen)
    due = np.sqrt(np.mean(np.sum((placed - TRUE[4:])[:, :2] ** 2, axis=1)))
    assert found["dead reckoning"][""]["rmse"] == pytest.approx(due, rel=1e-9)
    end = np.linalg.norm((placed - TRUE[4:])[-1, :2])
    assert found["dead reckoning"][""]["end"] == pytest.approx(end, rel=1e-9)


def test_a_trajectory_is_odometry_and_another_a_sensor(tmp_path):
    more = 'poses = "slam.txt"\n[sensors.poses]\nreads = "pose"\nstd = [0.2, 0.2, 0.1]\n'
    told = described(trajectories(tmp_path, more), "tum")
    drive = drives.laid(told.name, told.setting, drives.read(told.setting, told.path))
    assert drive.timeline.times[0] == TIMES[4]
    assert [variable.name for variable in drive.sensors] == ["poses"]
    errors = [
        consistency.rmse(pgm.smooth(drive.network(), e)[pose], drive.truth, ("east", "north"))
        for e in (drive.motion, drive.evidence)
    ]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # three linearisations
def test_a_table_with_beacons(tmp_path):
    more = "[methods]\nrobust = {StudentT = 4}\ngate = 0.99\nlag = 5\niterations = 3\n"
    found = results(tmp_path / "out", "csv", table(tmp_path, more=more))
    assert found["settings"]["reader"] == "csv"
    errors = found["results"]["my_log"]
    assert len(errors) == 8
    rmse = {way: each.get("Taylor", each.get(""))["rmse"] for way, each in errors.items()}
    assert rmse["smoother"] < 0.15 < rmse["dead reckoning"]
    assert {row["landmark"] for row in found["ranking"]["my_log"]} == {"a", "b", "c"}
    assert (tmp_path / "out" / "my_log_ranking.png").exists()


def test_a_bag_with_fixes_and_a_laser(tmp_path, capsys):
    bags = pytest.importorskip("tests.recordings.test_bags")
    make = bags.Maker(2)
    messages = []
    for k, (t, at) in enumerate(zip(TIMES - 100.0, driven().tolist(), strict=True)):
        messages.append(("/odom", make.odometry(t, *at)))
        if k % 5 == 0:
            east, north = TRUE[k, :2]
            # Not at 0°, 0°, where receivers without a fix are; degrees are 110.6 and 111.2 km.
            messages.append(("/gps", make.fix(t, 3.0 + north / 110_577.0, 4.0 + east / 111_169.0)))
            messages.append(("/scan", make.scan(t, [1.0, 2.0, 3.0])))
    bags.write(tmp_path / "drive", 2, messages)
    file = tmp_path / "bag.toml"
    file.write_text(
        'path = "drive"\n[start]\nmean = [0, 0, 0]\n[reader]\ntopics = ["/odom", "/gps", "/scan"]'
        "\n[sensors.fixes]\nreads = 'position'\nstd = [0.5, 0.5]\nmount = [0.1, 0, 0]\n" + NOISE
    )
    found = results(tmp_path / "out", "bag", file)
    assert found["results"]["drive"]["filter"]["Taylor"]["log_evidence"] > -40.0
    told = capsys.readouterr().out
    assert "Scans are not taken: /scan" in told
    assert "the recording's variances they are [1.0, 2.0]" in told


def plaza(path):
    poses = [[0.0, 0, 0, 0], [1.0, 2, 0, 0], [2.0, 4, 0, 0]]
    heard = [[t, 2, 7, np.hypot(3.0 - 2.0 * t, 3.0)] for t in (0.0, 1.0, 2.0)]
    tables = {"GT": poses, "DR": [[1.0, 2, 0], [2.0, 2, 0]], "TL": [[7.0, 3, 3]], "TD": heard}
    savemat(path / "log", tables, appendmat=False)
    return "[sensors.radio]\nreads = 'range'"


def freiburg(path):
    (path / "log").mkdir()
    (path / "log" / "world.dat").write_text("1 3 3\n")
    seen = "ODOMETRY 0 2 0\nSENSOR 1 3.2 1.3\nODOMETRY 0 2 0\nSENSOR 1 3.2 1.9\n"
    (path / "log" / "sensor_data.dat").write_text(seen)
    return "[start]\nmean = [0, 0, 0]\n[sensors.landmark]\nreads = 'range and bearing'"


def labyrinth(path):
    lines = []
    for t in (0.0, 1.0, 2.0):
        away = np.hypot(3.0 - 2.0 * t, 3.0)
        lines += [f"range2 {t} {away} 0.01 3 3 105 0", f"odom2diff {t} 2 2 0 0.0785 0 0 0"]
    (path / "log").write_text("\n".join(lines))
    (path / "truth").write_text("".join(f"point2 {t} {2 * t} 0 1 0 0 1\n" for t in (0, 1, 2)))
    return (
        "[reader]\ntruth = 'truth'\n[start]\nmean = [nan, nan, 0]\n[sensors.uwb]\nreads = 'range'"
    )


def mrclam(path):
    (path / "log").mkdir()
    for name, text in {
        "Barcodes": "6 72\n2 14\n",
        "Landmark_Groundtruth": "6 3 3 0.001 0.002\n",
        "Robot2_Odometry": "0 2 0\n1 2 0\n2 2 0\n",
        "Robot2_Measurement": "0 72 4.2 0.8\n1 72 3.2 1.2\n1 14 1 0\n2 72 3.2 1.9\n",
        "Robot2_Groundtruth": "0 0 0 0\n1 2 0 0\n2 4 0 0\n",
    }.items():
        (path / "log" / f"{name}.dat").write_text(text)
    return "[reader]\nrobot = 2\n[sensors.camera]\nreads = 'range and bearing'"


def barfoot(path):
    t, steady = np.array([[0.0], [1.0], [2.0]]), np.full((3, 1), 2.0)
    here = 2.0 * t + 0.5  # of the laser
    savemat(
        path / "log",
        {
            "t": t,
            "x_true": 2.0 * t,
            "y_true": 0 * t,
            "th_true": 0 * t,
            "l": [[3.0, 3.0]],
            "r": np.hypot(3.0 - here, 3.0),
            "b": np.arctan2(3.0, 3.0 - here),
            "d": 0.5,
            "v": steady,
            "om": 0 * t,
        },
        appendmat=False,
    )
    return "[sensors.laser]\nreads = 'range and bearing'"


@pytest.mark.parametrize("write", [plaza, freiburg, labyrinth, mrclam, barfoot])
def test_known_recordings_with_settings(tmp_path, write):
    """Each is of a robot that goes 2 m/s east from (0, 0), and sees (3, 3)."""
    more = write(tmp_path)
    file = tmp_path / "own.toml"
    std = "[0.1, 0.1]" if "bearing" in more else "0.1"
    file.write_text(f'path = "log"\n[motion]\nstd = [0.1, 0.1, 0.1]\n{more}\nstd = {std}\n')
    told = described(file, write.__name__)
    drive = drives.laid(told.name, told.setting, drives.read(told.setting, told.path))
    posterior = pgm.smooth(drive.network(), drive.evidence)
    steady = [[2.0 * t, 0.0, 0.0] for t in range(3)]
    np.testing.assert_allclose(posterior[pose].mean[-3:], steady, atol=0.1)
    assert np.abs(posterior.innovations[next(iter(drive.sensors))].residual[1:]).max() < 0.15
    (labels,) = drive.labels.values()
    assert len(set(labels)) == 1


def examples():
    """Settings on the guide's page, by reader."""
    page = (Path(__file__).parents[2] / "docs" / "guide" / "recordings.md").read_text()
    readers = ("csv", "bag", "tum", "plaza", "pose_graph")
    return dict(zip(readers, re.findall(r"```toml\n(.*?)```", page, re.S), strict=True))


@pytest.mark.parametrize("reader", sorted(set(examples()) - {"pose_graph"}))
def test_the_guides_settings_are_taken(tmp_path, reader):
    file = tmp_path / "own.toml"
    file.write_text(examples()[reader])
    for name in ("log.csv", "drive.bag", "odometry.txt", "groundtruth.txt", "slam.txt"):
        (tmp_path / name).write_text("")
    shutil.copy(Path(__file__).parents[2] / "docs" / "log.csv", tmp_path)
    (tmp_path / "Plaza1_.mat").write_text("")
    told = described(file, reader)
    assert told.setting.sensors
    if reader == "csv":
        drive = drives.laid("log", told.setting, drives.read(told.setting, told.path))
        last = pgm.smooth(drive.network(), drive.evidence)[pose].mean[-1]
        assert np.linalg.norm(last[:2] - [-1.03, 7.61]) < 0.1  # as the page has it


WRONG = {
    "[motion]\nstd = [0.1, 0.1]": r"own.toml: motion.std is \[0.1, 0.1\]; of one second, 3 numbers",
    "[motion]\nstd = [0.1, 0.1, -1]": r"motion.std is .*\(forward, left, turn\), was due",
    "[motion]\nspeed = 1": r"motion.std is missing",
    "[landmarks]\na = [1, 2]": r"own.toml: motion is missing; a table, \[motion\], was due",
    NOISE + "period = 0": r"motion.period is 0; a positive number of seconds was due",
    NOISE + "[sensors.radio]\nreads = 'sonar'": r"sensors.radio.reads is 'sonar'; one of range, be",
    NOISE + "[sensors.radio]\nreads = 'range'": r"sensors.radio.std is missing; above zero, a num",
    NOISE + "[sensors.radio]\nreads = 'pose'\nstd = 1": r"radio.std is 1; above zero, 3 numbers",
    NOISE + "[sensors.r]\nreads = 'heading'\nstd = 1\nscale = 2": r"sensors.r.scale is unknown; kn",
    NOISE + "[landmarks]\na = [1, 2, 3]": r"landmarks.a is \[1, 2, 3\]; a place, 2 numbers",
    NOISE + "[start]\nmean = 3": r"start.mean is 3; 3 numbers, \(east, north, heading\), was due",
    NOISE + "[methods]\ngate = 2": r"methods.gate is 2; a probability below 1 was due",
    NOISE + "[methods]\nrobust = {Tukey = 1}": r"methods.robust is .*like \{Cauchy = 1.0\}",
    NOISE + "[methods]\nrobust = {Huber = -1}": r"methods.robust: Huber: threshold is a positive",
    NOISE + "[methods]\nlag = 1.5": r"methods.lag is 1.5; a whole number, 1 or more, was due",
    NOISE + "[reader]\nbegin = 1": r"reader.columns is missing; a table of columns",
    NOISE + "[sensor]\n": r"reader.columns is missing",
    NOISE + "[reader.columns.radio]\nx = 'a'\n[sensor]": r"own.toml: sensor is unknown; known are ",
    "std = ": r"own.toml: it is no TOML: .*line 2",
    NOISE + "[truth]\nheading_shift = 'pi'": r"truth.heading_shift is 'pi'; a number of radians",
}


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_setting_is_refused_by_file_and_key(tmp_path, text):
    (tmp_path / "log.csv").write_text("time\n")
    file = tmp_path / "own.toml"
    own = (
        "" if "[reader" in text or "columns is missing" in WRONG[text] else "\n[reader.columns.a]\n"
    )
    file.write_text('path = "log.csv"\n' + text + own)
    with pytest.raises(pgm.errors.FileError, match=WRONG[text]) as refused:
        described(file, "csv")
    assert refused.value.path == str(file)


def test_what_a_recording_lacks_is_refused(tmp_path):
    for more, message in (
        ("[sensors.sonar]\nreads = 'range'\nstd = 1\n", "no sensor 'sonar'; it has radio"),
        ("", "radio has the components range; to read position it lacks east, north"),
    ):
        file = table(tmp_path, more=more)
        if not more:
            text = file.read_text().replace("reads = 'range'\nstd = 0.1", "reads = 'position'")
            file.write_text(text.replace("scale = 1.1\noffset = 0.2", "std = [1, 1]"))
        told = described(file, "csv")
        with pytest.raises(pgm.EvidenceError, match=message):
            drives.read(told.setting, told.path)
    file = table(tmp_path, 'bad = {x = "time"}\n')
    told = described(file, "csv")
    with pytest.raises(pgm.errors.FileError, match=r"csv.toml: reader: columns\['bad'\] names a"):
        drives.read(told.setting, told.path)


def test_clocks_that_differ_are_refused(tmp_path):
    file = trajectories(tmp_path)
    tum(tmp_path / "truth.txt", TIMES + 1e6, TRUE)
    told = described(file, "tum")
    with pytest.raises(pgm.EvidenceError, match="no time in common: are their clocks the same"):
        drives.laid("odometry", told.setting, drives.read(told.setting, told.path))
    tum(tmp_path / "odometry.txt", TIMES[:1], TRUE[:1])
    with pytest.raises(pgm.errors.FileError, match="it has one pose, which is no motion"):
        drives.read(told.setting, told.path)
    file.write_text('path = "odometry.txt"\n[reader]\ntruth = "moon.txt"\n' + NOISE)
    with pytest.raises(pgm.errors.FileError, match=r"reader.truth is 'moon.txt', where there is"):
        described(file, "tum")
    file.write_text('path = "moon.txt"\n' + NOISE)
    with pytest.raises(pgm.errors.FileError, match=r"path is .*moon.txt', where there is nothing"):
        described(file, "tum")


def test_refusals(tmp_path):
    with pytest.raises(pgm.EvidenceError, match="recordings csv needs --settings FILE"):
        recordings.run(data="csv")
    with pytest.raises(pgm.EvidenceError, match="plaza1 has settings of its own; with --settings"):
        recordings.run(data="plaza1", settings=tmp_path / "own.toml")
    with pytest.raises(pgm.EvidenceError, match="--settings is of one recording"):
        recordings.run(settings=tmp_path / "own.toml")
    with pytest.raises(pgm.EvidenceError, match="experiment of its own: pose_graphs --path FILE"):
        recordings.run(data="pose_graph")
    with pytest.raises(pgm.errors.FileError, match=r"none.toml: it cannot be read \(No such file"):
        setting_file.described(tmp_path / "none.toml", "csv")


def test_sensors_have_variables_of_their_own():
    two = tuple(Sensor(name, "range", (1.0,)) for name in ("x", "radio"))
    assert [variable.name for variable in drives.named(two)] == ["z of x", "radio"]
    assert list(drives.named(two[:1])) == [distance]
