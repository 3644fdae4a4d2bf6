"""Log-densities of CPDs against scipy, exact ranks, 50 digits and the joint of a network."""

import itertools
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

import pgm
from tests.dense import linear_joint, matrices, random_covariance, vectors

A, B, W = pgm.variables("a b w")
X = pgm.Variable("x", components=("east", "north", "up"))
Y = pgm.Variable("y", components=("p", "q"))
POSE = pgm.Variable("pose", components=("east", "heading"), angles=("heading",))
CLOUDY = pgm.Discrete("cloudy", states=("no", "yes"))
RAIN = pgm.Discrete("rain", states=("none", "some", "much"))
ROWS = np.array([[0.7, 0.3, 0.0], [0.1, 0.3, 0.6]])


def louder(w):
    return (0.5 + w[..., None] ** 2) * np.array([[2.0, 0.5], [0.5, 1.0]])


def curve(x, b):
    return np.stack([x[..., 0] * x[..., 1], np.sin(x[..., 2]) + b[..., 0]], axis=-1)


def kinds(rng):
    """A CPD of each continuous kind over y, and its mean and covariance at single values."""
    f, g, offset = rng.normal(size=(2, 3)), rng.normal(size=(2, 1)), rng.normal(size=2)
    cov = random_covariance(rng, 2)
    linear = {X: f, B: g}
    return {
        "without parents": (pgm.GaussianCPD(Y, offset, cov), lambda v: (offset, cov)),
        "linear": (
            pgm.LinearGaussianCPD(Y, linear, offset=offset, cov=cov),
            lambda v: (f @ v[X] + g @ v[B] + offset, cov),
        ),
        "linear, varying noise": (
            pgm.LinearGaussianCPD(Y, linear, offset=offset, cov=pgm.noise(louder, W)),
            lambda v: (f @ v[X] + g @ v[B] + offset, louder(v[W])),
        ),
        "noise of a parent alone": (
            pgm.GaussianCPD(Y, offset, pgm.noise(louder, W)),
            lambda v: (offset, louder(v[W])),
        ),
        "nonlinear": (
            pgm.NonlinearGaussianCPD(Y, (X, B), curve, cov),
            lambda v: (curve(v[X], v[B]), cov),
        ),
        "nonlinear, noise of the same parent": (
            pgm.NonlinearGaussianCPD(
                Y, (X, B), curve, pgm.noise(lambda x: louder(x[..., :1]), given=X)
            ),
            lambda v: (curve(v[X], v[B]), louder(v[X][:1])),
        ),
    }


def one_by_one(law, lead, child, values):
    """What scipy says of each combination of values."""
    child = np.broadcast_to(child, (*lead, 2))
    wide = {v: np.broadcast_to(a, (*lead, a.shape[-1])) for v, a in values.items()}
    found = np.empty(lead)
    for k in np.ndindex(lead):
        mean, cov = law({v: a[k] for v, a in wide.items()})
        found[k] = multivariate_normal(mean, cov).logpdf(child[k])
    return found


LEADS = [  # of the child, and of x, b and w
    ((), (), (), ()),
    ((4,), (), (), ()),
    ((), (4,), (1,), ()),
    ((5, 1), (4,), (1,), (4,)),
    ((4,), (2, 1, 1), (3, 1), (4,)),
    ((30,), (30,), (30,), (30,)),
]


@pytest.mark.parametrize("leads", LEADS, ids=repr)
@pytest.mark.parametrize("name", kinds(np.random.default_rng(0)))
def test_it_is_that_of_scipy_whatever_the_axes(name, leads):
    rng = np.random.default_rng(len(name))
    cpd, law = kinds(rng)[name]
    shapes = dict(zip((X, B, W), leads[1:], strict=True))
    values = {v: rng.normal(size=(*shapes[v], v.dimension)) for v in cpd.parents}
    child = rng.normal(size=(*leads[0], 2))
    lead = np.broadcast_shapes(leads[0], *(shapes[v] for v in cpd.parents))
    found = cpd.log_density(child, values)
    assert found.shape == lead
    assert_allclose(found, one_by_one(law, lead, child, values), rtol=1e-9, atol=1e-9)


