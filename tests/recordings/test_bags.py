"""Bags of ROS 1 and ROS 2, written here by rosbags: what was put in comes out, in metres."""

from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.errors import EvidenceError, FileError
from pgm.recordings import read_bag
from pgm.recordings.readers.messages import IMPROPER, UNKNOWN

rosbags = pytest.importorskip("rosbags")
from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import Writer as Writer2  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

TYPES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
BEGIN = 1_700_000_000
# Of x, y, z and three turns, each correlated with all others.
POSE_COV = np.diag(np.arange(1.0, 7.0)) + 0.1 * np.outer(np.arange(6.0), np.arange(6.0))
geo = pytest.mark.skipif(find_spec("pymap3d") is None, reason="pip install 'sepset[geo]'")


class Maker:
    """Messages of one kind of ROS."""

    def __init__(self, ros):
        self.ros, self.types = ros, TYPES[ros].types

    def make(self, kind, **values):
        return self.types[kind](**values)

    def header(self, t):
        nanoseconds = round(t * 1e9)
        stamp = self.make(
            "builtin_interfaces/msg/Time",
            sec=BEGIN + nanoseconds // 10**9,
            nanosec=nanoseconds % 10**9,
        )
        more = {"seq": 0} if self.ros == 1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="map", **more)

    def vector(self, x, y, z):
        return self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def pose(self, x, y, yaw):
        return self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", x=x, y=y, z=0.3),
            orientation=self.make(
                "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=np.sin(yaw / 2), w=np.cos(yaw / 2)
            ),
        )

    def twist(self, v, omega):
        return self.make(
            "geometry_msgs/msg/Twist",
            linear=self.vector(v, 0.0, 0.0),
            angular=self.vector(0.0, 0.0, omega),
        )

    def odometry(self, t, x, y, yaw):
        pose = self.make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=self.pose(x, y, yaw),
            covariance=np.zeros(36),
        )
        twist = self.make(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=self.twist(1.5, 0.2),
            covariance=np.zeros(36),
        )
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(t),
            child_frame_id="base",
            pose=pose,
            twist=twist,
        )

    def stamped(self, t, x, y, yaw):
        return self.make(
            "geometry_msgs/msg/PoseStamped", header=self.header(t), pose=self.pose(x, y, yaw)
        )

    def guess(self, t, x, y, yaw):
        pose = self.make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=self.pose(x, y, yaw),
            covariance=POSE_COV.ravel(),
        )
        return self.make(
            "geometry_msgs/msg/PoseWithCovarianceStamped", header=self.header(t), pose=pose
        )

    def imu(self, t, rate):
        quaternion = self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        untold = np.array([-1.0, *np.zeros(8)])
        return self.make(
            "sensor_msgs/msg/Imu",
            header=self.header(t),
            orientation=quaternion,
            orientation_covariance=untold,
            angular_velocity=self.vector(0.0, 0.0, rate),
            angular_velocity_covariance=np.diag([0.1, 0.2, 0.3]).ravel(),
            linear_acceleration=self.vector(0.5, 0.0, 9.8),
            linear_acceleration_covariance=np.zeros(9),
        )

    def fix(self, t, latitude, longitude, status=0):
        return self.make(
            "sensor_msgs/msg/NavSatFix",
            header=self.header(t),
            status=self.make("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=50.0,
            position_covariance=np.diag([1.0, 4.0, 9.0]).ravel(),
            position_covariance_type=2,
        )

    def scan(self, t, ranges):
        return self.make(
            "sensor_msgs/msg/LaserScan",
            header=self.header(t),
            angle_min=-0.5,
            angle_max=0.5,
            angle_increment=0.5,
            time_increment=0.0,
            scan_time=0.0,
            range_min=0.1,
            range_max=10.0,
            ranges=np.array(ranges, dtype=np.float32),
            intensities=np.zeros(0, dtype=np.float32),
        )


def write(path, ros, messages):
    """A bag of (topic, message) in order."""
    store = TYPES[ros]
    with Writer1(path) if ros == 1 else Writer2(path, version=9) as writer:
        connections = {}
        for k, (topic, message) in enumerate(messages):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            code = store.serialize_ros1 if ros == 1 else store.serialize_cdr
            writer.write(connections[topic], 10**9 * BEGIN + k, code(message, kind))
    return path


POSES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.5], [1.0, 2.0, 3.1], [0.0, 2.0, -3.1]])


