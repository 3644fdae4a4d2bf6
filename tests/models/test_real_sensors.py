"""Sensors as they are: against mpmath, and against runs drawn by the model."""

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from models import networks as n
from models import sensors
from pgm import consistency

# Derivatives of textbook formulas, in 30 digits. A sensor takes (x, m, a, c): pose, landmark,
# mount, calibration.
ARGUMENTS = {"x": slice(0, 3), "m": slice(3, 5), "a": slice(5, 8), "c": slice(8, 10)}
PLAIN = {"a": (0.0, 0.0, 0.0), "c": (1.0, 0.0)}
KNOWN = {"a": (0.7, -0.4, 0.3), "c": (1.1, -0.25)}


def place(x, a):
    east = x[0] + a[0] * mpmath.cos(x[2]) - a[1] * mpmath.sin(x[2])
    return east, x[1] + a[0] * mpmath.sin(x[2]) + a[1] * mpmath.cos(x[2])


def distance(x, m, a, c):
    east, north = place(x, a)
    return c[0] * mpmath.sqrt((m[0] - east) ** 2 + (m[1] - north) ** 2) + c[1]


def direction(x, m, a, c):
    east, north = place(x, a)
    return mpmath.atan2(m[1] - north, m[0] - east) - x[2] - a[2]


TEXTBOOK = {
    "RANGE": [distance],
    "BEARING": [direction],
    "RANGE_BEARING": [distance, direction],
    "POSITION": [lambda x, m, a, c: place(x, a)[0], lambda x, m, a, c: place(x, a)[1]],
    "HEADING": [lambda x, m, a, c: x[2] + a[2]],
}
CASES = [
    (name, mount, calibration)
    for name in TEXTBOOK
    for mount in (None, "known", "parent")
    for calibration in (None, "known", "parent")
    if calibration is None or "RANGE" in name
]


def made(name, mount, calibration):
    """A sensor, the names of its arguments, and what is fixed of the others."""
    sensor, fixed = getattr(sensors, name), dict(PLAIN)
    arguments = ["x", "m"][: len(sensor.derivatives)]
    for key, change, how in (
        ("a", sensors.mounted, mount),
        ("c", sensors.calibrated, calibration),
    ):
        if how == "known":
            sensor, fixed[key] = change(sensor, KNOWN[key]), KNOWN[key]
        elif how == "parent":
            sensor = change(sensor)
            arguments.append(key)
    return sensor, arguments, fixed


def draw(rng, shape=()):
    x = rng.normal(size=(*shape, 3)) * [3.0, 3.0, 6.0]
    m = x[..., :2] + rng.choice([-1, 1], (*shape, 2)) * rng.uniform(2.0, 6.0, (*shape, 2))
    a = rng.normal(size=(*shape, 3)) * 0.5
    return {"x": x, "m": m, "a": a, "c": rng.normal(size=(*shape, 2)) * [0.1, 0.5] + [1.0, 0.0]}


@pytest.mark.parametrize(("name", "mount", "calibration"), CASES)
def test_values_and_derivatives_are_the_textbooks(name, mount, calibration):
    sensor, arguments, fixed = made(name, mount, calibration)
    drawn = draw(np.random.default_rng(5))
    given = {**drawn, **{k: np.array(v) for k, v in fixed.items() if k not in arguments}}
    flat = np.concatenate([given[key] for key in ARGUMENTS]).tolist()

    def textbook(function):
        return lambda *v: function(*(v[part] for part in ARGUMENTS.values()))

    with mpmath.workdps(30):
        value = [float(textbook(f)(*flat)) for f in TEXTBOOK[name]]
        orders = [tuple(order) for order in np.eye(10, dtype=int)]
        jacobian = [[mpmath.diff(textbook(f), flat, o) for o in orders] for f in TEXTBOOK[name]]
        jacobian = np.array(jacobian, dtype=float)
    called = [drawn[key] for key in arguments]
    apart = sensor.function(*called) - value
    if "BEARING" in name:  # which comes wrapped
        apart[-1] = np.angle(np.exp(1j * apart[-1]))
    assert_allclose(apart, 0.0, atol=1e-12)
    for key, function in zip(arguments, sensor.derivatives, strict=True):
        assert_allclose(function(*called), jacobian[:, ARGUMENTS[key]], atol=1e-12)


