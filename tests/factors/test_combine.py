"""A Gaussian times a canonical form, against the product of two canonical forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm import CanonicalForm, Gaussian

A = pgm.Variable("a", components=("p", "q"))
B = pgm.Variable("b")
rng = np.random.default_rng(0)
ROOTS = rng.normal(size=(4, 3, 3))
FORM = CanonicalForm((B, A), ROOTS @ ROOTS.swapaxes(-1, -2), rng.normal(size=(4, 3)), 0.3)


def test_it_is_the_product():
    belief = Gaussian((A, B), rng.normal(size=3), np.diag([0.5, 2.0, 1.0]) + 0.1)
    found, log_integral = FORM.combine(belief)
    due = FORM * CanonicalForm.from_gaussian(belief)
    assert_allclose(log_integral, due.log_integral, rtol=1e-10)
    marginal = due.rearrange((A, B)).gaussian()
    assert_allclose(found.mean, marginal.mean, atol=1e-10)
    assert_allclose(found.cov, marginal.cov, atol=1e-10)


def test_a_singular_gaussian_is_the_limit_of_regular_ones():
    line = np.array([[1.0], [2.0], [0.0]])
    exact, log_integral = FORM.combine(Gaussian((A, B), np.ones(3), line @ line.T))
    near, near_integral = FORM.combine(
        Gaussian((A, B), np.ones(3), line @ line.T + 1e-10 * np.eye(3))
    )
    assert_allclose(exact.mean, near.mean, atol=1e-7)
    assert_allclose(log_integral, near_integral, atol=1e-7)


def test_refusals():
    with pytest.raises(pgm.ModelError, match="combine takes a Gaussian over"):
        FORM.combine(Gaussian(A, [0, 0], np.eye(2)))
    with pytest.raises(pgm.NumericalError, match="no integral"):
        CanonicalForm(B, [[-2.0]], [0.0]).combine(Gaussian(B, 0.0, 1.0))
