"""Statistical linear regression, against regressions and quadratures written out."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.hermite_e import hermegauss
from numpy.testing import assert_allclose

import pgm
from pgm.kernels import roots
from pgm.linearisers import Points, StatisticalRegression
from tests.dense import algebra, bound_function, definite, matrices, random_covariance, vectors

X = pgm.Variable("x", components=("east", "north", "heading"))
Y = pgm.Variable("y", components=("first", "second"))
BEARING = pgm.Variable("bearing", angles=("bearing",))
RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "unscented alpha": pgm.Unscented(alpha=0.5),
    "cubature": pgm.Cubature(),
    "gauss hermite 2": pgm.GaussHermite(2),
    "gauss hermite 5": pgm.GaussHermite(5),
    "monte carlo": pgm.MonteCarlo(20),
    "antithetic": pgm.MonteCarlo(12, antithetic=True),
    "fresh": pgm.MonteCarlo(20, fresh_per_run=True),
    "sobol": pgm.QuasiMonteCarlo(32),
    "fresh sobol": pgm.QuasiMonteCarlo(32, fresh_per_run=True),
}
SHARED = [name for name in RULES if not name.startswith("fresh")]
rules = pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
sigma_rules = pytest.mark.parametrize("rule", list(RULES.values())[1:], ids=list(RULES)[1:])


def cpd_of(function, child=Y, given_=(X,), **more):
    return pgm.NonlinearGaussianCPD(child, given_, function, np.eye(child.dimension), **more)


def curved(x):
    """A function of no polynomial degree."""
    return np.stack(
        [np.sin(x[..., 0]) + x[..., 1] * x[..., 2], np.hypot(1.0 + x[..., 0], x[..., 2] - 3.0)],
        axis=-1,
    )


def curved_by_x(x):
    """The derivative of `curved`."""
    a, b, c = x
    length = np.hypot(1.0 + a, c - 3.0)
    return np.array([[np.cos(a), c, b], [(1.0 + a) / length, 0.0, (c - 3.0) / length]])


@rules
@algebra
@given(matrices(2, 3), vectors(2), vectors(3), matrices(3, 3), st.integers(0, 3))
def test_affine_functions_are_exact(rule, matrix, offset, mean, root, rank):
    cov = root[:, :rank] @ root[:, :rank].T
    function = bound_function(cpd_of(lambda x: x @ matrix.T + offset))
    affine = rule(function, pgm.Gaussian(X, mean, cov))
    # A product is singular but for rounding: along what that leaves of a null direction points lie
    # 1e-8 apart, and half the digits of the slope are lost.
    assert_allclose(affine.F, matrix, atol=1e-6)
    assert_allclose(affine.F @ cov, matrix @ cov, atol=1e-9)
    assert_allclose(affine.b, offset, atol=1e-6)
    assert_allclose(affine.cov, 0.0, atol=1e-7)


def regression(X, Y, weights, cov_weights=None):
    """Weighted regression of values on points: F, b and the covariance of what is left."""
    cov_weights = weights if cov_weights is None else cov_weights
    dx, dy = X - weights @ X, Y - weights @ Y
    F = np.linalg.solve((cov_weights[:, None] * dx).T @ dx, (cov_weights[:, None] * dx).T @ dy).T
    left = dy - dx @ F.T
    return F, weights @ Y - F @ (weights @ X), (cov_weights[:, None] * left).T @ left


@sigma_rules
@pytest.mark.parametrize("seed", range(3))
def test_a_rule_is_the_regression_on_its_points(rule, seed):
    rng = np.random.default_rng(seed)
    mean, cov = rng.normal(size=3), random_covariance(rng, 3)
    affine = rule(bound_function(cpd_of(curved)), pgm.Gaussian(X, mean, cov))
    s, weights, cov_weights, _ = rule.points(3, "y", None)
    points = mean + s @ np.linalg.cholesky(cov).T
    F, b, left = regression(points, curved(points), weights, cov_weights)
    assert_allclose(affine.F, F, atol=1e-9)
    assert_allclose(affine.b, b, atol=1e-9)
    assert_allclose(affine.cov, left, atol=1e-9)


def test_monte_carlo_is_least_squares():
    rng = np.random.default_rng(0)
    mean, cov = rng.normal(size=3), random_covariance(rng, 3)
    rule = pgm.MonteCarlo(30, seed=4)
    affine = rule(bound_function(cpd_of(curved), step=5), pgm.Gaussian(X, mean, cov))
    points = mean + rule.points(3, "y", 5).points @ np.linalg.cholesky(cov).T
    design = np.column_stack([points, np.ones(30)])
    solution, *_ = np.linalg.lstsq(design, curved(points), rcond=None)
    assert_allclose(affine.F, solution[:3].T, atol=1e-9)
    assert_allclose(affine.b, solution[3], atol=1e-9)
    left = curved(points) - design @ solution
    assert_allclose(affine.cov, left.T @ left / 30, atol=1e-9)


def quadrature(function, mean, cov, order=8):
    """Mean of the values, and their covariance with x, by a dense Gauss–Hermite product."""
    nodes, node_weights = hermegauss(order)
    s = np.array(list(itertools.product(nodes, repeat=mean.size)))
    weights = np.prod(list(itertools.product(node_weights, repeat=mean.size)), axis=1)
    weights = weights / weights.sum()
    x = mean + s @ np.linalg.cholesky(cov).T
    y = function(x)
    return weights @ y, ((x - mean) * weights[:, None]).T @ (y - weights @ y)


@pytest.mark.parametrize(
    "rule", [pgm.Cubature(), pgm.Unscented(), pgm.Unscented(alpha=0.7, kappa=1.0)]
)
@algebra
@given(vectors(3), definite(3), matrices(2, 20))
def test_third_degree_rules(rule, mean, cov, coefficients):
    exponents = [e for e in itertools.product(range(4), repeat=3) if sum(e) <= 3]

    def polynomial(degree):
        def function(x):
            terms = [
                coefficients[:, k] * np.prod(x ** np.array(e), axis=-1)[..., None]
                for k, e in enumerate(exponents)
                if sum(e) <= degree
            ]
            return np.sum(terms, axis=0)

        return function

    cov = cov / np.trace(cov)
    at = pgm.Gaussian(X, mean, cov)
    # The mean of a cubic, and the slope through a quadratic, need moments of degree three.
    cubic = rule(bound_function(cpd_of(polynomial(3))), at)
    assert_allclose(cubic.F @ mean + cubic.b, quadrature(polynomial(3), mean, cov)[0], atol=1e-6)
    quadratic = rule(bound_function(cpd_of(polynomial(2))), at)
    value, cross = quadrature(polynomial(2), mean, cov)
    assert_allclose(quadratic.F @ mean + quadratic.b, value, atol=1e-6)
    assert_allclose(quadratic.F @ cov, cross.T, atol=1e-6)


ROOTS = {
    "zero": np.zeros((3, 0)),
    "one axis": [[1.0], [0.0], [0.0]],
    "last axis": [[0.0], [0.0], [0.7]],
    "two axes": [[1.0, 0.0], [0.0, 0.0], [0.0, 0.7]],
    "oblique line": [[0.5], [0.5], [0.0]],
    "oblique line in space": [[0.5], [-0.5], [0.5]],
    "oblique plane": [[0.5, 0.2], [0.5, 0.2], [0.0, 0.4]],
}


@sigma_rules
@pytest.mark.parametrize("root", ROOTS.values(), ids=ROOTS)
def test_singular_beliefs(rule, root):
    mean, cov = np.array([0.3, -0.8, 0.5]), np.array(root) @ np.array(root).T
    affine = rule(bound_function(cpd_of(curved)), pgm.Gaussian(X, mean, cov))
    s, weights, cov_weights, _ = rule.points(3, "y", None)
    points = mean + s @ roots.root(cov).T
    variances, directions = np.linalg.eigh(cov)
    along, null = directions[:, variances > 1e-9], directions[:, variances < 1e-9]
    F, centre, left = regression((points - mean) @ along, curved(points), weights, cov_weights)
    # On the range of the covariance the points decide, in its null directions the derivative.
    assert_allclose(affine.F @ along, F, atol=1e-9)
    assert_allclose(affine.F @ null, curved_by_x(mean) @ null, atol=1e-8)
    assert_allclose(affine.F @ mean + affine.b, centre, atol=1e-9)
    assert_allclose(affine.cov, left, atol=1e-9)


@sigma_rules
def test_without_any_uncertainty_it_is_taylor(rule):
    at = pgm.Gaussian(X, [0.3, -0.8, 0.5], np.zeros((3, 3)))
    function = bound_function(cpd_of(curved))
    affine, taylor = rule(function, at), pgm.Taylor()(function, at)
    assert_allclose(affine.F, taylor.F, atol=1e-12)
    assert_allclose(affine.b, taylor.b, atol=1e-12)
    assert_allclose(affine.cov, 0.0, atol=1e-15)


@rules
@pytest.mark.parametrize("name", ["one axis", "oblique line in space", "oblique plane", "regular"])
def test_units_do_not_matter(rule, name):
    root = np.array(ROOTS[name]) if name in ROOTS else np.diag([1.0, 0.5, 0.2])
    units, mean = np.array([1e3, 1.0, 1e-2]), np.array([0.3, -0.8, 0.5])
    affine = rule(bound_function(cpd_of(curved)), pgm.Gaussian(X, mean, root @ root.T))
    root = units[:, None] * root
    other = rule(
        bound_function(cpd_of(lambda x: curved(x / units))),
        pgm.Gaussian(X, units * mean, root @ root.T),
    )
    assert_allclose(other.F * units, affine.F, atol=1e-6)
    assert_allclose(other.b, affine.b, atol=1e-6)
    assert_allclose(other.cov, affine.cov, atol=1e-7)


def turned(x):
    """The bearing to a landmark behind, on a chart without a cut there."""
    return (np.pi + np.arctan2(x[..., 1], 5.0 + x[..., 0]) - x[..., 2])[..., None]


def wrapped(x):
    """The same in [−π, π)."""
    return (turned(x) + np.pi) % (2 * np.pi) - np.pi


@rules
@pytest.mark.parametrize("north", [-0.3, 0.0, 0.3])
@pytest.mark.parametrize("heading", [0.0, 7.0])
def test_bearings_near_the_cut(rule, north, heading):
    cov = np.array([[0.3, 0.1, 0.0], [0.1, 0.4, 0.0], [0.0, 0.0, 0.02]])
    at = pgm.Gaussian(X, [0.0, north, heading], cov)
    found = rule(bound_function(cpd_of(wrapped, BEARING)), at)
    expected = rule(bound_function(cpd_of(turned, BEARING)), at)
    assert_allclose(found.F, expected.F, atol=1e-9)
    assert_allclose(found.cov, expected.cov, atol=1e-12)
    value, other = (affine.F @ at.mean + affine.b for affine in (found, expected))
    assert_allclose(np.exp(1j * value), np.exp(1j * other), atol=1e-9)


@rules
def test_headings_beyond_half_a_turn(rule):
    """An angle that turns linearly with the state is no angle, however far its points turn."""
    turn, heading = pgm.Variable("turn"), pgm.Variable("heading", angles=("heading",))
    at = pgm.Gaussian(X, [0.2, -0.4, 1.0], np.diag([0.3, 0.2, 2.5**2]))

    def function(x):
        return (0.5 * x[..., 0] + x[..., 2])[..., None]

    found = rule(bound_function(cpd_of(function, heading)), at)
    expected = rule(bound_function(cpd_of(function, turn)), at)
    assert_allclose(found.F, expected.F, atol=1e-9)
    assert_allclose(found.b, expected.b, atol=1e-9)
    assert_allclose(found.cov, 0.0, atol=1e-9)


@sigma_rules
def test_bearings_of_a_singular_belief_near_the_cut(rule):
    at = pgm.Gaussian(X, [0.0, 0.01, 0.0], np.diag([0.0, 0.5, 0.0]))
    found = rule(bound_function(cpd_of(wrapped, BEARING)), at)
    expected = rule(bound_function(cpd_of(turned, BEARING)), at)
    assert_allclose(found.F, expected.F, atol=1e-8)
    assert_allclose(found.cov, expected.cov, atol=1e-12)


@pytest.mark.parametrize("name", SHARED)
@pytest.mark.parametrize("lead", [(3,), (40,), (2, 3)])
@pytest.mark.parametrize("rank", [1, 3])
def test_a_batch_is_its_singles(name, lead, rank):
    rule = RULES[name]
    rng = np.random.default_rng(0)
    mean, cov = rng.normal(size=(*lead, 3)), random_covariance(rng, 3, rank, lead)
    batch = rule(bound_function(cpd_of(curved), lead=len(lead)), pgm.Gaussian(X, mean, cov))
    single_function = bound_function(cpd_of(curved))
    for k in np.ndindex(lead):
        single = rule(single_function, pgm.Gaussian(X, mean[k], cov[k]))
        assert_allclose(batch.F[k], single.F, atol=1e-7)
        assert_allclose(batch.b[k], single.b, atol=1e-7)
        error = np.broadcast_to(batch.cov, (*lead, 2, 2))[k]
        assert_allclose(error, single.cov, atol=1e-7)


def test_several_parents_are_stacked_in_the_order_of_the_function():
    U = pgm.Variable("u", components=("v", "omega"))

    def drive(u, x):
        return np.stack([x[..., 0] + u[..., 0] * np.cos(x[..., 2]), u[..., 1] * x[..., 1]], axis=-1)

    mean = np.array([1.0, 0.5, 0.2, -0.4, 0.3])
    at = pgm.Gaussian((U, X), mean, 1e-8 * np.eye(5))
    c, s = np.cos(0.3), np.sin(0.3)
    expected = [[c, 0.0, 1.0, 0.0, -s], [0.0, -0.4, 0.0, 0.5, 0.0]]
    for rule in RULES.values():
        affine = rule(bound_function(cpd_of(drive, given_=(U, X))), at)
        assert_allclose(affine.F, expected, atol=1e-4)


@sigma_rules
def test_an_indefinite_belief_is_refused(rule):
    at = pgm.Gaussian._make((X,), np.zeros(3), np.diag([1.0, -1.0, 1.0]))
    with pytest.raises(pgm.NumericalError, match=r"CPD of y.*indefinite"):
        rule(bound_function(cpd_of(curved)), at)


class Trapezium(StatisticalRegression):
    """A rule of a user's own: a weighted grid on one axis."""

    def points(self, dimension, name, step):
        s = np.linspace(-10.0, 10.0, 101)[:, None]
        weights = np.exp(-0.5 * s[:, 0] ** 2)
        weights /= weights.sum()
        return Points(s, weights, weights, False)


