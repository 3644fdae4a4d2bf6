"""Readers of text and tables: what small files say, real ones to the row, and mangled ones."""

import io
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

import pgm
from pgm.errors import EvidenceError, FileError
from pgm.recordings import (
    Recording,
    read_barfoot,
    read_csv,
    read_freiburg,
    read_labyrinth,
    read_mrclam,
    read_plaza,
    read_pose_graph,
)

DATA = Path(os.environ.get("PGM_DATA") or Path(__file__).parents[3] / "shared" / "data")

MRCLAM = {
    "Barcodes": "# Subject # Barcode\n1 5\n2 14\n6 72\n7 27\n",
    "Landmark_Groundtruth": "6 1.9 -5.6 0.001 0.002\n7 0.5 4.2 0.003 0.004\n",
    "Robot1_Odometry": "# time v w\n0.0 0.1 0.0\n0.5 0.1 0.2\n0.5 0.2 0.2\n1.0 0.0 0.0\n",
    "Robot1_Measurement": "0.1 72 1.5 -0.2\n0.2 14 2.0 0.1\n0.2 99 2.0 0.1\n0.7 27 3.0 0.3\n",
    "Robot1_Groundtruth": "0.0 1 2 0.1\n0.5 1.1 2 0.1\n1.0 1.2 2 0.2\n",
}
LABYRINTH = {
    "Indoor_UWB_Input": (
        "range2 0.1 2.9 0.01 0 2 105 0\nrange2 0.2 1.6 0.01 2 2 107 0\n"
        "odom2diff 0.1 0.2 0.4 0 0.0785 1e-4 1e-4 1e-4\n"
        "odom2diff 0.2 0.3 0.3 0 0.0785 1e-4 1e-4 1e-4\n"
    ),
    "Indoor_UWB_GT": "point2 0.1 1.5 2.2 0 0 0 0\npoint2 0.2 1.6 2.2 0 0 0 0\n",
}
FREIBURG = {
    "world": "1 2 1\n2 0 4\n",
    "sensor_data": "ODOMETRY 0.1 0.2 0.001\nSENSOR 1 2.1 0.35\nODOMETRY 0.2 1.5 -0.2\n",
}
G2O = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0.5
VERTEX_SE2 3 2 0.5 1
VERTEX_XY 2 5 5
FIX 0
PARAMS_SE2OFFSET 0 0 0 0
EDGE_SE2 0 1 1 0 0.5 10 1 2 20 3 30
EDGE_SE2 1 3 1 0.1 0.5 10 0 0 20 0 30
EDGE_SE2 3 0 -2 0 -1 5 0 0 5 0 5
EDGE_SE2_XY 1 2 4 5 7 1 9
"""
CSV = "t,v,omega,id,d\n0,1.0,0.1,,\n0.5,1.5,0.2,7,4.2\n0.7,,,8,3.2\n1.0,1.0,0.0,,\n"
COLUMNS = {
    "velocities": {"t": "t", "v": "v", "omega": "omega"},
    "radio": {"t": "t", "subject": "id", "range": "d"},
}


def written(folder, texts, ending):
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / f"{name}.{ending}").write_text(text)
    return folder


def mat(**tables):
    file = io.BytesIO()
    savemat(file, tables)
    return io.BytesIO(file.getvalue())


def barfoot(**changes):
    column = np.arange(4.0)[:, None]
    r = np.zeros((4, 2))
    r[1, 0], r[2, 1] = 1.5, 2.5
    tables = {"t": 0.1 * column, "x_true": column, "y_true": column, "th_true": 0.1 * column}
    tables |= {"l": np.array([[1.0, 2.0], [3.0, 4.0]]), "r": r, "b": 0.1 * r, "v": column}
    tables |= {"om": -column, "d": 0.2, "r_var": 0.01, "b_var": 0.02, "v_var": 0.3, "om_var": 0.4}
    return mat(**tables | {"true_valid": np.array([[1, 1, 0, 1]]).T} | changes)


def test_mrclam(tmp_path):
    drive = read_mrclam(written(tmp_path, MRCLAM, "dat"))
    seen = drive.sightings["camera"]
    assert seen.subject.tolist() == [6, 2, 7]
    assert_array_equal(seen.values, [[1.5, -0.2], [2.0, 0.1], [3.0, 0.3]])
    assert_array_equal(drive.landmarks[7], [0.5, 4.2])
    assert_allclose(drive.landmark_cov[6], np.diag([1e-6, 4e-6]))
    assert_array_equal(drive.velocities["v"], [0.1, 0.1, 0.2, 0.0])
    assert [each.rows.tolist() for each in drive.dropped] == [[2]]
    # The value that another of the same moment follows is held for no time.
    assert_allclose(drive.dead_reckoning().values[-1][2], 0.1 + 0.5 * 0.2)
    known = drive.located()
    assert known.sightings["camera"].subject.tolist() == [6, 7]
    assert "without a place (row 1)" in repr(known)


def test_barfoot():
    drive = read_barfoot(barfoot())
    seen = drive.sightings["laser"]
    assert_allclose(seen.stamps, [0.1, 0.2])
    assert_allclose(seen.values, [[1.5, 0.15], [2.5, 0.25]])
    assert seen.subject.tolist() == [1, 2]
    assert_array_equal(seen.variances, [[0.01, 0.02]] * 2)
    # Row k drives from k − 1 to k.
    assert_array_equal(drive.velocities["v"], [1.0, 2.0, 3.0, 3.0])
    assert drive.dead_reckoning([0, 0, 0]).values[-1, 2] == pytest.approx(-0.6)
    assert drive.truth.stamps.tolist() == pytest.approx([0.0, 0.1, 0.3])
    assert drive.mounts["laser"].tolist() == [0.2, 0.0, 0.0]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"r": np.zeros((4, 3))}, r"the table r has shape \(4, 3\); \(4, 2\)"),
        ({"v": np.zeros((3, 1))}, r"the table v has shape \(3, 1\); \(4, 1\)"),
        ({"d": np.zeros((2, 1))}, r"the table d has shape \(2, 1\); one number"),
        ({"r": np.full((4, 2), np.nan)}, "the table r, row 0: .* is not finite"),
        ({"l": np.array(["a", "b"])}, "the table l is text; numbers in 2 columns were due"),
        ({"t": np.array([[0.0]])}, "was due"),
    ],
)
def test_barfoot_of_other_tables(changes, told):
    with pytest.raises(FileError, match=told):
        read_barfoot(barfoot(**changes))


def test_labyrinth(tmp_path):
    folder = written(tmp_path, LABYRINTH, "txt")
    drive = read_labyrinth(folder)
    assert drive.landmarks.keys() == {105, 107}
    assert_allclose(drive.velocities.values, [[0.3, (0.4 - 0.2) / 0.157], [0.3, 0.0]])
    plain = read_labyrinth(folder / "Indoor_UWB_Input.txt", swapped=False, wheelbase=0.0785)
    assert_allclose(plain.velocities["omega"], [(0.2 - 0.4) / 0.0785, 0.0])
    assert plain.truth is None
    assert drive.truth.components == ("east", "north")
    with pytest.raises(EvidenceError, match="wheelbase= is a positive"):
        read_labyrinth(folder, wheelbase=0.0)


def test_a_table_of_values():
    drive = read_csv(io.StringIO(CSV), COLUMNS, landmarks={7: (1.0, 2.0)})
    assert_array_equal(drive.velocities.stamps, [0.0, 0.5, 1.0])
    assert drive.sightings["radio"].subject.tolist() == [7, 8]
    assert not drive.dropped
    (told,) = read_csv(io.StringIO(CSV), {"radio": COLUMNS["radio"]}).dropped
    assert told.rows.tolist() == [0, 3]


def test_a_table_without_names_in_other_units():
    text = "# a log\n0;36;90;\n1000;72;180;25\n"
    columns = {
        "velocities": {"t": (0, "ms"), "v": (1, "km/h"), "omega": (2, "deg/s")},
        "compass": {"t": (0, "ms"), "heading": (2, "deg"), "variance of heading": (1, "deg")},
        "thermometer": {"t": (0, "ms"), "celsius": 3},
    }
    drive = read_csv(io.StringIO(text), columns, delimiter=";")
    assert_allclose(drive.velocities.values, [[10.0, np.pi / 2], [20.0, np.pi]])
    assert_allclose(drive.sightings["compass"].variances[:, 0], np.radians([6, 12]) ** 2 / [1, 2])
    assert_array_equal(drive.sightings["thermometer"]["celsius"], [25.0])


def test_a_table_of_wheels():
    text = "t,l,r\n0,0.1,0.2\n1,0.3,0.3\n"
    wheels = {"t": "t", "left": "l", "right": "r"}
    drive = read_csv(io.StringIO(text), {"odometry": wheels}, begin=-1.0, wheelbase=0.5)
    assert_allclose(drive.odometry.values, [[0.15, 0.2], [0.3, 0.0]])
    drive = read_csv(io.StringIO(text), {"velocities": wheels}, wheelbase=0.5)
    assert drive.velocities.components == ("v", "omega")
    with pytest.raises(EvidenceError, match="wheelbase= is a positive"):
        read_csv(io.StringIO(text), {"odometry": wheels}, wheelbase=-1.0)


def test_names_of_landmarks_that_python_takes_for_numbers():
    text = "t,id,r\n0,1_0,1\n1,10,1\n2,٣,1\n3,007,1\n4,,1\n"
    drive = read_csv(io.StringIO(text), {"radio": {"t": "t", "subject": "id", "range": "r"}})
    assert drive.sightings["radio"].subject.tolist() == ["1_0", 10, "٣", 7, None]


def test_variances_of_wheels_are_refused():
    wheels = {"t": "t", "left": "l", "right": "r", "variance of left": "s"}
    with pytest.raises(EvidenceError, match="variances of two wheels"):
        read_csv(io.StringIO("t,l,r,s\n0,1,1,2\n"), {"velocities": wheels}, wheelbase=0.5)


def test_paths_with_a_nul_are_refused():
    with pytest.raises(FileError, match=r"cannot be read .ValueError: embedded null"):
        read_pose_graph("a\0b")


@pytest.mark.parametrize(
    ("text", "columns", "error", "told"),
    [
        (CSV, {"velocities": {"t": "t", "v": "speed"}}, FileError, "no column 'speed'; they are"),
        ("t,d,d\n0,1,2\n", {"a": {"t": "t", "x": "d"}}, FileError, "several columns 'd'"),
        (CSV, {"radio": {"t": "t", "range": ("d", "yard")}}, EvidenceError, "'yard' is no unit"),
        (CSV, {"radio": {"range": "d"}}, EvidenceError, "names a column for t"),
        (CSV, {"radio": {"t": 0, "range": "d"}}, EvidenceError, "all named or all numbered"),
        (CSV, {}, EvidenceError, "columns is a mapping"),
        (CSV, {"radio": {"t": -1, "range": 1}}, EvidenceError, "a column's name or number"),
        ("t,v,omega\n0,1,\n", {"velocities": COLUMNS["velocities"]}, FileError, "line 2: .* empty"),
        ("t,v,omega\n0,1,x\n", {"velocities": COLUMNS["velocities"]}, FileError, "line 2: 'x' is"),
        (
            "t,v,omega\n0,1\n",
            {"velocities": COLUMNS["velocities"]},
            FileError,
            "line 2: .* 2 cells",
        ),
        ("t,v\n0,1\n", {"velocities": {"t": "t", "v": "v"}}, FileError, "has the components"),
    ],
)
def test_tables_that_cannot_be(text, columns, error, told):
    with pytest.raises(error, match=told):
        read_csv(io.StringIO(text), columns)


def test_a_pose_graph(tmp_path):
    graph = read_pose_graph(io.StringIO(G2O))
    assert graph.names.tolist() == [0, 1, 3]
    assert graph.landmark_names.tolist() == [2]
    assert graph.loops.tolist() == [2]
    assert graph.edges.second.tolist() == [1, 2, 0]
    assert_array_equal(graph.edges.information[0], [[10, 1, 2], [1, 20, 3], [2, 3, 30]])
    assert graph.sightings.information.tolist() == [[[7, 1], [1, 9]]]
    assert graph.fixed.tolist() == [0]
    assert graph.dropped[0].rows.tolist() == [6]
    drive = graph.recording()
    reckoned = drive.dead_reckoning(graph.poses[0])
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    assert_allclose(reckoned.values[-1, :2], [1, 0] + turn @ [1.0, 0.1])
    assert drive.sightings["landmark"].subject.tolist() == [2]
    assert_allclose(drive.odometry.variances[1], [0.1, 0.05, 1 / 30])
    assert_allclose(drive.odometry.cov[0], np.linalg.inv(graph.edges.information[0]))
    assert_allclose(drive.sightings["landmark"].cov[0], np.linalg.inv([[7.0, 1.0], [1.0, 9.0]]))


def test_edges_told_from_the_later_pose():
    """A drive told backwards ends where it does forwards, as surely."""
    c, s = np.cos(0.6), np.sin(0.6)
    there = np.array([2.0, 0.3, 0.6])
    back = np.array([-(c * 2.0 + s * 0.3), s * 2.0 - c * 0.3, -0.6])
    poses = "VERTEX_SE2 4 0 0 0\nVERTEX_SE2 5 0 0 0\n"
    edge = "EDGE_SE2 5 4 {} {} {} 40 3 1 50 -2 60\n".format(*back)
    graph = read_pose_graph(io.StringIO(poses + edge))
    assert graph.loops.size == 0
    odometry = graph.recording().odometry
    assert_allclose(odometry.values, [there], atol=1e-12)
    # By drawing: motions back with that noise, each turned round.
    cov = np.linalg.inv([[40.0, 3, 1], [3, 50, -2], [1, -2, 60]]) * 1e-6
    drawn = np.random.default_rng(0).multivariate_normal(back, cov, 200_000)
    c, s = np.cos(drawn[:, 2]), np.sin(drawn[:, 2])
    forward = -(c * drawn[:, 0] + s * drawn[:, 1])
    left = s * drawn[:, 0] - c * drawn[:, 1]
    due = 1e6 * np.cov([forward, left, -drawn[:, 2]])
    assert_allclose(odometry.cov[0], due, rtol=0.02, atol=1e-3)


def test_a_pose_graph_in_space():
    half = np.sin(0.25), np.cos(0.25)
    information = np.diag(np.arange(1.0, 7.0))
    upper = " ".join(str(x) for x in information[np.triu_indices(6)])
    text = (
        f"VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\nVERTEX_SE3:QUAT 1 2 2 3 0 0 {half[0]} {half[1]}\n"
        f"EDGE_SE3:QUAT 0 1 1 0 0.1 0 0 {half[0]} {half[1]} {upper}\n"
    )
    with pytest.raises(FileError, match=r"line 1: found VERTEX_SE3:QUAT, .* planar=True"):
        read_pose_graph(io.StringIO(text))
    graph = read_pose_graph(io.StringIO(text), planar=True)
    assert_allclose(graph.poses, [[1, 2, 0], [2, 2, 0.5]])
    assert_allclose(graph.edges.motions, [[1, 0, 0.5]])
    assert_allclose(np.diag(graph.edges.information[0]), [1, 2, 6 / 4])
    assert graph.dropped[0].rows.size == 3


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        ("VERTEX_SE2 0 0 0\n", 1, "found 4 words; `VERTEX_SE2 id east north heading` was due"),
        ("VERTEX_SE2 0 0 0\n", 1, "5: the line may be cut; complete it, or leave it out"),
        ("VERTEX_SE2 0 0 0 0 1\n", 1, "found 6 words; .*, 5: leave the others out"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0\n", 2, "found 5 words; .*, 12: the line may be cut"),
        ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 0 0 0\n", 2, "the vertex 0 for the second time; leave"),
        (
            "VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n",
            2,
            "the vertex 1, which the file does not have; add its line",
        ),
        ("VERTEX_SE2 0.5 0 0 0\n", 1, "a vertex 0.5; a whole number"),
        ("HELLO\n", 1, "'HELLO'; VERTEX_SE2"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n", 1, "a quaternion"),
        ("", None, "no poses"),
    ],
)
def test_a_malformed_pose_graph(text, line, told):
    with pytest.raises(FileError, match=told) as caught:
        read_pose_graph(io.StringIO(text), planar=True)
    assert caught.value.line == line


def test_a_graph_that_is_no_drive():
    text = "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nVERTEX2 2 1 0 0\nEDGE2 0 2 1 0 0 1 0 1 1 0 0\n"
    graph = read_pose_graph(io.StringIO(text))
    with pytest.raises(EvidenceError, match=r"2 poses have no edge to the next, .* of them 0"):
        graph.recording()


def plaza(**changes):
    tables = {"GT": [[0.0, 0, 0, 0], [1.0, 2, 0, 0]], "DR": [[1.0, 2, 0]], "TL": [[7.0, 5, 0]]}
    return mat(**tables | {"TD": [[0.5, 2, 7, 3.9]]} | changes)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"TL": [[7.5, 5, 0]]}, "TL has beacons that are no whole numbers"),
        ({"TL": [[7.0, 5, 0], [7.0, 5, 0]]}, "TL has a beacon twice"),
        ({"DR": [[np.nan, 2, 0]]}, "the table DR, row 0"),
        ({"DR": [[-1.0, 2, 0]]}, "begin=0.0 is after the first stamp"),
        ({"GT": np.zeros((0, 4))}, "GT"),
    ],
)
def test_plaza_of_other_tables(changes, told):
    with pytest.raises(FileError, match=told):
        read_plaza(plaza(**changes))


def rmse(poses, truth):
    return np.sqrt(np.square(poses.values[:, :2] - truth.values[:, :2]).sum(axis=1).mean())


@pytest.mark.parametrize(
    ("name", "counts", "shift", "due"),
    [("Plaza1_", (9657, 3529), 0.0, 1.935), ("Plaza2_", (4090, 1816), np.pi, 31.65)],
)
def test_plaza_to_the_row(name, counts, shift, due):
    gtsam = pytest.importorskip("gtsam")
    drive = read_plaza(gtsam.findExampleDataFile(f"{name}.mat"))
    heard = drive.sightings["radio"]
    assert (len(drive.odometry), len(heard)) == counts
    assert set(drive.landmarks) == {0, 1, 5, 6} == set(heard.subject.tolist())
    reckoned = drive.dead_reckoning(drive.truth.values[0] + [0.0, 0.0, shift])
    assert rmse(reckoned, drive.truth) == pytest.approx(due, rel=1e-3)
    if name == "Plaza1_":
        fates = {each.fate.split(",")[0]: each for each in drive.dropped}
        assert fates["stamped before the row above"].rows.size == 2
        assert fates["other values for a stamp and subject seen before"].rows.size == 2
        assert np.diff(heard.stamps).max() == pytest.approx(96.78, abs=0.01)
    merged = drive.merged()
    assert set(heard.stamps[heard.stamps > drive.times[0]]) <= set(merged.times)
    again = merged.dead_reckoning(reckoned.values[0], drive.times)
    assert_allclose(again.values, reckoned.values, atol=1e-9)


def test_labyrinth_to_the_row():
    if not (DATA / "labyrinth").is_dir():
        pytest.skip("the Labyrinth recording is not here; PGM_DATA may name its folder's folder")
    drive = read_labyrinth(DATA / "labyrinth")
    sizes = [len(each) for each in (drive.velocities, drive.sightings["uwb"], drive.truth)]
    assert sizes == [233] * 3
    assert not drive.dropped
    reckoned = drive.dead_reckoning([*drive.truth.values[0], np.pi])
    assert rmse(reckoned, drive.truth) == pytest.approx(0.214, abs=5e-4)


def test_freiburg_to_the_row():
    if not (DATA / "freiburg").is_dir():
        pytest.skip("the Freiburg recording is not here; PGM_DATA may name its folder's folder")
    drive = read_freiburg(DATA / "freiburg")
    seen = drive.sightings["landmark"]
    assert (len(drive.odometry), len(seen), len(drive.landmarks)) == (331, 1212, 9)
    assert seen["range"].min() == pytest.approx(0.006, abs=5e-4)
    assert seen["bearing"].min() == pytest.approx(-3.23, abs=5e-3)


def as_bytes(text):
    return text if isinstance(text, bytes) else text.encode()


def mangled(text, rng):
    """A text with one thing wrong, or several."""
    data = bytearray(text)
    at = int(rng.integers(len(data) + 1))
    kind = rng.integers(9)
    words = [b"nan", b"1e999", b"-1e300", b"word", b"\xff\xfe", b"1_0", b"9" * 400, b"\x00", b"#"]
    if kind == 0:
        return bytes(data[:at])
    if kind == 1:
        return bytes(data).replace(b"\n", b"\r\n")
    if kind == 2:
        return rng.bytes(200)
    if kind == 3:
        return b""
    if kind == 4:
        return bytes(data[at:] + data[:at])
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(data) + 1))
        data[at : at + int(rng.integers(3))] = words[rng.integers(len(words))]
    return bytes(data)


READERS = {
    "mrclam": (MRCLAM, "dat", read_mrclam),
    "labyrinth": (LABYRINTH, "txt", read_labyrinth),
    "freiburg": (FREIBURG, "dat", read_freiburg),
    "pose graph": ({"graph": G2O}, "g2o", lambda at: read_pose_graph(at / "graph.g2o")),
    "table": ({"log": CSV}, "csv", lambda at: read_csv(at / "log.csv", COLUMNS)),
    "plaza": ({"p": plaza().getvalue()}, "mat", lambda at: read_plaza(at / "p.mat")),
    "barfoot": ({"b": barfoot().getvalue()}, "mat", lambda at: read_barfoot(at / "b.mat")),
}


@pytest.mark.parametrize("kind", READERS)
def test_mangled_files_are_read_or_refused(kind, tmp_path):
    texts, ending, read = READERS[kind]
    refused = 0
    rng = np.random.default_rng(0)
    for name, text in texts.items():
        (tmp_path / f"{name}.{ending}").write_bytes(as_bytes(text))
    for k in range(70):
        name = list(texts)[k % len(texts)]
        path = tmp_path / f"{name}.{ending}"
        path.write_bytes(mangled(as_bytes(texts[name]), rng))
        try:
            found = read(tmp_path)
            assert repr(found)
            if isinstance(found, Recording) and (found.odometry or found.velocities):
                with np.errstate(all="ignore"):  # of numbers that overflow
                    found.dead_reckoning([0.0, 0.0, 0.0])
        except EvidenceError as error:
            if "cover no time" not in str(error):
                raise
        except FileError as error:
            refused += error.path == str(path)
        path.write_bytes(as_bytes(texts[name]))
    assert refused > 15


@pytest.mark.parametrize("kind", READERS)
def test_missing_files_are_refused(kind, tmp_path):
    with pytest.raises(FileError, match="cannot be read"):
        READERS[kind][2](tmp_path)


@pytest.mark.parametrize("read", [read_mrclam, read_freiburg])
def test_a_folder_that_is_none(read, tmp_path):
    with pytest.raises(FileError, match="is no folder"):
        read(tmp_path / "nowhere")
    with pytest.raises(FileError, match="a folder's path was due"):
        read(7)
    assert issubclass(FileError, pgm.PgmError)
