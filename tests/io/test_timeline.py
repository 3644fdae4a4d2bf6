"""A log laid on the states: loops over rows that count time, invariances, Plaza, every error."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import loadmat

import pgm
from models.motion import travelled, travelled_by_state
from models.sensors import range_only, range_only_by_state
from pgm.io import stamped, timeline

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("distance", "turn", "dt"))
plain = pgm.Variable("v", components=("speed", "rate"))
z = pgm.Variable("range")
gps = pgm.Variable("gps", components=("east", "north"))
m = pgm.Variable("beacon", components=("east", "north"))

TIMES = np.array([0.0, 1.0, 2.0, 4.0])
seeds = st.integers(0, 10**6)
many = settings(deadline=None, max_examples=60)


def overlap(begin, end, first, last):
    return max(0.0, min(end, last) - max(begin, first))


def odometry_by_loops(times, stamps, increments):
    """Each step's share of each increment, by time."""
    control = np.zeros((len(times) - 1, increments.shape[1]))
    for k in range(len(control)):
        for i, stamp in enumerate(stamps):
            before = [s for s in stamps if s < stamp]
            begin = max(before) if before else min(times[0], stamp - 1e-9)
            share = overlap(times[k], times[k + 1], begin, stamp) / (stamp - begin)
            control[k] += share * increments[i]
    return control


def velocities_by_loops(times, stamps, values):
    """Each step's average of the values that hold in it."""
    control = np.zeros((len(times) - 1, values.shape[1]))
    for k in range(len(control)):
        for i, stamp in enumerate(stamps):
            after = [s for s in stamps if s > stamp]
            end = min(after) if after else np.inf
            held = overlap(times[k], times[k + 1], stamp, end)
            control[k] += held / (times[k + 1] - times[k]) * values[i]
    return control


def draw_log(seed):
    """States, stamps that reach past both ends and often coincide with states, and rows."""
    rng = np.random.default_rng(seed)
    lattice = bool(rng.integers(2))
    times = np.sort(rng.choice(np.arange(10, 60), rng.integers(2, 15), replace=False)).astype(float)
    stamps = rng.choice(np.arange(0, 80), rng.integers(1, 40), replace=False).astype(float)
    stamps = np.unique(np.append(stamps, [rng.integers(0, 11), rng.integers(60, 80)]))
    if not lattice:
        times += rng.uniform(-0.4, 0.4, times.size)
        stamps += rng.uniform(-0.4, 0.4, stamps.size)
    stamps[0] = min(stamps[0], times[0])
    stamps = rng.permutation(stamps / 10)
    return times / 10, stamps, rng.normal(size=(stamps.size, 2)), rng


@given(seeds)
@many
def test_odometry_is_each_steps_share_of_each_increment(seed):
    times, stamps, increments, _ = draw_log(seed)
    log = timeline(times, odometry={u: stamped(stamps, increments)})
    due = odometry_by_loops(times, stamps, increments)
    assert_allclose(log.evidence[u][:, :2], due, atol=1e-12)
    assert_array_equal(log.evidence[u][:, 2], np.diff(times))
    assert_array_equal(log.dt, np.diff(times))
    assert log.steps == times.size - 1


@given(seeds)
@many
def test_velocities_are_averages_over_time(seed):
    times, stamps, values, _ = draw_log(seed)
    log = timeline(times, velocities={plain: stamped(stamps, values)})
    due = velocities_by_loops(times, stamps, values)
    assert_allclose(log.evidence[plain], due, atol=1e-12)


@given(seeds)
@many
def test_motion_is_preserved_however_the_states_stand(seed):
    times, stamps, rows, rng = draw_log(seed)
    fine = np.unique(np.concatenate([times, rng.uniform(times[0], times[-1], 20)]))
    coarse = timeline(times, odometry={u: stamped(stamps, rows)})
    split = timeline(fine, odometry={u: stamped(stamps, rows)})
    total = split.evidence[u].sum(axis=0)
    assert_allclose(coarse.evidence[u].sum(axis=0), total, atol=1e-10)
    ends = np.linspace(*np.sort(stamps)[[0, -1]], 7)
    whole = timeline(ends, odometry={u: stamped(stamps, rows)}).evidence[u]
    later = rows[stamps > stamps.min()]
    assert_allclose(whole[:, :2].sum(axis=0), later.sum(axis=0), atol=1e-10)


