"""Trajectories to and from files of the TUM format, and their covariances."""

import csv
import gzip
import io

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import pgm

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
s = pgm.Variable(
    "s", components=("roll", "pitch", "yaw", "x", "y", "z"), angles=("roll", "pitch", "yaw")
)
RNG = np.random.default_rng(0)
N = 50
TIMES = 1.3e9 + np.cumsum(RNG.uniform(0.01, 0.1, N))
PLANAR = {"position": ("east", "north"), "heading": "heading"}


def covariances(size):
    root = RNG.normal(size=(N, size, size))
    return root @ root.swapaxes(-1, -2)


def planar():
    mean = np.column_stack([RNG.normal(scale=100, size=(N, 2)), np.linspace(-9, 9, N)])
    return pgm.Gaussian(x, mean, covariances(3), steps=range(N))


def test_a_robot_in_the_plane_comes_back(tmp_path):
    belief, poses, beside = planar(), tmp_path / "run.tum", tmp_path / "run.csv"
    pgm.write_tum(poses, belief, times=TIMES, covariance=beside, **PLANAR)
    found = pgm.read_tum(poses, beside)
    assert_array_equal(found.times, TIMES)
    assert_array_equal(found.planar[:, :2], belief.mean[:, :2])
    assert_allclose(found.planar[:, 2], belief.wrapped().mean[:, 2], atol=1e-15)
    assert_array_equal(found.cov, belief.cov)
    assert found.components == ("east", "north", "heading")
    again = pgm.Gaussian(x, found.planar, found.cov, steps=range(N))
    assert_allclose(again.kl(belief), 0.0, atol=1e-9)


def test_a_second_writing_is_the_first(tmp_path):
    """Digits that were printed are digits that are read."""
    pgm.write_tum(tmp_path / "a", planar(), times=TIMES, **PLANAR)
    first = pgm.read_tum(tmp_path / "a")
    again = pgm.Gaussian(x, first.planar, 1.0, steps=range(N))
    pgm.write_tum(tmp_path / "b", again, times=first.times, **PLANAR)
    second = pgm.read_tum(tmp_path / "b")
    assert_array_equal(first.position, second.position)
    assert_array_equal(first.times, second.times)
    assert_allclose(first.orientation, second.orientation, atol=1e-15)
    lines = (tmp_path / "a").read_text().splitlines()[1:]
    numbers = np.array([line.split(" ") for line in lines], dtype=float)
    assert_array_equal(numbers[:, 4:], first.orientation)


def test_a_body_in_space(tmp_path):
    angles = RNG.uniform(-1, 1, (N, 3)) * [np.pi, 1.5, np.pi]
    belief = pgm.Gaussian(
        s, np.hstack([angles, RNG.normal(size=(N, 3))]), covariances(6), steps=range(N)
    )
    pgm.write_tum(
        tmp_path / "run.tum.gz",
        belief,
        times=TIMES,
        position=("x", "y", "z"),
        heading="yaw",
        pitch="pitch",
        roll="roll",
        covariance=tmp_path / "run.csv",
    )
    assert gzip.decompress((tmp_path / "run.tum.gz").read_bytes()).startswith(b"# timestamp")
    found = pgm.read_tum(tmp_path / "run.tum.gz", tmp_path / "run.csv")
    assert_array_equal(found.position, belief.mean[:, 3:])
    assert_allclose(found.angles, angles, atol=1e-12)
    due = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    assert_allclose(Rotation.from_quat(found.orientation).as_matrix(), due, atol=1e-14)
    order = [3, 4, 5, 0, 1, 2]
    assert found.components == ("x", "y", "z", "roll", "pitch", "yaw")
    assert_array_equal(found.cov, belief.cov[:, order][:, :, order])


def read_as_evo_does(text):
    """Rows as by its reader: single spaces, comments by their first letter, eight columns."""
    lines = (line for line in io.StringIO(text) if not line.startswith("#"))
    return np.array(list(csv.reader(lines, delimiter=" "))).astype(float)