@pytest.mark.parametrize(("name", "mount", "calibration"), CASES)
def test_a_batch_is_its_single_runs(name, mount, calibration):
    sensor, arguments, _ = made(name, mount, calibration)
    drawn = draw(np.random.default_rng(6), (5, 2))
    called = [drawn[key] for key in arguments]
    before = [part.copy() for part in called]
    for function in (sensor.function, *sensor.derivatives):
        batch = function(*called)
        for i in np.ndindex(5, 2):
            assert_allclose(batch[i], function(*(part[i] for part in called)), rtol=1e-12)
    for part, old in zip(called, before, strict=True):
        assert_array_equal(part, old)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sensors.mounted(sensors.RANGE, (1.0, 2.0)), r"mount: found \(1\.0, 2\.0\).*turn"),
        (lambda: sensors.calibrated(sensors.RANGE, (np.nan, 0)), r"calibration: .*\(scale, offset"),
        (lambda: n.sees_range(0.1, mount=3.0), r"mount: found 3\.0"),
        (lambda: n.grows(0.1, n.velocity), r'u has no component called "dt"'),
        (lambda: n.walks(n.gyro_bias, -0.1, n.travelled), r"standard deviations: found"),
    ],
)
def test_what_is_no_mount_calibration_or_noise_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


BEACONS = np.array([[0.0, 0.0], [12.0, 0.0], [0.0, 12.0], [12.0, 12.0]])
ROBOT = {
    "start": [6.0, 6.0, 0.3],
    "start_std": (0.2, 0.2, 0.05),
    "position_rate": 0.05,
    "heading_rate": 0.02,
    "sensor_std": 0.2,
}


def drawn_runs(model, steps=100, runs=150, seed=1):
    """Runs of a model whose parameters are drawn, too; steps of uneven duration."""
    u = np.zeros((steps, 3))
    u[:, 0], u[:, 1] = 0.3, 0.05 * np.sign(np.sin(np.arange(steps) / 20))
    u[:, 2] = np.random.default_rng(0).uniform(0.1, 0.5, steps)
    step = np.repeat(np.arange(steps + 1), 2)
    seen = pgm.sightings(step=step, given={n.landmark: BEACONS[np.arange(step.size) % 4]})
    return model.sample({n.travelled: u, n.distance: seen}, runs=runs, rng=seed)


def unknown_mount():
    """A range sensor somewhere on the robot."""
    base = n.calibrated_range(**ROBOT, mount=n.mount, guess_std=(0.0, 0.0))
    guess = pgm.GaussianCPD(n.mount, np.zeros(3), np.diag([0.5, 0.5, 0.0]) ** 2)
    return base.replace(prior=[*base.prior, guess], transition=[*base.transition, n.stays(n.mount)])