def test_rows_on_the_states_come_through_digit_for_digit():
    rng = np.random.default_rng(3)
    times = 1.7e9 + np.cumsum(rng.uniform(0.05, 0.3, 500))
    rows = rng.normal(size=(500, 2)) * [1.0, 1e-7]
    log = timeline(
        times, odometry={u: stamped(times, rows)}, velocities={plain: stamped(times, rows)}
    )
    assert_array_equal(log.evidence[u][:, :2], rows[1:])
    assert_array_equal(log.evidence[plain], rows[:-1])
    assert not log.controls[u].split.any()
    assert_array_equal(log.controls[u].dropped, [0])
    assert_array_equal(log.controls[plain].dropped, [499])


def test_stamps_that_differ_by_rounding_are_one_moment():
    rows = np.random.default_rng(4).normal(size=(60, 2))
    sums, decimals = np.cumsum(np.full(60, 0.1)), np.round(np.arange(1, 61) * 0.1, 1)
    assert not np.array_equal(sums, decimals)
    log = timeline(sums, odometry={u: stamped(decimals, rows)})
    assert_array_equal(log.evidence[u][:, :2], rows[1:])
    log = timeline(decimals, sensors={z: stamped(sums, np.ones(60))})
    assert not log.readings[z].moved.any()


def test_report_of_odometry():
    rows = stamped([5.0, 0.5, -1.0, 1.5, 3.0, -20.0], np.ones((6, 2)))
    report = timeline(TIMES, odometry={u: rows}).controls[u]
    assert_allclose(report.counted, [1.0, 0.5, 0.0, 1.0, 1.5, 0.0])
    assert_array_equal(report.split, [True, True, False, True, True, False])
    assert_array_equal(report.dropped, [2, 5])
    assert (report.longest, report.assumed, report.backwards) == (2.0, 0.0, 3)
    assert [line.strip() for line in repr(report).splitlines()] == [
        "6 increments, 4 used, 4 of them divided at a state; the longest covers 2 s",
        "3 stamped before the row above, put in order of time",
        "2 dropped: before the first state or after the last (rows 2, 5)",
    ]


def test_report_of_velocities():
    rows = stamped([-30.0, -1.0, 0.0, 0.5, 2.0, 3.0, 9.0], np.ones((7, 2)))
    report = timeline(TIMES, velocities={plain: rows}).controls[plain]
    assert_allclose(report.counted, [0.0, 0.0, 0.5, 1.5, 1.0, 1.0, 0.0])
    assert_array_equal(report.split, [False, False, False, True, False, True, False])
    assert (report.longest, report.assumed, report.backwards) == (6.0, 0.0, 0)
    assert [line.strip() for line in repr(report).splitlines()] == [
        "7 velocities, 4 used, 2 of them held past a state; the longest covers 6 s",
        "3 dropped: before the first state or after the last (rows 0, 1, 6)",
    ]


def test_first_increment_counts_from_the_first_state():
    log = timeline(TIMES, odometry={u: stamped([0.5, 2.0, 4.0], [[1, 2], [3, 0], [4, 0]])})
    assert_allclose(log.evidence[u], [[2.0, 2.0, 1.0], [2.0, 0.0, 1.0], [4.0, 0.0, 2.0]])
    assert log.controls[u].assumed == 0.5
    assert "count from the first state on, 0.5 s" in repr(log)
    alone = timeline([0.0, 1.0], odometry={u: stamped([1.0], [[1.0, 2.0]])})
    assert_array_equal(alone.evidence[u], [[1.0, 2.0, 1.0]])


def test_last_velocity_holds_as_long_as_the_longest():
    log = timeline(TIMES, velocities={plain: stamped([0, 2], [[1, 0], [3, 0]])})
    assert_allclose(log.evidence[plain], [[1, 0], [1, 0], [3, 0]])
    with pytest.raises(pgm.EvidenceError, match=r"end at 1 s, the states 3 s later.*\(1 s\)"):
        timeline(TIMES, velocities={plain: stamped([0, 1], [[1, 0], [3, 0]])})


def test_an_angle_is_averaged_the_short_way_round():
    course = pgm.Variable("u", components=("speed", "course"), angles=("course",))
    values = [[1.0, np.pi - 0.1], [3.0, 0.3 - np.pi], [0.0, 0.0]]
    log = timeline([0.0, 1.0], velocities={course: stamped([0.0, 0.5, 1.0], values)})
    assert_allclose(log.evidence[course], [[2.0, np.pi + 0.1]])


