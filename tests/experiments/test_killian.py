"""The Killian Court recording: what is read, and what is refused."""

import zipfile

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments import packaged
from experiments.killian import log as killian
from pgm.errors import FileError

BEHIND = "0 1.96 37.8 -2.0 1.96 37.8 -2.0 0.0 0.0 0.0 0.0 0.0 1031745824.6 iB21 606.8"
SETTING = "ROBOTLASER1 0 -1.5 3.0 1.5 50.0 0.1 0 3"


def scan(*ranges, setting=SETTING):
    return f"{setting} {' '.join(map(str, ranges))} {BEHIND}"


LINES = [
    "VERTEX_SE2 0 1.96 37.8 -2.0",
    scan(1.25, 50.0, 51.2),
    "VERTEX_SE2 1 1.7 37.3 -2.01",
    scan(0.0, 2.5, 49.9),
    "#SEQUENTIAL EDGES",
    "EDGE_SE2 0 1 0.57 0.01 0.005 500 1 2 600 3 5000",
    "",
    "EDGE_SE2 1 0 -0.57 0.0 0.0 1 0 0 2 0 3",
]


def written(folder, lines):
    path = folder / "small.g2o"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_recording_is_read(tmp_path):
    found = killian.load(written(tmp_path, LINES))
    assert found.poses.tolist() == [[1.96, 37.8, -2.0], [1.7, 37.3, -2.01]]
    assert found.scans.tolist() == [[1.25, 50.0, 50.0], [0.0, 2.5, 49.9]]
    assert found.most == 50.0
    assert_allclose(found.angles, [-1.5, 0.0, 1.5])
    assert found.edges.first.tolist() == [0, 1]
    assert found.edges.second.tolist() == [1, 0]
    assert found.edges.motions.tolist() == [[0.57, 0.01, 0.005], [-0.57, 0.0, 0.0]]
    assert found.edges.information.tolist() == [
        [[500, 1, 2], [1, 600, 3], [2, 3, 5000]],
        [[1, 0, 0], [0, 2, 0], [0, 0, 3]],
    ]


def test_a_recording_without_edges_is_one(tmp_path):
    found = killian.load(written(tmp_path, LINES[:2]))
    assert found.edges.motions.shape == (0, 3)
    assert found.edges.information.shape == (0, 3, 3)


def zipped(folder, *names):
    path = folder / "small.g2o.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, "\n".join(LINES))
    return path


def test_a_zipped_recording_is_read(tmp_path):
    found = killian.load(zipped(tmp_path, "small.g2o", "__MACOSX/", "__MACOSX/._small.g2o"))
    assert found.poses.shape == (2, 3)


@pytest.mark.parametrize(
    ("place", "line", "told"),
    [
        (0, "VERTEX_SE2 0 1 2", r"found 4 words; `VERTEX_SE2 id east north heading` was due"),
        (0, "VERTEX_SE2 0 1 nan 2", "'nan'; .*, in finite numbers, was due"),
        (0, "VERTEX_SE2 0 1 x 2", "in finite numbers"),
        (2, "VERTEX_SE2 0 1 2 3", "found the vertex 0 for the second time"),
        (0, LINES[1], "found a scan before its pose"),
        (2, LINES[1], "found a scan before its pose"),
        (1, "ROBOTLASER1 0 -1.5 3.0", "found 4 words; `ROBOTLASER1 type start"),
        (1, scan(1, 2), "found 26 words; 27, of 3 ranges, were due"),
        (1, scan(1, 2, 3, setting=SETTING + " 4"), "found 28 words; 27, of 3 ranges, were due"),
        (1, scan(1, "two", 3), "'two'; 3 ranges, in finite numbers"),
        (1, scan(1, -2, 3), "found a range of -2 m; 0 or more was due"),
        (1, scan(setting=SETTING[:-1] + "0"), "positive steps, ranges and counts were due"),
        (1, scan(setting=SETTING[:-1] + "1.5"), "positive steps, ranges and counts were due"),
        (3, scan(1, 2, 3, setting=SETTING.replace("50.0", "30.0")), "as before, was due"),
        (5, "EDGE_SE2 0 1 2 3 4", "found 6 words; `EDGE_SE2 from to"),
        (5, "EDGE_SE2 0 2 1 0 0 1 0 0 1 0 1", "the vertex 2, which the file does not have"),
        (5, "EDGE_SE2 0.5 1 1 0 0 1 0 0 1 0 1", r"a vertex 0\.5; a whole number"),
        (5, "EDGE_SE3 0 1", "'EDGE_SE3'; VERTEX_SE2, VERTEX2, EDGE_SE2"),
    ],
)
def test_a_malformed_line_is_named(place, line, told, tmp_path):
    path = written(tmp_path, [*LINES[:place], line, *LINES[place + 1 :]])
    with pytest.raises(FileError, match=told) as caught:
        killian.load(path)
    assert (caught.value.path, caught.value.line) == (str(path), place + 1)
    assert str(caught.value).startswith(f"{path}, line {place + 1}: ")


