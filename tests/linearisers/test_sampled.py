"""Rules that draw their points: keys, pairs, points for each run, and the prior's own moments."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.kernels import roots
from tests.dense import bound_function, random_covariance

X = pgm.Variable("x", components=("east", "north", "heading"))
Y = pgm.Variable("y", components=("first", "second"))
RULES = {
    "monte carlo": lambda n=10, **more: pgm.MonteCarlo(n, **more),
    "antithetic": lambda n=10, **more: pgm.MonteCarlo(n, antithetic=True, **more),
    "sobol": lambda n=16, **more: pgm.QuasiMonteCarlo(n, **more),
}
kinds = pytest.mark.parametrize("make", RULES.values(), ids=RULES)


def curved(x):
    return np.stack([np.sin(x[..., 0]) * x[..., 2], np.exp(0.3 * x[..., 1])], axis=-1)


def linearise(rule, mean, cov, step=None, function=curved, variable=Y):
    mean = np.asarray(mean)
    cpd = pgm.NonlinearGaussianCPD(variable, X, function, np.eye(variable.dimension))
    return rule(bound_function(cpd, lead=mean.ndim - 1, step=step), pgm.Gaussian(X, mean, cov))


@kinds
@pytest.mark.parametrize("fresh", [False, True])
def test_points_are_standard_normal(make, fresh):
    s = make(16384, fresh_per_run=fresh).points(3, "y", np.array([0])).points[0]
    assert s.shape == (16384, 3)
    # Pairs count for one: their even moments are equal.
    error = 5 / np.sqrt(8192)
    assert (np.abs(s.mean(axis=0)) < error).all()
    assert (np.abs(s.T @ s / 16384 - np.eye(3)) < np.sqrt(2) * error).all()
    assert (np.abs((s**4).mean(axis=0) - 3) < np.sqrt(96) * error).all()


@kinds
def test_points_are_keyed_by_seed_cpd_and_step(make):
    draw = make(seed=1).points(3, "y", 4).points
    assert_array_equal(draw, make(seed=1).points(3, "y", 4).points)
    assert_array_equal(make().points(3, "y", None).points, make().points(3, "y", 0).points)
    for seed, name, step in [(2, "y", 4), (1, "z", 4), (1, "y", 5), (1, "y", 3)]:
        other = make(seed=seed).points(3, name, step).points
        # Not one number in common, so no stretch of a stream is used twice.
        assert not np.isin(other, draw).any()


@kinds
@pytest.mark.parametrize("samples", [10, 12, 14])
@pytest.mark.parametrize(
    "steps", [np.arange(7), np.array([5, 5, 2, 9]), np.array([[0, 1], [1, 0]]), np.array([3])]
)
def test_one_call_for_many_steps_is_many_calls(make, steps, samples):
    rule = make(samples, seed=3)
    together = rule.points(3, "y", steps).points
    assert together.shape == (*steps.shape, samples, 3)
    for k in np.ndindex(steps.shape):
        assert_array_equal(together[k], rule.points(3, "y", int(steps[k])).points)


@kinds
def test_many_steps_are_linearised_in_one_call(make):
    rng = np.random.default_rng(0)
    steps = np.array([[4, 4], [0, 0], [7, 7]])  # sightings by runs
    mean, cov = rng.normal(size=(3, 2, 3)), random_covariance(rng, 3, lead=(3, 2))
    rule = make(20, seed=3)
    batch = linearise(rule, mean, cov, steps)
    for k in np.ndindex(3, 2):
        single = linearise(rule, mean[k], cov[k], int(steps[k]))
        assert_allclose(batch.F[k], single.F, atol=1e-9)
        assert_allclose(batch.b[k], single.b, atol=1e-9)
        assert_allclose(batch.cov[k], single.cov, atol=1e-9)


def test_antithetic_points_are_pairs():
    s = pgm.MonteCarlo(10, antithetic=True).points(3, "y", 2).points
    assert_array_equal(s[5:], -s[:5])
    assert np.unique(np.abs(s)).size == 15


def test_antithetic_means_of_odd_functions_are_exact():
    at = np.array([0.3, -0.2, 0.5]), 0.4 * np.eye(3)

    def odd(x):
        d = x - at[0]
        return np.stack([d[..., 0] ** 3 + d[..., 2], np.sin(d[..., 1] * d[..., 2] ** 2)], axis=-1)

    affine = linearise(pgm.MonteCarlo(10, antithetic=True), *at, function=odd)
    assert_allclose(affine.F @ at[0] + affine.b, 0.0, atol=1e-12)
    plain = linearise(pgm.MonteCarlo(10), *at, function=odd)
    assert np.abs(plain.F @ at[0] + plain.b).max() > 1e-3


def test_antithetic_slopes_of_even_functions_are_exact():
    mean = np.array([0.3, -0.2, 0.5])

    def even(x):
        d = x - mean
        return np.stack([d[..., 0] ** 2, np.cos(d[..., 1] * d[..., 2])], axis=-1)

    found = linearise(pgm.MonteCarlo(10, antithetic=True), mean, np.eye(3), function=even)
    assert_allclose(found.F, 0.0, atol=1e-12)
    assert np.abs(linearise(pgm.MonteCarlo(10), mean, np.eye(3), function=even).F).max() > 1e-2


# --- Points for each run ---


@kinds
def test_fresh_runs_differ_and_a_smaller_batch_is_the_first_of_them(make):
    rule = make(20, seed=2, fresh_per_run=True)
    mean, cov = np.full((6, 3), 0.4), np.broadcast_to(0.3 * np.eye(3), (6, 3, 3))
    batch, again = (linearise(rule, mean, cov, step=3) for _ in range(2))
    first = linearise(rule, mean[:4], cov[:4], step=3)
    assert_array_equal(batch.F, again.F)
    assert_allclose(batch.F[:4], first.F, atol=1e-12)
    assert_allclose(batch.cov[:4], first.cov, atol=1e-12)
    assert len(np.unique(batch.F[:, 0, 0])) == 6
    for other in (linearise(rule, mean, cov, step=4), linearise(make(20, seed=2), mean, cov, 3)):
        assert not np.isclose(other.F, batch.F).all(axis=(-2, -1)).any()


@kinds
def test_fresh_points_are_no_ones_else(make):
    rule = make(fresh_per_run=True)
    steps = np.broadcast_to(np.array([2, 3, 2, 7])[:, None], (4, 5))  # sightings by runs
    drawn = rule.points(3, "y", steps).points
    assert drawn.shape == (4, 5, rule.samples, 3)
    shared = make().points(3, "y", np.arange(10)).points
    unit = np.abs(np.concatenate([drawn.reshape(20, -1), shared.reshape(10, -1)]))
    distinct = 15 if "antithetic=True" in repr(rule) else 3 * rule.samples
    assert np.unique(unit).size == 30 * distinct


@kinds
def test_fresh_points_do_not_depend_on_how_steps_are_called(make):
    rule = make(fresh_per_run=True)
    steps = np.broadcast_to(np.array([2, 3, 2, 7])[:, None], (4, 5))
    together = rule.points(3, "y", steps).points
    assert_array_equal(together[[0, 2]], rule.points(3, "y", np.full((2, 5), 2)).points)
    assert_array_equal(together[1], rule.points(3, "y", np.full(5, 3)).points)
    assert_array_equal(together[:, :2], rule.points(3, "y", steps[:, :2]).points)


def localisation(runs=()):
    x = X
    z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))

    def drive(x):
        c, s = np.cos(x[..., 2]), np.sin(x[..., 2])
        return x + np.stack([c, s, 0.3 + 0 * c], axis=-1)

    def sight(x):
        east, north = 4.0 - x[..., 0], 3.0 - x[..., 1]
        bearing = np.arctan2(north, east) - x[..., 2]
        return np.stack([np.hypot(east, north), bearing], axis=-1)

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros((*runs, 3)), np.diag([0.04, 0.04, 0.3]))],
        [pgm.NonlinearGaussianCPD(x, x.previous, drive, 0.01 * np.eye(3))],
        [pgm.NonlinearGaussianCPD(z, x, sight, np.diag([0.05, 0.02]))],
    )
    values = np.tile([[4.5, 0.2], [4.2, 0.3], [3.0, 0.1], [2.5, 0.4]], (6, 1, 1))
    return model, x, z, values


STEPS = [1, 1, 2, 3]


@kinds
def test_fresh_runs_through_a_filter(make):
    model, x, z, values = localisation()
    rule = make(40, fresh_per_run=True)

    def run(values, verb=pgm.filter, **more):
        return verb(model, {z: pgm.sightings(values, STEPS)}, lineariser=rule, steps=3, **more)[x]

    batch, smaller = run(values), run(values[:4])
    assert_allclose(smaller.mean, batch.mean[:4], atol=1e-10)
    assert len(np.unique(batch.mean[:, 3, 0])) == 6
    smoothed = run(values, pgm.smooth, iterations=15)
    assert_allclose(smoothed.mean, run(values, pgm.smooth, iterations=16).mean, atol=1e-4)


@kinds
def test_fresh_runs_online_are_those_of_the_filter(make):
    model, x, z, values = localisation(runs=(6,))
    rule = make(40, fresh_per_run=True)
    batch = pgm.filter(model, {z: pgm.sightings(values, STEPS)}, lineariser=rule, steps=3)[x]
    robot = pgm.OnlineFilter(model, lineariser=rule)
    belief = robot.initial()
    for step in (1, 2, 3):
        rows = [k for k, at in enumerate(STEPS) if at == step]
        belief = robot.predict(belief)
        belief = robot.update(belief, {z: pgm.sightings(values[:, rows])})
    assert_allclose(belief[x].mean, batch.mean[:, 3], atol=1e-9)


# --- The prior's own moments ---


def textbook(points, function, mean, cov):
    """The report's (7.20)–(7.25), word for word."""
    values, count = function(points), len(points)
    value = values.sum(axis=0) / count
    cross = (points - mean).T @ (values - value) / count
    spread = (values - value).T @ (values - value) / count
    F = cross.T @ np.linalg.inv(cov)
    return F, value - F @ mean, spread - cross.T @ np.linalg.inv(cov) @ cross


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("antithetic", [False, True])
def test_prior_moments_are_the_reports_equations(seed, antithetic):
    rng = np.random.default_rng(seed)
    mean, cov = rng.normal(size=3), random_covariance(rng, 3) + 0.1 * np.eye(3)
    rule = pgm.MonteCarlo(10, seed, prior_moments=True, antithetic=antithetic)
    affine = linearise(rule, mean, cov, step=4)
    points = mean + rule.points(3, "y", 4).points @ np.linalg.cholesky(cov).T
    F, b, left = textbook(points, curved, mean, cov)
    assert_allclose(affine.F, F, atol=1e-9)
    assert_allclose(affine.b, b, atol=1e-9)
    assert_allclose(affine.cov, left, atol=1e-9)