def test_other_tools_read_the_file():
    file = io.StringIO()
    belief = planar()
    pgm.write_tum(file, belief, times=TIMES, **PLANAR)
    table = read_as_evo_does(file.getvalue())
    assert table.shape == (N, 8)
    assert_array_equal(table[:, 1:3], belief.mean[:, :2])
    turned = Rotation.from_quat(table[:, 4:]).apply([1.0, 0.0, 0.0])
    heading = belief.mean[:, 2]
    due = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(N)])
    assert_allclose(turned, due, atol=1e-14)


def test_a_file_as_the_benchmark_publishes_them():
    text = (
        "# ground truth trajectory\n"
        "# file: 'rgbd_dataset_freiburg1_xyz.bag'\n"
        "# timestamp tx ty tz qx qy qz qw\n"
        "1305031098.6659 1.3563 0.6305 1.6380 0.6132 0.5962 -0.3311 -0.3986\n"
        "1305031098.6758 1.3543 0.6306 1.6360 0.6129 0.5966 -0.3316 -0.3980\r\n"
        "\n"
        "1305031098.6858\t1.3525  0.6309 1.6380 0.6129 0.5968 -0.3310 -0.3982"
    )
    for source in (io.StringIO(text), io.BytesIO(text.encode())):
        found = pgm.read_tum(source)
        assert (
            repr(found).splitlines()[0]
            == "Poses(3 of them, 1305031098.6659 s to 1305031098.6858 s)"
        )
        assert_allclose(np.linalg.norm(found.orientation, axis=1), 1.0, rtol=1e-14)
        assert_allclose(found.orientation[0], [0.6132, 0.5962, -0.3311, -0.3986], atol=1e-4)
        assert found.cov is None
        assert found.components == ()


def test_a_body_without_orientation(tmp_path):
    y = pgm.Variable("y", components=("east", "north"))
    belief = pgm.Gaussian(y, np.ones((3, 2)), [1.0, 2.0], steps=range(3))
    pgm.write_tum(tmp_path / "p", belief, times=[0, 1, 2], position=("east", "north"), heading=None)
    assert_array_equal(pgm.read_tum(tmp_path / "p").orientation, [[0, 0, 0, 1]] * 3)


def test_point_masses_are_written_by_their_moments(tmp_path):
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(v, 0.0, 1.0) for v in (a, b)],
        transition=[pgm.LinearGaussianCPD(v, given={v.previous: 1.0}, cov=0.1) for v in (a, b)],
    )
    found = pgm.filter(model, {}, steps=2, belief=pgm.Particles(500, seed=0)).joint(a, b)
    options = {"times": [0, 1, 2], "position": ("a", "b"), "heading": None}
    pgm.write_tum(tmp_path / "p", found, covariance=tmp_path / "c", **options)
    back = pgm.read_tum(tmp_path / "p", tmp_path / "c")
    assert_array_equal(back.position[:, :2], found.mean)
    assert_allclose(back.cov, found.cov, rtol=1e-15)


def test_names_may_be_any(tmp_path):
    odd = pgm.Variable("odd", components=('a*b, "c"', "d*a"))
    belief = pgm.Gaussian(odd, np.zeros((2, 2)), [[2.0, 0.5], [0.5, 1.0]], steps=range(2))
    pgm.write_tum(
        tmp_path / "p",
        belief,
        times=[0, 1],
        position=odd.components,
        heading=None,
        covariance=tmp_path / "c",
    )
    found = pgm.read_tum(tmp_path / "p", tmp_path / "c")
    assert found.components == odd.components
    assert_array_equal(found.cov, belief.cov)


