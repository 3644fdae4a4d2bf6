"""Trajectories aligned and compared, and files of KITTI and EuRoC in their odd forms."""

import io

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import pgm
from pgm.io.alignment import matched


def walk(count=60, seed=0):
    rng = np.random.default_rng(seed)
    place = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.2, size=(count, 3)), axis=0))
    return pgm.Poses(np.arange(count) * 0.1, place, turns.as_quat())


def moved(poses, turn, shift, scale=1.0, noise=0.0, late=0.0):
    rng = np.random.default_rng(1)
    place = scale * turn.apply(poses.position.copy()) + shift
    place = place + noise * rng.normal(size=place.shape)
    quaternions = (turn * Rotation.from_quat(poses.orientation.copy())).as_quat()
    return pgm.Poses(poses.times + late, place, quaternions)


TURN = Rotation.from_euler("xyz", [0.3, -0.7, 2.0])


def test_a_trajectory_that_was_moved_is_laid_back():
    path = walk()
    for scale in (1.0, 3.0):
        found = moved(path, TURN, [5e5, 6e6, 10], scale, late=0.004).align(path, scale=scale != 1)
        assert_allclose(found.position, path.position, atol=1e-8)
        assert found.ate(path).rotation.max() < 1e-8
    level = Rotation.from_euler("z", 2.0)
    line = pgm.Poses(path.times, np.outer(path.times, [3.0, 4.0, 0.0]), path.orientation)
    turned = moved(line, level, [1.0, 2.0, 3.0])
    assert_allclose(turned.align(line, planar=True).position, line.position, atol=1e-12)
    with pytest.raises(pgm.ModelError, match=r"on one line.*planar=True"):
        turned.align(line)
    still = pgm.Poses(path.times, np.ones((60, 3)), path.orientation)
    with pytest.raises(pgm.ModelError, match="on one place"):
        still.align(line, planar=True)


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("scale", [False, True])
def test_no_other_motion_is_nearer(scale, planar):
    """Of noisy places: squares grow with each small motion from the one that was found."""
    path = walk()
    found = moved(path, TURN, [1, 2, 3], 1.3, noise=0.5).align(path, scale=scale, planar=planar)
    least = np.sum(found.ate(path).translation ** 2)
    rng = np.random.default_rng(2)
    for _ in range(50):
        vector = 1e-3 * rng.normal(size=3) * ([0, 0, 1] if planar else 1)
        size = 1 + 1e-3 * rng.normal() * scale
        shift = 1e-3 * rng.normal(size=3)
        other = moved(found, Rotation.from_rotvec(vector), shift, size)
        assert np.sum(other.ate(path).translation ** 2) > least


def test_mirrored_places_are_no_turn():
    path = walk()
    mirrored = pgm.Poses(path.times, path.position * [1, 1, -1], path.orientation)
    found = mirrored.align(path)
    assert found.ate(path).rmse > 0.1
    angles = (
        Rotation.from_quat(found.orientation.copy())
        * Rotation.from_quat(path.orientation.copy()).inv()
    )
    assert_allclose(angles.as_matrix(), np.tile(angles.as_matrix()[0], (60, 1, 1)), atol=1e-9)


def test_errors_are_those_of_their_definitions():
    path = walk()
    found = moved(path, TURN, [1, 2, 3], noise=0.3)
    matrices = []
    for each in (found, path):
        made = np.tile(np.eye(4), (60, 1, 1))
        made[:, :3, :3] = Rotation.from_quat(each.orientation.copy()).as_matrix()
        made[:, :3, 3] = each.position
        matrices.append(made)
    own, due = matrices
    for step in (1, 7):
        told = found.rpe(path, step=step)
        for k in range(0, 60 - step, 9):
            one, other = (np.linalg.inv(m[k]) @ m[k + step] for m in (own, due))
            apart = np.linalg.inv(other) @ one
            assert_allclose(told.translation[k], np.linalg.norm(apart[:3, 3]), rtol=1e-10)
            angle = np.arccos(np.clip(0.5 * (np.trace(apart[:3, :3]) - 1), -1, 1))
            assert_allclose(told.rotation[k], angle, atol=1e-7)
        assert_array_equal(told.times, found.times[step:])
    errors = found.ate(path)
    lengths = np.linalg.norm(found.position - path.position, axis=1)
    assert_allclose(errors.translation, lengths, rtol=1e-14)
    assert_allclose(errors.rmse, np.sqrt(np.mean(lengths**2)), rtol=1e-14)
    assert (errors.mean, errors.median, errors.max) == pytest.approx(
        (lengths.mean(), np.median(lengths), lengths.max())
    )
    assert_allclose(errors.rotation, TURN.magnitude(), rtol=1e-9)


