"""A recording: motion against composition one by one, no row lost or moved without a word."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.recordings import Recording, Stream

seeds = st.integers(0, 10**6)
some = settings(deadline=None, max_examples=40)
ARC, PLANAR, TURNS = ("distance", "turn"), ("forward", "left", "turn"), ("rot1", "trans", "rot2")


def matrix(forward, left, turn):
    """A motion as a homogeneous matrix."""
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin, forward], [sin, cos, left], [0.0, 0.0, 1.0]])


def driven(pose, steps, rate):
    """The pose after a steady motion, in many small straight steps: (forward, left, turn)."""
    for _ in range(steps):
        east, north, heading = pose
        facing = heading + 0.5 * rate[2] / steps
        cos, sin = np.cos(facing), np.sin(facing)
        pose = (
            east + (cos * rate[0] - sin * rate[1]) / steps,
            north + (sin * rate[0] + cos * rate[1]) / steps,
            heading + rate[2] / steps,
        )
    return np.array(pose)


def drawn(seed, components=ARC, rows=8):
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.uniform(0.05, 1.0, rows))
    values = rng.normal(scale=0.7, size=(rows, len(components)))
    return Recording(odometry=Stream(stamps, values, components, begin=0.0)), rng


@given(seeds, st.sampled_from([ARC, PLANAR, TURNS]))
@some
def test_dead_reckoning_composes_motions_one_by_one(seed, components):
    drive, rng = drawn(seed, components)
    start = rng.normal(size=3)
    pose, found = matrix(*start), drive.dead_reckoning(start)
    assert_array_equal(found.values[0], start)
    for row, (east, north, heading) in zip(drive.odometry.values, found.values[1:], strict=True):
        if components == ARC:
            radius = row[0] / row[1]
            motion = (radius * np.sin(row[1]), radius * (1 - np.cos(row[1])), row[1])
        elif components == TURNS:
            motion = (row[1] * np.cos(row[0]), row[1] * np.sin(row[0]), row[0] + row[2])
        else:
            motion = row
        pose = pose @ matrix(*motion)
        assert_allclose([east, north], pose[:2, 2], atol=1e-12)
        assert_allclose(np.exp(1j * heading), pose[0, 0] + 1j * pose[1, 0], atol=1e-12)


@given(seeds, st.sampled_from([ARC, PLANAR]))
@some
def test_a_cut_increment_goes_part_of_the_way(seed, components):
    drive, rng = drawn(seed, components, rows=1)
    (end,), (row,) = drive.odometry.stamps, drive.odometry.values
    share = rng.uniform(0.05, 0.95)
    (_, found) = drive.dead_reckoning([0.0, 0.0, 0.0], [0.0, share * end]).values
    if components == PLANAR:
        # Velocity of the steady motion, by solving the integral of its rotation for it.
        turns = np.linspace(0.0, row[2], 2001)
        mean = np.trapezoid(np.exp(1j * turns), dx=1.0 / 2000)
        speed = (row[0] + 1j * row[1]) / mean
        row = (speed.real, speed.imag, row[2])
    else:
        row = (row[0], 0.0, row[1])
    assert_allclose(found, driven((0.0, 0.0, 0.0), 4000, share * np.array(row)), atol=1e-6)


@given(seeds, st.sampled_from([ARC, PLANAR, TURNS]))
@some
def test_a_recording_driven_in_pieces_ends_where_it_did(seed, components):
    drive, rng = drawn(seed, components)
    times = np.union1d(rng.uniform(*drive.times[[0, -1]], 20), drive.times[[0, -1]])
    start = rng.normal(size=3)
    whole = drive.dead_reckoning(start)
    for other in (drive.resampled(times), drive.resampled(times).resampled(drive.times[[0, -1]])):
        assert_allclose(other.dead_reckoning(start).values[-1], whole.values[-1], atol=1e-9)
    middle = times[10]
    first, second = drive.between(-1.0, middle), drive.between(middle, 1e3)
    assert first.odometry.components == (ARC if components == ARC else first.odometry.components)
    pose = first.dead_reckoning(start).values[-1]
    assert_allclose(second.dead_reckoning(pose).values[-1], whole.values[-1], atol=1e-9)


@pytest.mark.parametrize("begin", [None, 1.0])
def test_motion_at_the_first_moment_is_told_of_when_it_is_left_out(begin):
    """It ends where the first pose begins: no pose would come before it."""
    stamps, rows = [1.0, 2.0, 1.0, 2.0], [[1.0, 0.0], [1.0, 0.5], [3.0, 0.0], [2.0, 0.0]]
    drive = Recording(odometry=Stream(stamps, rows, ARC, begin=begin))
    (early,) = (each for each in drive.dropped if not each.kept)
    assert early.rows.tolist() == ([2] if begin is None else [0, 2])
    assert "before which there is no pose" in repr(drive)
    pose = matrix(np.sin(0.5) / 0.5, (1.0 - np.cos(0.5)) / 0.5, 0.5) @ matrix(2.0, 0.0, 0.0)
    assert_allclose(drive.dead_reckoning([0.0, 0.0, 0.0]).values[-1, :2], pose[:2, 2], atol=1e-12)
    assert drive.replace(name="again").odometry.values.shape == drive.odometry.values.shape


@pytest.mark.parametrize("period", [1e-12, 5.0])
def test_periods_of_no_step_and_of_countless_ones_are_refused(period):
    drive = Recording(odometry=Stream([0.0, 1.0], [[0.0, 0.0], [1.0, 0.0]], ARC))
    with pytest.raises(pgm.EvidenceError, match=r"period=.*1 to 1e.08 were due"):
        drive.resampled(period=period)


def test_the_truth_is_cut_between_its_rows():
    truth = Stream(
        [0.0, 1.0, 2.0, 4.0],
        [[0.0, 0.0, 3.0], [1.0, 0.0, -3.0], [2.0, 2.0, -3.0], [4.0, 0.0, -3.0]],
        ("east", "north", "heading"),
        variances=np.ones((4, 3)),
    )
    drive = Recording(odometry=Stream([5.0], [[1.0, 0.0]], ARC, begin=0.0), truth=truth)
    part = drive.between(0.5, 3.0).truth
    assert_allclose(part.stamps, [0.5, 1.0, 2.0, 3.0])
    assert_allclose(part.values[:, :2], [[0.5, 0.0], [1.0, 0.0], [2.0, 2.0], [3.0, 1.0]])
    assert_allclose(np.cos(part["heading"]), np.cos([np.pi, 3.0, 3.0, 3.0]), atol=1e-12)
    assert np.isnan(part.variances[[0, 3]]).all()
    assert_allclose(part.variances[1:3], 1.0)
    assert drive.between(0.5, 3.0).dropped == ()
    assert_allclose(drive.between(1.0, 2.0).truth.stamps, [1.0, 2.0])
    assert_allclose(drive.between(2.5, 4.5).truth.stamps, [2.5, 4.0])
    assert_allclose(drive.between(2.5, 3.5).truth_at([2.5, 3.0]).values[:, 0], [2.5, 3.0])
    assert drive.replace(truth=None).between(1.0, 2.0).truth is None
