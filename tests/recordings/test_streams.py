"""Rows of a recording: none lost or moved without a word, and each error that names its cause."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.errors import ArrayError, EvidenceError
from pgm.recordings import Recording, Scans, Stream
from pgm.recordings.drives import mending

u = pgm.Variable("u", components=("distance", "turn", "dt"))
exact = pgm.Variable("w", components=("forward", "left", "turn"))
speed = pgm.Variable("v", components=("v", "omega"))
z = pgm.Variable("z", components=("bearing", "range"), angles=("bearing",))
m = pgm.Variable("m", components=("east", "north"))
ARC = ("distance", "turn")
POSE = ("east", "north", "heading")


def odometry(stamps=(1.0, 2.0, 3.0), begin=0.0):
    rows = np.column_stack([np.arange(1.0, len(stamps) + 1), np.full(len(stamps), 0.3)])
    return Stream(stamps, rows, ARC, begin=begin)


def heard(stamps, values=None, subject=None):
    values = np.arange(1.0, len(stamps) + 1) if values is None else values
    return Stream(stamps, values, ("range",), subject=subject)


def fates(recording):
    return [(each.stream, each.fate.split()[0], each.rows.tolist()) for each in recording.dropped]


def test_rows_are_put_in_order_and_doubles_left_out():
    nan = np.nan
    stream = heard([3.0, 1.0, 1.0, 2.0, 2.0, 4.0], [3, 1, 1, 2, 9, nan], subject=[1, 1, 1, 1, 1, 1])
    drive = Recording(odometry=odometry(), sightings={"radio": stream})
    kept = drive.sightings["radio"]
    assert_array_equal(kept.stamps, [1.0, 2.0, 2.0, 3.0])
    assert_array_equal(kept["range"], [1.0, 2.0, 9.0, 3.0])
    assert fates(drive) == [
        ("radio", "NaN,", [5]),
        ("radio", "equal", [2]),
        ("radio", "other", [4]),
        ("radio", "stamped", [1]),
    ]
    assert fates(drive.between(0.5, 2.5)) == fates(drive.replace(name="again")) == fates(drive)


def test_readings_of_different_subjects_are_no_doubles():
    drive = Recording(sightings={"radio": heard([1.0] * 3, [1, 1, 1], subject=[1, "a", None])})
    assert not drive.dropped
    assert drive.sightings["radio"].subject.tolist() == [1, "a", None]


def test_the_truth_has_one_row_a_stamp():
    rows = [[0, 0, 3], [1, 0, -3], [5, 5, 5], [1, 0, -3]]
    drive = Recording(truth=Stream([0.0, 1.0, 1.0, 1.0], rows, POSE))
    assert len(drive.truth) == 2
    assert [(fate, rows) for _, fate, rows in fates(drive)] == [("equal", [3]), ("other", [2])]
    assert_allclose(drive.truth_at([0.5]).values, [[0.5, 0.0, np.pi]])
    for time in (-0.1, 1.1):
        with pytest.raises(EvidenceError, match=r"the truth is of 0 s to 1 s, and not of"):
            drive.truth_at([time])


def test_gaps_of_the_truth_are_bridged_as_far_as_is_wished():
    drive = Recording(truth=Stream([0.0, 1.0, 5.0], [[0, 0], [1, 0], [5, 0]], ("east", "north")))
    assert_allclose(drive.truth_at([1.0, 3.0, 5.0])["east"], [1.0, 3.0, 5.0])
    assert_allclose(drive.truth_at([0.0, 0.5, 1.0, 5.0], longest=1.0)["east"], [0, 0.5, 1, 5])
    with pytest.raises(EvidenceError, match="a gap of 4 s around 3 s, longer than longest=1"):
        drive.truth_at([1.0, 3.0], longest=1.0)


def test_fixes_are_a_sensor_and_columns_have_names_of_your_own():
    fixes = Stream([1.0], [[1.0, 2.0, 3.0]], ("x", "y", "z"), variances=[[1.0, 4.0, 9.0]])
    place = fixes.select(north="y", east="x")
    assert_array_equal(place.variances, [[4.0, 1.0]])
    drive = Recording(
        odometry=odometry(),
        fixes=place,
        sightings={"radio": heard([2.0], subject=[1])},
        landmarks={1: (1, 2)},
    )
    fix = pgm.Variable("fix", components=("east", "north"))
    radio = pgm.Variable("z", components=("range",))
    laid = drive.timeline(odometry=u, sensors={fix: "fixes", radio: "radio"}, landmark=m)
    assert_array_equal(laid.evidence[fix].values, [[1.0, 2.0]])
    assert list(laid.evidence[radio].given) == [m]


def test_truth_of_poses_in_space():
    turned = np.array([[0.0, 0.0, np.sin(0.2), np.cos(0.2)]])
    drive = Recording(truth=pgm.Poses(np.array([1.0]), np.array([[1.0, 2.0, 3.0]]), turned))
    assert_allclose(drive.truth.values, [[1.0, 2.0, 0.4]])


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=30)
def test_nothing_is_moved_on_the_merged_axis(seed):
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.uniform(0.05, 1.0, 10))
    rows = rng.normal(size=(10, 2))
    seen = np.sort(rng.uniform(0.0, stamps[-1], 15))
    seen[3:5] = stamps[:2] + 5e-7  # of one moment
    drive = Recording(
        odometry=Stream(stamps, rows, ARC, begin=0.0),
        sightings={"a": heard(seen), "b": heard(seen[::2] + 0.01)},
    )
    laid = drive.timeline(odometry=u, sensors={pgm.Variable("z", components=("range",)): "a"})
    (report,) = laid.readings.values()
    assert not report.moved.any()
    assert report.kept.all()
    # What `timeline` adds up in each step is an arc, the motion that is composed.
    composed = drive.timeline(laid.times, odometry=exact).evidence[exact]
    assert_allclose(laid.evidence[u][:, 1], composed[:, 2], atol=1e-12)
    half = 0.5 * composed[:, 2]
    chord = laid.evidence[u][:, 0] * np.sinc(half / np.pi)
    assert_allclose(composed[:, :2], chord[:, None] * np.column_stack([np.cos(half), np.sin(half)]))


def test_increments_between_far_states_are_composed():
    drive = Recording(odometry=odometry())
    laid = drive.timeline([0.5, 2.5], odometry=exact)
    start, end = drive.dead_reckoning([0, 0, 0], [0.5, 2.5]).values
    east, north, turn = laid.evidence[exact][0]
    cos, sin = np.cos(start[2]), np.sin(start[2])
    moved = np.array([cos * east - sin * north, sin * east + cos * north])
    assert_allclose(start[:2] + moved, end[:2])
    assert start[2] + turn == pytest.approx(end[2])


def test_a_first_increment_of_an_unknown_duration_counts_for_nothing():
    drive = Recording(odometry=odometry(begin=None))
    assert drive.times.tolist() == [1.0, 2.0, 3.0]
    assert_allclose(drive.timeline(odometry=u).evidence[u][:, 0], [2.0, 3.0])
    assert len(drive.dead_reckoning([0, 0, 0])) == 3


def test_states_within_the_first_increment_get_their_share_of_it():
    laid = Recording(odometry=odometry()).timeline([0.25, 1.0, 3.0], odometry=u)
    assert_allclose(laid.evidence[u][:, 0], [0.75, 5.0])


def test_velocities_are_held():
    values = [[1.0, 0.0], [2.0, 0.5], [0.0, 0.0]]
    drive = Recording(velocities=Stream([0.0, 1.0, 3.0], values, ("v", "omega")))
    assert_allclose(drive.dead_reckoning([0, 0, 0]).values[-1, 2], 1.0)
    coarse = drive.resampled(period=0.5)
    assert_array_equal(coarse.velocities["v"], [1, 1, 2, 2, 2, 2, 0])
    assert_allclose(coarse.dead_reckoning([0, 0, 0], [0.0, 3.0]).values[-1, 2], 1.0)
    part = drive.between(0.5, 2.0)
    assert_array_equal(part.velocities.stamps, [0.5, 1.0, 2.0])
    assert_array_equal(part.velocities["v"], [1.0, 2.0, 2.0])
    whole = drive.dead_reckoning([0, 0, 0], [0.5, 2.0]).values
    assert_allclose(part.dead_reckoning(whole[0]).values[-1], whole[1], atol=1e-12)
    laid = drive.timeline([0.0, 2.0], velocities=speed)
    assert_allclose(laid.evidence[speed], [[1.5, 0.25]])


def test_a_part_without_truth_is_resampled():
    known = Stream([2.0, 3.0], [[0.0, 0.0], [1.0, 1.0]], ("east", "north"))
    part = Recording(odometry=odometry(), truth=known).between(0.0, 1.5)
    assert part.resampled(period=0.5).truth is None


def test_a_changed_recording_tells_of_each_row_once():
    fixes = Stream([1.0, 1.0], [[0.0, 0.0], [1.0, 1.0]], ("east", "north"))
    drive = Recording(fixes=fixes)
    assert [told.text for told in drive.dropped] == [f"1 kept: {mending.REPEATED} (row 1)"]
    assert drive.replace(name="again").dropped == drive.dropped


def test_increments_of_one_moment_are_both_driven():
    stream = Stream([1.0, 1.0, 2.0], [[1, 0.5], [1, 0.5], [1, 0.5]], ARC, begin=0.0)
    drive = Recording(odometry=stream)
    (told,) = drive.dropped
    assert told.text == f"1 kept: {mending.AGAIN} (row 1)"
    assert drive.replace(name="again").dropped == drive.dropped
    assert_allclose(drive.dead_reckoning([0, 0, 0]).values[:, 2], [0.0, 1.0, 1.5])
    assert_allclose(drive.between(0.5, 2.0).dead_reckoning([0, 0, 0]).values[-1, 2], 1.25)
    assert_allclose(drive.resampled([0.0, 1.0, 1.5]).odometry["turn"], [1.0, 0.25])


def test_readings_are_calibrated():
    stream = Stream(
        [0.5], [[0.1, 10.7]], ("bearing", "range"), variances=[[0.01, 4.0]], subject=[1]
    )
    drive = Recording(odometry=odometry(), sightings={"laser": stream}, landmarks={1: (3, 4, 5)})
    mended = drive.calibrated("laser", 2.0, 0.7)
    assert_allclose(mended.sightings["laser"].values, [[0.1, 5.0]])
    assert_allclose(mended.sightings["laser"].variances, [[0.01, 1.0]])
    laid = mended.timeline(odometry=u, sensors={z: "laser"}, landmark=m)
    assert_allclose(laid.evidence[z].values, [[0.1, 5.0]])
    assert_allclose(laid.evidence[z].given[m], [[3.0, 4.0]])


def test_values_are_immutable_and_travel():
    scans = Scans([0.0], [[1.0, 2.0]], [0.0, 0.1], 8.0)
    drive = Recording(
        odometry=odometry(),
        sightings={"radio": heard([1.0, 2.0], subject=["a", "b"])},
        scans={"laser": scans},
        mounts={"laser": (0.1, 0.0, 0.0)},
        landmark_cov={"a": np.eye(2)},
        landmarks={"a": (1, 2)},
    )
    again = pickle.loads(pickle.dumps(drive))
    assert repr(again) == repr(drive)
    with pytest.raises(AttributeError, match="immutable"):
        again.name = "b"
    with pytest.raises(ValueError, match="read-only"):
        again.odometry.values[0] = 0.0
    with pytest.raises(ArrayError, match="no array"):
        np.asarray(drive.odometry)
    assert list(drive.sightings["radio"].to_frame().columns) == ["range", "subject"]


STREAMS = [
    (([[0.0]], [1.0], ("a",)), {}, "stamps have shape"),
    (([0.0], [1.0], ()), {}, "components= names the columns"),
    (([0.0], [1.0], {"a", "b"}), {}, "components= names the columns"),
    (([0.0], [1.0, 2.0], ("a",)), {}, r"values have shape \(2, 1\); \(1, 1\)"),
    (([0.0], [1.0], ("a",)), {"subject": [1, 2]}, r"subject= has the shape \(2,\)"),
    (([0.0], [1.0], ("a",)), {"subject": [1.5]}, "whole numbers or words"),
    (([0.0], [1.0], ("a",)), {"variances": [-1.0]}, r"variances, row 0: \[-1.0\]"),
    (([0.0], [1.0], ("a",)), {"begin": 1.0}, "begin=1.0 is after the first stamp"),
    (([0.0], [1.0], ("a",)), {"begin": "now"}, "begin= is a time"),
    (([1e18], [1.0], ("a",)), {}, "seem to be nanoseconds"),
]


@pytest.mark.parametrize(("given", "more", "told"), STREAMS)
def test_streams_that_cannot_be(given, more, told):
    with pytest.raises(EvidenceError, match=told):
        Stream(*given, **more)


WHOLE = Stream([0.0, 1.0], [[0, 0, 0], [1, 0, 2 * np.pi]], ("forward", "left", "turn"))
PART = Stream([0.0, 1.0], [[1.0], [2.0]], ("range",), subject=[1, 2])


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: Recording(odometry=PART), r"odometry has the components \('range'\); known are"),
        (lambda: Recording(odometry=[1.0]), "odometry is given as Stream"),
        (lambda: Recording(velocities=Stream([0.0], [[np.nan, 0]], ("v", "omega"))), "row 0: NaN"),
        (lambda: Recording(truth=PART), "truth has the components"),
        (lambda: Recording(landmarks={1: [np.nan, 0]}), "the position of landmark 1"),
        (lambda: Recording(landmark_cov={1: np.eye(2)}), "which is no landmark"),
        (
            lambda: Recording(landmarks={1: [0, 0]}, landmark_cov={1: -np.eye(2)}),
            "the covariance of landmark 1",
        ),
        (lambda: Recording(mounts={"laser": (0, 0, 0)}), "mounts has 'laser'"),
        (lambda: Recording(scans={"laser": 1}), "the scans 'laser' are given as Scans"),
        (lambda: Recording().dead_reckoning([0, 0, 0]), "neither odometry nor velocities"),
        (lambda: Recording(odometry=odometry()).dead_reckoning(), "no truth; give start="),
        (lambda: Recording(odometry=odometry()).dead_reckoning([0, 0]), "start= is"),
        (lambda: Recording(odometry=odometry()).resampled(), "times or period="),
        (lambda: Recording(odometry=odometry()).resampled(period=0.0), "period= is a positive"),
        (lambda: Recording(odometry=odometry()).resampled([1.0, 1.0]), "times increase"),
        (lambda: Recording(odometry=odometry()).resampled([0.0, 9.0]), "0 s to 3 s, and not 9 s"),
        (lambda: Recording(odometry=odometry()).between(8.0, 9.0).stamps(), "cover no time"),
        (lambda: Recording(odometry=odometry()).between(2.0, 1.0), "between takes two times"),
        (lambda: Recording(odometry=WHOLE).resampled([0.0, 0.5]), "row 0: a turn of 6.283 rad"),
        (lambda: Recording(sightings={"a": PART}).calibrated("b"), "no sensor 'b'; it has 'a'"),
        (lambda: Recording(sightings={"a": PART}).calibrated("a", 0.0), "scale is a positive"),
        (lambda: Recording(odometry=odometry()).timeline(velocities=speed), "has no velocities"),
        (lambda: Recording(odometry=odometry()).timeline(odometry=speed), "they go by name"),
        (lambda: Recording(odometry=odometry()).timeline(odometry="u"), "names a variable"),
        (lambda: Recording(odometry=odometry()).timeline(sensors={"a": u}), "sensors= names a var"),
        (
            lambda: Recording(odometry=odometry(), sightings={"a": PART}).timeline(
                odometry=u, sensors={pgm.Variable("z", components=("range",)): "a"}, landmark=m
            ),
            r"of 'a', 2 rows \(rows 0, 1\) have a subject without a place, 1, 2;",
        ),
        (
            lambda: Recording(odometry=odometry(), sightings={"a": heard([1.0])}).timeline(
                odometry=u, sensors={pgm.Variable("z", components=("range",)): "a"}, landmark=m
            ),
            "nothing says whose the sightings are",
        ),
        (lambda: Scans([0.0], [[1.0]], [0.0, 1.0], 8.0), "ranges have shape"),
        (lambda: Scans([0.0], [[-1.0]], [0.0], 8.0), "0 or more was due"),
        (lambda: Scans([1.0, 0.0], [[1.0], [1.0]], [0.0], 8.0), "row 1: before the row above"),
        (lambda: Scans([1.0], [[1.0]], [0.0], 0.0), "most= is"),
        (lambda: PART["bearing"], "no component 'bearing'; it has 'range'"),
    ],
)
def test_recordings_that_cannot_be(call, told):
    with pytest.raises(EvidenceError, match=told):
        call()