def test_errors_are_those_of_evo(tmp_path):
    """By evo's own metrics, read from files that were written here."""
    evo = pytest.importorskip("evo.core.metrics")
    from evo.core import sync
    from evo.tools import file_interface

    path = walk()
    found = moved(path, TURN, [1, 2, 3], 1.5, noise=0.3, late=0.003)
    for name, each in (("a", found), ("b", path)):
        pgm.write_tum(tmp_path / name, each)
        pgm.write_kitti(tmp_path / f"{name}.kitti", each, camera=False)
        kitti = file_interface.read_kitti_poses_file(tmp_path / f"{name}.kitti")
        assert_allclose(kitti.positions_xyz, each.position, rtol=1e-14)
    ours, theirs = (file_interface.read_tum_trajectory_file(str(tmp_path / name)) for name in "ab")
    theirs, ours = sync.associate_trajectories(theirs, ours)
    for scale in (False, True):
        aligned = found.align(path, scale=scale)
        turned = file_interface.read_tum_trajectory_file(str(tmp_path / "a"))
        turned.align(theirs, correct_scale=scale)
        assert_allclose(aligned.position, turned.positions_xyz, atol=1e-9)
        metric = evo.APE(evo.PoseRelation.translation_part)
        metric.process_data((theirs, turned))
        assert_allclose(aligned.ate(path).rmse, metric.get_statistic(evo.StatisticsType.rmse))
        for relation, of in (
            (evo.PoseRelation.translation_part, "translation"),
            (evo.PoseRelation.rotation_angle_rad, "rotation"),
        ):
            metric = evo.RPE(relation, 1, evo.Unit.frames, all_pairs=True)
            metric.process_data((theirs, turned))
            assert_allclose(getattr(aligned.rpe(path), of), metric.error, atol=1e-7)


def test_poses_are_matched_by_time():
    rows, others = matched(np.array([0.0, 1.0, 2.0, 5.0]), np.array([0.004, 1.995, 2.001]), 0.01)
    assert rows.tolist() == [0, 2]
    assert others.tolist() == [0, 2]
    rows, others = matched(np.array([1.0, 1.004]), np.array([1.003]), 0.01)  # one pair each
    assert (rows.tolist(), others.tolist()) == ([1], [0])
    path = walk()
    few = pgm.Poses(path.times[::2], path.position[::2], path.orientation[::2])
    told = path.ate(few)
    assert told.unmatched == 30
    assert "30 without one" in repr(told)
    later = pgm.Poses(path.times + 1e6, path.position, path.orientation)
    with pytest.raises(pgm.EvidenceError, match="are their clocks the same"):
        path.ate(later)
    with pytest.raises(pgm.EvidenceError, match="tolerance="):
        path.ate(few, tolerance=-1.0)
    for step in (0, 60, 1.5):
        with pytest.raises(pgm.EvidenceError, match="step= is a number of rows, 1 to 59"):
            path.rpe(path, step=step)
    with pytest.raises(pgm.ModelError, match="a reference is Poses"):
        path.align(path.position)


def test_poses_that_are_none_are_refused():
    """As rows out of order would be paired wrongly, without a word."""
    path = walk()
    fine = {"times": path.times, "position": path.position, "orientation": path.orientation}
    lists = pgm.Poses(**{name: each.tolist() for name, each in fine.items()})
    assert lists.ate(path).rmse == 0.0
    bad = path.position.copy()
    bad[7, 1] = np.nan
    for told, change in (
        ("times= do not increase", {"times": path.times[::-1]}),
        ("no poses", {"times": []}),
        (r"position= has shape \(3, 3\); \(60, 3\) was due", {"position": path.position[:3]}),
        ("position= has no finite numbers in row 7", {"position": bad}),
        ("of length 2; unit quaternions", {"orientation": 2.0 * path.orientation}),
        ("come together", {"components": ("x",)}),
        (r"\(60, 1, 1\) was due", {"components": ("x",), "cov": np.eye(3)}),
    ):
        with pytest.raises(pgm.EvidenceError, match=told):
            pgm.Poses(**{**fine, **change})


