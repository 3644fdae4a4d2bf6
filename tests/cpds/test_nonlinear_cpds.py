"""Nonlinear Gaussian CPDs and noise: declared without a call of the user's functions."""

import numpy as np
import pytest

import pgm
from pgm import NonlinearGaussianCPD

A, B, C = pgm.variables("a b c")
X = pgm.Variable("x", components=("east", "north"))
U = pgm.Variable("u", components=("v", "omega"))


def never(*arguments):
    raise AssertionError("a user's function was called while the model was declared")


def test_what_it_holds_and_that_nothing_is_called():
    cpd = NonlinearGaussianCPD(
        X,
        (X.previous, U),
        never,
        pgm.noise(never, given=(U,)),
        jacobian={U: never},
        lineariser=never,
        grouped=True,
    )
    assert cpd.child == X
    assert cpd.given == cpd.parents == (X.previous, U)
    assert cpd.noise_given == (U,)
    assert cpd.function is never
    assert dict(cpd.jacobian) == {U: never}
    assert cpd.lineariser is never
    assert cpd.grouped is True
    assert repr(cpd) == "NonlinearGaussianCPD(x | x[t-1], u)"


def test_what_is_left_out():
    cpd = NonlinearGaussianCPD(X, U, never, np.eye(2))
    assert cpd.given == (U,)
    assert dict(cpd.jacobian) == {}
    assert cpd.lineariser is None
    assert cpd.grouped is False


def test_parents_of_the_noise_alone_come_last():
    cpd = NonlinearGaussianCPD(A, (B,), never, pgm.noise(never, given=(C, B)))
    assert cpd.parents == (B, C)
    assert cpd.scope == (A, B, C)


def test_it_is_immutable():
    derivatives = {U: never}
    cpd = NonlinearGaussianCPD(X, U, never, np.eye(2), jacobian=derivatives)
    derivatives[A] = never
    assert set(cpd.jacobian) == {U}
    with pytest.raises(AttributeError, match="immutable"):
        cpd.function = never
    with pytest.raises(TypeError):
        cpd.jacobian[U] = never
    with pytest.raises(ValueError, match="read-only"):
        cpd.cov[0, 0] = 2.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"function": 3.0}, "function must be callable, not 3.0"),
        ({"function": None}, "function must be callable"),
        ({"jacobian": {U: np.eye(2)}}, "Jacobian by u must be callable"),
        ({"jacobian": {A: never}}, r"given by \[a\], not among its parents"),
        ({"jacobian": {X.previous: never}}, r"given by \[x\[t-1\]\]"),
        ({"lineariser": "taylor"}, "cannot be called"),
    ],
)
def test_what_cannot_be_called_is_refused(arguments, words):
    arguments = {"function": never, "cov": np.eye(2)} | arguments
    with pytest.raises(pgm.ModelError, match=words) as caught:
        NonlinearGaussianCPD(X, U, **arguments)
    assert "x | u" in str(caught.value)
    assert caught.value.cpd.child == X
    if "jacobian" in arguments and "among" in words:
        assert caught.value.variable == A


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ((U, U), "twice"),
        ((X,), "own parent"),
        (("u",), "variables"),
        ((U, 3), "variables"),
        ("u", "NonlinearGaussianCPD of x: given holds variables, not 'u'"),
        (3, "NonlinearGaussianCPD of x: given holds variables, not 3"),
    ],
)
def test_malformed_parents_are_refused(given_, words):
    with pytest.raises(pgm.ModelError, match=words):
        NonlinearGaussianCPD(X, given_, never, np.eye(2))


@pytest.mark.parametrize(
    ("function", "given_", "words"),
    [
        (np.eye(2), U, "takes a function"),
        (never, "u", "noise: given holds variables, not 'u'"),
        (never, 3, "noise: given holds variables, not 3"),
        (never, (U, U), "twice"),
    ],
)
def test_malformed_noise_is_refused(function, given_, words):
    with pytest.raises(pgm.ModelError, match=words):
        pgm.noise(function, given_)


def test_noise_takes_one_parent_or_several():
    assert pgm.noise(never, U).given == (U,)
    assert pgm.noise(never, [U, A]).given == (U, A)
    with pytest.raises(AttributeError):
        pgm.noise(never, U).given = ()