def drive(ros):
    make = Maker(ros)
    found = []
    for k, pose in enumerate(POSES.tolist()):
        t = 0.5 * k
        found += [
            ("/odom", make.odometry(t, *pose)),
            ("/truth", make.stamped(t + 0.1, *pose)),
            ("/amcl", make.guess(t, *pose)),
            ("/imu", make.imu(t, 0.1 * k)),
            ("/gps", make.fix(t, 48.0 + 1e-5 * k, 9.0, -1 if k == 2 else 0)),
            ("/scan", make.scan(t, [1.0, np.inf, 0.05])),
        ]
    words = make.make("std_msgs/msg/String", data="hello")
    return [*found, ("/chat", words)]


@pytest.fixture(params=[1, 2], ids=["ROS 1", "ROS 2"])
def bag(request, tmp_path):
    path = tmp_path / ("drive.bag" if request.param == 1 else "drive")
    return write(path, request.param, drive(request.param))


@geo
def test_each_message_is_read(bag):
    found = read_bag(bag)
    assert_allclose(found.truth.stamps, BEGIN + 0.1 + 0.5 * np.arange(4))
    assert_allclose(found.truth.values, POSES)
    reckoned = found.dead_reckoning(POSES[0])
    assert_allclose(reckoned.stamps, BEGIN + 0.5 * np.arange(4))
    assert_allclose(reckoned.values[:, :2], POSES[:, :2], atol=1e-12)
    assert_allclose(reckoned["heading"], np.unwrap(POSES[:, 2]))
    guess = found.sightings["/amcl"]
    assert_allclose(guess.values, POSES)
    assert_array_equal(guess.cov[0], POSE_COV[np.ix_([0, 1, 5], [0, 1, 5])])
    assert_allclose(found.imu["rate_z"], 0.1 * np.arange(4))
    assert np.isnan(found.imu["heading"]).all()
    assert_array_equal(found.imu.variances[0, :3], [0.1, 0.2, 0.3])
    assert_array_equal(found.scans["/scan"].ranges[0], [1.0, 10.0, np.nan])
    assert_allclose(found.scans["/scan"].angles, [-0.5, 0.0, 0.5])
    assert len(found.fixes) == 3
    assert_allclose(found.fixes["north"], [0.0, 1.11192, 3.33577], rtol=2e-5)
    assert_array_equal(found.fixes.variances[0], [1.0, 4.0, 9.0])
    told = {each.stream: each.fate for each in found.dropped}
    due = {"fixes": "without a fix", "/chat": "of std_msgs/msg/String"}
    assert told == due


def test_topics_are_the_parts_that_are_asked_for(bag):
    found = read_bag(bag, {"/odom": "velocities", "/amcl": "truth"})
    assert found.odometry is None
    assert_allclose(found.velocities.values, np.tile([1.5, 0.0, 0.2], (4, 1)))
    assert_allclose(found.truth.values, POSES)
    assert not found.sightings
    assert read_bag(bag, ["/truth"]).odometry is None


@pytest.mark.parametrize(
    ("topics", "error", "told"),
    [
        (["/odometry"], FileError, "no topic '/odometry'; it has '/odom'"),
        (["/chat"], FileError, "/chat is of std_msgs/msg/String; known are"),
        ({"/odom": "imu"}, EvidenceError, "'odometry', 'velocities'.*, not 'imu'"),
        ({"/odom": "truth", "/truth": "truth"}, FileError, "would each be truth"),
        ([], EvidenceError, "topics= names topics"),
    ],
)
def test_topics_that_cannot_be(bag, topics, error, told):
    with pytest.raises(error, match=told):
        read_bag(bag, topics)


def test_what_is_no_bag(tmp_path):
    (tmp_path / "a.bag").write_bytes(b"no bag")
    (tmp_path / "b").mkdir()
    for path in (tmp_path / "a.bag", tmp_path / "b", tmp_path / "nowhere"):
        with pytest.raises(FileError, match="cannot be read as a bag") as caught:
            read_bag(path)
        assert caught.value.path == str(path)