@pytest.mark.parametrize("fresh", [False, True])
def test_prior_moments_of_a_linear_function(fresh):
    # With sample mean m and covariance S of points for N(0, I), a line A x + c becomes
    # F = A L S L⁻¹, F μ + b = A (μ + L m) + c and Σ_n = A L (S − S²) Lᵀ Aᵀ: exact only for S = I.
    rng = np.random.default_rng(1)
    A, c = rng.normal(size=(2, 3)), rng.normal(size=2)
    mean, cov = rng.normal(size=(5, 3)), random_covariance(rng, 3, lead=(5,))
    rule = pgm.MonteCarlo(10, prior_moments=True, fresh_per_run=fresh)
    affine = linearise(rule, mean, cov, 2, lambda x: x @ A.T + c)
    sample = rule.points(3, "y", np.full(5, 2)).points
    for k in range(5):
        L, m, S = np.linalg.cholesky(cov[k]), sample[k].mean(axis=0), np.cov(sample[k].T, ddof=0)
        assert_allclose(affine.F[k], A @ L @ S @ np.linalg.inv(L), atol=1e-8)
        assert_allclose(affine.F[k] @ mean[k] + affine.b[k], A @ (mean[k] + L @ m) + c, atol=1e-8)
        assert_allclose(affine.cov[k], A @ L @ (S - S @ S) @ L.T @ A.T, atol=1e-8)
        predicted = affine.F[k] @ cov[k] @ affine.F[k].T + affine.cov[k]
        assert_allclose(predicted, A @ L @ S @ L.T @ A.T, atol=1e-8)
    assert (np.linalg.eigvalsh(affine.cov)[:, 0] < -0.01).any()