GOOD = "0.0 1 2 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        ("", None, "it has no poses"),
        ("# only words\n", None, "it has no poses"),
        (GOOD + "1.0 1 2 0 0 0 1\n", 2, r"it has 7 numbers, where t x y z .* 8 of them"),
        (GOOD + "\n1.0,1,2,0,0,0,0,1\n", 3, "it has 1 numbers.*not by commas"),
        (GOOD + "1.0 1 2 0 0 0 zero 1\n", 2, "'zero' is no number"),
        (GOOD + "1.0 1 2_0 0 0 0 0 1\n", 2, "'2_0' is no number"),
        (GOOD + "1.0 1 nan 0 0 0 0 1\n", 2, "'nan' is not finite"),
        (GOOD + "inf 1 2 0 0 0 0 1\n", 2, "'inf' is not finite"),
        ("1403715524907143168 1 2 0 0 0 0 1\n", None, "seem to be nanoseconds"),
        (GOOD + "1.0 1 2 0 0 0 0 0\n", 2, "have the length 0, and were to be a unit"),
        (GOOD + "1.0 1 2 0 0 0 0 1e300\n", 2, "have the length inf"),
        (GOOD + "1.0 1 2 0 0 0 1 1\n", 2, r"have the length 1.41421.*w last"),
    ],
)
def test_malformed_poses(text, line, told, tmp_path):
    path = tmp_path / "broken.tum"
    path.write_text(text)
    with pytest.raises(pgm.FileError, match=told) as caught:
        pgm.read_tum(path)
    assert caught.value.path == str(path)
    assert caught.value.line == line
    assert "broken.tum" in str(caught.value)


HEAD = "t,east*east,east*north,north*north\n"