@geo
def test_mangled_bags_are_read_or_refused(bag):
    file = bag if bag.is_file() else next(bag.glob("*.db3"))
    whole, rng, refused = file.read_bytes(), np.random.default_rng(0), 0
    for k in range(24):
        data, at = bytearray(whole), int(rng.integers(len(whole)))
        data[at : len(data) if k % 3 else at + 40] = b"" if k % 3 == 1 else rng.bytes(40)
        file.write_bytes(data)
        try:
            read_bag(bag)
        except FileError:
            refused += 1
    assert refused > 8


def test_messages_that_are_no_measurements(tmp_path):
    make = Maker(2)
    bad = make.odometry(1.0, 0.0, 0.0, 0.0)
    bad.pose.pose.orientation.w = 0.5
    with pytest.raises(FileError, match=r"/odom, message 1: .* is no unit quaternion"):
        read_bag(write(tmp_path / "a", 2, [("/odom", make.odometry(0.5, 0, 0, 0)), ("/odom", bad)]))
    bare = [make.odometry(-BEGIN, x, 0, 0) for x in (0, 1)]
    with pytest.raises(FileError, match=r"/odom: headers of messages have no stamps"):
        read_bag(write(tmp_path / "c", 2, [("/odom", each) for each in bare]))
    late = [make.scan(1.0, [1, 1, 1]), make.scan(0.5, [2, 2, 2])]
    found = read_bag(write(tmp_path / "b", 2, [("/scan", each) for each in late]))
    assert_array_equal(found.scans["/scan"].ranges[:, 0], [2.0, 1.0])
    assert found.dropped[0].rows.tolist() == [1]


@geo
def test_fixes_at_null_and_beyond_a_pole(tmp_path):
    make = Maker(2)
    places = [(0.0, 0.0), (48.0, 11.0), (0.0, 0.0), (48.00001, 11.0)]
    bag = write(tmp_path / "a", 2, [("/gps", make.fix(k, *at)) for k, at in enumerate(places)])
    found = read_bag(bag)
    assert_allclose(found.fixes["north"], [0.0, 1.11192], rtol=2e-5)
    (told,) = found.dropped
    assert told.rows.tolist() == [0, 2]
    assert "0°, 0°" in repr(found)
    bag = write(tmp_path / "b", 2, [("/gps", make.fix(0.0, 95.0, 48.0))])
    with pytest.raises(FileError, match=r"latitude 95°, longitude 48°, .*exchanged"):
        read_bag(bag)
    bag = write(tmp_path / "d", 2, [("/gps", make.fix(k, 48.0, 200.0)) for k in range(2)])
    with pytest.raises(FileError, match=r"row 0: .*longitude 200°, .*subtract 360"):
        read_bag(bag)
    bag = write(tmp_path / "c", 2, [("/gps", make.fix(0.0, 0.0, 0.0))])
    assert read_bag(bag).fixes is None


@geo
def test_two_receivers_are_on_one_plane(tmp_path):
    make = Maker(2)
    rows = [("/left", make.fix(0.0, 48.0, 11.0)), ("/right", make.fix(0.1, 48.001, 11.0))]
    bag = write(tmp_path / "a", 2, rows)
    found = read_bag(bag, {"/left": "fixes", "/right": "sightings"})
    assert_allclose(found.fixes.values, 0.0)
    assert_allclose(found.sightings["/right"]["north"], 111.2, rtol=1e-3)


@geo
def test_variances_that_are_all_zero_are_none(tmp_path):
    make = Maker(2)
    fix = make.fix(0.0, 48.0, 11.0)
    fix.position_covariance = np.zeros(9)
    assert read_bag(write(tmp_path / "a", 2, [("/gps", fix)])).fixes.variances is None


