"""Many runs of which one is badly scaled, and at one step alone, against 300 digits."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from precise import eye, floats, mp, precise, zeros

import pgm

x = pgm.Variable("x", components=("position", "velocity"))
w, z = pgm.Variable("w"), pgm.Variable("z")
MOVED, READ = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.3]])
PUSH = np.outer([0.5, 1.0], [0.5, 1.0])  # of rank one
NOISE = 0.01
RUNS, STEPS, APART = 40, 13, 3


def push(variance):
    return variance[..., None] * PUSH


def network():
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2))],
        [
            pgm.LinearGaussianCPD(
                x, {x.previous: MOVED, w: np.zeros((2, 1))}, cov=pgm.noise(push, given=w)
            )
        ],
        [pgm.LinearGaussianCPD(z, {x: READ}, cov=NOISE)],
    )


def kalman(variances, values):
    """Filtered moments, and ln p(readings)."""
    motion, row, mean, cov = precise(MOVED), precise(READ)[0], zeros(2), eye(2)
    means, covs, log_evidence = [mean], [cov], mp.mpf(0)
    for variance, value in zip(precise(variances), precise(values), strict=True):
        mean, cov = motion @ mean, motion @ cov @ motion.T + variance * precise(PUSH)
        cross = cov @ row
        predictive, residual = row @ cross + mp.mpf(NOISE), value - row @ mean
        mean = mean + cross * residual / predictive
        cov = cov - np.outer(cross, cross) / predictive
        log_evidence -= (mp.log(2 * mp.pi * predictive) + residual**2 / predictive) / 2
        means.append(mean)
        covs.append(cov)
    return floats(means), floats(covs), float(log_evidence)


@pytest.mark.parametrize("step", [3, 5, 8])
@pytest.mark.parametrize("variance", [1e8, 1e10, 1e14])
def test_a_wide_push(step, variance):
    """Before the reading is more than after it, and neither shows at every eighth step."""
    variances, rng = np.full((RUNS, STEPS, 1), NOISE), np.random.default_rng(1)
    variances[APART, step - 1] = variance
    values = rng.normal(size=(RUNS, STEPS, 1))
    evidence = {w: variances, z: values}
    for kept in ({}, {"keep": [x], "executor": ThreadPoolExecutor(2)}):
        found = pgm.filter(network(), evidence, **kept)
        for run in (APART, 7):
            mean, cov, log_evidence = kalman(variances[run, :, 0], values[run, :, 0])
            std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
            assert (np.abs(found[x].mean[run] - mean) / std).max() <= 1e-6
            scale = std[..., None] * std[..., None, :]
            assert (np.abs(found[x].cov[run] - cov) / scale).max() <= 1e-6
            assert found.log_evidence[run] == pytest.approx(log_evidence, rel=0, abs=1e-6)


def test_a_transition_that_goes_far_and_back():
    """No reading says so, and the steps between are not looked at."""
    both = np.ones((2, 2))

    def spread(state, by):
        return state + by * (state @ both.T)

    def slope(state, by):
        return np.eye(2) + by[..., None] * both

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [1.0, 2.0], [[1.0, 0.2], [0.2, 2.0]])],
        [
            pgm.NonlinearGaussianCPD(
                x, (x.previous, w), spread, 1e-4 * np.eye(2), jacobian={x.previous: slope}
            )
        ],
        [pgm.LinearGaussianCPD(z, {x: READ}, cov=NOISE)],
    )
    by, far = np.zeros((RUNS, STEPS, 1)), 1e6
    by[APART, 2:4, 0] = far, -far / (1.0 + 2.0 * far)
    motion = [precise(np.eye(2) + each * both) for each in by[APART]]
    cov = precise([[1.0, 0.2], [0.2, 2.0]])
    covs = [cov]
    for each in motion:
        cov = each @ cov @ each.T + precise(1e-4 * np.eye(2))
        covs.append(cov)
    found = pgm.filter(model, {w: by})[x].cov[APART]
    np.testing.assert_allclose(found, floats(covs), rtol=1e-6)