@pytest.mark.parametrize("place", [0, 1, 2])
def test_dt_stands_where_the_variable_has_it(place):
    names = ["distance", "turn"]
    names.insert(place, "dt")
    control = pgm.Variable("u", components=tuple(names))
    log = timeline(TIMES, odometry={control: stamped(TIMES, np.arange(8.0).reshape(4, 2))})
    due = np.insert(np.arange(2.0, 8.0).reshape(3, 2), place, [1.0, 1.0, 2.0], axis=1)
    assert_array_equal(log.evidence[control], due)


@given(seeds, st.sampled_from([None, 0.0, 0.3, 2.0, np.inf]))
@many
def test_readings_go_to_the_nearest_state(seed, tolerance):
    times, _, _, rng = draw_log(seed)
    count = rng.integers(1, 40)
    stamps = rng.choice([rng.uniform(-1, 8, count), np.round(rng.uniform(-1, 8, count), 1)])
    stamps[0] = times[0]
    values = np.where(rng.random((count, 1)) < 0.2, np.nan, rng.normal(size=(count, 2)))
    values[0] = 1.0
    places = rng.normal(size=(count, 2))
    log = timeline(times, sensors={gps: stamped(stamps, values, {m: places})}, tolerance=tolerance)
    report, rows = log.readings[gps], []
    for row, stamp in enumerate(stamps):
        distance = np.abs(times - stamp)
        assert distance[report.step[row]] <= distance.min() + 1e-12
        assert report.shift[row] == times[report.step[row]] - stamp
        reach = tolerance
        if tolerance is None:
            reach = np.inf
            reach = (times[1] - times[0]) / 2 if stamp < times[0] else reach
            reach = (times[-1] - times[-2]) / 2 if stamp > times[-1] else reach
        if np.isnan(values[row]).all():
            assert report.reason[row] == "not taken"
        elif distance.min() <= reach + 1e-6:
            rows.append(row)
            assert report.reason[row] == ""
        elif times[0] <= stamp <= times[-1]:
            assert report.reason[row] == "too far from any state"
        else:
            assert report.reason[row].startswith("before" if stamp < times[0] else "after")
    seen = log.evidence[gps]
    assert_array_equal(np.flatnonzero(report.kept), rows)
    assert_array_equal(report.dropped, np.setdiff1d(np.arange(count), rows))
    assert_array_equal(seen.values, values[rows])
    assert_array_equal(seen.given[m], places[rows])
    assert_array_equal(seen.step, report.step[rows])


def test_midway_goes_to_the_earlier_state():
    log = timeline(TIMES, sensors={z: stamped([0.5, 3.0, 3.01], [1, 2, 3])})
    assert_array_equal(log.evidence[z].step, [0, 2, 3])


@given(seeds)
@many
def test_the_order_of_rows_changes_nothing(seed):
    times, stamps, rows, rng = draw_log(seed)
    seen = rng.uniform(times[0], times[-1], 12)
    seen[5:8] = seen[2]
    values, places = rng.normal(size=12), rng.normal(size=(12, 2))
    places[6] = places[2]
    shuffle, mix = rng.permutation(12), rng.permutation(stamps.size)

    def lay(rows_of_u, rows_of_z):
        return timeline(
            times,
            odometry={u: stamped(stamps[rows_of_u], rows[rows_of_u])},
            sensors={z: stamped(seen[rows_of_z], values[rows_of_z], {m: places[rows_of_z]})},
        )

    one, other = lay(np.arange(stamps.size), np.arange(12)), lay(mix, shuffle)
    assert_array_equal(other.evidence[u], one.evidence[u])
    for field in ("counted", "split"):
        due = getattr(one.controls[u], field)[mix]
        assert_array_equal(getattr(other.controls[u], field), due)
    assert_array_equal(other.evidence[z].values, one.evidence[z].values[shuffle])
    assert_array_equal(other.evidence[z].step, one.evidence[z].step[shuffle])
    assert_array_equal(other.evidence[z].given[m], one.evidence[z].given[m][shuffle])
    assert other.readings[z].repeated.sum() == one.readings[z].repeated.sum() == 1


