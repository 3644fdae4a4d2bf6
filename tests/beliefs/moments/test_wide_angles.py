"""Headings that are hardly known, and robots that spin: angles beyond half a turn."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("turn",))
compass = pgm.Variable("compass", components=("heading",), angles=("heading",))
counter = pgm.Variable("counter")
RULES = {"unscented": pgm.Unscented(), "cubature": pgm.Cubature(), "mc": pgm.MonteCarlo(40)}
SPIN = np.array([[0.0], [0.0], [1.0]])


def networks(sd, sensor=compass):
    """One network of functions and its linear twin."""
    prior = [pgm.GaussianCPD(x, [0, 0, 0], np.diag([1.0, 1.0, sd**2]))]
    noise, read = 1e-2 * np.eye(3), np.array([[0.0, 0.0, 1.0]])
    functions = pgm.DynamicBayesianNetwork(
        prior,
        [pgm.NonlinearGaussianCPD(x, (x.previous, u), lambda x, u: x + u @ SPIN.T, noise)],
        [pgm.NonlinearGaussianCPD(sensor, x, lambda x: x[..., 2:3], 0.04)],
    )
    linear = pgm.DynamicBayesianNetwork(
        prior,
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0, u: SPIN}, cov=noise)],
        [pgm.LinearGaussianCPD(sensor, {x: read}, cov=0.04)],
    )
    return functions, linear


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
@pytest.mark.parametrize("sd", [0.5, 2.0])
def test_a_heading_that_is_hardly_known(sd, rule):
    """A rule is exact on a linear function, however far its points turn."""
    functions, linear = networks(sd)
    evidence = {u: np.full((3, 1), 0.1), compass: np.full((3, 1), 0.5)}
    found, due = pgm.smooth(functions, evidence, lineariser=rule), pgm.smooth(linear, evidence)
    assert_allclose(found[x].mean, due[x].mean, atol=1e-9)
    assert_allclose(found[x].cov, due[x].cov, atol=1e-9)
    assert_allclose(found.log_evidence, due.log_evidence, atol=1e-8)


@pytest.mark.parametrize("lineariser", [pgm.Taylor(), pgm.Unscented()])
@pytest.mark.parametrize("turn", [4.0, -4.0, 7.0])
def test_a_robot_that_spins_is_not_unwound(turn, lineariser):
    functions, linear = networks(0.1, counter)
    evidence = {u: np.full((5, 1), turn), counter: turn * np.arange(1.0, 6.0)[:, None]}
    found = pgm.smooth(functions, evidence, lineariser=lineariser, iterations=2)
    due = pgm.smooth(linear, evidence)
    assert_allclose(found[x].mean, due[x].mean, atol=1e-8)
    assert_allclose(found.log_evidence, due.log_evidence, atol=1e-7)


def test_batches_of_wide_and_narrow_headings_are_their_singles():
    wide, narrow = (np.diag([1.0, 1.0, sd**2]) for sd in (2.0, 0.2))
    functions, _ = networks(1.0)

    def belief(cov):
        model = functions.replace(prior=[pgm.GaussianCPD(x, [0, 0, 0], cov)])
        evidence = {u: np.full((3, 1), 0.1), compass: np.full((3, 1), 0.5)}
        return pgm.smooth(model, evidence, lineariser=pgm.Unscented())[x]

    both = belief(np.array([wide, narrow]))
    for k, cov in enumerate((wide, narrow)):
        assert_allclose(both.mean[k], belief(cov).mean, atol=1e-12)
