"""Robust noise: densities against quadrature and SciPy, weights, refusals."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats
from scipy.integrate import quad
from scipy.special import gamma

import pgm

X, Z = pgm.Variable("x"), pgm.Variable("z", components=("a", "b"))
PROPER = [pgm.StudentT(3.0), pgm.Huber(1.345), pgm.Cauchy(2.385)]
EVERY = [*PROPER, pgm.Cauchy(0.7), pgm.TruncatedLeastSquares(2.0)]
COV = np.array([[2.0, 0.5], [0.5, 1.0]])


def sensor(noise, cov=COV):
    return pgm.LinearGaussianCPD(Z, given={X: [[1.0], [2.0]]}, cov=cov, noise=noise)


def mass(noise, size, end):
    """The probability of a square below end², by quadrature over the radius."""
    sphere = 2.0 * np.pi ** (size / 2) / gamma(size / 2)

    def density(r):
        return sphere * r ** (size - 1) * np.exp(noise.log_scale(size) - noise.loss(r * r, size))

    return quad(density, 0.0, end)[0]


@pytest.mark.parametrize("noise", PROPER, ids=repr)
@pytest.mark.parametrize("size", [1, 2, 3])
def test_densities_integrate_to_one(noise, size):
    assert mass(noise, size, np.inf) == pytest.approx(1.0, abs=1e-7)


def test_densities_of_student_and_cauchy_are_those_of_scipy():
    z = 4.0 * np.random.default_rng(1).normal(size=(7, 2))
    for noise, dof, scale in [
        (pgm.StudentT(3.0), 3.0, 1.0),
        (pgm.Cauchy(2.0), 2.0, 2.0),  # k² − d degrees of freedom, scale k²/ν
    ]:
        expected = stats.multivariate_t([1.0, 2.0], scale * COV, df=dof).logpdf(z)
        np.testing.assert_allclose(sensor(noise).log_density(z, {X: 1.0}), expected, rtol=1e-12)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_densities_of_many_degrees_of_freedom_go_over_into_the_gaussian(size):
    """Differences of logarithms of Γ lose all digits there."""
    gaussian = -0.5 * size * np.log(2.0 * np.pi)
    for noise, far in [(pgm.StudentT(1e4), 1e-3), (pgm.Cauchy(1e3), 1e-5)]:
        assert noise.log_scale(size) == pytest.approx(gaussian, abs=far)
    for large in (1e12, 1e16, 1e25, 1e50):
        assert pgm.StudentT(large).log_scale(size) == pytest.approx(gaussian, abs=1e-10)
        assert pgm.Cauchy(large).log_scale(size) == pytest.approx(gaussian, abs=1e-10)
    with mpmath.workdps(40):
        half = mpmath.mpf(size) / 2
        for dof in (1e-3, 7.0, 1e6, 1e9):
            exact = mpmath.loggamma(dof / 2 + half) - mpmath.loggamma(mpmath.mpf(dof) / 2)
            exact -= half * mpmath.log(mpmath.pi * dof)
            assert pgm.StudentT(dof).log_scale(size) == pytest.approx(float(exact), abs=1e-8)


@pytest.mark.parametrize("noise", PROPER, ids=repr)
def test_draws_have_the_density(noise):
    drawn = sensor(noise).sample({X: 1.0}, size=20_000, rng=2) - [1.0, 2.0]
    white = np.linalg.solve(np.linalg.cholesky(COV), drawn.T)
    for end in (0.5, 1.5, 4.0):
        share = np.mean((white**2).sum(axis=0) < end * end)
        assert share == pytest.approx(mass(noise, 2, end), abs=0.015)
    assert abs(np.mean(np.sign(white[0]))) < 0.03


@pytest.mark.parametrize("noise", PROPER, ids=repr)
def test_a_missing_component_is_left_out(noise):
    alone = pgm.Variable("alone")
    single = pgm.LinearGaussianCPD(alone, given={X: 1.0}, cov=2.0, noise=noise)
    one = single.log_density([3.0], {X: 1.0})
    assert sensor(noise).log_density([3.0, np.nan], {X: 1.0}) == pytest.approx(one)
    assert sensor(noise).log_density([np.nan, np.nan], {X: 1.0}) == 0.0


@pytest.mark.parametrize("noise", EVERY, ids=repr)
@given(at=st.floats(0.0, 1e4), other=st.floats(0.0, 1e4))
def test_tangents_lie_above_the_loss(noise, at, other):
    loss, weight = (float(f(np.array(at), 2)) for f in (noise.loss, noise.weight))
    assert float(noise.loss(np.array(other), 2)) <= loss + 0.5 * weight * (other - at) + 1e-7


def test_stages_of_a_graduated_loss_have_the_weights_of_their_slopes():
    noise, square = pgm.TruncatedLeastSquares(2.0), np.linspace(0.01, 30.0, 301)
    for mu in (0.1, 1.0, 7.0):
        stage, step = np.array(mu), 1e-5
        loss = [noise.staged_loss(square + way * step, stage) for way in (1, -1)]
        slope = (loss[0] - loss[1]) / step
        np.testing.assert_allclose(noise.staged(square, stage), slope, atol=1e-6)
    hard = noise.staged(square, np.array(np.inf))
    np.testing.assert_allclose(hard, noise.weight(square, 2))


@pytest.mark.parametrize("kind", [pgm.StudentT, pgm.Huber, pgm.Cauchy, pgm.TruncatedLeastSquares])
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan, "much", None, True])
def test_parameters_that_are_none_are_refused(kind, value):
    with pytest.raises(pgm.ModelError, match=f"{kind.__name__}.*positive number"):
        kind(value)


def test_noise_of_no_kind_and_singular_noise_are_refused():
    with pytest.raises(pgm.ModelError, match=r"z \| x.*noise is robust noise.*cov="):
        sensor(0.5)
    for cov in ([1.0, 0.0], np.ones((2, 2))):
        with pytest.raises(pgm.ModelError, match=r"StudentT.*singular"):
            sensor(pgm.StudentT(3.0), cov)
    dependent = pgm.noise(lambda x: np.zeros((*x.shape[:-1], 2)), X, diagonal=True)
    with pytest.raises(pgm.ModelError, match="singular"):
        sensor(pgm.StudentT(3.0), dependent).log_density([0.0, 0.0], {X: 1.0})


@pytest.mark.parametrize("noise", [pgm.TruncatedLeastSquares(2.0), pgm.Cauchy(1.0)], ids=repr)
def test_improper_densities_are_neither_drawn_nor_evaluated(noise):
    with pytest.raises(pgm.ModelError, match="improper"):
        sensor(noise).log_density([0.0, 0.0], {X: 1.0})
    with pytest.raises(pgm.ModelError, match="improper"):
        sensor(noise).sample({X: 1.0}, rng=0)


def test_a_cpd_shows_its_noise():
    assert "noise: StudentT(dof=3.0)" in str(sensor(pgm.StudentT(3.0)))


@pytest.mark.parametrize("kind", [pgm.StudentT, pgm.Huber, pgm.Cauchy, pgm.TruncatedLeastSquares])
@pytest.mark.parametrize("value", [1e-200, 1e200])
def test_parameters_whose_squares_are_no_numbers_are_refused(kind, value):
    with pytest.raises(pgm.ModelError, match=f"{kind.__name__}.* between 1e-50 and 1e.50"):
        kind(value)


@given(dof=st.floats(0.5, 30.0), size=st.integers(1, 6), length=st.floats(-3.0, 5.0))
def test_student_noise_is_a_mixture_of_scales(dof, size, length):
    """To a relative error of 1e-6, however far off the residual is."""
    noise, square = pgm.StudentT(dof), 10.0 ** (2.0 * length)
    weights, factors = noise.scales(size)
    logs = np.log(weights) - 0.5 * size * np.log(2.0 * np.pi * factors) - 0.5 * square / factors
    due = noise.log_scale(size) - noise.loss(np.array(square), size)
    assert_allclose(np.logaddexp.reduce(logs), due, atol=5e-6)


@given(scale=st.floats(1.3, 5.0), length=st.floats(-3.0, 5.0))
def test_the_cauchy_loss_of_a_scalar_is_a_mixture_of_scales(scale, length):
    noise, square = pgm.Cauchy(scale), 10.0 ** (2.0 * length)
    weights, factors = noise.scales(1)
    logs = np.log(weights) - 0.5 * np.log(2.0 * np.pi * factors) - 0.5 * square / factors
    due = noise.log_scale(1) - noise.loss(np.array(square), 1)
    assert_allclose(np.logaddexp.reduce(logs), due, atol=5e-6)
    assert noise.scales(2) is None
    assert pgm.Huber(scale).scales(1) is None
