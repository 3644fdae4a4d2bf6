"""Linear systems discretised: beside mpmath, closed forms, filterpy, and finer steps."""

import mpmath
import numpy as np
import pytest
from filterpy.common import (
    Q_continuous_white_noise,
    Q_discrete_white_noise,
    van_loan_discretization,
)
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from models import tracking
from models.continuous import LinearSystem, ornstein_uhlenbeck
from tests.dense import algebra

FAST = np.array([[-1e4, 2.0, 0.0], [1.0, -1e-3, 1.0], [0.0, 0.5, -2.0]])
UNITS = np.array([[0.0, 1e-6, 0.0], [0.0, 0.0, 1e3], [0.0, 0.0, -1e-2]])
GROWS = np.array([[3.0, 1.0, 0.0], [0.0, -1.0, 2.0], [0.0, 0.0, 0.1]])
TURNS = np.array([[0.0, 10.0, 0.0], [-10.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
rng = np.random.default_rng(0)
L, B = rng.normal(size=(3, 2)), rng.normal(size=(3, 1))
D = L @ L.T


def precise(drift, dt):
    """F, Q and G by exponentials of 80 digits, as of Van Loan."""
    size = len(drift)
    with mpmath.workdps(80):
        loan, held = mpmath.zeros(2 * size), mpmath.zeros(size + 1)
        for i, j in np.ndindex(size, size):
            loan[i, j], loan[size + i, size + j] = -drift[i, j] * dt, drift[j, i] * dt
            loan[i, size + j], held[i, j] = D[i, j] * mpmath.mpf(dt), drift[i, j] * dt
        for i in range(size):
            held[i, size] = B[i, 0] * mpmath.mpf(dt)
        loan, held = (mpmath.expm(each, method="taylor") for each in (loan, held))
        matrix = loan[size:, size:].T
        found = matrix, matrix * loan[:size, size:], held[:size, size:]
        return [np.array(each.tolist(), dtype=float) for each in found]


@pytest.mark.parametrize(
    ("drift", "dt"),
    [
        *((drift, dt) for drift in (UNITS, GROWS, TURNS) for dt in (1e-9, 1e-3, 0.7)),
        *((FAST, dt) for dt in (1e-9, 1e-3)),
        (GROWS, 15.0),
    ],
)
def test_all_digits_beside_mpmath(drift, dt):
    """Covariances in units in which variances are one, since rows may have any units."""
    matrix, cov, control = precise(drift, dt)
    found = LinearSystem(drift, D, B).over(dt)
    scale = np.sqrt(np.diag(cov))
    assert_allclose(found.matrix, matrix, rtol=1e-12, atol=1e-13 * np.abs(matrix).max())
    assert_allclose(found.cov / scale / scale[:, None], cov / scale / scale[:, None], atol=1e-12)
    assert_allclose(found.control, control, rtol=1e-12, atol=1e-13 * np.abs(control).max())


@pytest.mark.parametrize("dt", [1e-9, 1.0, 1e6])
def test_slow_and_fast_motions_keep_their_digits_side_by_side(dt):
    """Of rates 10⁻⁶ to 10⁶ a second: Q_ij = D_ij (1 − e^{−(a_i + a_j) Δt}) / (a_i + a_j)."""
    rates = np.array([1e-6, 1.0, 1e6])
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    found = LinearSystem(-np.diag(rates), D).over(dt)
    total = rates[:, None] + rates
    assert_allclose(found.matrix, np.diag(np.exp(-rates * dt)), rtol=1e-12, atol=1e-15)
    assert_allclose(found.cov, -D * np.expm1(-total * dt) / total, rtol=1e-12)
    rotated = LinearSystem(-turn @ np.diag(rates) @ turn.T, turn @ D @ turn.T).over(dt)
    # Rounding of A itself moves the slow rate by 10⁶ × 10⁻¹⁶.
    assert_allclose(rotated.cov, turn @ found.cov @ turn.T, rtol=1e-3, atol=1e-9 * found.cov.max())


@pytest.mark.parametrize("dt", [1e-9, 0.3, 1e6])
def test_targets_are_such_systems_and_filterpys(dt):
    velocity, acceleration = (np.diag(np.ones(k), 1) for k in (1, 2))
    for drift, matrix, cov in [
        (velocity, tracking.constant_velocity, tracking.white_acceleration),
        (acceleration, tracking.constant_acceleration, tracking.white_jerk),
    ]:
        size = len(drift)
        density = np.zeros((size, size))
        density[-1, -1] = 0.3
        found = LinearSystem(drift, density).over(dt)
        assert_allclose(found.matrix, matrix(dt, axes=1), rtol=1e-12)
        assert_allclose(found.cov, cov(dt, 0.3, axes=1), rtol=1e-12)
        theirs = Q_continuous_white_noise(size, dt, 0.3, block_size=2, order_by_dim=False)
        assert_allclose(cov(dt, 0.3), theirs, rtol=1e-12)
        if dt < 1.0:
            gain = np.zeros((size, 1))
            gain[-1] = np.sqrt(0.3)
            sigma, cov_of_theirs = van_loan_discretization(drift, gain, dt)
            assert_allclose(found.matrix, sigma, rtol=1e-12)
            assert_allclose(found.cov, cov_of_theirs, rtol=1e-9)
    for size, cov in [(2, tracking.held_acceleration), (3, tracking.jumping_acceleration)]:
        theirs = Q_discrete_white_noise(size, dt, 0.2**2, block_size=3, order_by_dim=False)
        assert_allclose(cov(dt, 0.2, axes=3), theirs, rtol=1e-12)


def test_a_known_turn_is_such_a_system():
    dt, rate = np.array([0.0, 0.3, 7.0]), 0.4
    drift = np.zeros((4, 4))
    drift[0, 2] = drift[1, 3] = 1.0
    drift[2, 3], drift[3, 2] = -rate, rate
    found = LinearSystem(drift, np.zeros((4, 4))).over(dt)
    assert_allclose(tracking.known_turn(dt, rate), found.matrix, atol=1e-13)
    # A turn whose rate is a state moves by the same matrix.
    x = np.array([1.0, 2.0, 3.0, -1.0, rate])
    moved = tracking.turning(np.broadcast_to(x, (3, 5)), dt[:, None])
    assert_allclose(moved[:, :4], found.matrix @ x[:4], atol=1e-12)
    slope = tracking.turning_by_state(np.broadcast_to(x, (3, 5)), dt[:, None])
    assert_allclose(slope[:, :4, :4], found.matrix, atol=1e-13)
    assert tracking.turn_noise(dt, 0.1, 0.2).shape == (3, 5, 5)


@pytest.mark.parametrize("dt", [0.0, 1e-9, 2.5, 1e6])
def test_an_ornstein_uhlenbeck_process_is_such_a_system(dt):
    found, due = (
        ornstein_uhlenbeck(dt, 10.0, 2.0),
        LinearSystem([[-0.1]], [[0.8]], [[0.1]]).over(dt),
    )
    for own, other in zip(found, due, strict=True):
        assert_allclose(own, other, rtol=1e-12, atol=1e-15)
    still = ornstein_uhlenbeck(dt, np.inf, 2.0)
    assert (still.matrix.item(), still.cov.item(), still.control.item()) == (1.0, 0.0, 0.0)


@algebra
@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_two_steps_are_one(first, second):
    system = LinearSystem(TURNS / 10.0 - 0.1 * np.eye(3), D, B)
    matrices, covs, controls = system.over([first, second, first + second])
    assert_allclose(matrices[1] @ matrices[0], matrices[2], atol=1e-12)
    assert_allclose(matrices[1] @ covs[0] @ matrices[1].T + covs[1], covs[2], atol=1e-11)
    assert_allclose(matrices[1] @ controls[0] + controls[1], controls[2], atol=1e-12)


def test_no_time_moves_nothing_and_stacks_are_of_single_steps():
    system = LinearSystem(GROWS, D, B)
    found = system.over(0.0)
    assert_array_equal(found.matrix, np.eye(3))
    assert not found.cov.any()
    assert not found.control.any()
    dt = np.array([[0.3, 0.0, 0.3], [1e-4, 2.0, 0.7]])
    for stack, single in zip(
        system.over(dt), zip(*(system.over(each) for each in dt.flat), strict=True), strict=True
    ):
        assert_allclose(stack.reshape(6, *stack.shape[2:]), np.array(single), rtol=1e-12)
    assert system.over([]).matrix.shape == (0, 3, 3)


@pytest.mark.parametrize("dt", [-1e-9, [0.1, -0.2], np.nan, np.inf])
@pytest.mark.parametrize(
    "of",
    [
        LinearSystem(GROWS, D).over,
        tracking.constant_velocity,
        tracking.constant_acceleration,
        lambda dt: tracking.white_acceleration(dt, 1.0),
        lambda dt: tracking.white_jerk(dt, 1.0),
        lambda dt: tracking.held_acceleration(dt, 1.0),
        lambda dt: tracking.jumping_acceleration(dt, 1.0),
        lambda dt: tracking.known_turn(dt, 0.1),
        lambda dt: tracking.turn_noise(dt, 1.0, 0.1),
        lambda dt: ornstein_uhlenbeck(dt, 1.0, 1.0),
    ],
)
def test_durations_below_zero_are_refused(of, dt):
    with pytest.raises(ValueError, match="give the duration of a step"):
        of(dt)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: LinearSystem([1.0], [[1.0]]), r"\(n, n\) was due"),
        (lambda: LinearSystem(np.eye(2), np.eye(3)), r"\(2, 2\) was due"),
        (lambda: LinearSystem(np.eye(2), np.eye(2), np.ones(2)), r"\(2, m\) was due"),
        (lambda: LinearSystem([[np.nan]], [[1.0]]), "drift has entries"),
        (lambda: LinearSystem(np.eye(2), [[1.0, 0.5], [0.0, 1.0]]), "not symmetric"),
        (lambda: LinearSystem(np.eye(2), [[1.0, 2.0], [2.0, 1.0]]), "negative eigenvalue, -1"),
        (lambda: LinearSystem([[3.0]], [[1.0]]).over([1.0, 1e3]), "over 1000 s .* grows beyond"),
        (lambda: ornstein_uhlenbeck(1.0, 0.0, 1.0), "time_constant"),
        (lambda: ornstein_uhlenbeck(1.0, 1.0, -1.0), "std"),
    ],
)
def test_systems_that_are_none_are_refused(made, words):
    with pytest.raises(ValueError, match=words):
        made()


