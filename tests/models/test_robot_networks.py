"""Robots and targets as networks: textbook filters, known gains, and consistency over many runs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_are

import pgm
from models import networks as n
from models import sensors, tracking
from pgm import consistency

LANDMARKS = np.array([[4.0, 3.0], [-2.0, 5.0]])


def jacobians_dropped(network):
    """The network with numerical derivatives in place of those it gives."""

    def plain(cpd):
        if isinstance(cpd, pgm.NonlinearGaussianCPD):
            return pgm.NonlinearGaussianCPD(cpd.child, cpd.given, cpd.function, cpd.cov)
        return cpd

    return network.replace(
        transition=[plain(cpd) for cpd in network.transition],
        observation=[plain(cpd) for cpd in network.observation],
    )


def sighted(steps):
    return pgm.sightings(
        step=np.arange(1, steps + 1),
        given={n.landmark: LANDMARKS[np.arange(steps) % len(LANDMARKS)]},
    )


DRIVE = n.differential_drive(0.5, radius=0.1, wheelbase=0.3, start_std=(0.1, 0.1, 0.05))
CASES = {
    "velocity_position": (n.velocity_position(0.5), {n.velocity: np.tile([1.0, 0.4], (8, 1))}),
    "velocity_pose": (n.velocity_pose(0.5), {n.velocity: np.tile([1.0, 0.4], (8, 1))}),
    "turn_after_move": (
        n.turn_after_move(start_std=(0.1, 0.1, 0.1)),
        {n.move: np.tile([0.5, 0.3], (8, 1))},
    ),
    "differential_drive": (
        DRIVE,
        {n.wheels: np.tile([9.0, 10.0], (8, 1)), n.sighting: sighted(8)},
    ),
    "bearings": (
        DRIVE.replace(observation=[n.sees_bearing(0.05)]),
        {n.wheels: np.tile([9.0, 10.0], (8, 1)), n.bearing: sighted(8)},
    ),
    "coordinated_turn": (n.coordinated_turn(0.5), {}),
}


def sample(name, runs=(), seed=0):
    network, controls = CASES[name]
    return network, network.sample(
        controls, steps=None if controls else 8, runs=runs, rng=np.random.default_rng(seed)
    )


@pytest.mark.parametrize("name", CASES)
def test_given_and_numerical_derivatives_agree(name):
    network, drawn = sample(name)
    given, numerical = (
        pgm.smooth(net, drawn.evidence) for net in (network, jacobians_dropped(network))
    )
    state = network.prior[0].child
    assert_allclose(given[state].mean, numerical[state].mean, atol=1e-6)
    assert_allclose(given.log_evidence, numerical.log_evidence, atol=1e-6)


def test_linear_velocity_is_the_textbook_kalman_filter():
    dt, rng = 0.5, np.random.default_rng(0)
    stds = {"start_std": (0.2, 0.3), "motion_std": (0.1, 0.15), "sensor_std": (0.4, 0.2)}
    controls, readings = rng.normal(size=(6, 2)), rng.normal(size=(6, 2))
    network = n.linear_velocity(dt, start=(1.0, -1.0), **stds)
    belief = pgm.filter(network, {n.speed: controls, n.fix: readings})[n.point]
    start, process, sensor = (np.square(std) for std in stds.values())
    mean, var = np.array([1.0, -1.0]), start  # the axes are independent
    for t in range(6):
        mean, var = mean + dt * controls[t], var + process
        gain = var / (var + sensor)
        mean, var = mean + gain * (readings[t] - mean), (1.0 - gain) * var
        assert_allclose(belief.mean[t + 1], mean, atol=1e-12)
        assert_allclose(belief.cov[t + 1], np.diag(var), atol=1e-12)


def test_a_pose_that_is_read_may_be_wrapped():
    network = n.velocity_pose(1.0, start=(0.0, 0.0, 3.1))
    controls, reading = np.array([[1.0, 0.1]]), np.array([[0.0, 0.0, -3.0]])
    turned = reading + np.array([0.0, 0.0, 2 * np.pi])
    wrapped, unwrapped = (
        pgm.filter(network, {n.velocity: controls, n.pose_fix: z})[n.pose]
        for z in (reading, turned)
    )
    assert_allclose(wrapped.mean, unwrapped.mean, atol=1e-12)
    assert abs(wrapped.mean[1, 2] - 3.2) < 0.1


def test_a_position_may_be_read_on_other_scales():
    """Reading 2 north with deviation 2 s is reading north with deviation s."""
    controls, reading = np.array([[1.0, 0.1]]), np.array([[1.2, 0.3]])
    scaled, plain = (
        pgm.filter(
            n.velocity_position(1.0).replace(observation=[sensor]),
            {n.velocity: controls, n.fix: z},
        )[n.pose]
        for sensor, z in (
            (n.reads_position((0.1, 0.4), scale=(1.0, 2.0)), reading * [1.0, 2.0]),
            (n.reads_position((0.1, 0.2)), reading),
        )
    )
    assert_allclose(scaled.mean, plain.mean, atol=1e-12)
    assert_allclose(scaled.cov, plain.cov, atol=1e-12)


def test_the_noise_of_a_move_grows_with_the_move():
    """Variances 0.01 |d|, 0.01 |φ|; a pure turn leaves the position exactly known."""
    network = n.turn_after_move()
    belief = pgm.filter(network, {n.move: np.array([[0.0, -0.5], [-2.0, 0.0]])})[n.pose]
    assert_allclose(belief.cov[0], np.zeros((3, 3)))
    assert_allclose(belief.cov[1], np.diag([0.0, 0.0, 0.005]), atol=1e-15)
    heading = belief.mean[1, 2]
    sideways = -2.0 * np.array([-np.sin(heading), np.cos(heading)])
    turned = np.append(sideways, 1.0)
    due = 0.005 * np.outer(turned, turned) + np.diag([0.02, 0.02, 0.0])
    assert_allclose(belief.cov[2], due, atol=1e-15)


def test_a_rate_below_zero_is_refused():
    network = n.turn_after_move(position_rate=-0.01)
    with pytest.raises(pgm.ModelError, match="noise of the CPD of x at step 1"):
        pgm.filter(network, {n.move: np.array([[1.0, 0.1]])})


def test_constant_velocity_reaches_its_steady_state():
    """The predicted covariance solves the filter's Riccati equation."""
    dt, density, std = 0.4, 0.3, 0.5
    network = n.constant_velocity(dt, acceleration_density=density, sensor_std=(std, std))
    belief = pgm.filter(network, {n.fix: np.zeros((200, 2))}).predicted[n.target]
    steady = solve_discrete_are(
        tracking.constant_velocity(dt).T,
        np.eye(2, 4).T,
        tracking.white_acceleration(dt, density),
        std**2 * np.eye(2),
    )
    assert_allclose(belief.cov[-1], steady, rtol=1e-8, atol=1e-12)