@geo
def test_covariances_of_fixes_are_those_of_each_row(tmp_path):
    make = Maker(2)
    fixes = [make.fix(k, 48.0, 11.0 + 1e-5 * k) for k in range(3)]
    fixes[1].position_covariance_type = 0  # its covariance is unknown
    cov = np.array([[1.0, 0.5, 0.2], [0.5, 4.0, -0.3], [0.2, -0.3, 9.0]])
    fixes[2].position_covariance = cov.ravel()  # of east, north and up
    drive = read_bag(write(tmp_path / "a", 2, [("/gps", each) for each in fixes]))
    assert drive.fixes.components == ("east", "north", "up")
    assert_array_equal(drive.fixes.cov[0], np.diag([1.0, 4.0, 9.0]))
    assert_allclose(drive.fixes.cov[2], cov, atol=1e-5)
    assert np.isnan(drive.fixes.cov[1]).all()
    told = [(each.fate, each.rows.tolist(), each.kept) for each in drive.dropped]
    assert told == [(UNKNOWN, [1], True)]


@geo
def test_correlated_fixes_of_a_bag_reach_the_noise(tmp_path):
    make, cov = Maker(2), np.array([[4.0, 1.8], [1.8, 1.0]])
    fixes = [make.fix(k, 48.0, 11.0 + 1e-5 * k) for k in range(2)]
    for fix in fixes:
        fix.position_covariance[[0, 1, 3, 4]] = cov.ravel()
    drive = read_bag(write(tmp_path / "a", 2, [("/gps", each) for each in fixes]))
    x, z = (pgm.Variable(name, components=("east", "north")) for name in "xz")
    r = pgm.Variable("r", components=("east", "east*north", "north"))
    noise = pgm.noise(lambda r: r[..., [[0, 1], [1, 2]]], given=r)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0], 100.0)],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0)],
        observation=[pgm.LinearGaussianCPD(z, {x: 1.0}, cov=noise)],
    )
    log = drive.timeline(drive.fixes.stamps, sensors={z: "fixes"}, variances={z: r})
    found = pgm.filter(model, log.evidence, steps=1)[x]
    # Of a place that does not move, information adds.
    due = np.linalg.inv(np.eye(2) / 100.0 + 2.0 * np.linalg.inv(cov))
    assert_allclose(found.cov[-1], due, rtol=1e-5)
    told = np.linalg.solve(cov, drive.fixes.values[:, :2].sum(axis=0))
    assert_allclose(found.mean[-1], due @ told, atol=1e-6)


@geo
@pytest.mark.parametrize(
    "odd",
    [
        [1.0, 9.0, 0.0, 9.0, 4.0, 0.0, 0.0, 0.0, 9.0],  # indefinite
        [1.0, 0.5, 0.0, 0.1, 4.0, 0.0, 0.0, 0.0, 9.0],  # not symmetric
        [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0],  # as some say that they know nothing
        [1.0, np.nan, 0.0, np.nan, 4.0, 0.0, 0.0, 0.0, 9.0],
    ],
)
def test_covariances_of_a_bag_that_are_none_are_told(tmp_path, odd):
    make = Maker(2)
    fixes = [make.fix(k, 48.0, 11.0, status=-1 if k == 0 else 0) for k in range(3)]
    fixes[2].position_covariance = np.array(odd)
    drive = read_bag(write(tmp_path / "a", 2, [("/gps", each) for each in fixes]))
    told = [(each.fate, each.rows.tolist(), each.kept) for each in drive.dropped]
    assert told == [("without a fix", [0], False), (IMPROPER, [2], True)]
    assert_array_equal(drive.fixes.variances, [[1.0, 4.0, 9.0], [np.nan] * 3])
    z, r = (pgm.Variable(name, components=("east", "north")) for name in "zr")
    with pytest.raises(EvidenceError, match=r"'fixes' has no variances in 1 row \(row 1\)"):
        drive.timeline(drive.fixes.stamps, sensors={z: "fixes"}, variances={z: r})


@geo
def test_a_bags_datum_may_be_given(tmp_path):
    make = Maker(1)
    bag = write(tmp_path / "a.bag", 1, [("/gps", make.fix(0.0, 48.001, 11.0))])
    found = read_bag(bag, datum=(48.0, 11.0, 50.0))
    assert_allclose(found.fixes["north"], 111.2, rtol=1e-3)
    assert found.datum.latitude == 48.0