def test_means_and_covariances_of_runs():
    rng = np.random.default_rng(1)
    mean, cov = rng.normal(size=(3, 1, 2)), random_covariance(rng, 2, lead=(4,))
    cpd, point = pgm.GaussianCPD(Y, mean, cov), rng.normal(size=2)
    due = [
        [multivariate_normal(mean[i, 0], cov[k]).logpdf(point) for k in range(4)] for i in range(3)
    ]
    assert_allclose(cpd.log_density(point), due, rtol=1e-9)
    assert cpd.log_density(np.broadcast_to(point, (5, 3, 4, 2))).shape == (5, 3, 4)
    varying = pgm.GaussianCPD(Y, mean[:, 0], pgm.noise(louder, W))
    steps = np.array([[0.1], [0.2], [0.3]])
    due = [
        multivariate_normal(m[0], louder(w)).logpdf(point) for m, w in zip(mean, steps, strict=True)
    ]
    assert_allclose(varying.log_density(point, {W: steps}), due, rtol=1e-9)


def test_python_numbers_are_scalars():
    cpd = pgm.LinearGaussianCPD(A, {B: 2.0}, cov=4.0)
    due = -0.5 * np.log(8 * np.pi) - 0.5 * (7 - 6) ** 2 / 4
    found = cpd.log_density(7, {B: 3})
    assert found.shape == ()
    assert_allclose(found, due, rtol=1e-15)


def test_no_values_at_all():
    cpd = pgm.NonlinearGaussianCPD(A, B, lambda b: b, 1.0)
    assert cpd.log_density(np.zeros((0, 1)), {B: 1.0}).shape == (0,)
    assert cpd.log_density(1.0, {B: np.zeros((3, 0, 1))}).shape == (3, 0)
    assert pgm.TableCPD(RAIN, CLOUDY, table=ROWS).log_density([], {CLOUDY: 1}).shape == (0,)


def test_a_copy_at_a_step_and_its_lag():
    cpd = pgm.LinearGaussianCPD(A, {A.previous: 0.5}, cov=1.0)
    due = cpd.log_density(2.0, {A.previous: 3.0})
    assert_array_equal(cpd.at(4).log_density(2.0, {A.at(3): 3.0}), due)
    assert_allclose(due, -0.5 * np.log(2 * np.pi) - 0.125)


@settings(max_examples=60)
@given(matrices(2, 3), vectors(2), vectors(3), vectors(2), matrices(2, 2), matrices(3, 3))
def test_the_product_is_the_joint(factor, offset, x, y, root, prior):
    """Chain rule: ln p(x) + ln p(y | x) is the log-density of the dense joint."""
    covs = prior @ prior.T + np.eye(3), root @ root.T + np.eye(2)
    cpds = (
        pgm.GaussianCPD(X, np.ones(3), covs[0]),
        pgm.LinearGaussianCPD(Y, {X: factor}, offset=offset, cov=covs[1]),
    )
    joint = linear_joint([(X, {}, np.ones(3), covs[0]), (Y, {X: factor}, offset, covs[1])])
    _, due = joint.given({X: x, Y: y})
    found = cpds[0].log_density(x) + cpds[1].log_density(y, {X: x})
    assert_allclose(found, due, rtol=1e-7, atol=1e-7)


def test_the_sum_over_a_network_is_its_evidence():
    """Everything observed: what inference finds, singular noise included."""
    cpds = [
        pgm.GaussianCPD(X, [1.0, 0.0, 2.0], [[2, 1, 0], [1, 3, 1], [0, 1, 1]]),
        pgm.LinearGaussianCPD(Y, {X: [[1, 0, 0], [0, 1, 1]]}, cov=np.diag([0.3, 0.0])),
        pgm.LinearGaussianCPD(A, {Y: [[1.0, -1.0]]}, cov=0.0),
    ]
    net = pgm.BayesianNetwork(cpds)
    drawn = net.sample(5, rng=0)
    due = pgm.infer(pgm.compile(net), drawn).log_evidence
    found = sum(c.log_density(drawn[c.child], {p: drawn[p] for p in c.given}) for c in cpds)
    assert np.isfinite(found).all()
    assert_allclose(found, due, rtol=1e-9)


# ---- singular noise


def open_components(root):
    """The components that those before them leave free in a covariance R Rᵀ, R of integers."""
    rows = [[Fraction(int(entry)) for entry in row] for row in root]
    found, basis = [], []
    for k, row in enumerate(rows):
        left = list(row)
        for pivot, other in basis:
            factor = left[pivot] / other[pivot]
            left = [a - factor * b for a, b in zip(left, other, strict=True)]
        if any(left):
            found.append(k)
            basis.append((next(j for j, entry in enumerate(left) if entry), left))
    return found