def test_files_that_are_not_recordings(tmp_path):
    for lines, told in (
        (["#"], "no poses"),
        (LINES[:1], "no scans"),
        (LINES[:3], "the pose 1 has no scan"),
    ):
        with pytest.raises(FileError, match=told):
            killian.load(written(tmp_path, lines))
    (tmp_path / "broken.zip").write_bytes(b"PK no archive")
    (tmp_path / "bytes.g2o").write_bytes(b"VERTEX_SE2 \xff")
    for path, told in (
        (tmp_path / "nowhere.g2o", "cannot be read"),
        (tmp_path / "broken.zip", "'PK'; VERTEX_SE2"),
        (tmp_path / "bytes.g2o", "0xff is no UTF-8"),
        (zipped(tmp_path, "one.g2o", "two.g2o"), r"as a \.zip of one file"),
        (zipped(tmp_path, "__MACOSX/one.g2o"), r"as a \.zip of one file"),
    ):
        with pytest.raises(FileError, match=told):
            killian.load(path)


def test_a_recording_that_is_not_installed_is_told(monkeypatch):
    monkeypatch.setattr(packaged.importlib.util, "find_spec", lambda name: None)
    assert killian.find() is None
    with pytest.raises(FileError, match=r"Killian Court.*pip install 'rtb-data>=2\.0'"):
        killian.load()


@pytest.fixture(scope="module")
def recorded():
    if killian.find() is None:
        pytest.skip("the recording comes with rtb-data, which is not installed")
    return killian.load()


def test_the_recording_has_its_poses_scans_and_edges(recorded):
    assert recorded.poses.shape == (3873, 3)
    assert recorded.scans.shape == (3873, 180)
    assert recorded.angles.shape == (180,)
    assert np.abs(recorded.poses[:, 2]).max() <= np.pi
    assert_allclose(recorded.angles, np.radians(np.arange(-90, 90)), atol=1e-4)
    assert recorded.scans.max() == recorded.most == 50.0
    assert recorded.poses[0].tolist() == [1.96, 37.867, -2.01239]
    assert recorded.scans[0, :3].tolist() == [1.27, 1.32, 1.32]
    edges = recorded.edges
    assert edges.motions.shape == (4987, 3)
    assert (edges.second - edges.first == 1).sum() == 3872
    assert (np.linalg.eigvalsh(edges.information) > 0.0).all()


def test_edges_are_seen_from_the_first_pose(recorded):
    """Every motion of the drive is nearly that between its poses, turned into the first's frame."""
    edges = recorded.edges
    one, other = recorded.poses[edges.first], recorded.poses[edges.second]
    apart = other - one
    c, s = np.cos(one[:, 2]), np.sin(one[:, 2])
    ahead = c * apart[:, 0] + s * apart[:, 1]
    left = c * apart[:, 1] - s * apart[:, 0]
    steady = edges.second - edges.first == 1
    assert np.median(np.abs(ahead - edges.motions[:, 0])[steady]) < 0.01
    assert np.median(np.abs(left - edges.motions[:, 1])[steady]) < 0.01


def test_angles_go_to_the_left(recorded):
    """Points seen from a pose and from the next lie on the same walls; mirrored they do not."""

    def points(number, sign):
        east, north, heading = recorded.poses[number]
        ranges = recorded.scans[number]
        near = ranges < 8.0
        course = heading + sign * recorded.angles[near]
        return np.stack(
            [east + ranges[near] * np.cos(course), north + ranges[near] * np.sin(course)]
        )

    def distance(sign):
        found = []
        for number in range(0, 3870, 90):
            one, other = points(number, sign), points(number + 1, sign)
            apart = np.linalg.norm(one[:, :, None] - other[:, None], axis=0)
            found.append(np.median(apart.min(axis=1)))
        return np.median(found)

    assert distance(1.0) < 0.7 * distance(-1.0)
