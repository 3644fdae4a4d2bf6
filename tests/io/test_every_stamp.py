"""A timeline without times: a state at every stamp, so that nothing is moved."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from models import networks as n
from pgm.io import stamped, timeline
from pgm.io.stamped import SAME

u = pgm.Variable("u", components=("distance", "turn", "dt"))
v = pgm.Variable("v", components=("speed",))
z = pgm.Variable("range")
gps = pgm.Variable("gps", components=("east", "north"))
m = pgm.Variable("beacon", components=("east", "north"))
seeds = st.integers(0, 10**6)
many = settings(deadline=None, max_examples=60)


def draw_log(seed):
    """Two controls and two sensors with stamps of their own, some of which coincide."""
    rng = np.random.default_rng(seed)

    def stamps(count, low, high):
        found = rng.uniform(low, high, count)
        return rng.permutation(np.where(rng.random(count) < 0.4, np.round(found, 1), found))

    odometry, velocities = (np.unique(stamps(rng.integers(3, 12), 0, 4)) for _ in range(2))
    odometry, velocities = rng.permutation([*odometry, 4.5]), np.append(velocities, 5.0)
    ranges, fixes = stamps(rng.integers(1, 15), -1, 6), stamps(rng.integers(1, 8), -1, 6)
    ranges[0] = fixes[0] = 4.2
    values = np.where(rng.random((fixes.size, 2)) < 0.3, np.nan, 1.0)
    values[0] = 1.0
    return {
        "odometry": {u: stamped(odometry, rng.normal(size=(odometry.size, 2)))},
        "velocities": {v: stamped(velocities, rng.normal(size=velocities.size))},
        "sensors": {z: stamped(ranges, np.ones(ranges.size)), gps: stamped(fixes, values)},
    }


def of_log(log):
    driven = [np.asarray(log[kind][w].stamps) for kind, w in (("odometry", u), ("velocities", v))]
    fixed = np.asarray(log["sensors"][gps].stamps)
    taken = ~np.isnan(log["sensors"][gps].values).all(axis=1)
    return driven, [np.asarray(log["sensors"][z].stamps), fixed[taken]]


@given(seeds)
@many
def test_states_are_all_stamps_that_the_controls_cover(seed):
    log = draw_log(seed)
    driven, seen = of_log(log)
    first, last = max(each.min() for each in driven), min(each.max() for each in driven)
    every = np.unique(np.concatenate([*driven, *seen]))
    every = every[(every >= first) & (every <= last)]
    found = timeline(**log)
    assert_array_equal(found.times, every)
    assert not any(report.moved.any() for report in found.readings.values())
    for sensor, stamps in zip((z, gps), seen, strict=True):
        report = found.readings[sensor]
        within = (report.stamps >= first) & (report.stamps <= last)
        assert report.kept.sum() == ((stamps >= first) & (stamps <= last)).sum()
        assert (report.reason[~within] != "").all()
        assert_array_equal(found.times[report.step[report.kept]], report.stamps[report.kept])
    coarse = timeline(np.array([first, last]), **log, tolerance=10.0)
    assert_allclose(found.evidence[u].sum(axis=0), coarse.evidence[u][0], atol=1e-12)
    spent = (found.evidence[v] * found.dt[:, None]).sum() / (last - first)
    assert_allclose(spent, coarse.evidence[v][0, 0], atol=1e-12)


@given(seeds, st.sampled_from([0.05, 0.3, 2.0]))
@many
def test_a_tolerance_spares_states(seed, tolerance):
    log = draw_log(seed)
    driven, _ = of_log(log)
    every, found = timeline(**log), timeline(**log, tolerance=tolerance)
    within = [each for each in np.concatenate(driven) if found.times[0] <= each <= found.times[-1]]
    assert np.isin(within, found.times).all()
    for sensor, report in found.readings.items():
        assert (np.abs(report.shift[report.kept]) <= tolerance + SAME).all()
        assert report.kept[every.readings[sensor].kept].all()
    own = np.setdiff1d(found.times, within)
    assert (np.diff(own) > tolerance).all()
    assert all(np.abs(each - np.array(within)).min() > tolerance for each in own)
    assert found.steps <= every.steps


@given(seeds)
@many
def test_the_order_of_rows_changes_nothing(seed):
    log, rng = draw_log(seed), np.random.default_rng(seed)

    def mixed(rows):
        order = rng.permutation(len(rows.stamps))
        return stamped(np.asarray(rows.stamps)[order], np.asarray(rows.values)[order])

    other = {kind: {w: mixed(rows) for w, rows in logs.items()} for kind, logs in log.items()}
    one, two = timeline(**log), timeline(**other)
    assert_array_equal(one.times, two.times)
    for w in (u, v):
        assert_array_equal(one.evidence[w], two.evidence[w])
    for w in (z, gps):
        assert_array_equal(np.sort(one.evidence[w].step), np.sort(two.evidence[w].step))


def test_stamps_that_differ_by_rounding_share_a_state():
    sums, decimals = np.cumsum(np.full(60, 0.1)), np.round(np.arange(1, 61) * 0.1, 1)
    rows = np.random.default_rng(4).normal(size=(60, 2))
    log = timeline(odometry={u: stamped(decimals, rows)}, sensors={z: stamped(sums, np.ones(60))})
    assert_array_equal(log.times, decimals)
    assert_array_equal(log.evidence[u][:, :2], rows[1:])
    assert not log.readings[z].moved.any()
    chain = 1.0 + 0.6e-6 * np.arange(9)  # each within a microsecond of the next, not all of one
    log = timeline(
        odometry={u: stamped([0.0, 2.0], np.ones((2, 2)))}, sensors={z: stamped(chain, np.ones(9))}
    )
    assert log.readings[z].kept.all()
    assert not log.readings[z].moved.any()
    assert (np.diff(log.times) > SAME).all()


def test_without_controls_states_are_where_something_is_read():
    log = timeline(sensors={z: stamped([3.0, 1.0, 2.5, 1.0], [1, 2, np.nan, 4])})
    assert_array_equal(log.times, [1.0, 3.0])
    assert_array_equal(log.evidence[z].step, [1, 0, 0])


def test_a_copy_may_be_dropped():
    nan = np.nan
    values = [[1, nan], [1, nan], [1, 2], [1, nan], [nan, nan], [nan, nan], [1, nan]]
    given = {m: [[0, 0], [0, 0], [0, 0], [5, 5], [0, 0], [0, 0], [0, 0]]}
    rows = stamped([1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 3.0], values, given)
    both = timeline([0.0, 1.0, 4.0], sensors={gps: rows}).readings[gps]
    assert_array_equal(np.flatnonzero(both.copied), [1])
    assert_array_equal(np.flatnonzero(both.repeated), [1, 2])
    assert both.kept.sum() == 5
    assert "2 kept that repeat a stamp and landmark, 1 of them the value, too" in repr(both)
    log = timeline([0.0, 1.0, 4.0], sensors={gps: rows}, drop_copies=True)
    assert_array_equal(log.readings[gps].dropped, [1, 4, 5])
    assert log.readings[gps].reason[1] == "a copy of an earlier row"
    assert "1 dropped: a copy of an earlier row (row 1)" in repr(log)
    assert_array_equal(log.evidence[gps].step, [1, 1, 1, 2])
    alone = timeline(sensors={gps: rows}, drop_copies=True)
    assert_array_equal(alone.times, [1.0, 3.0])


def test_every_stamp_is_the_dense_gaussian_of_the_wiener_process():
    """A random walk in continuous time, its odometry split at readings of two sensors."""
    p, a = pgm.Variable("p"), pgm.Variable("a", components=("moved", "dt"))
    f, g = pgm.Variable("f"), pgm.Variable("g")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(p, mean=1.0, cov=2.0)],
        transition=[
            pgm.LinearGaussianCPD(
                p,
                given={p.previous: 1.0, a: [[1.0, 0.0]]},
                cov=pgm.noise(lambda a: 0.3 * a[..., 1:], given=a, diagonal=True),
            )
        ],
        observation=[
            pgm.LinearGaussianCPD(f, given={p: 1.0}, cov=0.5),
            pgm.LinearGaussianCPD(g, given={p: -2.0}, cov=0.7),
        ],
    )
    stamps, moved = np.array([0.0, 1.0, 2.0, 4.0]), np.array([9.0, 0.5, 0.25, 1.0])
    read = {f: [3.1, 0.3, 1.0, 0.3], g: [0.7, 0.3]}
    rng = np.random.default_rng(0)
    values = {sensor: rng.normal(size=len(at)) for sensor, at in read.items()}
    log = timeline(
        odometry={a: stamped(stamps, moved)},
        sensors={sensor: stamped(at, values[sensor]) for sensor, at in read.items()},
    )
    smoothed = pgm.smooth(model, log.evidence)

    times = np.unique(np.concatenate([stamps, *read.values()]))
    mean = 1.0 + np.interp(times, stamps, np.cumsum(moved) - moved[0])
    cov = 2.0 + 0.3 * np.minimum.outer(times, times)
    at = np.concatenate(list(read.values()))
    scale = np.repeat([1.0, -2.0], [4, 2])
    rows = scale[:, None] * (at[:, None] == times)
    noise = np.diag(np.repeat([0.5, 0.7], [4, 2]))
    gain = np.linalg.solve(rows @ cov @ rows.T + noise, rows @ cov).T
    due = mean + gain @ (np.concatenate(list(values.values())) - rows @ mean)
    assert_array_equal(log.times, times)
    assert_allclose(smoothed[p].mean[:, 0], due, rtol=1e-10)
    assert_allclose(smoothed[p].cov[:, 0, 0], np.diag(cov - gain @ rows @ cov), rtol=1e-10)


def test_a_divided_increment_is_off_by_its_acceleration_alone():
    """By a Δt² / 8 in the middle, where the true place is v t + a t² / 2."""
    told, halfway, a = np.arange(0.0, 3.1, 0.2), np.arange(0.1, 3.0, 0.2), 6.0

    def place(t):
        return 2.0 * t + 0.5 * a * t**2

    rows = np.column_stack([np.diff(place(told), prepend=0.0), np.zeros(told.size)])
    seen = {z: stamped(halfway, np.ones(halfway.size))}
    log = timeline(odometry={u: stamped(told, rows)}, sensors=seen)
    apart = np.cumsum(log.evidence[u][:, 0]) - place(log.times[1:])
    assert_allclose(apart[::2], a * 0.2**2 / 8, rtol=1e-9)
    assert_allclose(apart[1::2], 0.0, atol=1e-12)


def fast_robot(speed, turn_rate, runs, seed):
    """A robot on a circle, odometry at 5 Hz, sightings between: truth, odometry, sightings."""
    rng = np.random.default_rng(seed)
    network = n.calibrated_range(
        start=[0, 0, 0],
        start_std=(0.05, 0.05, 0.02),
        position_rate=0.05,
        heading_rate=0.02,
        sensor_std=0.05,
        guess_std=(0.0, 0.0),
    )
    told, heard = np.arange(0.0, 10.01, 0.2), np.sort(rng.uniform(0.0, 10.0, 120))
    times = np.union1d(told, heard)
    u = np.diff(times)[:, None] * [speed, turn_rate, 1.0]
    beacons = np.array([[0.0, 9.0], [9.0, 0.0], [-9.0, -9.0]])[np.arange(120) % 3]
    step = np.searchsorted(times, heard)
    sample = network.sample(
        {n.travelled: u, n.distance: pgm.sightings(step=step, given={n.landmark: beacons})},
        runs=runs,
        rng=rng,
    )
    truth = sample[n.pose][:, np.searchsorted(times, told)]
    odometry = {n.travelled: stamped(told, np.tile([0.2 * speed, 0.2 * turn_rate], (51, 1)))}
    return network, truth, told, odometry, (heard, sample.evidence[n.distance], beacons)


@pytest.mark.parametrize(("speed", "worse"), [(0.0, 1.0), (5.0, 2.0)])
def test_moved_readings_spoil_a_fast_robots_estimate(speed, worse):
    """20 runs of known truth: readings at their own times are consistent, moved ones are not."""
    network, truth, told, odometry, (heard, seen, beacons) = fast_robot(speed, 1.0, 20, 3)
    errors, nees = {}, {}
    for name, times in (("own", None), ("moved", told)):
        # The layout is that of one run; the values of all runs take its rows' places.
        rows = {n.distance: stamped(heard, np.arange(120.0), {n.landmark: beacons})}
        log = timeline(times, odometry=odometry, sensors=rows)
        laid = log.evidence[n.distance]
        order = laid.values[:, 0].astype(int)
        values = pgm.sightings(seen.values[:, order], step=laid.step, given=laid.given)
        belief = pgm.smooth(network, {**log.evidence, n.distance: values})[n.pose]
        at = np.searchsorted(log.times, told)
        belief = pgm.Gaussian(n.pose, belief.mean[:, at], belief.cov[:, at])
        errors[name] = pgm.consistency.rmse(belief, truth, ("east", "north"))
        nees[name] = pgm.consistency.nees(belief, truth)[:, 1:].mean() / 3
    assert 0.7 < nees["own"] < 1.3
    assert errors["moved"] >= worse * errors["own"] - 1e-9
    assert (nees["moved"] > 3.0) == (speed > 0.0)


BAD = {
    "nothing": ({}, r"states are at the stamps of the log, of which 0 will do; .*two or more"),
    "one reading": ({"sensors": {z: stamped([1.0], [2.0])}}, r"of which 1 will do"),
    "one increment": (
        {"odometry": {u: stamped([1.0], [[1, 1]])}, "sensors": {z: stamped([2.0], [1.0])}},
        r"of which 1 will do",
    ),
    "no increments": ({"odometry": {u: stamped([], [])}}, r"u has no rows; leave it out"),
    "controls apart": (
        {
            "odometry": {u: stamped([0.0, 1.0], np.ones((2, 2)))},
            "velocities": {v: stamped([2.0, 3.0], [1, 1])},
        },
        r"no time in common \(u 0 s to 1 s; v 2 s to 3 s\)",
    ),
    "readings apart": (
        {
            "odometry": {u: stamped([0.0, 1.0], np.ones((2, 2)))},
            "sensors": {z: stamped([2.0, 3.0], [1, 1])},
        },
        r"no measurement of range is near a state: .*same clock",
    ),
    "a bare pair": ({"odometry": {u: ([0.0, 1.0], 1)}}, r"pgm\.stamped.*not as tuple"),
    "stamps in nanoseconds": (
        {"sensors": {z: stamped([1.7e18, 1.7e18 + 1e9], [1, 1])}},
        r"seem to be nanoseconds",
    ),
    "drop_copies is no bool": ({"drop_copies": "yes"}, r"drop_copies is True or False, not 'yes'"),
}


@pytest.mark.parametrize("case", BAD)
def test_errors_say_what_was_found(case):
    change, message = BAD[case]
    with pytest.raises(pgm.EvidenceError, match=message):
        timeline(**change)