def test_a_rule_of_ones_own_is_points_and_weights():
    A = pgm.Variable("a")
    at = pgm.Gaussian(A, 0.5, 0.3)
    affine = Trapezium()(bound_function(cpd_of(np.exp, A, (X.previous,)), lead=0), at)
    # E[exp a] and E[exp' a] of a normal, by Stein's lemma the regression's slope.
    value = np.exp(0.5 + 0.15)
    assert_allclose(affine.F, [[value]], rtol=1e-8)
    assert_allclose(affine.F @ at.mean + affine.b, [value], rtol=1e-8)
    left = value**2 * (np.exp(0.3) - 1) - 0.3 * value**2
    assert_allclose(affine.cov, [[left]], rtol=1e-7)


@pytest.mark.parametrize(
    ("points", "mean_weights", "cov_weights", "centred", "text"),
    [
        (np.eye(2), [0.5, 0.6], [0.5, 0.5], False, "mean_weights add up to 1.1; one was due"),
        (np.eye(2), [0.5, np.nan], [0.5, 0.5], False, "mean_weights add up to nan"),
        (np.eye(2), [1.0], [0.5, 0.5], False, r"its mean_weights \(1,\)"),
        (np.eye(2), [0.5, 0.5], [1.0], False, r"its cov_weights \(1,\)"),
        (np.ones(2), [0.5, 0.5], [0.5, 0.5], False, r"points have shape \(2,\)"),
        (np.eye(2), [0.5, 0.5], [0.5, 0.5], True, "the first of them is not the origin"),
    ],
)
def test_points_that_do_not_fit_their_weights_are_refused(
    points, mean_weights, cov_weights, centred, text
):
    with pytest.raises(pgm.ModelError, match=text):
        pgm.linearisers.Points(points, np.array(mean_weights), np.array(cov_weights), centred)
