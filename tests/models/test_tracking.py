"""Targets against integration, complex numbers and quadrature."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from models import tracking
from models.sinc import sinc, sinc_slope

TURN = tracking.CoordinatedTurn(dt=0.7)
number = st.floats(-10.0, 10.0)
states = st.tuples(number, number, number, number, st.floats(-3.0, 3.0)).map(np.array)


def arguments(seed=0, runs=(4, 25)):
    """Draw states; every third of a run does not turn, or hardly."""
    x = np.random.default_rng(seed).normal(size=(*runs, 5)) * [3.0, 3.0, 2.0, 2.0, 1.0]
    x[..., ::3, 4] = 0.0
    x[..., 1::3, 4] *= 1e-6
    return x


def test_constant_velocity_is_the_exponential_of_the_motion():
    generator = np.zeros((4, 4))
    generator[0, 2] = generator[1, 3] = 1.0
    assert_allclose(tracking.constant_velocity(0.3), expm(0.3 * generator), atol=1e-15)


def test_white_acceleration_is_what_the_noise_has_become():
    """The integral of Φ(τ) L q Lᵀ Φ(τ)ᵀ, by Gauss–Legendre quadrature, exact for polynomials."""
    dt, density = 0.7, 0.4
    nodes, weights = np.polynomial.legendre.leggauss(4)
    enters = np.diag([0.0, 0.0, density, density])
    total = sum(
        0.5 * dt * w * (phi := tracking.constant_velocity(0.5 * dt * (1 + t))) @ enters @ phi.T
        for t, w in zip(nodes, weights, strict=True)
    )
    assert_allclose(tracking.white_acceleration(dt, density), total, atol=1e-15)


def test_white_acceleration_does_not_depend_on_how_time_is_cut():
    whole, half = (tracking.white_acceleration(dt, 0.4) for dt in (1.0, 0.5))
    phi = tracking.constant_velocity(0.5)
    assert_allclose(phi @ half @ phi.T + half, whole, atol=1e-15)


def test_a_held_acceleration_moves_by_the_school_formula():
    dt, std = 0.7, 0.4
    cov = tracking.held_acceleration(dt, std)
    assert np.linalg.matrix_rank(cov) == 2
    acceleration = np.random.default_rng(0).normal(size=(2,))
    moved = np.concatenate([0.5 * acceleration * dt**2, acceleration * dt])
    # What a held acceleration does lies in the range of the covariance, and weighs a²/σ² there.
    assert_allclose(cov @ np.linalg.pinv(cov) @ moved, moved, atol=1e-12)
    weight = moved @ np.linalg.pinv(cov) @ moved
    assert_allclose(weight, acceleration @ acceleration / std**2, rtol=1e-10)


def test_no_noise_is_legal():
    assert not tracking.white_acceleration(1.0, 0.0).any()
    assert not tracking.held_acceleration(1.0, 0.0).any()


@pytest.mark.parametrize("omega", [0.0, 1e-300, -1e-12, 1e-8, 1e-4, -0.03, 1.0, -7.0])
def test_the_turn_integrates_the_motion(omega):
    start = np.array([4.0, -2.0, 1.5, -0.5, omega])
    driven = solve_ivp(
        lambda _, x: [x[2], x[3], -x[4] * x[3], x[4] * x[2], 0.0],
        (0.0, TURN.dt),
        start,
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
    )
    assert_allclose(TURN(start), driven.y[:, -1], atol=1e-12)


@given(states)
def test_the_turn_is_a_rotation_of_the_velocity(x):
    """With complex numbers: v' = v e^{iωΔt}, p' = p + v (e^{iωΔt} − 1) / (iω)."""
    place, speed, omega = complex(x[0], x[1]), complex(x[2], x[3]), x[4]
    spin = np.exp(1j * omega * TURN.dt)
    if abs(omega) < 1e-3:  # the quotient cancels: take its series
        a = 1j * omega * TURN.dt
        chord = TURN.dt * (1 + a / 2 + a**2 / 6 + a**3 / 24 + a**4 / 120)
    else:
        chord = (spin - 1.0) / (1j * omega)
    place, speed = place + speed * chord, speed * spin
    due = [place.real, place.imag, speed.real, speed.imag, omega]
    assert_allclose(TURN(x), due, atol=1e-10)


def test_the_turn_s_jacobian_is_the_derivative():
    x, step = arguments(), 1e-2
    columns = []
    for move in np.eye(5) * step:
        difference = [TURN(x + k * move) - TURN(x - k * move) for k in (1, 2, 3)]
        columns.append((45 * difference[0] - 9 * difference[1] + difference[2]) / (60 * step))
    assert_allclose(TURN.by_state(x), np.stack(columns, axis=-1), atol=1e-10)


@pytest.mark.parametrize("omega", [0.0, 1e-12, -1e-9])
def test_the_jacobian_at_no_turn_is_constant_velocity_and_the_limit(omega):
    """There ∂p'/∂ω is Δt²/2 times the velocity turned by a quarter, ∂v'/∂ω is Δt times it."""
    jacobian = TURN.by_state(np.array([1.0, 2.0, 3.0, 4.0, omega]))
    assert_allclose(jacobian[:4, :4], tracking.constant_velocity(TURN.dt), atol=1e-8)
    turned = np.array([-4.0, 3.0])
    assert_allclose(jacobian[:2, 4], 0.5 * TURN.dt**2 * turned, atol=1e-8)
    assert_allclose(jacobian[2:4, 4], TURN.dt * turned, atol=1e-8)


def test_a_batch_is_its_single_runs():
    x = arguments(seed=1)
    for function in (TURN, TURN.by_state):
        batch = function(x)
        assert not np.shares_memory(batch, x)
        for i in np.ndindex(4, 25):
            assert_allclose(batch[i], function(x[i]), rtol=1e-12, atol=1e-14)
    assert TURN(np.empty((0, 5))).shape == (0, 5)
    assert TURN.by_state(np.empty((0, 5))).shape == (0, 5, 5)


def test_the_turn_s_noise_has_rank_three():
    cov = TURN.noise(0.3, 0.05)
    assert np.linalg.matrix_rank(cov) == 3
    assert_allclose(cov[:4, :4], tracking.held_acceleration(TURN.dt, 0.3))
    assert_allclose(cov[4], [0.0, 0.0, 0.0, 0.0, (0.05 * 0.7) ** 2])


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf])
def test_a_duration_that_is_none_is_refused(dt):
    with pytest.raises(ValueError, match="duration of a step"):
        tracking.CoordinatedTurn(dt=dt)


@given(st.floats(-20.0, 20.0))
def test_sinc_and_its_slope(a):
    assert_allclose(sinc(a), np.sinc(a / np.pi), atol=1e-15)
    inside = np.exp(2j * np.pi * np.arange(32) / 32)  # Cauchy's formula on a circle about a
    around = np.sinc((a + 0.5 * inside) / np.pi)  # 1 where the circle goes through 0
    assert_allclose(sinc_slope(np.array(a)), np.mean(around / inside).real / 0.5, atol=1e-10)