def test_report_of_readings():
    nan = np.nan
    stamps = [0.1, 9.0, 0.1, 0.1, -3.0, 2.0, -0.4, 1.0]
    beacon = [[0, 0], [0, 0], [0, 0], [1, 0], [0, 0], [0, 0], [0, 0], [nan, nan]]
    values = [5.0, 5.0, 6.0, 5.0, 5.0, 5.0, 5.0, nan]
    report = timeline(TIMES, sensors={z: stamped(stamps, values, {m: beacon})}).readings[z]
    assert_array_equal(report.kept, [True, False, True, True, False, True, True, False])
    assert_array_equal(report.moved, [True, False, True, True, False, False, True, False])
    assert_array_equal(np.flatnonzero(report.repeated), [2])
    assert_allclose(report.shift, [-0.1, -5.0, -0.1, -0.1, 3.0, 0.0, 0.4, 0.0])
    assert report.backwards == 3
    assert [line.strip() for line in repr(report).splitlines()] == [
        "8 measurements, 5 kept, 4 moved by 0.1 s (median), 0.4 s at most",
        "1 kept that repeat a stamp and landmark",
        "3 stamped before the row above",
        "1 dropped: not taken (row 7)",
        "1 dropped: before the first state, by 3 s (row 4)",
        "1 dropped: after the last state, by 5 s (row 1)",
    ]


def test_a_reading_without_some_of_its_components_is_kept():
    nan = np.nan
    log = timeline(TIMES, sensors={gps: stamped([1.0, 2.0, 3.0], [[nan, 2], [nan, nan], [3, 4]])})
    assert_array_equal(log.readings[gps].kept, [True, False, True])
    assert_array_equal(log.evidence[gps].values, [[nan, 2], [3, 4]])


def test_a_list_of_logs_is_one_log():
    near, far = [1.0, 2.0], [3.0, 4.0]
    logs = [
        stamped([0.2, 1.1], [5.0, 6.0], {m: pgm.constant(near)}),
        stamped([0.1, 3.9, 4.0], [7.0, 8.0, np.nan], {m: pgm.constant(far)}),
    ]
    log = timeline(TIMES, sensors={z: logs})
    assert_array_equal(log.evidence[z].values[:, 0], [5, 6, 7, 8])
    assert_array_equal(log.evidence[z].step, [0, 1, 0, 3])
    assert_array_equal(log.evidence[z].given[m], [near, near, far, far])
    assert_array_equal(log.readings[z].dropped, [4])
    assert log.readings[z].backwards == 0


def test_columns_of_a_table_by_name():
    table = np.array(
        [(0.0, 1.0, 0.1, 9), (1.0, 2.0, 0.2, 9), (2.0, 3.0, 0.3, 9), (4.0, 4.0, 0.4, 9)],
        dtype=[("time", float), ("distance", float), ("turn", float), ("other", int)],
    )
    log = timeline(table["time"], odometry={u: stamped(table["time"], table[["distance", "turn"]])})
    assert_array_equal(log.evidence[u][:, :2], [[2.0, 0.2], [3.0, 0.3], [4.0, 0.4]])


def test_a_sensor_that_read_nothing():
    none = timeline(TIMES, sensors={gps: stamped([], []), z: stamped([1.0, 2.0], [np.nan, np.nan])})
    assert none.evidence[gps].values.shape == (0, 2)
    assert none.evidence[z].values.shape == (0, 1)
    assert "0 measurements, 0 kept" in repr(none)


def test_results_do_not_change():
    stamps, rows = TIMES.copy(), np.ones((4, 2))
    log = timeline(
        stamps, odometry={u: stamped(stamps, rows)}, sensors={gps: stamped(stamps, rows, {m: rows})}
    )
    before = log.evidence[u].copy()
    stamps += 1.0
    rows += 1.0
    assert_array_equal(log.evidence[u], before)
    assert_array_equal(log.times, TIMES)
    seen, report = log.evidence[gps], log.readings[gps]
    arrays = [log.times, log.dt, log.evidence[u], seen.values, seen.step, seen.given[m]]
    arrays += [report.stamps, report.step, report.shift, report.reason, report.repeated]
    arrays += [log.controls[u].stamps, log.controls[u].counted, log.controls[u].split]
    assert not any(array.flags.writeable for array in arrays)
    with pytest.raises(TypeError):
        log.evidence[u] = before
    with pytest.raises(dataclasses.FrozenInstanceError):
        log.times = stamps


