"""Linearisers at many runs: what they make is that of each run alone."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.kernels import step
from pgm.kernels.dense import Dense, Runs, StackRoot
from pgm.kernels.regression import fit, of_runs, regress
from pgm.linearisers.lineariser import prepare
from tests.dense import bound_function, random_covariance

X = pgm.Variable("x", components=("east", "north", "heading"))
Y = pgm.Variable("y", components=("range", "bearing"), angles=("bearing",))
RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "unscented alpha": pgm.Unscented(alpha=0.5),
    "cubature": pgm.Cubature(),
    "gauss hermite": pgm.GaussHermite(3),
    "more points than are prepared": pgm.GaussHermite(5),
    "monte carlo": pgm.MonteCarlo(20),
    "known moments": pgm.MonteCarlo(20, prior_moments=True),
}
rules = pytest.mark.parametrize("rule", RULES.values(), ids=RULES)


def seen(x):
    """Range and bearing of a landmark, stacked as most users would."""
    east, north = 4.0 - x[..., 0], 2.0 - x[..., 1]
    return np.stack([np.hypot(east, north), np.arctan2(north, east) - x[..., 2]], axis=-1)


def seen_by_x(x):
    east, north = 4.0 - x[..., 0], 2.0 - x[..., 1]
    r, zero, one = np.hypot(east, north), 0.0 * east, 1.0 + 0.0 * east
    rows = [[-east / r, -north / r, zero], [north / r**2, -east / r**2, -one]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@pytest.fixture(name="beliefs", params=["regular", "one certain component", "wide heading"])
def fixture_beliefs(request):
    """Of 40 runs."""
    rng = np.random.default_rng(3)
    mean = 0.5 * rng.normal(size=(40, 3))
    cov = np.stack([0.02 * random_covariance(rng, 3) for _ in range(40)])
    if request.param == "one certain component":
        cov[5, 1], cov[5, :, 1] = 0.0, 0.0
    if request.param == "wide heading":
        cov[7] = np.diag([0.01, 0.01, 9.0])
    return mean, cov


@rules
@pytest.mark.parametrize("analytic", [False, True])
def test_many_runs_are_each_run_alone(rule, analytic, beliefs):
    mean, cov = beliefs
    jacobian = {X: seen_by_x} if analytic else None
    cpd = pgm.NonlinearGaussianCPD(Y, (X,), seen, np.eye(2), jacobian=jacobian)
    many = rule(bound_function(cpd, lead=1), pgm.Gaussian(X, mean, cov))
    for k in range(40):
        alone = rule(bound_function(cpd), pgm.Gaussian(X, mean[k], cov[k]))
        assert_allclose(many.F[k], alone.F, atol=1e-9)
        assert_allclose(many.b[k], alone.b, atol=1e-9)
        assert_allclose(np.broadcast_to(many.cov, (40, 2, 2))[k], alone.cov, atol=1e-9)


@rules
def test_steps_and_runs_are_each_run_alone(rule, beliefs):
    """The prepared form takes any batch: here five steps of eight runs."""
    mean, cov = beliefs
    cpd = pgm.NonlinearGaussianCPD(Y, (X,), seen, np.eye(2))
    first = mean.T.reshape(3, 5, 8), np.moveaxis(cov, 0, -1).reshape(3, 3, 5, 8)
    function = bound_function(cpd, lead=2)
    line = prepare(rule, function.template)(function, *first)
    for k in range(40):
        alone = rule(bound_function(cpd), pgm.Gaussian(X, mean[k], cov[k]))
        at, run = divmod(k, 8)
        assert_allclose(line.matrix[..., at, run], alone.F, atol=1e-9)
        assert_allclose(line.value[..., at, run], alone.F @ mean[k] + alone.b, atol=1e-9)
        if line.error is not None:
            assert_allclose(line.error[..., at, run], alone.cov, atol=1e-9)


def fitted(rule, values, size):
    """Slope, value at the centre and what is left, of values (N, d) by the prepared regression."""
    found = step.regress(Dense(np.eye(size)).root(), rule, Dense(values))
    many = np.stack([values, 2.0 * values], axis=-1)
    root = Runs(np.stack([np.eye(size)] * 2, axis=-1)).root()
    runs = step.regress(root, of_runs(rule), Runs(many))
    for k, factor in enumerate((1.0, 2.0)):
        assert_allclose(runs.matrix.array[..., k], factor * found.matrix.array, atol=1e-12)
        assert_allclose(runs.value.array[..., k], factor * found.value.array, atol=1e-12)
        assert_allclose(runs.error.array[..., k], factor**2 * found.error.array, atol=1e-11)
    return found.matrix.array, found.value.array[:, 0], found.error.array


def directly(s, values, mean_weights, cov_weights):
    """The same by the regression that is not prepared."""
    root = StackRoot(np.eye(s.shape[-1]))
    found = regress(root, s, values, mean_weights, cov_weights)
    return found.matrix.array, found.value.vector, found.error.array


@pytest.mark.parametrize("size", [1, 3])
@pytest.mark.parametrize("name", ["unscented", "unscented alpha", "cubature", "gauss hermite"])
def test_a_prepared_fit_is_the_regression(name, size):
    """Through the points of a cubature of one component goes a line, which leaves nothing."""
    points = RULES[name].points(size, "y", 0)
    values = np.random.default_rng(4).normal(size=(len(points.points), 2))
    found = fitted(points.fit, values, size)
    due = directly(*points[:1], values, *points[1:3])
    for one, other in zip(found, due, strict=True):
        assert_allclose(one, other, atol=1e-12)


def test_negative_weights_subtract():
    """A prepared fit keeps the sign of what a negative weight adds."""
    rng = np.random.default_rng(5)
    s, mean_weights = rng.normal(size=(6, 2)), np.full(6, 1 / 6)
    weights = np.array([-0.1, 0.1, 0.2, 0.3, 0.2, 0.3])
    values = rng.normal(size=(6, 2)) * np.array([9.0, 1, 1, 1, 1, 1])[:, None]
    found = fitted(fit(s, mean_weights, weights), values, 2)
    due = directly(s, values, mean_weights, weights)
    for one, other in zip(found, due, strict=True):
        assert_allclose(one, other, atol=1e-10)
    assert (np.linalg.eigvalsh(found[2]) < 0.0).any()


@pytest.mark.parametrize(
    ("rule", "due"),
    [
        (pgm.Unscented(), True),
        (pgm.Unscented(alpha=1e-3), False),
        (pgm.Cubature(), True),
        (pgm.MonteCarlo(20), True),
        (pgm.MonteCarlo(20, prior_moments=True), False),
        (pgm.Taylor(), False),
    ],
    ids=repr,
)
def test_only_sums_of_squares_are_never_indefinite(rule, due):
    assert rule.is_semidefinite(3) is due


def test_a_prepared_fit_is_made_once():
    one, other = (pgm.Unscented().points(3, "y", k).fit for k in (0, 1))
    assert one is other
    assert (one.slope.shape, one.rest.shape) == ((3, 7), (3, 7))