def test_covariances_are_told_when_they_are_left_out():
    x = pgm.Variable("x", ("east", "north", "heading"), angles=("heading",))
    belief = pgm.Gaussian(x, [[0, 0, 0], [1, 0, 0], [1, 2, 0]], cov=0.1, steps=range(3))
    path = pgm.Poses.of(belief, times=range(3), position=("east", "north"), heading="heading")
    found = path.align(path, planar=True)
    assert found.cov is None
    assert "before the trajectory was aligned" in repr(found)
    with pytest.raises(pgm.ModelError, match="no covariances to write"):
        pgm.write_tum(io.StringIO(), found, covariance=io.StringIO())
    with pytest.raises(pgm.ModelError, match="of their own"):
        pgm.write_tum(io.StringIO(), found, times=range(3))
    with pytest.raises(pgm.ModelError, match="times=, position= and heading="):
        pgm.write_tum(io.StringIO(), belief, times=range(3), position=("east", "north"))


KITTI = "1 0 0 {x} 0 1 0 {y} 0 0 1 {z}\n"


def test_kittis_camera_is_seen_from_above():
    """It drives ahead (z), then right (x): forward, then to the right, which is minus left."""
    right = "0 0 1 1.5 0 1 0 0 -1 0 0 4\n"  # turned right by a quarter, looking along x
    text = KITTI.format(x="0", y="0", z="0.000000e+00") + KITTI.format(x=0, y=0, z="4e0") + right
    found = pgm.read_kitti(io.StringIO(text), io.StringIO("0\n1.036e-01\n2.07e-01\n"), camera=True)
    assert_allclose(found.planar, [[0, 0, 0], [4, 0, 0], [4, -1.5, -np.pi / 2]], atol=1e-12)
    assert_allclose(found.times, [0.0, 0.1036, 0.207])
    raw = pgm.read_kitti(io.StringIO(text), np.arange(3.0), camera=False)
    assert_array_equal(raw.position[2], [1.5, 0.0, 4.0])


@pytest.mark.parametrize("camera", [False, True])
def test_kittis_files_come_back(camera):
    path, file, times = walk(), io.StringIO(), io.StringIO()
    pgm.write_kitti(file, path, camera=camera, times=times)
    file.seek(0), times.seek(0)
    found = pgm.read_kitti(file, times, camera=camera)
    assert_allclose(found.position, path.position, rtol=1e-15)
    assert_array_equal(found.times, path.times)
    assert found.ate(path).rotation.max() < 1e-7


def test_kittis_files_that_are_none():
    one = KITTI.format(x=0, y=0, z=0)
    for text, times, said in (
        ("", [], "no poses"),
        (one + "1 2 3\n", [0, 1], "line 2"),
        (one + "2" + one[1:], [0, 1], "pose 1: its matrix .* is no rotation"),
        ("-" + one, [0], "is no rotation"),
        (one, [0, 1], "2 times for 1 pose"),
        (one, io.StringIO("1403715524907143168"), "nanoseconds"),
    ):
        with pytest.raises(pgm.FileError, match=said):
            pgm.read_kitti(io.StringIO(text), times, camera=True)
    with pytest.raises(pgm.EvidenceError, match="camera= is True"):
        pgm.read_kitti(io.StringIO(one), [0], camera=1)
    told = pgm.read_kitti(io.StringIO(2 * one), [1.0, 0.0], camera=True).dropped
    assert "put in order" in repr(told)
    with pytest.raises(pgm.ModelError, match="Poses were due"):
        pgm.write_kitti(io.StringIO(), np.eye(4), camera=True)


NAMES = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], ...\r\n"