WIDE = pgm.Variable("wide", components=tuple("abcde"))


@settings(max_examples=80)
@given(st.integers(0, 5), st.integers(0, 10_000))
def test_singular_noise_has_the_density_of_what_it_leaves_free(rank, seed):
    rng = np.random.default_rng(seed)
    root = rng.integers(-3, 4, size=(5, rank))
    mean, cov = 100.0 * rng.normal(size=5), (root @ root.T).astype(float)
    cpd, free = pgm.GaussianCPD(WIDE, mean, cov), open_components(root)
    points = mean + rng.normal(size=(7, rank)) @ root.T
    due = np.zeros(7)
    if free:
        part = cov[np.ix_(free, free)]
        white = np.linalg.solve(part, (points - mean)[:, free].T)
        due = -0.5 * ((points - mean)[:, free] * white.T).sum(axis=1)
        due -= 0.5 * np.linalg.slogdet(2 * np.pi * part)[1]
    assert_allclose(cpd.log_density(points), due, rtol=1e-6, atol=1e-6)
    fixed = np.setdiff1d(np.arange(5), free)
    for k in fixed:
        away = points.copy()
        away[:, k] += 1e-4 * max(1.0, np.sqrt(cov[k, k]))
        assert_array_equal(cpd.log_density(away), -np.inf)


def test_draws_of_an_angle_beside_what_it_determines_have_a_density():
    """Some turn by more than half, where the wrapped residual is off the line of the noise."""
    turned = pgm.Variable("turned", components=("heading", "drift"), angles=("heading",))
    cpd = pgm.GaussianCPD(turned, [0.0, 0.0], [[9.0, 9.0], [9.0, 9.0]])
    draws = cpd.sample(size=2000, rng=0)
    assert (np.abs(draws[:, 0]) > np.pi).any()
    due = -0.5 * (draws[:, 0] ** 2 / 9.0 + np.log(2 * np.pi * 9.0))
    assert_allclose(cpd.log_density(draws), due, rtol=1e-9)
    assert_array_equal(cpd.log_density(draws + np.array([0.0, 1e-3])), -np.inf)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("far", [0.0, 1e4])
def test_draws_of_others_lie_on_the_subspace(scale, far):
    """Eigenvectors leave √ε of the largest deviation; a factor some digits of the coordinates."""
    rng = np.random.default_rng(0)
    root = scale * rng.normal(size=(5, 3))
    mean = np.full(5, far * scale)
    points = rng.multivariate_normal(mean, root @ root.T, size=500)
    assert np.isfinite(pgm.GaussianCPD(WIDE, mean, root @ root.T).log_density(points)).all()
    units = np.array([1.0, 1e3, 1e-3, 1.0, 10.0])
    root, mean = root * units[:, None], mean * units
    cpd = pgm.GaussianCPD(WIDE, mean, root @ root.T)
    points = mean + rng.normal(size=(500, 3)) @ root.T
    assert np.isfinite(cpd.log_density(points)).all()
    away = points + 1e-4 * np.abs(root).max(axis=1) * np.array([0, 0, 0, 1, 0])
    assert_array_equal(cpd.log_density(away), -np.inf)


def test_rounding_of_a_large_coordinate_reaches_what_it_determines():
    """A step of 1e-6 beside 1e6 has four digits; the other component is ten thousand times it."""
    cov = 1e-12 * np.array([[1.0, 1e4], [1e4, 1e8]])
    white = np.random.default_rng(0).normal(size=100)
    points = np.stack([1e6 + 1e-6 * white, 1e-2 * white], axis=-1)
    found = pgm.GaussianCPD(Y, [1e6, 0.0], cov).log_density(points)
    due = -0.5 * (white**2 + np.log(2 * np.pi * 1e-12))
    assert_allclose(found, due, atol=1e-3)