def localisation(start, start_std, q_xy, q_heading, range_std):
    per_second = np.diag([q_xy, q_xy, q_heading]) ** 2
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, mean=start, cov=np.diag(start_std) ** 2)],
        transition=[
            pgm.NonlinearGaussianCPD(
                x,
                given=(x.previous, u),
                function=travelled,
                jacobian={x.previous: travelled_by_state},
                cov=pgm.noise(lambda u: u[..., 2, None, None] * per_second, given=(u,)),
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(
                z,
                given=(x, m),
                function=range_only,
                jacobian={x: range_only_by_state},
                cov=range_std**2,
            ),
            pgm.LinearGaussianCPD(gps, given={x: np.eye(2, 3)}, cov=np.eye(2)),
        ],
    )


def test_the_engine_takes_the_evidence_of_many_sensors_and_controls():
    """A random walk driven by two controls, read by two sensors, against the dense Gaussian."""
    p, a = pgm.Variable("p"), pgm.Variable("a", components=("v", "dt"))
    b, f, g = pgm.Variable("b"), pgm.Variable("f"), pgm.Variable("g")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(p, mean=1.0, cov=2.0)],
        transition=[
            pgm.LinearGaussianCPD(
                p,
                given={p.previous: 1.0, a: np.array([[1.0, 0.0]]), b: 1.0},
                cov=pgm.noise(lambda a: 0.3 * a[..., 1, None, None], given=(a,)),
            )
        ],
        observation=[
            pgm.LinearGaussianCPD(f, given={p: 1.0}, cov=0.5),
            pgm.LinearGaussianCPD(g, given={p: -2.0}, cov=0.7),
        ],
    )
    log = timeline(
        TIMES,
        odometry={b: stamped([1.0, 2.0, 4.0], [0.5, 0.25, 1.0])},
        velocities={a: stamped([0.0, 1.5, 4.0], [2.0, 4.0, 0.0])},
        sensors={
            f: stamped([2.1, 0.1, 0.0], [1.0, 2.0, 3.0]),
            g: stamped([3.9, np.pi, 50.0], [-4.0, -5.0, -6.0]),
        },
    )
    drift, steps = np.array([2.0 + 0.5, 3.0 + 0.25, 4.0 + 1.0]), np.diff(TIMES)
    lower = np.tril(np.ones((4, 4)))
    cov = lower @ np.diag([2.0, *(0.3 * steps)]) @ lower.T
    mean = np.cumsum([1.0, *drift])
    rows = np.zeros((5, 4))
    rows[[0, 1, 2], [2, 0, 0]] = 1.0
    rows[[3, 4], [3, 3]] = -2.0
    gain = cov @ rows.T @ np.linalg.inv(rows @ cov @ rows.T + np.diag([0.5, 0.5, 0.5, 0.7, 0.7]))
    due = mean + gain @ (np.array([1.0, 2.0, 3.0, -4.0, -5.0]) - rows @ mean)
    smoothed = pgm.smooth(model, log.evidence)
    assert_allclose(smoothed[p].mean[:, 0], due, rtol=1e-10)
    assert_allclose(smoothed[p].cov[:, 0, 0], np.diag(cov - gain @ rows @ cov), rtol=1e-10)


def test_plaza2_against_its_baseline():
    gtsam = pytest.importorskip("gtsam", reason="the Plaza recordings come with gtsam")
    data = loadmat(gtsam.findExampleDataFile("Plaza2_.mat"))
    truth, odometry, ranges = data["GT"], data["DR"], data["TD"]
    beacons = {int(name): place for name, *place in data["TL"]}
    places = [beacons[int(name)] for name in ranges[:, 2]]
    log = timeline(
        truth[:, 0],
        odometry={u: stamped(odometry[:, 0], odometry[:, 1:])},
        sensors={z: stamped(ranges[:, 0], (ranges[:, 3] - 0.020) / 1.0694, {m: places})},
    )
    assert_array_equal(log.evidence[u][:, :2], odometry[:, 1:])
    nearest = [np.abs(truth[:, 0] - stamp).argmin() for stamp in ranges[:, 0]]
    assert_array_equal(log.evidence[z].step, nearest)
    assert log.readings[z].kept.all()
    model = localisation(truth[0, 1:] + [0, 0, np.pi], [0.2, 0.2, 0.05], 0.05, 0.02, 0.529)
    error = pgm.filter(model, log.evidence)[x].mean[:, :2] - truth[:, 1:3]
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) == pytest.approx(0.367, rel=0.03)