def test_durations_by_step_equal_those_of_a_clock():
    rng = np.random.default_rng(5)
    dt, fixes = rng.uniform(0.1, 3.0, 9), rng.normal(size=(9, 2))
    timed = pgm.smooth(n.constant_velocity(dt), {n.fix: fixes})
    clocked = pgm.smooth(n.uneven_constant_velocity(), {n.fix: fixes, n.clock: dt[:, None]})
    assert_allclose(timed[n.target].mean, clocked[n.target].mean, atol=1e-11)
    assert_allclose(timed[n.target].cov, clocked[n.target].cov, atol=1e-11)
    assert timed.log_evidence == pytest.approx(float(clocked.log_evidence), abs=1e-11)


@pytest.mark.parametrize("density", [0.0, 0.1])
def test_constant_velocity_is_consistent(density):
    """300 runs: mean NEES inside the 99 % band at the end, exact motion included."""
    network = n.constant_velocity(0.5, acceleration_density=density)
    drawn = network.sample({}, steps=30, runs=300, rng=1)
    posterior = pgm.smooth(network, drawn.evidence)
    low, high = consistency.mean_band(4, 300)
    truth = drawn[n.target]
    for belief in (posterior.filtered[n.target], posterior[n.target]):
        assert low < consistency.nees(belief, truth)[:, -1].mean() < high
    assert consistency.rmse(posterior[n.target], truth) < consistency.rmse(
        posterior.filtered[n.target], truth
    )


@pytest.mark.parametrize("omega", [-0.3, 0.0, 0.3])
def test_a_turn_rate_is_learnt_from_positions(omega):
    """An exact turn among readings of 0.1 m: the rate is found, and within its deviation."""
    network = n.coordinated_turn(
        0.5, acceleration_std=0.0, turn_acceleration_std=0.0, sensor_std=(0.1, 0.1)
    )
    t = 0.5 * np.arange(1, 41)
    # A chord of the unit-speed circle through the origin, eastwards at first.
    a = omega * t / 2
    chord = t * np.sinc(a / np.pi) * np.exp(1j * a)
    noise = 0.1 * np.random.default_rng(2).normal(size=(40, 2))
    readings = np.stack([chord.real, chord.imag], axis=-1) + noise
    belief = pgm.smooth(network, {n.fix: readings}, lineariser=pgm.Unscented())[n.turning_target]
    error = belief.mean[-1, 4] - omega
    assert abs(error) < min(0.01, 3.0 * belief.std[-1, 4])


def as_function(std):
    """A compass as a function with derivatives: what `reads_heading` says without either."""
    return pgm.NonlinearGaussianCPD(
        n.compass,
        given=n.pose,
        function=sensors.heading,
        cov=std**2,
        jacobian={n.pose: sensors.heading_by_state},
    )


@pytest.mark.parametrize("lineariser", [pgm.Taylor(), pgm.Unscented()])
def test_a_heading_is_read_linearly_on_either_side_of_a_half_turn(lineariser):
    network = n.turn_after_move(start=(0.0, 0.0, 3.0), start_std=(0.1, 0.1, 0.2))
    controls = {n.move: np.tile([0.5, 0.1], (12, 1))}
    drawn = network.sample(controls, runs=20, rng=3)
    wrapped = (drawn[n.compass] + np.pi) % (2 * np.pi) - np.pi
    assert wrapped.min() < -2.5 < 2.5 < wrapped.max()
    linear, nonlinear = (
        pgm.smooth(
            network.replace(observation=[sensor]),
            controls | {n.compass: wrapped},
            lineariser=lineariser,
        )
        for sensor in (n.reads_heading(0.1), as_function(0.1))
    )
    assert_allclose(linear[n.pose].mean, nonlinear[n.pose].mean, atol=1e-12)
    assert_allclose(linear[n.pose].cov, nonlinear[n.pose].cov, atol=1e-12)
    assert_allclose(linear.log_evidence, nonlinear.log_evidence, atol=1e-9)


@pytest.mark.parametrize("std", [-0.1, np.nan, np.inf])
def test_standard_deviations_that_are_none_are_refused(std):
    for build in (
        lambda: n.velocity_pose(0.5, motion_std=(0.1, std, 0.1)),
        lambda: n.constant_velocity(0.5, start_std=(1.0, 1.0, 1.0, std)),
        lambda: n.sees_landmark((0.1, std)),
        lambda: n.sees_range(std),
        lambda: n.sees_bearing(std),
        lambda: n.reads_heading(std),
    ):
        with pytest.raises(ValueError, match=f"standard deviations: found .*{std}.*; give finite"):
            build()
