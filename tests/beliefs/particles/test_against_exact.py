"""Particles against exact beliefs: the Kalman filter and smoother, and a fine grid."""

import numpy as np
import pytest
from clouds import cart, pose, robot, robot_evidence, x, z
from scipy.stats import norm, t

import pgm

STEPS = 12


def evidence(rng=1):
    return cart().sample({}, steps=STEPS, rng=rng).evidence


@pytest.mark.parametrize("resampling", ["systematic", "stratified", "residual", "multinomial"])
def test_filters_are_exact_within_monte_carlo_errors(resampling):
    # Independent seeds give the standard error of each estimate.
    given = evidence()
    exact = pgm.filter(cart(), given)
    found = [
        pgm.filter(cart(), given, belief=pgm.Particles(2000, seed=k, resampling=resampling))
        for k in range(30)
    ]
    for name in ("mean", "cov"):
        each = np.array([getattr(f[x], name) for f in found])
        error = each.std(axis=0, ddof=1) / np.sqrt(len(each))
        off = (each.mean(axis=0) - getattr(exact[x], name)) / error
        assert np.abs(off).max() < 4.5  # of some 70 numbers
        assert np.sqrt(np.mean(off**2)) < 2.0  # those of neighbouring steps go together
    evidences = np.array([f.log_evidence for f in found])
    ratio = np.exp(evidences - exact.log_evidence)  # unbiased
    assert abs(ratio.mean() - 1.0) < 3.0 * ratio.std(ddof=1) / np.sqrt(len(ratio))


def test_a_hundred_thousand_particles():
    given = evidence(4)
    exact, n = pgm.filter(cart(), given), 100_000
    found = pgm.filter(cart(), given, belief=pgm.Particles(n, seed=5))
    error = exact[x].std / np.sqrt(n) * 3.0  # resampled in the past: a little above 1/√n
    assert (np.abs(found[x].mean - exact[x].mean) < 3.0 * error).all()
    assert abs(found.log_evidence - exact.log_evidence) < 0.03


@pytest.mark.parametrize("smoothing", ["metropolis", "full"])
def test_smoothers_are_exact_within_monte_carlo_errors(smoothing):
    given = evidence()
    exact = pgm.smooth(cart(), given)
    found = [
        pgm.smooth(cart(), given, belief=pgm.Particles(300, seed=k, smoothing=smoothing))
        for k in range(20)
    ]
    for name in ("mean", "cov"):
        each = np.array([getattr(f[x], name) for f in found])
        error = each.std(axis=0, ddof=1) / np.sqrt(len(each))
        bias = 0.01  # of order 1/n
        off = np.abs(each.mean(axis=0) - getattr(exact[x], name))
        assert (off < 4.0 * error + bias).all()
    joint = np.array([f.joint(x.at(3), x.at(7)).cov for f in found])
    error = joint.std(axis=0, ddof=1) / np.sqrt(len(joint))
    assert (np.abs(joint.mean(axis=0) - exact.joint(x.at(3), x.at(7)).cov) < 4 * error + 0.01).all()


@pytest.mark.slow
def test_a_hundred_thousand_particles_are_within_three_standard_errors():
    """One run, by the errors that eleven others have: filter, smoother and log-evidence."""
    given = evidence(4)
    exact = {"filtered": pgm.filter(cart(), given), "smoothed": pgm.smooth(cart(), given)}
    limit = t.isf(norm.sf(3.0), 10)  # three standard errors, which eleven runs tell
    found = [
        pgm.smooth(cart(), given, belief=pgm.Particles(100_000, seed=k, moves=60))
        for k in range(12)
    ]
    for kind, right in exact.items():
        each = [f.filtered if kind == "filtered" else f for f in found]
        for name in ("mean", "cov"):
            values = np.array([getattr(f[x], name) for f in each])
            error = values[1:].std(axis=0, ddof=1)
            off = np.abs(values[0] - getattr(right[x], name)) / np.where(error > 0.0, error, 1.0)
            assert np.sqrt(np.mean(off**2)) < 1.5
            assert np.mean(off > limit) < 0.02
    evidences = np.array([f.log_evidence for f in found])
    error = evidences[1:].std(ddof=1)
    assert abs(evidences[0] - exact["filtered"].log_evidence) < limit * error