@pytest.mark.parametrize("root", [np.zeros((3, 1)), [[0.5], [0.5], [0.0]], np.diag([0.4, 0, 0.3])])
def test_prior_moments_of_a_singular_belief(root):
    root = np.asarray(root, dtype=float)
    mean, cov = np.array([0.3, -0.8, 0.5]), root @ root.T
    rule = pgm.MonteCarlo(10, prior_moments=True)
    affine = linearise(rule, mean, cov)
    variances, directions = np.linalg.eigh(cov)
    along, null = directions[:, variances > 1e-9], directions[:, variances < 1e-9]
    taylor = linearise(pgm.Taylor(), mean, cov)
    assert_allclose(affine.F @ null, taylor.F @ null, atol=1e-8)
    if not along.size:
        assert_allclose(affine.b, taylor.b, atol=1e-8)
        assert_allclose(affine.cov, 0.0)
        return
    # In coordinates along the range the covariance is regular and the equations apply.
    points = rule.points(3, "y", None).points @ roots.root(cov).T @ along

    def inside(p):
        return curved(mean + p @ along.T)

    F, _, left = textbook(points, inside, np.zeros(along.shape[1]), along.T @ cov @ along)
    assert_allclose(affine.F @ along, F, atol=1e-8)
    assert_allclose(affine.cov, left, atol=1e-9)