def test_plaza1_reports_what_is_odd_about_it():
    gtsam = pytest.importorskip("gtsam", reason="the Plaza recordings come with gtsam")
    data = loadmat(gtsam.findExampleDataFile("Plaza1_.mat"))
    ranges, places = data["TD"], {name: place for name, *place in data["TL"]}
    given = {m: [places[name] for name in ranges[:, 2]]}
    log = timeline(data["GT"][:, 0], sensors={z: stamped(ranges[:, 0], ranges[:, 3], given)})
    report = log.readings[z]
    assert (report.backwards, report.repeated.sum(), report.kept.sum()) == (2, 2, 3529)
    assert np.abs(report.shift).max() < 0.11


ROWS = np.ones((4, 2))
GOOD = {"odometry": {u: stamped(TIMES, ROWS)}}
BAD = {
    "times are not numbers": (
        {"times": ["a", "b"]},
        None,
        r"times must be numbers, not texts",
    ),
    "times have two axes": ({"times": np.ones((3, 1))}, None, r"times have shape \(3, 1\)"),
    "one state": ({"times": [1.0]}, None, r"times has 1 states; a timeline needs two"),
    "times go back": (
        {"times": [0.0, 2.0, 1.5, 3.0]},
        None,
        r"times: row 2 \(1\.5 s\) is not after row 1 \(2\.0 s\)",
    ),
    "times stand still": ({"times": [0.0, 1.0, 1.0]}, None, r"row 2 \(1\.0 s\) is not after row 1"),
    "a time is NaN": ({"times": [0.0, np.nan, 1.0]}, None, r"times, row 1: not a finite time"),
    "times are dates": (
        {"times": np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[s]")},
        None,
        r"times must be numbers, not dates; take .*timedelta64\(1, 's'\) for seconds",
    ),
    "tolerance is negative": ({"tolerance": -1.0}, None, r"tolerance must be 0 or more seconds"),
    "tolerance is NaN": ({"tolerance": np.nan}, None, r"tolerance must be 0 or more seconds"),
    "logs without variables": (
        {"odometry": stamped(TIMES, ROWS)},
        None,
        r"odometry are given by variable, .* not as Stamped",
    ),
    "a name for a variable": ({"odometry": {"u": stamped(TIMES, ROWS)}}, "u", r"'u' is none"),
    "a variable of one step": ({"odometry": {u.at(3): stamped(TIMES, ROWS)}}, u.at(3), r"u\[3\]"),
    "a variable twice": (
        {"velocities": {u: stamped(TIMES, ROWS)}},
        u,
        r"u is given both as odometry and as velocities",
    ),
    "a bare pair": ({"odometry": {u: (TIMES, ROWS)}}, u, r"u: .*pgm\.stamped.*not as tuple"),
    "a bare pair for a sensor": (
        {"sensors": {z: (TIMES, TIMES)}},
        z,
        r"range: .*pgm\.stamped.*not as ndarray",
    ),
    "odometry with landmarks": (
        {"odometry": {u: stamped(TIMES, ROWS, {m: ROWS})}},
        u,
        r"odometry of u are given \[beacon\]; only sensors",
    ),
    "dt among the data": (
        {"odometry": {u: stamped(TIMES, np.ones((4, 3)))}},
        u,
        r"odometry of u have shape \(4, 3\); \(4, 2\) was due.*distance, turn "
        r'\(the component "dt" is filled in\)',
    ),
    "no component for dt": (
        {"odometry": {plain: stamped(TIMES, np.ones(4))}},
        plain,
        r'odometry of v have shape \(4,\); \(4, 2\).*needs a component called "dt"',
    ),
    "rows without stamps": (
        {"odometry": {u: stamped(TIMES, ROWS[:3])}},
        u,
        r"odometry of u have 3 rows with 4 stamps",
    ),
    "stamps in a column": (
        {"odometry": {u: stamped(TIMES[:, None], ROWS)}},
        u,
        r"stamps of u have shape \(4, 1\)",
    ),
    "a stamp is NaN": (
        {"odometry": {u: stamped([0, 1, np.inf, np.nan], ROWS)}},
        u,
        r"stamps of u, rows 2, 3: not a finite time",
    ),
    "an increment is NaN": (
        {"odometry": {u: stamped(TIMES, [[1, 1], [1, np.nan], [1, 1], [1, 1]])}},
        u,
        r"odometry of u, row 1: NaN or infinite",
    ),
    "no increments": ({"odometry": {u: stamped([], [])}}, u, r"odometry of u have no rows"),
    "two increments of one stamp": (
        {"odometry": {u: stamped([4.0, 0.0, 4.0, 1.0], ROWS)}},
        u,
        r"odometry of u: rows 0 and 2 have one stamp, 4 s; keep one",
    ),
    "two velocities of one stamp": (
        {"velocities": {plain: stamped([0.0, 0.0, 4.0, 4.0], ROWS)}},
        plain,
        r"velocities of v: rows 0 and 1 have one stamp, 0 s \(2 such pairs\)",
    ),
    "odometry ends early": (
        {"odometry": {u: stamped([0.0, 1.0, 2.0, 3.5], ROWS)}},
        u,
        r"odometry of u ends at 3\.5 s, the states at 4 s; .*keep times\[times <= 3\.5\]",
    ),
    "odometry begins late": (
        {"odometry": {u: stamped([1.5, 2.0, 3.0, 4.0], ROWS)}},
        u,
        r"odometry of u begins at 1\.5 s, 1\.5 s after the first state.*\(1 s\)",
    ),
    "velocities begin late": (
        {"velocities": {plain: stamped([0.1, 1.0, 2.0, 4.0], ROWS)}},
        plain,
        r"velocities of v begin at 0\.1 s, the states at 0 s",
    ),
    "one velocity": (
        {"velocities": {plain: stamped([0.0], ROWS[:1])}},
        plain,
        r"velocities of v end at 0 s, the states 4 s later",
    ),
    "a reading partly infinite": (
        {"sensors": {gps: stamped([0.0, 1.0], [[1, 2], [np.inf, 2]])}},
        gps,
        r"gps has infinite entries; a component not taken is NaN",
    ),
    "a reading infinite": ({"sensors": {z: stamped([0.0], [np.inf])}}, z, r"range has infinite"),
    "a measurement of a wrong shape": (
        {"sensors": {gps: stamped([0.0, 1.0], [1, 2])}},
        gps,
        r"measurements of gps have shape \(2,\); \(2, 2\) was due, .*east, north",
    ),
    "landmarks too few": (
        {"sensors": {z: stamped([0.0, 1.0], [1, 2], {m: [[0, 0]]})}},
        m,
        r"beacon, given for the measurements of range have 1 rows with 2 stamps",
    ),
    "a landmark unknown": (
        {"sensors": {z: stamped([0.0, 1.0], [1, 2], {m: [[0, 0], [np.nan, 0]]})}},
        m,
        r"beacon, given for the measurements of range, row 1: NaN",
    ),
    "a landmark without variable": (
        {"sensors": {z: stamped([0.0], [1], {"m": [[0, 0]]})}},
        z,
        r"measurements of range are given 'm', which is no variable",
    ),
    "logs given different things": (
        {"sensors": {z: [stamped([0.0], [1], {m: [[0, 0]]}), stamped([0.0], [1])]}},
        z,
        r"logs of range are given \[beacon\] and \[\]",
    ),
    "an empty list of logs": ({"sensors": {z: []}}, z, r"range has an empty list of logs"),
    "another clock": (
        {"sensors": {z: stamped([1.7e9, 1.7e9 + 1], [1, 2])}},
        z,
        r"no measurement of range is near a state: stamps from 1700000000 s to 1700000001 s, "
        r"states from 0 s to 4 s; are both in seconds",
    ),
    "too tight a tolerance": (
        {"sensors": {z: stamped([0.5], [1])}, "tolerance": 0.1},
        z,
        r"no measurement of range is near a state: .*tolerance 0\.1 s",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_errors_say_what_was_found(case):
    change, variable, message = BAD[case]
    with pytest.raises(pgm.EvidenceError, match=message) as caught:
        timeline(**({"times": TIMES} | GOOD | change))
    assert caught.value.variable == variable
    if case == "times go back":
        assert caught.value.step == 2
