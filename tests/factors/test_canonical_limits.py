"""Canonical forms: what does not exist, what is malformed, and that nothing changes them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm import CanonicalForm

A = pgm.Variable("a")
B = pgm.Variable("b", components=("east", "north"))
C = pgm.Variable("c")


@pytest.mark.parametrize(
    "K",
    [
        np.zeros((3, 3)),  # vacuous
        np.diag([1.0, 1.0, 0.0]),
        np.diag([1.0, 1.0, -1.0]),
        np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0]]),
        np.array([[1.0, 0.0, 0.0], [0.0, 1e8, 1e4], [0.0, 1e4, 1.0]]),  # the same in other units
        np.diag([1.0, 1.0, 1.0]) - 0.9,
    ],
)
def test_what_does_not_exist_raises(K):
    form = CanonicalForm((A, B), K, np.zeros(3))
    for ask in (
        lambda: form.marginalise(B),
        lambda: form.gaussian(),
        lambda: form.log_integral,
        lambda: form.normalised(),
    ):
        with pytest.raises(pgm.NumericalError, match="positive definite") as caught:
            ask()
        assert "b" in str(caught.value)
        assert isinstance(caught.value, ArithmeticError)


def test_one_improper_form_of_a_batch_raises():
    K = np.ones((20, 1, 1))
    K[7] = 0.0
    with pytest.raises(pgm.NumericalError):
        _ = CanonicalForm(A, K, np.zeros((20, 1))).log_integral


def test_an_improper_form_may_be_integrated_where_it_is_proper():
    form = CanonicalForm((A, C), [[1.0, -1.0], [-1.0, 1.0]], [0.0, 0.0])  # a − c ~ N(0, 1)
    rest = form.marginalise(A)
    assert_allclose(rest.K, 0.0, atol=1e-15)
    assert_allclose(rest.h, 0.0, atol=1e-15)
    assert_allclose(rest.g, 0.5 * np.log(2 * np.pi))
    with pytest.raises(pgm.NumericalError):
        rest.marginalise(C)


@pytest.mark.parametrize("cov", [np.zeros((2, 2)), np.ones((2, 2)), [[4e8, 2e4], [2e4, 1.0]]])
def test_a_singular_gaussian_has_no_canonical_form(cov):
    with pytest.raises(pgm.NumericalError, match="singular"):
        CanonicalForm.from_gaussian(pgm.Gaussian(B, [0, 0], cov))


@pytest.mark.parametrize(
    ("K", "h", "g", "words"),
    [
        (np.eye(3), [0, 0], 0, "shape"),
        (np.eye(2), [0, 0, 0], 0, "shape"),
        ([1, 1], [0, 0], 0, "shape"),
        ([[1, 0.1], [0, 1]], [0, 0], 0, "not symmetric"),
        ([[np.nan, 0], [0, 1]], [0, 0], 0, "finite"),
        (np.eye(2), [0, np.inf], 0, "finite"),
        (np.eye(2), [0, 0], -np.inf, "finite"),
        (np.ones((2, 2, 2)), np.zeros((3, 2)), 0, "broadcast"),
        (np.eye(2), np.zeros((3, 2)), np.zeros(2), "broadcast"),
    ],
)
def test_malformed_forms_are_refused(K, h, g, words):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        CanonicalForm(B, K, h, g)
    assert "(b)" in str(caught.value)


def test_scopes_that_do_not_fit_are_refused():
    form = CanonicalForm((A, B), np.eye(3), np.zeros(3))
    with pytest.raises(pgm.ModelError, match=r"lacks \(b\)"):
        form.extend((A, C))
    for ask in (
        lambda: form.marginal(C),
        lambda: form.marginalise(C),
        lambda: form.reduce({C: 1.0}),
    ):
        with pytest.raises(pgm.ModelError, match="not in the scope") as caught:
            ask()
        assert caught.value.variable == C
    with pytest.raises(pgm.ModelError, match="shape") as caught:
        form.reduce({B: [1.0]})
    assert caught.value.variable == B
    with pytest.raises(pgm.ModelError, match="twice"):
        CanonicalForm((A, A), np.eye(2), np.zeros(2))
    with pytest.raises(pgm.ModelError, match="variables"):
        CanonicalForm(("a",), np.eye(1), np.zeros(1))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_only_finite_values_are_put_in(value):
    with pytest.raises(pgm.PgmError):
        CanonicalForm((A, B), np.eye(3), np.zeros(3)).reduce({B: [value, 0.0]})


def test_a_factor_is_multiplied_with_factors_alone():
    form = CanonicalForm.vacuous(A)
    with pytest.raises(TypeError):
        _ = form * 2.0
    with pytest.raises(TypeError):
        _ = form / 2.0


def test_a_form_is_immutable_and_keeps_no_one_elses_arrays():
    K, h = np.eye(1), np.zeros(1)
    form = CanonicalForm(A, K, h)
    K[0, 0], h[0] = 7.0, 7.0
    assert form.K == 1.0
    assert form.h == 0.0
    with pytest.raises(AttributeError, match="immutable"):
        form.K = K
    for part in (form.K, form.h, form.g, (form * form).K, form.reduce({}).K):
        with pytest.raises(ValueError, match="read-only"):
            part[...] = 1.0


def test_repr_tells_scope_and_batch():
    assert repr(CanonicalForm.vacuous((A, B))).splitlines()[0] == "CanonicalForm(a, b)"
    assert "(4,)" in repr(CanonicalForm(A, np.ones((4, 1, 1)), [0.0]))
