"""The algebra of canonical forms, against evaluation, inversion and integration by hand."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import dblquad
from scipy.stats import multivariate_normal

import pgm
from pgm import CanonicalForm
from tests.dense import algebra, definite, random_covariance, vectors

A = pgm.Variable("a")
B = pgm.Variable("b", components=("east", "north"))
C = pgm.Variable("c")
SCOPES = [(A,), (B,), (A, B), (B, C), (C, A), (C, B, A)]


def size(scope):
    return sum(variable.dimension for variable in scope)


def stacked(scope, point):
    return np.concatenate([point[variable] for variable in scope])


@st.composite
def forms(draw, scope=None):
    scope = draw(st.sampled_from(SCOPES)) if scope is None else scope
    n = size(scope)
    return CanonicalForm(scope, draw(definite(n)), draw(vectors(n)), draw(st.floats(-5, 5)))


points = st.fixed_dictionaries({A: vectors(1), B: vectors(2), C: vectors(1)})


def log_value(form, point):
    """Evaluate ln C by the definition, whatever the order of the scope."""
    x = stacked(form.scope, point)
    return -0.5 * x @ form.K @ x + form.h @ x + form.g


def log_integral(K, h, g):
    """Integrate in closed form: ½ (n ln 2π − ln|K| + hᵀK⁻¹h) + g."""
    sign, log_det = np.linalg.slogdet(K)
    assert sign > 0
    return g + 0.5 * (len(h) * np.log(2 * np.pi) - log_det + h @ np.linalg.inv(K) @ h)


def assert_same(form, other):
    other = other.rearrange(form.scope)
    for part in ("K", "h", "g"):
        assert_allclose(getattr(form, part), getattr(other, part), rtol=1e-9, atol=1e-9)


@algebra
@given(forms(), points)
def test_log_value_is_the_definition(form, point):
    assert_allclose(form.log_value(stacked(form.scope, point)), log_value(form, point), atol=1e-9)


@algebra
@given(forms(), forms(), points)
def test_a_product_multiplies_values_and_commutes(f, g, point):
    product = f * g
    assert set(product.scope) == {*f.scope, *g.scope}
    assert_allclose(log_value(product, point), log_value(f, point) + log_value(g, point), atol=1e-9)
    assert_same(product, g * f)


@algebra
@given(forms(), forms(), forms())
def test_products_associate(f, g, h):
    assert_same((f * g) * h, f * (g * h))


@algebra
@given(forms(), forms(), points)
def test_a_quotient_undoes_a_product(f, g, point):
    quotient = (f * g) / g
    assert_allclose(log_value(quotient, point), log_value(f, point), atol=1e-9)
    assert_same(quotient, f.extend(quotient.scope))
    assert_allclose(log_value(f / g, point), log_value(f, point) - log_value(g, point), atol=1e-9)


@algebra
@given(forms((A, B)), points)
def test_a_wider_or_reordered_scope_changes_no_value(form, point):
    for scope in itertools.permutations((A, B, C)):
        wide = form.extend(scope)
        assert wide.scope == scope
        assert_allclose(log_value(wide, point), log_value(form, point), atol=1e-9)
    assert form.rearrange((B, A)).scope == (B, A)


@algebra
@given(forms((A, B, C)))
def test_marginals_are_blocks_of_the_moments(form):
    cov = np.linalg.inv(form.K)
    mean = cov @ form.h
    places = {A: [0], B: [1, 2], C: [3]}
    for keep in [(A,), (B,), (C, A), (B, C), (C, B, A)]:
        index = np.concatenate([places[variable] for variable in keep])
        marginal = form.marginal(*keep)
        assert marginal.scope == keep
        assert_allclose(np.linalg.inv(marginal.K), cov[np.ix_(index, index)], atol=1e-9)
        assert_allclose(np.linalg.solve(marginal.K, marginal.h), mean[index], atol=1e-8)
        # What is integrated out leaves the integral as it was.
        assert_allclose(
            log_integral(marginal.K, marginal.h, marginal.g),
            log_integral(form.K, form.h, form.g),
            atol=1e-8,
        )


@algebra
@given(forms((A, B, C)))
def test_variables_are_integrated_out_in_any_order(form):
    at_once = form.marginalise(A, B)
    assert_same(at_once, form.marginalise(A).marginalise(B))
    assert_same(at_once, form.marginalise(B).marginalise(A))
    assert_same(at_once, form.marginalise(B, A))
    assert_same(at_once, form.marginal(C))


@algebra
@given(forms((A, B, C)), vectors(2))
def test_reducing_and_marginalising_commute(form, value):
    assert_same(form.reduce({B: value}).marginalise(C), form.marginalise(C).reduce({B: value}))


@algebra
@given(forms((A, B, C)), points)
def test_reducing_puts_values_in(form, point):
    for seen in [(A,), (B,), (C, A), (C, B)]:
        reduced = form.reduce({variable: point[variable] for variable in seen})
        assert set(reduced.scope) == {A, B, C} - set(seen)
        assert_allclose(log_value(reduced, point), log_value(form, point), atol=1e-9)


@algebra
@given(forms(), points)
def test_nothing_left_is_a_number(form, point):
    reduced = form.reduce({variable: point[variable] for variable in form.scope})
    assert reduced.scope == ()
    assert_allclose(reduced.log_integral, log_value(form, point), atol=1e-9)
    total = form.marginalise(*form.scope)
    assert_allclose(total.g, log_integral(form.K, form.h, form.g), atol=1e-9)


@algebra
@given(forms(), points)
def test_integral_moments_and_normalisation(form, point):
    assert_allclose(form.log_integral, log_integral(form.K, form.h, form.g), atol=1e-9)
    cov = np.linalg.inv(form.K)
    gaussian = form.gaussian()
    assert gaussian.scope == form.scope
    assert_allclose(gaussian.mean, cov @ form.h, atol=1e-9)
    assert_allclose(gaussian.cov, cov, atol=1e-9)
    density = multivariate_normal(cov @ form.h, cov).logpdf(stacked(form.scope, point))
    assert_allclose(log_value(form.normalised(), point), density, atol=1e-8)
    assert_allclose(form.normalised().log_integral, 0.0, atol=1e-9)


def test_the_integral_is_that_of_quadrature():
    form = CanonicalForm(B, [[2.0, -0.7], [-0.7, 1.5]], [0.4, -1.1], 0.3)
    value, _ = dblquad(
        lambda y, x: np.exp(form.log_value([x, y])), -9, 9, -9, 9, epsabs=1e-10, epsrel=1e-10
    )
    assert_allclose(np.exp(form.log_integral), value, rtol=1e-8)


@algebra
@given(vectors(3), definite(3), st.floats(-9, 9))
def test_from_a_gaussian_and_back(mean, cov, log_weight):
    form = CanonicalForm.from_gaussian(pgm.Gaussian((A, B), mean, cov), log_weight)
    x = np.array([0.3, -1.0, 2.0])
    density = multivariate_normal(mean, cov).logpdf(x)
    assert_allclose(form.log_value(x), density + log_weight, atol=1e-8)
    assert_allclose(form.log_integral, log_weight, atol=1e-8)
    back = form.gaussian()
    assert_allclose(back.mean, mean, atol=1e-8)
    assert_allclose(back.cov, cov, atol=1e-8)


@algebra
@given(vectors(3), definite(3), vectors(2))
def test_reducing_a_density_gives_that_of_the_evidence_and_the_conditional(mean, cov, value):
    form = CanonicalForm.from_gaussian(pgm.Gaussian((A, B), mean, cov)).reduce({B: value})
    density = multivariate_normal(mean[1:], cov[1:, 1:]).logpdf(value)
    assert_allclose(form.log_integral, density, atol=1e-8)
    gain = cov[:1, 1:] @ np.linalg.inv(cov[1:, 1:])
    assert_allclose(form.gaussian().mean, mean[:1] + gain @ (value - mean[1:]), atol=1e-8)
    assert_allclose(form.gaussian().cov, cov[:1, :1] - gain @ cov[1:, :1], atol=1e-8)


@pytest.mark.parametrize("lead", [(3,), (40,), (2, 3)])
def test_a_batch_is_its_singles(lead):
    rng = np.random.default_rng(1)

    def draw(scope):
        n = size(scope)
        K = random_covariance(rng, n, lead=lead) + np.eye(n)
        return CanonicalForm(scope, K, rng.normal(size=(*lead, n)), rng.normal(size=lead))

    f, g = draw((A, B)), draw((B, C))
    value = rng.normal(size=(*lead, 2))
    batch = {
        "product": f * g,
        "quotient": f / g,
        "marginal": (f * g).marginal(C, A),
        "reduced": (f * g).reduce({B: value}),
        "normalised": f.normalised(),
    }
    for k in np.ndindex(lead):
        one, other = (CanonicalForm(form.scope, form.K[k], form.h[k], form.g[k]) for form in (f, g))
        single = {
            "product": one * other,
            "quotient": one / other,
            "marginal": (one * other).marginal(C, A),
            "reduced": (one * other).reduce({B: value[k]}),
            "normalised": one.normalised(),
        }
        for name, form in batch.items():
            assert_same(single[name], CanonicalForm(form.scope, form.K[k], form.h[k], form.g[k]))
        assert_allclose(f.gaussian().mean[k], one.gaussian().mean, atol=1e-10)
        assert_allclose(f.log_integral[k], one.log_integral, atol=1e-10)


def test_leading_axes_broadcast():
    f = CanonicalForm(A, np.ones((4, 1, 1, 1)), np.zeros((1, 3, 1)), 0.5)
    assert f.K.shape == (4, 3, 1, 1)
    assert f.h.shape == (4, 3, 1)
    assert f.g.shape == (4, 3)
    product = f * CanonicalForm(A, [[2.0]], [1.0])
    assert_allclose(product.K, np.full((4, 3, 1, 1), 3.0))
    assert_allclose(product.g, np.full((4, 3), 0.5))
    many = CanonicalForm((A, B), np.eye(3), np.ones(3)).reduce({B: np.arange(10.0).reshape(5, 2)})
    assert many.g.shape == (5,)
    assert_allclose(many.g[2], 4 + 5 - 0.5 * (4**2 + 5**2))


def test_a_vacuous_factor_is_one():
    one = CanonicalForm.vacuous((A, B))
    assert one.log_value(np.array([3.0, -2.0, 7.0])) == 0.0
    f = CanonicalForm((B, A), 2 * np.eye(3), np.ones(3), 0.1)
    assert_same(f, f * one)
    assert_same(f, f / one)