def test_moves_leave_the_deviations_of_the_full_smoother():
    """Those are the exact ones, of a linear network."""
    given = evidence()
    exact = pgm.smooth(cart(), given)[x].std
    found = pgm.smooth(cart(), given, belief=pgm.Particles(10_000, seed=1))
    assert np.abs(found[x].std / exact - 1.0).max() < 0.03
    assert found.status.unmoved.shape == (STEPS,)


@pytest.mark.parametrize("lag", [1, 3])
def test_fixed_lags_know_what_is_measured_a_lag_later(lag):
    given = evidence()
    exact = pgm.smooth(cart(), given, lag=lag)
    found = pgm.smooth(cart(), given, lag=lag, belief=pgm.Particles(10_000, seed=2))
    assert (np.abs(found[x].mean - exact[x].mean) < 0.08 * exact[x].std).all()
    np.testing.assert_allclose(found[x].std, exact[x].std, rtol=0.06)
    assert str(found.kind) == f"fixed-lag ({lag})"


def test_particles_and_a_grid_agree_about_a_robot():
    given = robot_evidence(5)
    grid = pgm.Grid({"east": (2.0, 10.0, 107), "north": (0.0, 8.0, 107), "heading": 72})
    exact = pgm.filter(robot(), given, belief=grid)
    found = pgm.filter(robot(), given, belief=pgm.Particles(100_000, seed=1))
    one, other = found[pose].gaussian(), exact[pose].gaussian()
    assert (np.abs(one.mean - other.mean) < 0.04 * exact[pose].std).all()
    assert one.kl(other).max() < 5e-3
    assert abs(found.log_evidence - exact.log_evidence) < 0.03


def test_missing_components_are_left_out():
    given = dict(robot_evidence(4))
    (sensor,) = [v for v in given if v.name == "seen"]
    values = np.array(given[sensor].values)
    values[2] = np.nan
    values[3, 1] = np.nan
    given[sensor] = pgm.sightings(values, given[sensor].step, given[sensor].given)
    exact = pgm.filter(
        robot(),
        given,
        belief=pgm.Grid({"east": (2.0, 10.0, 81), "north": (0.0, 8.0, 81), "heading": 72}),
    )
    found = pgm.filter(robot(), given, belief=pgm.Particles(60_000, seed=1))
    assert (np.abs(found[pose].mean - exact[pose].mean) < 0.05 * exact[pose].std).all()


def test_noise_that_inputs_decide_and_hidden_controls():
    u, command = pgm.variables("u command")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2))],
        transition=[
            pgm.LinearGaussianCPD(
                u, {command: 1.0}, cov=pgm.noise(lambda c: c[..., None] ** 2, given=command)
            ),
            pgm.LinearGaussianCPD(
                x, {x.previous: [[1.0, 0.3], [0.0, 1.0]], u: [[0.0], [1.0]]}, cov=0.1 * np.eye(2)
            ),
        ],
        observation=[pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=0.2)],
    )
    given = model.sample({command: np.linspace(0.2, 0.6, 6)[:, None]}, rng=1).evidence
    exact = pgm.smooth(model, given)
    found = pgm.smooth(model, given, belief=pgm.Particles(20_000, seed=3))
    for variable in (x, u):
        assert found[variable].mean.shape == exact[variable].mean.shape
        gap = np.abs(found[variable].mean - exact[variable].mean)
        assert (gap < 0.06 * exact[variable].std).all()
        np.testing.assert_allclose(found[variable].std, exact[variable].std, rtol=0.06)


def test_float32_states_leave_the_same_answer():
    given = robot_evidence(5)
    one, other = (
        pgm.filter(robot(), given, belief=pgm.Particles(50_000, seed=1, dtype=kind))
        for kind in (np.float64, np.float32)
    )
    assert other[pose].states.dtype == np.float32
    assert (np.abs(one[pose].mean - other[pose].mean) < 0.05 * one[pose].std).all()
    assert abs(one.log_evidence - other.log_evidence) < 0.05
