"""Chains whose numbers go beyond float64, or through numbers so large that digits are lost."""

import warnings

import numpy as np
import pytest
from precise import Reference, floats

import pgm

x = pgm.Variable("x", components=("position", "velocity"))
u, z = pgm.Variable("u", components=("position", "velocity")), pgm.Variable("z")
MOVED = np.array([[1.0, 1.0], [0.0, 1.0]])


def network(motion, prior=1.0, noise=1.0, tolerance=1.0):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [1.0, 2.0], prior * np.eye(2) if np.isfinite(prior) else prior)],
        [pgm.LinearGaussianCPD(x, {x.previous: motion, u: np.eye(2)}, cov=noise * np.eye(2))],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.5]]}, cov=tolerance)],
    )


WAYS = {
    "filter": pgm.filter,
    "kept": lambda *evidence: pgm.filter(*evidence, keep=[x]),
    "smooth": pgm.smooth,
    "balanced": lambda *evidence: pgm.smooth(*evidence, method=pgm.Balanced()),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("prior", [1.0, np.inf])
@pytest.mark.parametrize("lead", [(), (40,)])
@pytest.mark.parametrize("factor", [1e160, 1e308])
def test_an_explosion_is_refused(way, prior, lead, factor):
    """Without a reading that would notice, and without a warning of arithmetic."""
    model = network([[factor, 0.0], [factor, 1.0]], prior)
    evidence = {u: np.zeros((3, 2)), z: np.full((*lead, 3, 1), np.nan)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(pgm.NumericalError, match="finite"):
            WAYS[way](model, evidence)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("value", [1e155, 1e160, 1e300])
def test_a_density_beyond_float64_is_refused(way, value):
    model, evidence = network(np.eye(2)), {u: np.zeros((3, 2)), z: [[1.0], [value], [2.0]]}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(pgm.NumericalError, match="float64 can hold"):
            WAYS[way](model, evidence)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("lead", [(), (40,)])
def test_means_that_go_far_and_back(way, lead):
    """What is lost at 10¹² counts a step later, where the mean is small.

    Means are right but for their last places there, which are more than their deviations' digits.
    """
    steps, rng = 6, np.random.default_rng(0)
    model = network(MOVED, 1e-4, 1e-10, 1e-2)
    moves, values = np.zeros((steps, 2)), rng.normal(size=(steps, 1))
    moves[:2, 0], values[0] = [1e12, -1e12], 1e12
    due = Reference(model, steps, {u: moves}, [(z, k + 1, values[k], {}) for k in range(steps)])
    evidence = {u: moves, z: np.broadcast_to(values, (*lead, steps, 1))}
    with pytest.warns(pgm.PrecisionWarning, match="too small beside its mean") as said:
        found = WAYS[way](model, evidence)
    assert sum(each.category is pgm.PrecisionWarning for each in said) == 1
    beliefs = due.filtered if way in ("filter", "kept") else due.smoothed
    mean, cov = (floats([each[k] for each in beliefs]) for k in (0, 1))
    std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    left = -np.log10((0.5 * np.spacing(np.abs(mean)) / std).max())
    assert (found.status.digits <= left + 0.1).all()
    assert (found.status.digits > left - 1.0).all()
    off = np.abs(found[x].mean - mean) - 2.0 * np.spacing(np.abs(mean))
    assert (off / std).max() <= 1e-6
    np.testing.assert_allclose(found.log_evidence, float(due.log_evidence), rtol=0, atol=1e-6)
