"""Covariances as a variance, the variance of each component, or a matrix."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.factors.arrays import covariance_fault

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
y = pgm.Variable("y", components=("east", "north"))
a = pgm.Variable("a")
u = pgm.Variable("u", components=("v", "omega"))
MAKERS = {
    "prior": (lambda cov: pgm.GaussianCPD(x, np.zeros(3), cov), "x"),
    "linear": (lambda cov: pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=cov), "x"),
    "nonlinear": (lambda cov: pgm.NonlinearGaussianCPD(x, x.previous, np.sin, cov), "x"),
    "gaussian": (lambda cov: pgm.Gaussian(x, np.zeros(3), cov), "x"),
    "affine": (lambda cov: pgm.AffineGaussian(np.eye(3), np.zeros(3), cov), "affine"),
}
CHECKED = [name for name in MAKERS if name != "affine"]


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize(
    ("given", "matrix"),
    [
        (0, np.zeros((3, 3))),
        (0.5, np.diag([0.5, 0.5, 0.5])),
        (np.float32(0.25), np.diag([0.25, 0.25, 0.25])),
        ([1, 2, 3], np.diag([1.0, 2.0, 3.0])),
        ((0.0, 0.5, 0.0), np.diag([0.0, 0.5, 0.0])),
        (np.full((3, 3), 2.0), np.full((3, 3), 2.0)),
    ],
)
def test_every_form_is_the_matrix(name, given, matrix):
    assert_array_equal(MAKERS[name][0](given).cov, matrix)


@pytest.mark.parametrize("name", CHECKED)
@pytest.mark.parametrize(
    ("given", "told"),
    [
        (-1.0, "has the negative variance -1"),
        ([1.0, -0.25, 1.0], "has the negative variance -0.25"),
        ([1.0, 2.0], r"has shape \(2,\); its 3 components .*'heading'.* need .*variances \(3,\)"),
        ([1.0], r"has shape \(1,\); .* or one variance for all of them"),
        (np.ones((2, 3)), r"has shape \(2, 3\); "),
        (np.nan, "has entries that are NaN or infinite"),
        ([1.0, np.nan, 1.0], "has entries that are NaN or infinite"),
        (-np.inf, "has entries that are NaN or infinite"),
        ("wide", "must be numbers"),
    ],
)
def test_a_wrong_one_is_refused_by_name(name, given, told):
    make, named = MAKERS[name]
    with pytest.raises(pgm.ModelError, match=told) as caught:
        make(given)
    assert named in str(caught.value)


def test_rows_of_variances_are_never_taken_for_runs():
    """Three rows of variances of three components look as a matrix, and are one."""
    rows = np.ones((3, 3)) + np.diag([0.0, 1.0, 2.0])
    assert pgm.GaussianCPD(x, np.zeros((3, 3)), rows).cov.shape == (3, 3)
    told = "variances (..., n) of each run are matrices as cov[..., None] * np.eye(n)"
    with pytest.raises(pgm.ModelError, match=re.escape(told)):
        pgm.GaussianCPD(x, np.zeros((5, 3)), np.ones((5, 3)))
    each = np.ones((5, 3))[..., None] * np.eye(3)
    assert pgm.GaussianCPD(x, np.zeros((5, 3)), each).cov.shape == (5, 3, 3)


def test_a_series_of_variances_is_taken_by_its_names():
    pandas = pytest.importorskip("pandas")
    series = pandas.Series({"north": 2.0, "heading": 3.0, "east": 1.0})
    assert_array_equal(pgm.GaussianCPD(x, series * 0.0, series).cov, np.diag([1.0, 2.0, 3.0]))
    with pytest.raises(pgm.ModelError, match="the covariance of x must be numbers"):
        pgm.GaussianCPD(x, np.zeros(3), series.rename({"north": "up"}))
    with pytest.raises(pgm.ModelError, match="columns with names"):
        pgm.GaussianCPD(x, np.zeros(3), pandas.DataFrame(np.eye(3), columns=x.components))


def test_a_variance_serves_all_runs_and_steps():
    assert pgm.Gaussian(y, np.zeros((7, 2)), [1.0, 4.0], steps=range(7)).std.shape == (7, 2)
    affine = pgm.AffineGaussian(np.zeros((5, 2, 3)), np.zeros(2), 0.1)
    assert_array_equal(affine.cov, 0.1 * np.eye(2))


@pytest.mark.parametrize("shape", [(2,), (3, 2)])
def test_affine_shapes_that_do_not_fit(shape):
    with pytest.raises(pgm.ModelError, match=r"must end in \(d, n\), \(d,\) and \(d, d\)"):
        pgm.AffineGaussian(np.eye(3), np.zeros(3), np.ones(shape))


@pytest.mark.parametrize(
    ("given", "flat"), [(np.inf, [1, 1, 1]), ([np.inf, 2.0, np.inf], [1, 0, 1])]
)
def test_flat_priors(given, flat):
    prior = pgm.GaussianCPD(x, np.zeros(3), given)
    assert_array_equal(np.isinf(np.diagonal(prior.cov)), np.asarray(flat, dtype=bool))
    assert not prior.cov[~np.eye(3, dtype=bool)].any()
    for name in ("linear", "nonlinear", "gaussian"):
        with pytest.raises(pgm.ModelError, match="NaN or infinite"):
            MAKERS[name][0](given)


def test_a_flat_vector_is_found_from_its_measurements():
    z = pgm.Variable("z", components=("east", "north"))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(y, [0.0, 0.0], cov=[np.inf, np.inf])],
        transition=[pgm.LinearGaussianCPD(y, given={y.previous: 1.0}, cov=0)],
        observation=[pgm.LinearGaussianCPD(z, given={y: 1.0}, cov=[4.0, 1.0])],
    )
    values = np.array([[1.0, 2.0], [3.0, 0.0], [2.0, 4.0]])
    found = pgm.smooth(model, {z: values})[y]
    assert_allclose(found.mean, np.tile(values.mean(axis=0), (4, 1)), atol=1e-9)
    assert_allclose(found.cov[0], np.diag([4.0, 1.0]) / 3, rtol=1e-9)


def driven(function, **options):
    """A walk whose noise the control sets, run over two runs of four steps."""
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, np.zeros(3), cov=0)],
        transition=[
            pgm.LinearGaussianCPD(
                x, given={x.previous: 1.0}, cov=pgm.noise(function, (u,), **options)
            )
        ],
    )
    controls = np.arange(16.0).reshape(2, 4, 2)
    return pgm.filter(model, {u: controls})[x], controls


def variances(u):
    return np.stack([u[..., 0], 2 * u[..., 1], np.ones_like(u[..., 0])], axis=-1)


def test_noise_says_that_it_gives_variances():
    found, controls = driven(variances, diagonal=True)
    matrices, _ = driven(lambda u: variances(u)[..., None] * np.eye(3))
    due = np.cumsum(variances(controls), axis=1)
    assert_allclose(np.diagonal(found.cov[:, 1:], axis1=-2, axis2=-1), due)
    assert_array_equal(found.cov, matrices.cov)


@pytest.mark.parametrize(
    ("function", "options", "told"),
    [
        (variances, {}, r"variances \(\.\.\., n\) are declared by .*diagonal=True"),
        (lambda u: 0.1, {}, r"returned shape \(\) where"),
        (lambda u: 0.1, {"diagonal": True}, r"returned shape \(\) where .* variance of each"),
        (lambda u: [0.1, 0.1, 0.1], {"diagonal": True}, r"returned shape \(3,\) where"),
        (lambda u: 0.1 * np.eye(3), {"diagonal": True}, r"returned shape \(3, 3\) where"),
        (lambda u: -variances(u), {"diagonal": True}, "negative variance"),
    ],
)
def test_noise_is_refused(function, options, told):
    with pytest.raises(pgm.ModelError, match=told) as caught:
        driven(function, **options)
    assert "the noise of the CPD of x" in str(caught.value)


def test_diagonal_is_a_bool():
    with pytest.raises(pgm.ModelError, match="diagonal is True or False, not 3"):
        pgm.noise(variances, (u,), diagonal=3)


def test_noise_stays_diagonal_in_an_unrolled_network():
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, np.zeros(3), cov=0)],
        transition=[
            pgm.LinearGaussianCPD(
                x, given={x.previous: 1.0}, cov=pgm.noise(variances, (u,), diagonal=True)
            )
        ],
    )
    network, controls = model.unroll(2), np.array([[1.0, 2.0], [3.0, 4.0]])
    evidence = {u.at(k + 1): controls[k] for k in range(2)}
    found = pgm.infer(pgm.compile(network), evidence)
    due = pgm.filter(model, {u: controls})
    assert_allclose(found[x.at(2)].cov, due[x.at(2)].cov, atol=1e-12)


@pytest.mark.parametrize("least", [1e-3, 1e-9, 1e-12, 0.0, -1e-12, -9e-11, -1.1e-10, -1e-9, -0.1])
@pytest.mark.parametrize("size", [2, 3, 6])
def test_what_is_indefinite_is_what_the_eigenvalues_of_correlations_say(size, least):
    rng = np.random.default_rng(size)
    for _ in range(20):
        axes = np.linalg.qr(rng.normal(size=(size, size)))[0]
        values = np.concatenate([[0.0], rng.uniform(0.5, 2.0, size - 1)])
        scaled = axes @ np.diag(values) @ axes.T
        scaled /= np.sqrt(np.outer(np.diag(scaled), np.diag(scaled)))
        scaled = 0.5 * (scaled + scaled.T)
        scaled += least * np.eye(size)
        unit = 10.0 ** rng.uniform(-6.0, 6.0, size)
        cov = scaled * np.outer(unit, unit)
        cov = np.triu(cov) + np.triu(cov, 1).T
        assert (covariance_fault(cov) is None) == (least > -1e-10)
        sound = np.eye(size)
        assert (covariance_fault(np.stack([sound, cov])) is None) == (least > -1e-10)