def test_stamps_that_repeat_or_go_back(tmp_path):
    """Of two poses of one stamp the first is taken, and poses come in order of time; both told."""
    path, beside = tmp_path / "a.tum", tmp_path / "a.csv"
    rows = [(0.0, 1), (0.2, 3), (0.2, 4), (0.1, 2), (0.3, 5), (0.2, 6)]
    path.write_text("".join(f"{t} {x} 0 0 0 0 0 1\r\n" for t, x in rows))
    beside.write_text("t,east*east\n" + "".join(f"{t},{x / 10}\n" for t, x in rows))
    poses = pgm.read_tum(path, beside)
    assert_array_equal(poses.times, [0.0, 0.1, 0.2, 0.3])
    assert_array_equal(poses.position[:, 0], [1, 2, 3, 5])
    assert_array_equal(poses.cov[:, 0, 0], [0.1, 0.2, 0.3, 0.5])
    back, again = poses.dropped
    assert (back.rows.tolist(), back.kept) == ([3, 5], True)
    assert (again.rows.tolist(), again.kept) == ([2, 5], False)
    assert "2 dropped: of a stamp seen before (rows 2, 5)" in repr(poses)
    drive = pgm.Recording(truth=poses)
    assert {each.stream for each in drive.dropped} == {"truth"}
    assert "of a stamp seen before" in repr(drive)


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        ("", 1, "the first line is to name the columns"),
        ("0.0,1,0,1\n", 1, r"the first line is to name the columns.*found '0.0,1,0,1'"),
        ("t,east*east,east*north\n", 1, "the first line is to name the columns"),
        ("time,east*east\n", 1, "the first line is to name the columns"),
        (HEAD + "0.0,1,0\n", 2, "it has 3 numbers, where the first line names 4"),
        (HEAD + "0.0,1,x,1\n", 2, "'x' is no number"),
        (HEAD + "0.0,inf,0,1\n", 2, "'inf' is not finite"),
        (HEAD + "0.0,1,0,1\n", None, "it has 1 covariances, where the poses are 2"),
        (HEAD + "0.0,1,0,1\n0.5,1,0,1\n", 3, "t = 0.5, where the pose is of t = 1.0"),
        (HEAD + "0.0,1,0,1\n1.0,1,2,1\n", 3, "the covariance of east, north is indefinite"),
        (HEAD + "0.0,1,0,1\n\n1.0,-1,0,1\n", 4, "east, north has the negative variance -1"),
        (HEAD + '0.0,1,0,"' + "1" * 200_000, 2, "it is no table of values"),
    ],
)
def test_malformed_covariances(text, line, told, tmp_path):
    path = tmp_path / "beside.csv"
    path.write_text(text)
    with pytest.raises(pgm.FileError, match=told) as caught:
        pgm.read_tum(io.StringIO(GOOD + "1.0 1 2 0 0 0 0 1\n"), path)
    assert caught.value.path == str(path)
    assert caught.value.line == line


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        pgm.read_tum(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("changed", "error", "told"),
    [
        ({"times": TIMES[:-1]}, pgm.EvidenceError, "times= has 49 of them, and the belief 50"),
        ({"times": TIMES[::-1]}, pgm.EvidenceError, "times= do not increase: .* in row 1"),
        ({"times": np.full(N, 3.0)}, pgm.EvidenceError, "times= do not increase: 3 s in row 1"),
        ({"times": np.r_[TIMES[:-1], np.nan]}, pgm.EvidenceError, "row 49: not a finite time"),
        ({"times": TIMES * 1e9}, pgm.EvidenceError, "they seem to be nanoseconds"),
        ({"position": ("east",)}, pgm.ModelError, "position= names two components or three"),
        ({"position": "east"}, pgm.ModelError, "position= names two components or three"),
        ({"position": {"east", "north"}}, pgm.ModelError, "position= names two"),
        ({"position": ("east", "up")}, pgm.ModelError, "has no component 'up'"),
        ({"position": ("east", "east")}, pgm.ModelError, "'east' is named twice"),
        ({"heading": "bearing"}, pgm.ModelError, "has no component 'bearing'; it has 'east'"),
        (
            {"position": ("east", "heading"), "heading": "north"},
            pgm.ModelError,
            "'north' of .* is no angle; declare it",
        ),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_written(changed, error, told, tmp_path):
    path = tmp_path / "p"
    with pytest.raises(error, match=told):
        pgm.write_tum(path, planar(), **{"times": TIMES, **PLANAR, **changed})
    assert not path.exists()


def test_runs_and_other_things_are_refused(tmp_path):
    many = pgm.Gaussian(x, np.zeros((2, 5, 3)), 1.0, steps=range(5))
    with pytest.raises(pgm.ModelError, match=r"leading axes \(2, 5\); .* belief\.run\(0\)"):
        pgm.write_tum(tmp_path / "p", many, times=np.arange(5), **PLANAR)
    with pytest.raises(pgm.ModelError, match="a belief over time, like"):
        pgm.write_tum(tmp_path / "p", np.zeros((5, 3)), times=np.arange(5), **PLANAR)


def test_infinite_variances_have_no_file(tmp_path):
    z = pgm.Variable("z", components=("east", "north"))
    y = pgm.Variable("y", components=("east", "north"))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(y, [0.0, 0.0], cov=np.inf)],
        transition=[pgm.LinearGaussianCPD(y, given={y.previous: 1.0}, cov=0.1)],
        observation=[pgm.LinearGaussianCPD(z, given={y: 1.0}, cov=0.1)],
    )
    belief = pgm.filter(model, {z: pgm.sightings([[1.0, 2.0]], step=[1])}, steps=2)[y]
    options = {"position": ("east", "north"), "heading": None, "covariance": tmp_path / "c"}
    with pytest.raises(pgm.ModelError, match=r"infinite variance in row 0: .* belief\[k:\]"):
        pgm.write_tum(tmp_path / "p", belief, times=[0, 1, 2], **options)
    with pytest.raises(pgm.ModelError, match="infinite variance in row 0"):
        pgm.write_tum(tmp_path / "p", belief, times=[0, 1, 2], **options | {"covariance": None})
    pgm.write_tum(tmp_path / "p", belief[1:], times=[1, 2], **options)
    assert len(pgm.read_tum(tmp_path / "p", tmp_path / "c").times) == 2


def test_poses_and_covariances_are_two_files(tmp_path):
    path = tmp_path / "p"
    for other in (path, str(path), tmp_path / "." / "p"):
        with pytest.raises(pgm.ModelError, match="covariance= is the file of the poses"):
            pgm.write_tum(path, planar(), times=TIMES, covariance=other, **PLANAR)
    file = io.StringIO()
    with pytest.raises(pgm.ModelError, match="need one of their own"):
        pgm.write_tum(file, planar(), times=TIMES, covariance=file, **PLANAR)
    assert not path.exists()
    assert not file.getvalue()
