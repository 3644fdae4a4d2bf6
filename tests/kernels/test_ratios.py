"""Ratios of Gaussians given more evidence, multiplied into others: against information forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pgm.kernels.merging import Ratio


def covariance(rng, n, rank=None):
    root = rng.standard_normal((n, rank or n))
    return root @ root.T


@pytest.mark.parametrize("seed", range(6))
def test_a_ratio_adds_the_information_that_it_is_of(seed):
    """Three components measured by one or two numbers; into Gaussians within the known one."""
    rng = np.random.default_rng(seed)
    n, d = 3, 1 + seed % 2
    a, V = 10.0 * rng.standard_normal(n), covariance(rng, n) + np.eye(n)
    h, r = rng.standard_normal((d, n)), 0.1 * np.eye(d)
    z = h @ a + rng.standard_normal(d)
    gain = V @ h.T @ np.linalg.inv(h @ V @ h.T + r)
    later = a + gain @ (z - h @ a), V - gain @ h @ V
    m, P = a + rng.standard_normal(n), 0.3 * V + 0.1 * covariance(rng, n)
    found = Ratio.of(later, (a, V)).taken(m, P)
    gain = P @ h.T @ np.linalg.inv(h @ P @ h.T + r)
    assert_allclose(found[0], m + gain @ (z - h @ m), atol=1e-9)
    assert_allclose(found[1], P - gain @ h @ P, atol=1e-9)


def test_exact_readings_and_what_is_known_already():
    """A component read without noise; one without variance, and one that nothing was said of."""
    V = np.diag([4.0, 0.0, 1.0])
    ratio = Ratio.of(
        (np.array([3.0, 5.0, 0.0]), np.diag([0.0, 0.0, 1.0])), (np.array([0, 5.0, 0]), V)
    )
    mean, cov = ratio.taken(np.array([1.0, 5.0, 0.5]), np.diag([2.0, 0.0, 0.25]))
    assert_allclose(mean, [3.0, 5.0, 0.5], atol=1e-12)
    assert_allclose(cov, np.diag([0.0, 0.0, 0.25]), atol=1e-12)
