"""First-order expansion, with derivatives given, missing, or given for a part."""

from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from tests.dense import bound_function

MACHINE = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")
X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
U = pgm.Variable("u", components=("v", "omega"))
V = np.array([1.5, 0.3])
MEAN = np.array([1.0, -2.0, 0.7])


def drive(x, u):
    heading = x[..., 2] + 0.5 * u[..., 1]
    step = np.stack([u[..., 0] * np.cos(heading), u[..., 0] * np.sin(heading), u[..., 1]], axis=-1)
    return x + step


def by_state(x, u):
    heading = x[..., 2] + 0.5 * u[..., 1]
    F = np.zeros((*x.shape[:-1], 3, 3))
    F[...] = np.eye(3)
    F[..., 0, 2], F[..., 1, 2] = -u[..., 0] * np.sin(heading), u[..., 0] * np.cos(heading)
    return F


def by_control(x, u):
    heading = x[..., 2] + 0.5 * u[..., 1]
    c, s, v = np.cos(heading), np.sin(heading), u[..., 0]
    return np.stack(
        [
            np.stack([c, -0.5 * v * s], axis=-1),
            np.stack([s, 0.5 * v * c], axis=-1),
            np.stack([0 * v, 0 * v + 1], axis=-1),
        ],
        axis=-2,
    )


def cpd_of(jacobian=None):
    return pgm.NonlinearGaussianCPD(X, (X.previous, U), drive, np.eye(3), jacobian=jacobian)


JACOBIANS = {
    "none": {},
    "state": {X.previous: by_state},
    "control": {U: by_control},
    "both": {X.previous: by_state, U: by_control},
}
given_ones = pytest.mark.parametrize("jacobian", JACOBIANS.values(), ids=JACOBIANS)


@given_ones
@pytest.mark.parametrize("std", [0.0, 0.2])
def test_with_a_known_control(jacobian, std):
    function = bound_function(cpd_of(jacobian), {U: V})
    affine = pgm.Taylor()(function, pgm.Gaussian(X.previous, MEAN, std**2 * np.eye(3)))
    F = by_state(MEAN, V)
    assert_allclose(affine.F, F, atol=1e-8)
    assert_allclose(affine.b, drive(MEAN, V) - F @ MEAN, atol=1e-8)
    assert_array_equal(affine.cov, np.zeros((3, 3)))


@given_ones
def test_with_a_hidden_control(jacobian):
    at = pgm.Gaussian((X.previous, U), np.concatenate([MEAN, V]), 0.01 * np.eye(5))
    affine = pgm.Taylor()(bound_function(cpd_of(jacobian)), at)
    assert_allclose(affine.F, np.hstack([by_state(MEAN, V), by_control(MEAN, V)]), atol=1e-8)
    assert_allclose(affine.F @ at.mean + affine.b, drive(MEAN, V), atol=1e-12)


def test_only_derivatives_by_hidden_parents_are_called():
    def never(x, u):
        raise AssertionError("called")

    cpd = cpd_of({X.previous: by_state, U: never})
    at = pgm.Gaussian(X.previous, MEAN, np.eye(3))
    assert_allclose(pgm.Taylor()(bound_function(cpd, {U: V}), at).F, by_state(MEAN, V))


def test_the_users_derivative_is_taken_at_its_word():
    cpd = cpd_of({X.previous: lambda x, u: 7.0 * by_state(x, u)})
    at = pgm.Gaussian(X.previous, MEAN, np.eye(3))
    affine = pgm.Taylor()(bound_function(cpd, {U: V}), at)
    assert_allclose(affine.F, 7.0 * by_state(MEAN, V))
    assert_allclose(affine.F @ MEAN + affine.b, drive(MEAN, V))


@given_ones
def test_batches(jacobian):
    rng = np.random.default_rng(0)
    mean, u = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 2))
    function = bound_function(cpd_of(jacobian), {U: u}, lead=2)
    affine = pgm.Taylor()(function, pgm.Gaussian(X.previous, mean, 0.01 * np.eye(3)))
    assert_allclose(affine.F, by_state(mean, u), atol=1e-8)
    value = np.einsum("...ij,...j->...i", affine.F, mean) + affine.b
    assert_allclose(value, drive(mean, u), atol=1e-12)


@pytest.mark.parametrize("apart", [0.1, 1e-3])
@pytest.mark.parametrize("traced", [True, False])
@pytest.mark.parametrize("runs", [(), (3,)])
def test_a_range_between_two_places_of_which_neither_is_known(apart, traced, runs):
    """Differences over a share of what is unknown, 10 m here, would leap over the landmark."""
    robot, mark, z = pgm.variables("robot mark z")

    def see(a, b):
        if not traced and (a > 1e9).any():  # which no trace follows
            return a
        return np.sqrt(1.0 + (b - a) ** 2)

    far = np.full((*runs, 1), 3.0)
    see_it = pgm.NonlinearGaussianCPD(z, given=(robot, mark), function=see, cov=1e-4)
    assert ("numerical" in str(see_it.derivatives)) != traced
    model = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(robot, far, 1e6),
            pgm.LinearGaussianCPD(mark, {robot: 1.0}, cov=apart**2, offset=2.0),
            see_it,
        ]
    )
    found = pgm.infer(pgm.compile(model), {z: np.full((*runs, 1), np.sqrt(5.0))})
    cov = found.joint(robot, mark).cov
    due = 1.0 / (apart**-2 + (2.0 / np.sqrt(5.0)) ** 2 / 1e-4)
    variance = cov[..., 0, 0] + cov[..., 1, 1] - 2.0 * cov[..., 0, 1]
    assert_allclose(variance, np.full(runs, due), rtol=1e-5, atol=2e-9)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
def test_a_bearing_at_the_landmark_is_one_run_or_many(compiled):
    """Where a trace has no finite derivative its differences are over the same steps."""
    z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))

    def see(x):
        away = -x[..., :2]
        bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
        return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, np.zeros(3), [4.0, 9.0, 1.0])],
        [pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.0)],
        [pgm.NonlinearGaussianCPD(z, X, see, cov=[0.01, 0.01])],
    )
    one = pgm.filter(model, {z: [[0.1, 0.2]]}, compiled=compiled)[X]
    seen = np.tile([[0.1, 0.2]], (3, 1, 1))
    many = pgm.filter(model, {z: seen}, steps=1, compiled=compiled)[X]
    robot = pgm.OnlineFilter(model, compiled=compiled)
    online = robot.update(robot.predict(robot.initial()), {z: [0.1, 0.2]})[X]
    for run in range(3):
        assert_allclose(many.mean[run], one.mean, rtol=1e-12, atol=1e-12)
        assert_allclose(many.cov[run], one.cov, rtol=1e-12, atol=1e-12)
    assert_allclose(online.cov, one.cov[-1], rtol=1e-12, atol=1e-12)
