"""Rules against dense quadrature of the report's (7.15)–(7.22): exact, or of the order due."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from tests.dense import bound_function

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
POSE = pgm.Variable("pose", components=("east", "north", "heading"), angles=("heading",))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))


def drive(x):
    """The velocity motion model at v = 1, ω = 0.5 over a second."""
    heading, chord = x[..., 2] + 0.25, np.sin(0.25) / 0.25
    step = [chord * np.cos(heading), chord * np.sin(heading), 0.5 + 0.0 * heading]
    return x + np.stack(step, axis=-1)


def sight(x):
    """Range and bearing of a landmark at (3, 2)."""
    east, north = 3.0 - x[..., 0], 2.0 - x[..., 1]
    return np.stack([np.hypot(east, north), np.arctan2(north, east) - x[..., 2]], axis=-1)


MEAN = np.array([0.1, -0.2, 0.3])
ROOT = np.array([[0.25, 0.0, 0.0], [0.1, 0.2, 0.0], [0.05, -0.1, 0.35]])
CASES = {"drive": (drive, POSE), "sight": (sight, Z)}
cases = pytest.mark.parametrize(("function", "child"), CASES.values(), ids=CASES)


def dense(function, scale=1.0, mean=MEAN, root=ROOT):
    """F, μ_y and Σ_n by the trapezium rule, which for a normal density converges exponentially.

    Also the standard deviations, for one random point, of the estimates of μ_y and of F.
    """
    grid = np.arange(-9.0, 9.01, 0.5)
    s = np.array(np.meshgrid(grid, grid, grid, indexing="ij")).reshape(3, -1).T
    weights = np.exp(-0.5 * (s**2).sum(axis=-1))
    weights /= weights.sum()
    L = scale * root
    y = function(mean + s @ L.T)
    value = weights @ y
    J = ((y - value) * weights[:, None]).T @ s
    F = J @ np.linalg.inv(L)
    left = y - value - s @ J.T
    noise = (left * weights[:, None]).T @ left
    influence = np.einsum("ki,kj->kij", left, s @ np.linalg.inv(L))
    return F, value, noise, np.sqrt(np.einsum("k,kij->ij", weights, influence**2))


def apply_rule(rule, function, child, scale=1.0, runs=None, mean=MEAN, root=ROOT):
    cpd = pgm.NonlinearGaussianCPD(child, X, function, np.eye(child.dimension))
    L = scale * root
    lead = () if runs is None else (runs,)
    at = pgm.Gaussian(X, np.broadcast_to(mean, (*lead, 3)), np.broadcast_to(L @ L.T, (*lead, 3, 3)))
    affine = rule(bound_function(cpd, lead=len(lead)), at)
    return affine.F, affine.F @ mean + affine.b, affine.cov


@cases
def test_gauss_hermite_converges(function, child):
    due = dense(function)
    errors = []
    for order in (2, 3, 5, 9, 17):
        found = apply_rule(pgm.GaussHermite(order), function, child)
        errors.append([np.abs(a - b).max() for a, b in zip(found, due[:3], strict=True)])
    errors = np.array(errors)
    assert (errors[1:] < 0.5 * errors[:-1] + 1e-11).all()
    assert (errors[2] < 5e-4).all()
    assert (errors[-1] < 1e-8).all()


@cases
@pytest.mark.parametrize(
    ("rule", "value", "slope"),
    [
        (pgm.Taylor(), 2, 2),
        (pgm.Unscented(), 4, 2),
        (pgm.Unscented(alpha=0.8, kappa=1.0), 4, 2),
        (pgm.Cubature(), 4, 2),
        (pgm.GaussHermite(2), 4, 2),
        (pgm.GaussHermite(3), 6, 4),
        (pgm.GaussHermite(4), 8, 6),
    ],
    ids=repr,
)
def test_errors_fall_with_the_spread_at_the_order_due(rule, value, slope, function, child):
    """A rule of degree 2p − 1 misses μ_y by terms of σ²ᵖ, and F by terms of σ²ᵖ⁻²."""
    wide, narrow = 1.0, 0.5
    errors = []
    for scale in (wide, narrow):
        found, due = apply_rule(rule, function, child, scale), dense(function, scale)
        errors.append([np.abs(found[1] - due[1]).max(), np.abs(found[0] - due[0]).max()])
    orders = np.log2(np.array(errors[0]) / np.array(errors[1]))
    assert_allclose(orders, [value, slope], atol=0.35)


@cases
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("antithetic", [False, True])
def test_monte_carlo_is_within_its_standard_error(seed, antithetic, function, child):
    count = 40_000
    F, value, noise, spread = dense(function)
    rule = pgm.MonteCarlo(count, seed, antithetic=antithetic)
    found = apply_rule(rule, function, child)
    # Pairs are at worst half as many points.
    bound = 4.5 / np.sqrt(count / 2 if antithetic else count)
    assert (np.abs(found[1] - value) < bound * np.sqrt(np.diag(noise)) + 1e-12).all()
    assert (np.abs(found[0] - F) < bound * spread + 1e-12).all()
    assert_allclose(found[2], noise, atol=4 * bound * noise.max())


@cases
def test_prior_moments_are_unbiased(function, child):
    """μ_y is unbiased, F and the predicted covariance are too small by one part in N."""
    count, runs = 12, 20_000
    rule = pgm.MonteCarlo(count, prior_moments=True, fresh_per_run=True)
    F, value, noise, _ = dense(function)
    found = apply_rule(rule, function, child, runs=runs)
    cov = ROOT @ ROOT.T
    predicted = found[0] @ cov @ found[0].swapaxes(-1, -2) + found[2]
    for sample, due in [
        (found[1], value),
        (found[0], (1 - 1 / count) * F),
        (predicted, (1 - 1 / count) * (F @ cov @ F.T + noise)),
    ]:
        error = sample.std(axis=0) / np.sqrt(runs)
        assert (np.abs(sample.mean(axis=0) - due) < 4.5 * error + 1e-12).all()


@cases
def test_the_line_through_its_own_moments_is_nearer(function, child):
    """What the sample's own mean and covariance gain at ten points."""
    F, value, _, _ = dense(function)
    errors = []
    for prior in (True, False):
        rule = pgm.MonteCarlo(10, prior_moments=prior, fresh_per_run=True)
        found = apply_rule(rule, function, child, runs=2000)
        errors.append([rms(found[1] - value), rms(found[0] - F)])
    assert (np.array(errors[1]) < 0.6 * np.array(errors[0])).all()