def test_irregular_steps_equal_a_grid_of_small_ones():
    """One system smoothed at the stamps of its readings, and at all tenths of a second."""
    x, z = pgm.Variable("x", components=("place", "speed")), pgm.Variable("z")
    spring = LinearSystem([[0.0, 1.0], [-1.5, -0.3]], [[0.0, 0.0], [0.0, 0.4]])
    stamps = np.array([3, 4, 11, 30, 31, 47])
    values = np.random.default_rng(2).normal(size=(6, 1))

    def network(dt):
        moved = spring.over(dt)
        motion = pgm.LinearGaussianCPD(x, {x.previous: moved.matrix}, moved.cov)
        sensor = pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, 0.1)
        return pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, [1.0, 0.0], 1.0)], [motion], [sensor])

    own = pgm.smooth(network(0.1 * np.diff(stamps, prepend=0)), {z: values})
    grid = pgm.smooth(network(0.1), {z: pgm.sightings(values, step=stamps)}, steps=stamps[-1])
    at = np.concatenate([[0], stamps])
    assert_allclose(own[x].mean, grid[x].mean[at], atol=1e-12)
    assert_allclose(own[x].cov, grid[x].cov[at], atol=1e-12)
    assert own.log_evidence == pytest.approx(float(grid.log_evidence), abs=1e-12)