UNKNOWN = {  # the model, the state, and which of its components are unknown
    "scale and offset": (
        n.calibrated_range(**ROBOT, guess_std=(0.1, 1.0)),
        n.calibration,
        np.array([0, 1]),
    ),
    "offset that walks": (
        n.calibrated_range(**ROBOT, guess_std=(0.1, 1.0), walk=(0.0, 0.05)),
        n.calibration,
        np.array([0, 1]),
    ),
    "gyro": (
        n.drifting_gyro(**ROBOT, bias_std=0.02, bias_walk=0.002),
        n.gyro_bias,
        np.array([0]),
    ),
    "mount": (unknown_mount(), n.mount, np.array([0, 1])),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_parameters_are_recovered_and_beliefs_in_them_are_consistent(name):
    """150 runs: the mean NEES lies in its 99 % band, the errors shrink to a fraction."""
    model, state, free = UNKNOWN[name]
    drawn = drawn_runs(model)
    posterior = pgm.smooth(model, drawn.evidence)
    low, high = consistency.mean_band(free.size, 150)
    for belief in (posterior.filtered[state], posterior[state]):
        error = (belief.mean - drawn[state])[..., free]
        cov = belief.cov[..., free[:, None], free]
        nees = np.einsum("rti,rti->rt", error, np.linalg.solve(cov, error[..., None])[..., 0])
        assert low < nees[:, 20].mean() < high
        assert low < nees[:, -1].mean() < high
    spread = drawn[state][:, 0, free].std(axis=0)
    assert (np.sqrt(np.mean(error[:, 0] ** 2, axis=0)) < 0.4 * spread).all()


def test_static_states_are_exactly_constant_and_the_same_online():
    model, state, _ = UNKNOWN["scale and offset"]
    drawn = drawn_runs(model, steps=12, runs=())
    smoothed, u = pgm.smooth(model, drawn.evidence), drawn.evidence[n.travelled]
    assert_allclose(smoothed[state].mean, smoothed[state].mean[[0]].repeat(13, 0), rtol=1e-12)
    robot = pgm.OnlineFilter(model)
    belief, seen = robot.initial(), drawn.evidence[n.distance]
    for t in range(13):
        belief = belief if t == 0 else robot.predict(belief, {n.travelled: u[t - 1]})
        now = seen.step == t
        at = {n.landmark: seen.given[n.landmark][now]}
        belief = robot.update(belief, {n.distance: pgm.sightings(seen.values[now], given=at)})
    assert_allclose(belief[state].mean, smoothed[state].mean[-1], rtol=1e-9)
    assert_allclose(belief[state].cov, smoothed[state].cov[-1], rtol=1e-8, atol=1e-12)


def test_mount_and_calibration_are_numbers_or_evidence():
    """Ranges and bearings from a turned sensor off the centre, told by the model or as evidence."""
    base = n.uneven_range_bearing(motion_std=(0.05, 0.05, 0.02), sensor_std=(0.1, 0.02))
    how = {"mount": (0.5, -0.2, 0.4), "calibration": (1.1, 0.2)}
    told = base.replace(observation=[n.sees_landmark((0.1, 0.02), **how)])
    asked = base.replace(
        observation=[n.sees_landmark((0.1, 0.02), mount=n.mount, calibration=n.calibration)]
    )
    u = np.tile([1.0, 0.3, 0.5], (8, 1))
    seen = pgm.sightings(step=np.arange(1, 9), given={n.landmark: BEACONS[np.arange(8) % 4]})
    drawn = told.sample({n.timed_velocity: u, n.sighting: seen}, rng=4)
    one = pgm.smooth(told, drawn.evidence)
    known = {getattr(n, name): pgm.constant(value) for name, value in how.items()}
    other = pgm.smooth(asked, {**drawn.evidence, **known})
    assert_allclose(one[n.pose].mean, other[n.pose].mean, atol=1e-12)
    assert_allclose(one.log_evidence, other.log_evidence, rtol=1e-12)
    blind = pgm.smooth(base, drawn.evidence)
    assert blind.log_evidence < one.log_evidence - 50


def test_an_antenna_ahead_tells_the_heading():
    """A fix of the reference point says nothing of a still robot's heading; one ahead does."""
    still = {n.timed_velocity: np.tile([0.0, 0.0, 1.0], (20, 1))}
    base = n.uneven_range_bearing(start_std=(1.0, 1.0, 0.3), motion_std=(0.0, 0.0, 0.0))
    for mount, knows in (((0.0, 0.0, 0.0), False), ((1.5, 0.0, 0.0), True)):
        model = base.replace(observation=[n.reads_antenna((0.1, 0.1), mount)])
        drawn = model.sample({**still, n.fix: pgm.sightings(step=np.arange(1, 21))}, rng=2)
        std = pgm.smooth(model, drawn.evidence)[n.pose].std[-1, 2]
        assert (std < 0.9 * 0.3) == knows


def test_durations_grow_noise_and_a_step_may_be_divided():
    """Two parts of an arc, one after the other, are the whole, and so are their noises."""
    rng = np.random.default_rng(7)
    u = rng.normal(size=(5, 3)) * [1.0, 0.4, 0.0] + [0.0, 0.0, 0.4]
    share = rng.uniform(0.1, 0.9, 5)[:, None]
    half = np.stack([share * u, (1.0 - share) * u], axis=1).reshape(10, 3)
    model = n.calibrated_range(**{**ROBOT, "heading_rate": 0.0, "start_std": (0.2, 0.2, 0.0)})
    whole, divided = (pgm.filter(model, {n.travelled: each})[n.pose] for each in (u, half))
    assert_allclose(divided.mean[::2], whole.mean, atol=1e-12)
    assert_allclose(divided.cov[::2], whole.cov, atol=1e-12)


def test_a_target_read_at_any_time_is_the_wiener_process_acceleration_model():
    """Readings at uneven times against the model of even steps that has a state at each of them."""
    even, uneven = n.constant_velocity(0.1), n.uneven_constant_velocity()
    at = np.array([3, 4, 11, 20])
    fixes = np.random.default_rng(8).normal(size=(4, 2))
    due = pgm.smooth(even, {n.fix: pgm.sightings(fixes, step=at)}, steps=20)
    log = pgm.timeline(0.1 * np.array([0, *at]), sensors={n.fix: pgm.stamped(0.1 * at, fixes)})
    found = pgm.smooth(uneven, {**log.evidence, n.clock: log.dt[:, None]})
    assert_allclose(found[n.target].mean[1:], due[n.target].mean[at], atol=1e-10)
    assert_allclose(found[n.target].cov[1:], due[n.target].cov[at], atol=1e-10)