def test_no_noise_is_a_point():
    cpd = pgm.LinearGaussianCPD(A, {B: 0.1, W: 0.2}, cov=0.0)
    assert 0.1 * 3 + 0.2 * 3 != 0.9
    assert_array_equal(cpd.log_density([[0.9], [0.9 + 1e-6]], {B: 3.0, W: 3.0}), [0.0, -np.inf])
    assert not np.signbit(cpd.log_density(0.9, {B: 3.0, W: 3.0}))
    # A difference of large numbers has the rounding of these.
    close = pgm.LinearGaussianCPD(A, {B: 1e6, W: -1e6}, cov=0.0)
    values = {B: 1e6 + 1e-3, W: 1e6}
    child = 1e6 * (values[B] - values[W])
    assert abs(child - (1e6 * values[B] - 1e6 * values[W])) > 1e-5
    assert_array_equal(close.log_density([[child], [child + 1.0]], values), [0.0, -np.inf])
    square = pgm.NonlinearGaussianCPD(
        Y, B, lambda b: np.concatenate([b, b**2], -1), np.zeros((2, 2))
    )
    assert_array_equal(square.log_density([[0.3, 0.09], [0.3, 0.1]], {B: 0.3}), [0.0, -np.inf])


def test_noise_that_comes_and_goes():
    cpd = pgm.LinearGaussianCPD(A, {B: 1.0}, cov=pgm.noise(lambda w: w[..., None] ** 2, W))
    found = cpd.log_density([[1.0], [1.0], [2.0]], {B: 1.0, W: [[0.0], [2.0], [0.0]]})
    assert_allclose(found, [0.0, -0.5 * np.log(8 * np.pi), -np.inf])


# ---- far and near


@pytest.mark.parametrize("variance", [1e-200, 1e-9, 1.0, 1e200])
@pytest.mark.parametrize("off", [0.0, 1e-3, 50.0, 1e5])
def test_against_fifty_digits(variance, off):
    """At any scale, with a correlation that takes away six of the digits."""
    deviation = np.sqrt(variance)
    cov = variance * np.array([[1.0, 1 - 1e-6], [1 - 1e-6, 1.0]])
    point = deviation * np.array([off, 1.0])
    found = pgm.GaussianCPD(Y, [0, 0], cov).log_density(point)
    with mpmath.workdps(50):
        exact, r = mpmath.matrix(cov.tolist()), mpmath.matrix(point.tolist())
        square = (r.T * mpmath.inverse(exact) * r)[0]
        due = -(square + mpmath.log(mpmath.det(2 * mpmath.pi * exact))) / 2
    assert_allclose(found, float(due), rtol=1e-8)


def test_what_is_too_far_to_be_squared_has_no_density():
    cpd = pgm.GaussianCPD(Y, [1e308, 0.0], np.eye(2))
    assert_array_equal(cpd.log_density([[-1e308, 0.0], [1e200, 1.0]]), -np.inf)


# ---- angles


@pytest.mark.parametrize("linear", [True, False])
def test_residuals_of_angles_are_wrapped(linear):
    cov = np.array([[1.0, 0.3], [0.3, 0.2]])
    if linear:
        cpd = pgm.LinearGaussianCPD(POSE, {POSE.previous: 1.0}, cov=cov)
    else:
        cpd = pgm.NonlinearGaussianCPD(POSE, POSE.previous, lambda pose: pose, cov)
    turns = 2 * np.pi * np.arange(-3, 4)[:, None] * [0.0, 1.0]
    found = cpd.log_density(np.array([0.5, 3.0]) + turns, {POSE.previous: [0.2, -3.0]})
    due = multivariate_normal([0, 0], cov).logpdf([0.3, 6.0 - 2 * np.pi])
    assert_allclose(found, due, rtol=1e-9)
    moved = cpd.log_density([0.5, 3.0], {POSE.previous: np.array([0.2, -3.0]) + turns})
    assert_allclose(moved, due, rtol=1e-9)


def test_an_angle_without_noise_is_itself_after_any_turn():
    cpd = pgm.GaussianCPD(POSE, [1.0, np.pi], np.diag([1.0, 0.0]))
    found = cpd.log_density([[1.0, -np.pi], [1.0, 101 * np.pi], [1.0, 3.0]])
    due = -0.5 * np.log(2 * np.pi)
    assert_allclose(found, [due, due, -np.inf])


# ---- tables


def test_a_table_has_its_entries():
    cpd = pgm.TableCPD(RAIN, CLOUDY, table=ROWS)
    with np.errstate(divide="ignore"):
        due = np.log(ROWS)
    found = cpd.log_density(["none", "some", "much"], {CLOUDY: [["no"], ["yes"]]})
    assert_array_equal(found, due)
    assert_array_equal(cpd.log_density(np.arange(3), {CLOUDY: [[0], [1]]}), due)
    assert cpd.log_density("much", {CLOUDY: "yes"}).shape == ()
    prior = pgm.TableCPD(RAIN, table=[0.5, 0.25, 0.25])
    assert_array_equal(prior.log_density([[2, 0]]), np.log([[0.25, 0.5]]))


