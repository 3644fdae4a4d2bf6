"""Draws from CPDs: their laws, their shapes, and the seeds of networks."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chisquare, kstest

import pgm
from tests.dense import random_covariance

A, B, W = pgm.variables("a b w")
X = pgm.Variable("x", components=("east", "north", "up"))
Y = pgm.Variable("y", components=("p", "q"))
HEADING = pgm.Variable("heading", angles=("heading",))
CLOUDY = pgm.Discrete("cloudy", states=("no", "yes"))
RAIN = pgm.Discrete("rain", states=("none", "some", "much"))
ROWS = np.array([[0.7, 0.3, 0.0], [0.1, 0.3, 0.6]])
COUNT = 20_000


def louder(w):
    return (0.5 + w[..., None] ** 2) * np.array([[2.0, 0.5], [0.5, 1.0]])


def curve(x):
    return np.stack([x[..., 0] * x[..., 1], np.sin(x[..., 2])], axis=-1)


COV = np.array([[2.0, -0.7], [-0.7, 0.5]])
FACTOR = np.array([[1.0, 2.0, 0.0], [0.5, -1.0, 1.0]])
PLACES, LOUD = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]), np.array([[0.2], [1.5]])
# Each with its means and covariances at the two places.
KINDS = {
    "without parents": (pgm.GaussianCPD(Y, [[1.0, 2.0], [3.0, 4.0]], COV), [[1, 2], [3, 4]], COV),
    "linear": (
        pgm.LinearGaussianCPD(Y, {X: FACTOR}, offset=[1.0, -1.0], cov=COV),
        PLACES @ FACTOR.T + [1.0, -1.0],
        COV,
    ),
    "linear, varying noise": (
        pgm.LinearGaussianCPD(Y, {X: FACTOR}, cov=pgm.noise(louder, W)),
        PLACES @ FACTOR.T,
        louder(LOUD),
    ),
    "nonlinear": (pgm.NonlinearGaussianCPD(Y, X, curve, COV), curve(PLACES), COV),
    "nonlinear, varying noise": (
        pgm.NonlinearGaussianCPD(Y, X, curve, pgm.noise(louder, W)),
        curve(PLACES),
        louder(LOUD),
    ),
}


def at_places(cpd):
    return {v: {X: PLACES, W: LOUD}[v] for v in cpd.parents}


@pytest.mark.parametrize("name", KINDS)
def test_draws_are_normal(name):
    """Whitened by the covariance, all components are standard normal and independent."""
    cpd, mean, cov = KINDS[name]
    drawn = cpd.sample(at_places(cpd), COUNT, rng=0)
    assert drawn.shape == (COUNT, 2, 2)
    lower = np.linalg.cholesky(np.broadcast_to(cov, (2, 2, 2)))
    white = np.linalg.solve(lower, (drawn - mean)[..., None])[..., 0].reshape(COUNT, 4)
    assert min(kstest(column, "norm").pvalue for column in white.T) > 1e-3
    assert_allclose(white.T @ white / COUNT, np.eye(4), atol=5 * np.sqrt(2 / COUNT))


@pytest.mark.parametrize("name", KINDS)
def test_the_density_is_that_of_the_draws(name):
    """Twice the log-density below its largest is χ² of two degrees."""
    cpd, mean, _ = KINDS[name]
    values = at_places(cpd)
    drawn = cpd.sample(values, COUNT, rng=1)
    below = cpd.log_density(mean, values) - cpd.log_density(drawn, values)
    assert kstest(2 * below.ravel(), "chi2", args=(2,)).pvalue > 1e-3


def test_frequencies_are_those_of_the_table():
    cpd = pgm.TableCPD(RAIN, CLOUDY, table=ROWS)
    drawn = cpd.sample({CLOUDY: ["no", "yes"]}, COUNT, rng=0)
    assert drawn.shape == (COUNT, 2)
    assert np.issubdtype(drawn.dtype, np.integer)
    for k, row in enumerate(ROWS):
        counts = np.bincount(drawn[:, k], minlength=3)
        assert (counts[row == 0.0] == 0).all()
        assert chisquare(counts[row > 0], COUNT * row[row > 0]).pvalue > 1e-3
    assert np.isfinite(cpd.log_density(drawn, {CLOUDY: [0, 1]})).all()


@pytest.mark.parametrize(
    ("size", "lead", "shape"),
    [
        ((), (), ()),
        (4, (), (4,)),
        (np.int64(4), (3,), (4, 3)),
        ((2, 4), (3, 1), (2, 4, 3, 1)),
        (0, (3,), (0, 3)),
        ([5], (), (5,)),
    ],
)
def test_shapes(size, lead, shape):
    linear = pgm.LinearGaussianCPD(Y, {A: np.ones((2, 1)), B: np.ones((2, 1))}, cov=COV)
    values = {A: np.zeros((*lead, 1)), B: 1.0}
    assert linear.sample(values, size, rng=0).shape == (*shape, 2)
    table = pgm.TableCPD(RAIN, CLOUDY, table=ROWS)
    assert table.sample({CLOUDY: np.zeros(lead, dtype=int)}, size, rng=0).shape == shape
    prior = pgm.GaussianCPD(Y, np.zeros((*lead, 2)), COV)
    assert prior.sample(size=size, rng=0).shape == (*shape, 2)
    loud = pgm.GaussianCPD(Y, [0, 0], pgm.noise(louder, W))
    assert loud.sample({W: np.ones((*lead, 1))}, size, rng=0).shape == (*shape, 2)


def test_axes_of_parents_broadcast():
    cpd = pgm.LinearGaussianCPD(A, {B: 1.0, W: 10.0}, cov=0.0)
    drawn = cpd.sample({B: [[[1.0]], [[2.0]]], W: [[1.0], [2.0], [3.0]]}, rng=0)
    assert_array_equal(drawn[..., 0], [[11, 21, 31], [12, 22, 32]])


def test_a_network_draws_what_its_cpds_do():
    """One after another, from one generator."""
    cpds = [
        pgm.GaussianCPD(X, [0, 1, 2], random_covariance(np.random.default_rng(0), 3, rank=2)),
        pgm.NonlinearGaussianCPD(Y, X, curve, pgm.noise(louder, W)),
        pgm.LinearGaussianCPD(A, {Y: [[1.0, 2.0]], W: -1.0}, cov=0.3),
    ]
    due = pgm.BayesianNetwork(cpds).sample(50, inputs={W: 0.4}, rng=7)
    rng, values = np.random.default_rng(7), {W: 0.4}
    for cpd in cpds:
        size = () if cpd.given else 50
        values[cpd.child] = cpd.sample({v: values[v] for v in cpd.parents}, size, rng=rng)
        assert_array_equal(values[cpd.child], due[cpd.child])
    tables = [pgm.TableCPD(CLOUDY, table=[0.4, 0.6]), pgm.TableCPD(RAIN, CLOUDY, table=ROWS)]
    due = pgm.BayesianNetwork(tables).sample(50, rng=7)
    rng = np.random.default_rng(7)
    cloudy = tables[0].sample(size=50, rng=rng)
    assert_array_equal(cloudy, due[CLOUDY])
    assert_array_equal(tables[1].sample({CLOUDY: cloudy}, rng=rng), due[RAIN])


def test_a_seed_draws_the_same_again():
    cpd = pgm.GaussianCPD(Y, [0, 0], COV)
    first, again, other = (cpd.sample(size=3, rng=seed) for seed in (5, 5, 6))
    assert_array_equal(first, again)
    assert_array_equal(first, cpd.sample(size=3, rng=np.random.default_rng(5)))
    assert (first != other).all()


def test_singular_noise_moves_what_it_leaves_free():
    cov = np.outer([1.0, -2.0, 0.0], [1.0, -2.0, 0.0])
    drawn = pgm.GaussianCPD(X, [1.0, 2.0, 3.0], cov).sample(size=100, rng=0)
    assert_array_equal(drawn[:, 2], 3.0)
    assert_allclose(drawn[:, 1] - 2.0, -2.0 * (drawn[:, 0] - 1.0), atol=1e-12)
    assert drawn[:, 0].std() > 0.5


def test_angles_are_drawn_on_one_chart():
    cpd = pgm.LinearGaussianCPD(HEADING, {HEADING.previous: 1.0}, cov=25.0)
    drawn = cpd.sample({HEADING.previous: 100.0}, 1000, rng=0)
    assert abs(drawn.mean() - 100.0) < 5 * 5 / np.sqrt(1000)
    assert np.ptp(drawn) > 2 * np.pi


def test_a_copy_at_a_step():
    cpd = pgm.LinearGaussianCPD(A, {A.previous: 0.5}, cov=pgm.noise(lambda w: w[..., None], W))
    due = cpd.sample({A.previous: 3.0, W: 2.0}, rng=0)
    assert_array_equal(cpd.at(4).sample({A.at(3): 3.0, W.at(4): 2.0}, rng=0), due)


@pytest.mark.parametrize("size", [-1, 2.5, "3", True, (2, -1), None, {2, 3}])
def test_the_number_of_draws_is_checked(size):
    with pytest.raises(pgm.ModelError, match="size is how many draws for each value"):
        pgm.GaussianCPD(A, 0, 1).sample(size=size, rng=0)


@pytest.mark.parametrize("rng", [None, True, -1, 1.5, "seed", np.random])
def test_what_draws_is_asked_for(rng):
    for cpd in (pgm.GaussianCPD(A, 0, 1), pgm.TableCPD(CLOUDY, table=[0.5, 0.5])):
        with pytest.raises(pgm.ModelError, match=r"rng is a numpy\.random\.Generator or a seed"):
            cpd.sample(rng=rng)


def test_more_draws_than_memory_are_refused():
    cpd = pgm.LinearGaussianCPD(A, {B: 1.0, W: 1.0}, cov=1.0)
    with pytest.raises(pgm.ModelError, match=r"draws from .* GiB.* draw fewer") as caught:
        cpd.sample({B: 1.0, W: 1.0}, 10**15, rng=0)
    assert caught.value.cpd is cpd
    wide = {B: np.broadcast_to(1.0, (10**8, 1, 1)), W: np.broadcast_to(1.0, (10**8, 1))}
    with pytest.raises(pgm.ModelError, match=r"all of .* values .* GiB.* fewer at a time"):
        cpd.sample(wide, rng=0)
    with pytest.raises(pgm.ModelError, match=r"all of .* values .* GiB.* fewer at a time"):
        cpd.log_density(wide[B], {B: 1.0, W: wide[W]})


def test_parents_are_asked_for():
    cpd = pgm.LinearGaussianCPD(A, {B: 1.0}, cov=1.0)
    with pytest.raises(pgm.ModelError, match="no value of its parent b"):
        cpd.sample(rng=0)
    with pytest.raises(pgm.ModelError, match=r"value of w, which is none of its parents \(b\)"):
        cpd.sample({B: 1.0, W: 1.0}, rng=0)
    with pytest.raises(pgm.ModelError, match="NaN or infinite"):
        cpd.sample({B: np.nan}, rng=0)
    with pytest.raises(pgm.ModelError, match="infinite variance"):
        pgm.GaussianCPD(Y, [0, 0], np.inf).sample(rng=0)


def test_a_kind_of_its_own_says_that_it_has_neither():
    class Poisson(pgm.cpds.CPD):
        def __init__(self, child):
            self._set_scope(child, ())

    cpd = Poisson(A)
    with pytest.raises(pgm.ModelError, match="cannot be drawn from"):
        cpd.sample(rng=0)
    with pytest.raises(pgm.ModelError, match="has no density"):
        cpd.log_density(1.0)
