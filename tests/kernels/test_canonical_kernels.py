"""The canonical form on arrays, against explicit inverses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from pgm.kernels import canonical
from tests.dense import algebra, definite, matrices, random_covariance, vectors

scalars = st.floats(-5.0, 5.0)


def log_value(form, x):
    K, h, g = form
    return -0.5 * x @ K @ x + h @ x + g


@algebra
@given(vectors(3), definite(3), scalars, vectors(3))
def test_from_moments_and_back(mean, cov, weight, x):
    form = canonical.from_moments(mean, cov, np.array(weight))
    density = multivariate_normal(mean, cov).logpdf(x)
    assert_allclose(log_value(form, x), weight + density, atol=1e-8)
    for found, expected in zip(canonical.to_moments(*form), (mean, cov, weight), strict=True):
        assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
@algebra
@given(matrices(3, 3), vectors(3), matrices(3, 2), vectors(3), scalars)
def test_combining_a_singular_density_with_information(rank, root, mean, factor, h, g):
    root = root[:, :rank]
    cov, K = root @ root.T, factor @ factor.T
    found = canonical.combine(mean, cov, K, h, np.array(g))
    inverse = np.linalg.inv(np.eye(3) + cov @ K)
    e = h - K @ mean
    posterior = inverse @ cov
    assert_allclose(found[1], posterior, atol=1e-7)
    assert_allclose(found[0], mean + posterior @ e, atol=1e-7)
    # Over x = mean + L s with s ~ N(0, I): integrate exp(−½ sᵀ(I + LᵀKL)s + eᵀL s).
    inside = np.eye(rank) + root.T @ K @ root
    pull = root.T @ e
    expected = g + h @ mean - 0.5 * mean @ K @ mean
    expected += 0.5 * (pull @ np.linalg.inv(inside) @ pull - np.linalg.slogdet(inside)[1])
    assert_allclose(found[2], expected, atol=1e-6)


@algebra
@given(vectors(2), definite(2), definite(2), vectors(2), scalars)
def test_combining_is_multiplying_and_integrating(mean, cov, K, h, g):
    product = [
        a + b
        for a, b in zip(canonical.from_moments(mean, cov, np.zeros(())), (K, h, g), strict=True)
    ]
    expected = canonical.to_moments(*product)
    found = canonical.combine(mean, cov, K, h, np.array(g))
    for a, b in zip(found, expected, strict=True):
        assert_allclose(a, b, atol=1e-7)


@pytest.mark.parametrize("rank", [0, 1, 2])
@algebra
@given(matrices(2, 3), vectors(2), matrices(2, 2), matrices(2, 2), vectors(2), scalars)
def test_backward_is_the_formula_of_the_mathematics(rank, F, b, root, factor, h, g):
    root = root[:, :rank]
    noise, K = root @ root.T, factor @ factor.T
    M = np.eye(2) + K @ noise
    inverse = np.linalg.inv(M)
    e = h - K @ b
    found = canonical.backward(F, b, noise, K, h, np.array(g))
    expected = g - 0.5 * np.linalg.slogdet(M)[1] + h @ b - 0.5 * b @ K @ b
    expected += 0.5 * e @ noise @ inverse @ e
    assert_allclose(found[0], F.T @ inverse @ K @ F, atol=1e-6)
    assert_allclose(found[1], F.T @ inverse @ e, atol=1e-6)
    assert_allclose(found[2], expected, atol=1e-6)


@pytest.mark.parametrize(("sharp", "vague"), [(1e4, 1e4), (1e6, 1e6), (1e12, 1e6)])
def test_backward_of_vague_noise_after_a_sharp_message_costs_no_digits(sharp, vague):
    # A position at 3 known to 1/sharp, then a motion of variance `vague`.
    K, noise = np.array([[sharp]]), np.array([[vague]])
    found = canonical.backward(np.eye(1), np.zeros(1), noise, K, 3.0 * K[0], np.zeros(()))
    assert_allclose(found[0], 1.0 / (vague + 1.0 / sharp), rtol=1e-12)
    assert_allclose(found[1] / found[0][0], 3.0, rtol=1e-9)


@algebra
@given(matrices(2, 3), vectors(2), definite(2), vectors(5))
def test_from_affine_is_the_conditional_density(F, b, noise, yx):
    form = canonical.from_affine(F, b, noise)
    density = multivariate_normal(F @ yx[2:] + b, noise).logpdf(yx[:2])
    assert_allclose(log_value(form, yx), density, atol=1e-7)


@algebra
@given(definite(2), vectors(2), scalars, vectors(2), vectors(2))
def test_shifting_moves_the_origin(K, h, g, by, y):
    shifted = canonical.shift(K, h, np.array(g), by)
    assert_allclose(log_value(shifted, y + by), log_value((K, h, g), y), atol=1e-9)


@algebra
@given(definite(4), vectors(4), scalars)
def test_marginalising_and_reducing_at_any_places(K, h, g):
    keep, drop = np.array([3, 0]), np.array([1, 2])
    found = canonical.marginalise(K, h, np.array(g), keep, drop)
    cov = np.linalg.inv(K)
    assert_allclose(np.linalg.inv(found[0]), cov[np.ix_(keep, keep)], atol=1e-8)
    assert_allclose(np.linalg.solve(found[0], found[1]), (cov @ h)[keep], atol=1e-7)
    as_slices = canonical.marginalise(K, h, np.array(g), slice(0, 2), slice(2, 4))
    assert_allclose(np.linalg.inv(as_slices[0]), cov[:2, :2], atol=1e-8)
    value, rest = np.array([0.5, -1.0]), np.array([2.0, 0.25])
    reduced = canonical.reduce(K, h, np.array(g), keep, drop, value)
    whole = np.array([rest[1], value[0], value[1], rest[0]])
    assert_allclose(log_value(reduced, rest), log_value((K, h, g), whole), atol=1e-9)


SINGULAR = np.ones((2, 2))
ZERO = np.zeros(())


@pytest.mark.parametrize(
    "form",
    [
        lambda: canonical.from_moments(np.zeros(2), SINGULAR, ZERO),
        lambda: canonical.to_moments(SINGULAR, np.zeros(2), ZERO),
        lambda: canonical.marginalise(
            np.zeros((2, 2)), np.zeros(2), ZERO, slice(0, 1), slice(1, 2)
        ),
        lambda: canonical.from_affine(np.ones((2, 1)), np.zeros(2), SINGULAR),
        lambda: canonical.from_affine(np.ones((2, 1)), np.zeros(2), np.diag([1.0, -1.0])),
    ],
)
def test_what_does_not_exist_is_nan(form):
    assert np.isnan(form()[2])


@pytest.mark.parametrize("lead", [3, 40])
def test_batches_are_their_singles(lead):
    rng = np.random.default_rng(0)
    mean, cov = rng.normal(size=(lead, 3)), random_covariance(rng, 3, 2, lead=(lead,))
    K, h = random_covariance(rng, 3, 1, lead=(lead,)), rng.normal(size=(lead, 3))
    F, g = rng.normal(size=(lead, 3, 2)), rng.normal(size=lead)
    combined = canonical.combine(mean, cov, K, h, g)
    back = canonical.backward(F, mean, cov, K, h, g)
    for k in range(lead):
        one = canonical.combine(mean[k], cov[k], K[k], h[k], g[k])
        one_back = canonical.backward(F[k], mean[k], cov[k], K[k], h[k], g[k])
        for part in range(3):
            assert_allclose(combined[part][k], one[part], atol=1e-8)
            assert_allclose(back[part][k], one_back[part], atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_moments_of_forms_with_flat_directions(seed):
    """Where x_2 and x_3 are known by their difference alone, x_0 and x_1 have their moments."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((2, 4, 4))
    rows[:, :3, :2] = rng.normal(size=(2, 3, 2))
    rows[:, 3, 2:] = 1e4, -1e4
    units = np.array([1.0, 1e5, 1.0, 1.0])
    precision = rows.mT @ rows * units[:, None] * units
    h = rng.normal(size=(2, 4, 3)) * units[:, None]
    h[:, 2:] = [[1.0], [-1.0]]
    mean, cov, loose = canonical.determined_moments(precision, h)
    assert loose.tolist() == [[False, False, True, True]] * 2
    due = np.linalg.inv(precision[:, :2, :2])
    assert_allclose(cov[:, :2, :2], due, rtol=1e-8)
    assert_allclose(mean[:, :2], due @ h[:, :2], rtol=1e-8)