def test_euroc_in_its_odd_forms():
    lines = [
        "1403715524907143168,4.6,-1.7,0.8,0.5,0.5,0.5,0.5,0.1,0.2,0.3,0,0,0,0,0,0\r\n",
        " 1403715524912143104 , 4.7,-1.8,0.9, 1,0,0,0\r\n",
        "\r\n",
        "1403715524912143104,4.8,-1.8,0.9,1,0,0,0\r\n",
        "1.403715524917143e+18,4.9,-1.8,0.9,1,0,0,0\r\n",
    ]
    found = pgm.read_euroc(io.StringIO(NAMES + "".join(lines)))
    assert_allclose(found.position[:, 0], [4.6, 4.7, 4.9])
    assert_array_equal(found.orientation[0], 0.5)
    assert_allclose(found.times - 1403715524.0, [0.907143168, 0.912143104, 0.917143], atol=3e-7)
    (told,) = found.dropped
    assert told.rows.tolist() == [2]
    assert pgm.read_euroc(io.StringIO(lines[0])).times.size == 1  # without names


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (NAMES, "no poses"),
        ("1403715524907143168,1,2,3\n", "line 1: it has 4 numbers"),
        ("1403715524.9,1,2,3,1,0,0,0\n", "whole nanoseconds were due"),
        ("1403715524,1,2,3,1,0,0,0\n1403715525,1,2,3,1,0,0,0\n", "poses are 1 ns apart"),
        ("1403715524907143168,1,2,3,0,0,0,0\n", "length 0, .* w first"),
        ("#t,x,y,z,q_x,q_y,q_z,q_w\n1,1,2,3,0,0,0,1\n", "line 1: its quaternion is q_x"),
        ("1403715524907143168,1,2,up,1,0,0,0\n", "'up' is no number"),
        ("\u00b2,1,2,3,1,0,0,0\n", "is no number"),
        (f"{'9' * 400},1,2,3,1,0,0,0\n", "is not finite"),
    ],
)
def test_euroc_files_that_are_none(text, said):
    with pytest.raises(pgm.FileError, match=said):
        pgm.read_euroc(io.StringIO(text))


def test_values_of_a_state_along_its_steps():
    """In its units, at the nearest poses; NaN where there is none, and in other components."""
    km = pgm.Variable(
        "x",
        components=("speed", "east", "north", "up", "yaw", "roll"),
        units=("m/s", "km", "km", "km", "rad", "rad"),
        angles=("yaw", "roll"),
    )
    path = walk(5)
    names = {"position": ("east", "north", "up"), "heading": "yaw", "roll": "roll"}
    found = path.along(km, times=[-1.0, 0.1, 0.205, 0.26], **names)
    assert np.isnan(found[:, 0]).all()
    assert np.isnan(found[[0, 3]]).all()
    assert_allclose(found[1:3, 1:4], path.position[1:3] / 1000.0)
    turned = Rotation.from_quat(path.orientation[1:3]).as_euler("ZYX")
    assert_allclose(found[1:3, 4:], turned[:, [0, 2]], atol=1e-12)
    near = path.along(km, times=[0.26], tolerance=0.05, **names)
    assert_allclose(near[0, 1:4], path.position[3] / 1000.0)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"position": ("east", "place")}, "has no component 'place'"),
        ({"heading": "east"}, "named twice"),
        ({"heading": "north", "position": ("east", "speed")}, "speed.*no position"),
        ({"heading": "north", "position": ("east", "up")}, "'north' of .* is no angle"),
        ({"position": "east"}, "position= names two components or three"),
        ({"times": [100.0]}, "no pose of"),
        ({"times": [1.0, 0.0]}, "do not increase"),
    ],
)
def test_values_that_cannot_be_found_are_refused(given, told):
    flat = pgm.Variable(
        "x", components=("east", "north", "up", "speed"), units=("m", "m", "m", "m/s")
    )
    asked = {"times": [0.1], "position": ("east", "north"), "heading": None} | given
    with pytest.raises((pgm.ModelError, pgm.EvidenceError), match=told):
        walk(5).along(flat, **asked)


def test_only_variables_have_values_along_poses():
    with pytest.raises(pgm.ModelError, match="along takes a state, a pgm\\.Variable, not 'x'"):
        walk(5).along("x", times=[0.1], position=("east", "north"), heading=None)
