"""Affine Gaussian conditionals: both directions, against densities and explicit formulas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

import pgm
from pgm import AffineGaussian, CanonicalForm, Gaussian
from tests.dense import (
    algebra,
    definite,
    linear_joint,
    matrices,
    random_covariance,
    vectors,
)

X = pgm.Variable("x", components=("east", "north", "heading"))
Y = pgm.Variable("y", components=("range", "bearing"))
P, Q = pgm.variables("p q")
NOISES = {
    "regular": np.array([[0.5, 0.2], [0.2, 0.3]]),
    "rank one": np.array([[0.5, 0.1], [0.1, 0.02]]),
    "none of one": np.array([[0.0, 0.0], [0.0, 0.3]]),
    "none": np.zeros((2, 2)),
}
noises = pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)


def affine_of(seed=0, noise=None):
    rng = np.random.default_rng(seed)
    noise = NOISES["regular"] if noise is None else noise
    return AffineGaussian(rng.normal(size=(2, 3)), rng.normal(size=2), noise)


@noises
@algebra
@given(vectors(3), matrices(3, 2))
def test_forward_is_the_childs_marginal(noise, mean, root):
    affine, cov = affine_of(noise=noise), root @ root.T  # singular
    joint = linear_joint([("y", {"x": affine.F}, affine.b, noise), ("x", {}, mean, cov)])
    child = affine.forward(Gaussian(X, mean, cov), Y)
    assert child.scope == (Y,)
    assert_allclose(child.mean, joint.marginal("y")[0], atol=1e-9)
    assert_allclose(child.cov, joint.marginal("y")[1], atol=1e-9)


@noises
@algebra
@given(vectors(2), definite(2), st.floats(-5, 5), vectors(3))
def test_backward_is_the_convolution(noise, mean, cov, weight, x):
    # exp(weight) N(y; mean, cov) against N(y; F x + b, noise) gives N(F x + b; mean, cov + noise).
    affine = affine_of(noise=noise)
    message = CanonicalForm.from_gaussian(Gaussian(Y, mean, cov), weight)
    back = affine.backward(message, X)
    density = multivariate_normal(mean, cov + noise).logpdf(affine.F @ x + affine.b)
    assert back.scope == (X,)
    assert_allclose(back.log_value(x), weight + density, atol=1e-7)


@algebra
@given(definite(2), vectors(2), st.floats(-5, 5))
def test_backward_is_the_formula_with_an_explicit_inverse(K, h, g):
    affine = affine_of()
    F, b, S = affine.F, affine.b, np.linalg.inv(affine.cov)
    # Multiply the conditional and the message over (y, x), then integrate y out.
    inner = np.linalg.inv(S + K)
    back = affine.backward(CanonicalForm(Y, K, h, g), X)
    assert_allclose(back.K, F.T @ S @ F - F.T @ S @ inner @ S @ F, atol=1e-8)
    assert_allclose(back.h, -F.T @ S @ b + F.T @ S @ inner @ (S @ b + h), atol=1e-8)
    total = S @ b + h
    log_scale = g - 0.5 * (b @ S @ b + np.linalg.slogdet(affine.cov)[1])
    log_scale += 0.5 * (total @ inner @ total - np.linalg.slogdet(S + K)[1])
    assert_allclose(back.g, log_scale, atol=1e-8)
    joined = (affine.canonical(Y, X) * CanonicalForm(Y, K, h, g)).marginalise(Y)
    for part in ("K", "h", "g"):
        assert_allclose(getattr(joined, part), getattr(back, part), atol=1e-8)


@noises
def test_backward_of_messages_about_a_part(noise):
    affine = affine_of(noise=noise)
    one_row = np.array([[2.0, 0.6], [0.6, 0.18]])  # K of rank one
    message = CanonicalForm(Y, one_row, [1.0, 0.3], 0.2)
    back = affine.backward(message, X)
    # The same, with the part of y that the message speaks of as the child: s = (1, 0.3)·y.
    row = np.array([1.0, 0.3])
    part = AffineGaussian(
        (row @ affine.F)[None], [row @ affine.b], [[row @ affine.cov @ row]]
    ).backward(CanonicalForm(P, [[2.0]], [1.0], 0.2), X)
    for name in ("K", "h", "g"):
        assert_allclose(getattr(back, name), getattr(part, name), atol=1e-12)
    nothing = affine.backward(CanonicalForm.vacuous(Y), X)
    for name in ("K", "h", "g"):
        assert_allclose(getattr(nothing, name), 0.0, atol=1e-15)


@noises
def test_backward_of_singular_noise_is_the_limit_of_small_noise(noise):
    message = CanonicalForm(Y, [[2.0, 0.5], [0.5, 1.0]], [0.3, -1.0], 0.2)
    limit = affine_of(noise=noise + 1e-10 * np.eye(2)).backward(message, X)
    back = affine_of(noise=noise).backward(message, X)
    for part in ("K", "h", "g"):
        assert_allclose(getattr(back, part), getattr(limit, part), atol=1e-7)


def test_backward_without_noise_substitutes():
    affine = affine_of(noise=np.zeros((2, 2)))
    message = CanonicalForm(Y, [[2.0, 0.5], [0.5, 1.0]], [0.3, -1.0], 0.2)
    x = np.array([0.4, -1.2, 2.0])
    back = affine.backward(message, X)
    assert_allclose(back.log_value(x), message.log_value(affine.F @ x + affine.b))


def test_backward_of_a_quotients_negative_information():
    # ∫ N(y; x, 1) exp(y²/4) dy exists: 1 + KΣ = ½.
    K, h, b = -0.5, 0.4, 0.3
    affine = AffineGaussian([[1.0]], [b], [[1.0]])
    back = affine.backward(CanonicalForm(P, [[K]], [h], 0.0), [Q])
    e = h - K * b
    assert_allclose(back.K, [[K / 0.5]])
    assert_allclose(back.h, [e / 0.5])
    assert_allclose(back.g, -0.5 * np.log(0.5) + h * b - 0.5 * K * b**2 + 0.5 * e**2 / 0.5)


def test_backward_that_diverges_raises():
    affine = AffineGaussian([[1.0]], [0.0], [[1.0]])
    with pytest.raises(pgm.NumericalError):
        affine.backward(CanonicalForm(P, [[-2.0]], [0.0]), [Q])


@algebra
@given(matrices(2, 3), vectors(2), definite(2), vectors(2), vectors(3))
def test_canonical_is_the_conditional_density(F, b, noise, y, x):
    form = AffineGaussian(F, b, noise).canonical(Y, X)
    assert form.scope == (Y, X)
    density = multivariate_normal(F @ x + b, noise).logpdf(y)
    assert_allclose(form.log_value(np.concatenate([y, x])), density, atol=1e-8)
    S = np.linalg.inv(noise)
    assert_allclose(form.K, np.block([[S, -S @ F], [-F.T @ S, F.T @ S @ F]]), atol=1e-9)
    assert_allclose(form.h, np.concatenate([S @ b, -F.T @ S @ b]), atol=1e-9)


def test_several_parents_and_children_share_the_stacked_vectors():
    affine = affine_of()
    form = affine.canonical((P, Q), (X,))
    assert form.scope == (P, Q, X)
    assert_allclose(form.K, affine.canonical(Y, X).K)
    U = pgm.Variable("u", components=("v", "omega"))
    back = affine.backward(CanonicalForm(Y, np.eye(2), [1.0, 0.0]), (U, P))
    assert back.scope == (U, P)


@pytest.mark.parametrize("name", ["rank one", "none of one", "none"])
def test_singular_noise_has_no_canonical_form(name):
    with pytest.raises(pgm.NumericalError, match="singular") as caught:
        affine_of(noise=NOISES[name]).canonical(Y, X)
    assert caught.value.variable == Y
    assert "y" in str(caught.value)


@pytest.mark.parametrize("lead", [(3,), (40,), (2, 3)])
def test_a_batch_is_its_singles(lead):
    rng = np.random.default_rng(0)
    F, b = rng.normal(size=(*lead, 2, 3)), rng.normal(size=(*lead, 2))
    noise = random_covariance(rng, 2, lead=lead) + 0.1 * np.eye(2)
    mean, cov = rng.normal(size=(*lead, 3)), random_covariance(rng, 3, 2, lead=lead)
    K, h = random_covariance(rng, 2, 1, lead=lead), rng.normal(size=(*lead, 2))
    batch = AffineGaussian(F, b, noise)
    child = batch.forward(Gaussian(X, mean, cov), Y)
    back = batch.backward(CanonicalForm(Y, K, h), X)
    form = batch.canonical(Y, X)
    for k in np.ndindex(lead):
        single = AffineGaussian(F[k], b[k], noise[k])
        one = single.forward(Gaussian(X, mean[k], cov[k]), Y)
        assert_allclose(child.mean[k], one.mean, atol=1e-12)
        assert_allclose(child.cov[k], one.cov, atol=1e-12)
        one_back = single.backward(CanonicalForm(Y, K[k], h[k]), X)
        one_form = single.canonical(Y, X)
        for part in ("K", "h", "g"):
            assert_allclose(getattr(back, part)[k], getattr(one_back, part), atol=1e-9)
            assert_allclose(getattr(form, part)[k], getattr(one_form, part), atol=1e-9)


@pytest.mark.parametrize(
    ("F", "b", "cov"),
    [
        ([1.0, 2.0], [1.0], [[1.0]]),
        (np.ones((2, 3)), np.ones(3), np.eye(2)),
        (np.ones((2, 3)), np.ones(2), np.eye(3)),
        (np.ones((2, 3)), 1.0, np.eye(2)),
        (np.ones((2, 3)), np.ones(2), np.ones(3)),
    ],
)
def test_malformed_conditionals_are_refused(F, b, cov):
    with pytest.raises(pgm.ModelError, match="must end in"):
        AffineGaussian(F, b, cov)


def test_scopes_must_fit():
    affine = affine_of()
    message = CanonicalForm.vacuous(Y)
    for ask in (
        lambda: affine.canonical(P, X),
        lambda: affine.canonical(Y, P),
        lambda: affine.backward(message, [P]),
        lambda: affine.backward(CanonicalForm.vacuous(P), X),
    ):
        with pytest.raises(pgm.ModelError, match="does not map"):
            ask()


@pytest.mark.parametrize(
    ("parent", "child"),
    [(Gaussian(X, np.zeros(3), np.eye(3)), P), (Gaussian(P, 0, 1), Y)],
)
def test_scopes_must_fit_forward(parent, child):
    with pytest.raises(pgm.ModelError, match="does not map"):
        affine_of().forward(parent, child)


def test_a_conditional_is_immutable():
    affine = affine_of()
    with pytest.raises(AttributeError, match="immutable"):
        affine.F = np.eye(2)
    for part in (affine.F, affine.b, affine.cov):
        with pytest.raises(ValueError, match="read-only"):
            part[...] = 1.0


def test_a_conditional_keeps_no_one_elses_arrays():
    F = np.ones((2, 3))
    affine = AffineGaussian(F, np.zeros(2), np.eye(2))
    F[0, 0] = 7.0
    assert affine.F[0, 0] == 1.0


def test_repr_tells_the_sizes():
    assert repr(affine_of()).splitlines()[0] == "AffineGaussian(3 -> 2)"