def test_the_sum_over_a_discrete_network_is_its_evidence():
    rng = np.random.default_rng(0)
    variables = [pgm.Discrete(f"d{k}", k + 1) for k in range(4)]
    cpds = []
    for k, child in enumerate(variables):
        table = rng.random([v.size for v in variables[: k + 1]])
        table /= table.sum(axis=-1, keepdims=True)
        cpds.append(pgm.TableCPD(child, variables[:k], table=table))
    net = pgm.BayesianNetwork(cpds)
    states = np.array(list(itertools.product(*(range(v.size) for v in variables)))).T
    evidence = dict(zip(variables, states, strict=True))
    found = sum(c.log_density(evidence[c.child], {p: evidence[p] for p in c.given}) for c in cpds)
    assert_allclose(np.exp(found).sum(), 1.0)
    assert_allclose(found, pgm.infer(pgm.compile(net), evidence).log_evidence, rtol=1e-12)


# ---- what is refused

LINEAR = pgm.LinearGaussianCPD(A, {X: np.ones((1, 3))}, cov=1.0)
TABLE = pgm.TableCPD(RAIN, CLOUDY, table=ROWS)
HERE = {X: [1.0, 2.0, 3.0]}
FAULTS = {
    "no parents": (LINEAR, 1.0, None, X, r"no value of its parent x; .* parents \(x\)"),
    "another": (
        LINEAR,
        1.0,
        {**HERE, B: 1.0},
        B,
        r"value of b, which is none of its parents \(x\)$",
    ),
    "its child": (LINEAR, 1.0, {**HERE, A: 1.0}, A, "value of a, which is none of its parents"),
    "a name": (LINEAR, 1.0, {"x": [1, 2, 3]}, None, "'x', which is none .* the variable itself"),
    "no mapping": (LINEAR, 1.0, [1.0], None, "parents, of .* is a mapping .* not list"),
    "the child's width": (LINEAR, [1.0, 2.0], HERE, A, r"shape \(2,\); .*'a'.*\[\.\.\., None\]"),
    "a parent's width": (LINEAR, 1.0, {X: [1.0, 2.0]}, X, r"shape \(2,\); .* 3 components"),
    "a number of three": (LINEAR, 1.0, {X: 1.0}, X, r"shape \(\); .* 3 components"),
    "axes": (LINEAR, np.ones((2, 1)), {X: np.ones((3, 3))}, None, r"the child \(2,\), .* \(3,\)"),
    "NaN": (LINEAR, 1.0, {X: [1.0, np.nan, 0.0]}, X, "NaN or infinite"),
    "infinity": (LINEAR, 1.0, {X: [1.0, np.inf, 0.0]}, X, "NaN or infinite"),
    "text": (LINEAR, "one", HERE, A, "numbers"),
    "no state": (
        TABLE,
        "hail",
        {CLOUDY: 0},
        RAIN,
        r"'hail', .*\('none', 'some', 'much'\), 0 to 2$",
    ),
    "a missing state": (TABLE, [0, -1], {CLOUDY: 0}, RAIN, r"is -1 \(first in run 1\), .* 0 to 2$"),
    "a missing parent": (TABLE, 0, {CLOUDY: [1, -1]}, CLOUDY, r"of cloudy in TableCPD.* is -1"),
    "no whole number": (TABLE, 1.0, {CLOUDY: 0}, RAIN, r"names or indices .* 'much'\)$"),
    "no discrete parent": (TABLE, 0, {}, CLOUDY, "no value of its parent cloudy"),
    "a flat prior": (
        pgm.GaussianCPD(A, 0, np.inf),
        1.0,
        None,
        A,
        "infinite variance.* a finite one",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_values_that_do_not_fit_are_refused(name):
    cpd, child, parents, variable, words = FAULTS[name]
    with pytest.raises(pgm.ModelError, match=words) as caught:
        cpd.log_density(child, parents)
    assert caught.value.variable == variable
    assert caught.value.cpd is cpd
    if (
        "child" not in name
        and child is not None
        and name not in ("axes", "NaN", "infinity", "text")
    ):
        assert repr(cpd.child) in str(caught.value)


def test_components_that_are_nan_were_not_measured():
    cov = np.array([[1.0, 0.6, 0.2], [0.6, 2.0, -0.3], [0.2, -0.3, 1.5]])
    cpd = pgm.GaussianCPD(X, mean=[0.5, -0.5, 0.25], cov=cov)
    values = np.array([[1.0, np.nan, 0.3], [np.nan] * 3, [0.1, 0.2, 0.3]])
    kept = np.ix_([0, 2], [0, 2])
    expected = [
        multivariate_normal([0.5, 0.25], cov[kept]).logpdf([1.0, 0.3]),
        0.0,
        multivariate_normal([0.5, -0.5, 0.25], cov).logpdf([0.1, 0.2, 0.3]),
    ]
    np.testing.assert_allclose(cpd.log_density(values), expected)


def test_axes_of_parents_that_do_not_broadcast():
    cpd = pgm.LinearGaussianCPD(A, {B: 1.0, W: 1.0}, cov=1.0)
    with pytest.raises(pgm.ModelError, match=r"broadcast: b \(2,\), w \(3,\)"):
        cpd.log_density(1.0, {B: np.ones((2, 1)), W: np.ones((3, 1))})


def failing(function=lambda b: b, cov=1.0):
    return pgm.NonlinearGaussianCPD(A, B, function, cov)


BAD = {
    "raises": (
        failing(lambda b: [1][int(b.max())]),
        pgm.ModelError,
        "function .* run 2,.* IndexError",
    ),
    "shape": (
        failing(lambda b: b[..., 0]),
        pgm.ModelError,
        r"returned shape \(3,\) where \(3, 1\)",
    ),
    "NaN": (
        failing(lambda b: np.where(b > 1, np.nan, b)),
        pgm.LinearisationError,
        "of a, run 2, has values that are NaN",
    ),
    "no covariance": (
        failing(cov=pgm.noise(lambda b: 1.0 - b[..., None], B)),
        pgm.ModelError,
        "noise of the CPD of a, run 2, has the negative variance -1",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_functions_that_fail_say_where(name):
    cpd, kind, words = BAD[name]
    for use in (
        lambda values: cpd.log_density(0.0, values),
        lambda values: cpd.sample(values, rng=0),
    ):
        with pytest.raises(kind, match=words) as caught:
            use({B: [[0.0], [1.0], [2.0]] if name != "raises" else [[0.0], [0.0], [1.0]]})
        assert caught.value.cpd is cpd
        assert caught.value.variable == A
        assert caught.value.run in (None, 2)
    at_step = cpd.at(4)
    with pytest.raises(kind) as caught:
        at_step.log_density(0.0, {B.at(4): [[2.0]]})
    assert caught.value.step == 4


# [5, −6, −3], [−6, 8, 2], [−3, 2, 5], of rank 2, but for errors: it passes as a covariance.
ROUGH = np.array(
    [
        [4.9999999997, -6.0000000001, -3.0000000003],
        [-6.0000000001, 8.0, 2.0000000002],
        [-3.0000000003, 2.0000000002, 4.9999999998],
    ]
)


def test_a_rough_covariance_is_refused_and_the_advice_helps():
    cpd = pgm.GaussianCPD(X, np.zeros(3), ROUGH)
    belief = pgm.Gaussian(X, np.zeros(3), ROUGH)
    noise = pgm.noise(lambda b: b[..., None] * ROUGH, B)
    varying = pgm.LinearGaussianCPD(X, {A: np.ones((3, 1))}, cov=noise)
    values = {A: 0.0, B: [[0.0], [1.0]]}
    for use in (
        lambda: cpd.log_density(np.zeros(3)),
        lambda: cpd.sample(rng=0),
        lambda: belief.sample(rng=0),
        lambda: pgm.BayesianNetwork([cpd]).sample(rng=0),
        lambda: varying.log_density(np.zeros(3), values),
        lambda: varying.sample(values, rng=0),
    ):
        with pytest.raises(pgm.NumericalError, match="negative eigenvalues to 0") as caught:
            use()
        assert caught.value.run in (None, 1)
    eigenvalues, vectors = np.linalg.eigh(ROUGH)
    mended = (vectors * np.maximum(eigenvalues, 0.0)) @ vectors.T
    cpd = pgm.GaussianCPD(X, np.zeros(3), mended)
    assert np.isfinite(cpd.log_density(cpd.sample(size=10, rng=0))).all()