def rms(error):
    return np.sqrt((error**2).mean())


@cases
def test_rates_of_convergence(function, child):
    """Random points err as 1/√N, scrambled Sobol points about as 1/N."""
    F, value, _, _ = dense(function)
    errors = {}
    for count, (name, rule) in itertools.product(
        (32, 512),
        {
            "random": lambda n: pgm.MonteCarlo(n, fresh_per_run=True),
            "antithetic": lambda n: pgm.MonteCarlo(n, antithetic=True, fresh_per_run=True),
            "sobol": lambda n: pgm.QuasiMonteCarlo(n, fresh_per_run=True),
        }.items(),
    ):
        found = apply_rule(rule(count), function, child, runs=400)
        errors[name, count] = np.array([rms(found[1] - value), rms(found[0] - F)])
    for name in ("random", "antithetic"):
        rate = np.log(errors[name, 512] / errors[name, 32]) / np.log(16)
        assert_allclose(rate, -0.5, atol=0.1)
    rate = np.log(errors["sobol", 512] / errors["sobol", 32]) / np.log(16)
    assert (rate < -0.8).all()
    assert (errors["sobol", 512] < 0.2 * errors["random", 512]).all()
    # What is even about the mean has no part in F, but its own mean sees half as many points.
    value, slope = errors["antithetic", 512] / errors["random", 512]
    assert_allclose(value, np.sqrt(2), atol=0.15)
    assert slope < 0.5


@cases
def test_sobol_points_converge(function, child):
    F, value, noise, _ = dense(function)
    found = apply_rule(pgm.QuasiMonteCarlo(2**15), function, child)
    for a, b in zip(found, (F, value, noise), strict=True):
        assert_allclose(a, b, atol=2e-4)


@pytest.mark.parametrize(
    ("rule", "tolerance"),
    [
        (pgm.GaussHermite(7), 2e-3),
        (pgm.QuasiMonteCarlo(8192), 2e-3),
        # Four standard errors of F: √(0.2/40 000) over a deviation of 0.25.
        (pgm.MonteCarlo(40_000), 0.036),
    ],
    ids=["gauss hermite", "sobol", "monte carlo"],
)
def test_a_heading_known_to_a_radian(rule, tolerance):
    """Where points turn beyond half a turn, (7.15)–(7.22) hold on the unwrapped chart."""
    root = np.diag([0.25, 0.25, 1.1])
    F, value, noise, _ = dense(drive, root=root)
    found = apply_rule(rule, drive, POSE, root=root)
    for a, b in zip(found, (F, value, noise), strict=True):
        assert_allclose(a, b, atol=tolerance)