def test_prior_moments_through_a_filter():
    """The prediction has the sample's own moments; an indefinite Σ_n is carried."""
    model, x, _, _ = localisation(runs=(200,))
    cpd = model.transition[0]
    rule = pgm.MonteCarlo(10, seed=3, prior_moments=True, fresh_per_run=True)
    found = pgm.filter(model, {}, lineariser=rule, steps=1)[x]
    points = rule.points(3, "x", np.ones(200, int)).points
    values = cpd.function(points * np.sqrt([0.04, 0.04, 0.3]))
    assert_allclose(found.mean[:, 1], values.mean(axis=1), atol=1e-10)
    spread = np.array([np.cov(each.T, ddof=0) for each in values]) + cpd.cov
    assert_allclose(found.cov[:, 1], spread, atol=1e-10)


# --- What is refused ---


@kinds
@pytest.mark.parametrize(("n", "enough"), [(1, 4), (3, 8)])
def test_too_few_samples_are_refused(make, n, enough):
    make(enough).points(n, "y", 1)
    with pytest.raises(pgm.LinearisationError, match=f"CPD of y: ask for {enough}"):
        make(enough - 2).points(n, "y", 1)
    with pytest.raises(pgm.LinearisationError, match=f"ask for {enough}"):
        pgm.MonteCarlo(enough - 1).points(n, "y", 1)


@kinds
@pytest.mark.parametrize("arguments", [(0,), (-5,), (10.0,), ("10",), (True,)])
def test_malformed_sizes_are_refused(make, arguments):
    with pytest.raises(pgm.LinearisationError, match=r"MonteCarlo\(samples=.*whole number from 1"):
        make(*arguments)


@kinds
@pytest.mark.parametrize("seed", [-1, 0.5, None, 2**63, False])
def test_malformed_seeds_are_refused(make, seed):
    with pytest.raises(pgm.LinearisationError, match=r"MonteCarlo\(seed=.*whole number from 0"):
        make(10, seed=seed)


def test_odd_antithetic_samples_are_refused():
    with pytest.raises(pgm.LinearisationError, match=r"samples=11, antithetic=True.*even"):
        pgm.MonteCarlo(11, antithetic=True)


@pytest.mark.parametrize(
    ("rule", "switch"),
    [
        (pgm.MonteCarlo, "prior_moments"),
        (pgm.MonteCarlo, "fresh_per_run"),
        (pgm.MonteCarlo, "antithetic"),
        (pgm.QuasiMonteCarlo, "fresh_per_run"),
    ],
)
def test_switches_are_true_or_false(rule, switch):
    for value in ("yes", 3, 1, None, 0.0, np.array([True])):
        with pytest.raises(pgm.LinearisationError, match=rf"\({switch}=.*True or False"):
            rule(10, **{switch: value})
    assert rule(10, **{switch: np.True_}) == rule(10, **{switch: True})
