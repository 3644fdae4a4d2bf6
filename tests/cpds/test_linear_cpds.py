"""Gaussian and linear Gaussian CPDs: what they hold, and what they refuse."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm import GaussianCPD, LinearGaussianCPD

A, B, C = pgm.variables("a b c")
X = pgm.Variable("x", components=("east", "north"))
U = pgm.Variable("u", components=("v", "omega"))


def test_a_gaussian_cpd():
    cpd = GaussianCPD(X, mean=[1, 2], cov=[[2, 1], [1, 3]])
    assert cpd.child == X
    assert cpd.given == cpd.parents == cpd.noise_given == ()
    assert cpd.scope == (X,)
    assert_array_equal(cpd.mean, [1.0, 2.0])
    assert_array_equal(cpd.cov, [[2.0, 1.0], [1.0, 3.0]])
    assert cpd.cov.dtype == float


def test_python_numbers_are_scalars():
    cpd = GaussianCPD(A, mean=3, cov=2)
    assert_array_equal(cpd.mean, [3.0])
    assert_array_equal(cpd.cov, [[2.0]])
    linear = LinearGaussianCPD(A, given={B: 2, C: -1}, offset=1, cov=0)
    assert_array_equal(linear.matrices[B], [[2.0]])
    assert_array_equal(linear.offset, [1.0])
    assert_array_equal(linear.cov, [[0.0]])


def test_means_and_covariances_of_runs():
    cpd = GaussianCPD(X, mean=np.zeros((5, 2)), cov=np.ones((5, 1, 1)) * np.eye(2))
    assert cpd.mean.shape == (5, 2)
    assert cpd.cov.shape == (5, 2, 2)


@pytest.mark.parametrize("cov", [np.zeros((2, 2)), np.ones((2, 2))])
def test_singular_covariances_are_ordinary(cov):
    assert_array_equal(GaussianCPD(X, [0, 0], cov).cov, cov)
    assert_array_equal(LinearGaussianCPD(X, {U: 1.0}, cov=cov).cov, cov)


def test_a_linear_cpd():
    F = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    Y = pgm.Variable("y", components=("i", "j", "k"))
    cpd = LinearGaussianCPD(Y, given={X: F, A: [[1], [0], [2]]}, offset=[7, 8, 9], cov=np.eye(3))
    assert cpd.given == cpd.parents == (X, A)
    assert cpd.scope == (Y, X, A)
    assert_array_equal(cpd.matrices[X], F)
    assert_array_equal(cpd.matrices[A], [[1.0], [0.0], [2.0]])
    assert_array_equal(cpd.offset, [7.0, 8.0, 9.0])


def test_a_number_is_a_multiple_of_the_identity():
    cpd = LinearGaussianCPD(U, given={X: -2.0}, offset=3.0, cov=np.eye(2))
    assert_array_equal(cpd.matrices[X], -2.0 * np.eye(2))
    assert_array_equal(cpd.offset, [3.0, 3.0])
    assert_array_equal(LinearGaussianCPD(U, given={X: 1.0}, cov=np.eye(2)).offset, [0.0, 0.0])


def test_the_step_before_is_another_variable():
    cpd = LinearGaussianCPD(X, given={X.previous: 1.0}, cov=np.eye(2))
    assert cpd.scope == (X, X.previous)


def test_noise_of_a_parent():
    noise = pgm.noise(lambda u: u[..., :1, None] * np.eye(2), given=U)
    cpd = LinearGaussianCPD(X, given={X.previous: 1.0}, cov=noise)
    assert cpd.given == (X.previous,)
    assert cpd.noise_given == (U,)
    assert cpd.scope == (X, X.previous, U)
    both = LinearGaussianCPD(X, given={U: 1.0, A: np.ones((2, 1))}, cov=noise)
    assert both.parents == (U, A)


def test_reprs_are_densities():
    assert repr(GaussianCPD(X, [0, 0], np.eye(2))) == "GaussianCPD(x)"
    linear = LinearGaussianCPD(X, {X.previous: 1.0, U: 1.0}, cov=np.eye(2))
    assert repr(linear) == "LinearGaussianCPD(x | x[t-1], u)"


def test_cpds_are_immutable_and_keep_no_one_elses_arrays():
    mean, F, given_ = np.zeros(2), np.eye(2), {}
    given_[U] = F
    prior = GaussianCPD(X, mean, np.eye(2))
    linear = LinearGaussianCPD(X, given_, offset=mean, cov=F)
    mean[0], F[0, 0] = 7.0, 7.0
    given_[A] = np.ones((2, 1))
    assert_allclose(prior.mean, 0.0)
    assert_allclose(linear.offset, 0.0)
    assert_allclose(linear.matrices[U], np.eye(2))
    assert_allclose(linear.cov, np.eye(2))
    assert linear.given == (U,)
    for cpd in (prior, linear):
        with pytest.raises(AttributeError, match="immutable"):
            cpd.cov = np.eye(2)
    for part in (prior.mean, prior.cov, linear.offset, linear.cov, linear.matrices[U]):
        with pytest.raises(ValueError, match="read-only"):
            part[...] = 1.0
    with pytest.raises(TypeError):
        linear.matrices[A] = np.ones((2, 1))


COVARIANCES = [
    (np.eye(3), r"shape \(3, 3\).*need \(2, 2\)"),
    ([1.0, 1.0, 1.0], "shape"),
    (-1.0, "negative"),
    ([[1.0, 2.0], [2.0, 1.0]], "negative"),
    (-np.eye(2), "negative"),
    ([[1.0, 0.2], [0.0, 1.0]], "not symmetric"),
    ([[np.nan, 0.0], [0.0, 1.0]], "NaN or infinite"),
    ([[-np.inf, 0.0], [0.0, 1.0]], "NaN or infinite"),
    ([[1.0, np.inf], [np.inf, 1.0]], "NaN or infinite"),
    ([[np.inf, 0.5], [0.5, 1.0]], "NaN or infinite|infinite variance has a covariance"),
    ([[np.inf, np.nan], [np.nan, 1.0]], "NaN or infinite|infinite variance has a covariance"),
    ([[np.inf, 0.0], [0.0, np.nan]], "NaN or infinite"),
    ("white", "must be numbers"),
    (None, "NaN or infinite|must be numbers|shape"),
]


@pytest.mark.parametrize(("cov", "words"), COVARIANCES)
@pytest.mark.parametrize(
    "make",
    [
        lambda cov: GaussianCPD(X, [0, 0], cov),
        lambda cov: LinearGaussianCPD(X, {U: 1.0}, cov=cov),
        lambda cov: pgm.NonlinearGaussianCPD(X, U, np.sin, cov),
    ],
)
def test_malformed_covariances_are_refused(make, cov, words):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        make(cov)
    assert caught.value.variable == X
    assert "x" in str(caught.value)


@pytest.mark.parametrize("cov", [np.diag([np.inf, 1.0]), np.diag([np.inf, np.inf])])
def test_only_a_prior_may_be_flat(cov):
    assert_array_equal(GaussianCPD(X, [0, 0], cov).cov, cov)
    with pytest.raises(pgm.ModelError, match="NaN or infinite"):
        LinearGaussianCPD(X, {U: 1.0}, cov=cov)
    with pytest.raises(pgm.ModelError, match="NaN or infinite"):
        pgm.NonlinearGaussianCPD(X, U, np.sin, cov)


@pytest.mark.parametrize("cov", [np.diag([1e6, -1e-5]), [[1e6, 2.0], [2.0, 1e-6]]])
def test_the_units_of_one_component_do_not_excuse_another(cov):
    with pytest.raises(pgm.ModelError, match="negative"):
        GaussianCPD(X, [0, 0], cov)


def test_one_run_does_not_excuse_another():
    with pytest.raises(pgm.ModelError, match="negative"):
        GaussianCPD(A, 0, [[[1e12]], [[-1.0]]])


@pytest.mark.parametrize("cov", [np.ones((3, 1, 1)), np.ones((1, 1, 1))])
def test_only_priors_have_covariances_by_run(cov):
    """Elsewhere the axis in front is of steps, which a network without time does not have."""
    cpd = LinearGaussianCPD(A, {B: 1.0}, cov=cov)
    assert cpd.steps == len(cov)
    with pytest.raises(pgm.ModelError, match=f"each of the steps 1..{len(cov)}, and a network wi"):
        pgm.BayesianNetwork([GaussianCPD(B, 0.0, 1.0), cpd])
    with pytest.raises(pgm.ModelError, match="shape"):
        LinearGaussianCPD(A, {B: 1.0}, cov=cov[None])


@pytest.mark.parametrize(
    ("mean", "words"),
    [
        ([0.0], "shape"),
        (0.0, "shape"),
        ([0.0, 0.0, 0.0], "shape"),
        ([0.0, np.nan], "NaN or infinite"),
        ([0.0, np.inf], "NaN or infinite"),
        (["here", "there"], "must be numbers"),
    ],
)
def test_malformed_means_are_refused(mean, words):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        GaussianCPD(X, mean, np.eye(2))
    assert caught.value.variable == X


def test_leading_axes_must_broadcast():
    with pytest.raises(pgm.ModelError):
        GaussianCPD(A, np.zeros((2, 1)), np.ones((3, 1, 1)))


@pytest.mark.parametrize(
    ("given_", "words", "variable"),
    [
        ({U: np.eye(3)}, "shape", U),
        ({A: 1.0}, "shape", A),  # no number maps a scalar to two components
        ({A: [1.0, 2.0]}, "shape", A),
        ({U: [[1.0, np.nan], [0.0, 1.0]]}, "NaN or infinite", X),
        ([U], "map each parent", X),
        (U, "map each parent", X),
        ({X: 1.0}, "own parent", X),
        ({"u": 1.0}, "LinearGaussianCPD of x: given holds variables, not 'u'", None),
    ],
)
def test_malformed_parents_are_refused(given_, words, variable):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        LinearGaussianCPD(X, given_, cov=np.eye(2))
    assert caught.value.variable == variable


def test_did_you_mean_the_step_before():
    with pytest.raises(pgm.ModelError, match=r"did you mean x\.previous"):
        LinearGaussianCPD(X, {X: 1.0}, cov=np.eye(2))


@pytest.mark.parametrize(
    ("offset", "words"),
    [([1.0], "shape"), ([1.0, 2.0, 3.0], "shape"), ([0.0, np.nan], "NaN or infinite")],
)
def test_malformed_offsets_are_refused(offset, words):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        LinearGaussianCPD(X, {U: 1.0}, offset=offset, cov=np.eye(2))
    assert caught.value.variable == X


@pytest.mark.parametrize("arguments", [{"given": {U: "F"}}, {"given": {U: 1.0}, "offset": "b"}])
def test_what_is_no_number_is_refused(arguments):
    with pytest.raises(pgm.ModelError):
        LinearGaussianCPD(X, cov=np.eye(2), **arguments)


@pytest.mark.parametrize(
    "make",
    [
        lambda child: GaussianCPD(child, 0, 1),
        lambda child: LinearGaussianCPD(child, {B: 1.0}, cov=1),
        lambda child: pgm.NonlinearGaussianCPD(child, B, np.sin, 1),
    ],
)
@pytest.mark.parametrize(
    ("child", "words"), [("a", "variable"), (A.previous, r"cannot be a\[t-1\]")]
)
def test_malformed_children_are_refused(make, child, words):
    with pytest.raises(pgm.ModelError, match=words):
        make(child)


def test_a_cpd_of_a_step_is_not_placed_again():
    """Its parents would stand at the child's own step."""
    position = pgm.Variable("position")
    cpd = pgm.LinearGaussianCPD(position, {position.previous: 1.0}, cov=0.1)
    placed = cpd.at(3)
    with pytest.raises(pgm.ModelError, match=r"is of step 3 already; place its origin"):
        placed.at(2)
    assert placed.origin.at(2).parents == (position.at(1),)
