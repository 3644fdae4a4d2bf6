"""What a lineariser is given: the CPD's function with the evidence bound."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from tests.dense import bound_function

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
M = pgm.Variable("m", components=("east", "north"))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))


def range_bearing(x, m):
    east, north = m[..., 0] - x[..., 0], m[..., 1] - x[..., 1]
    return np.stack([np.hypot(east, north), np.arctan2(north, east) - x[..., 2]], axis=-1)


def by_state(x, m):
    east, north = m[..., 0] - x[..., 0], m[..., 1] - x[..., 1]
    r2, zero = east**2 + north**2, 0 * east
    r = np.sqrt(r2)
    return np.stack(
        [
            np.stack([-east / r, -north / r, zero], axis=-1),
            np.stack([north / r2, -east / r2, zero - 1], axis=-1),
        ],
        axis=-2,
    )


def sensor(function=range_bearing, given=(X, M), **more):
    return pgm.NonlinearGaussianCPD(Z, given, function, 0.01 * np.eye(2), **more)


def test_masks_and_name():
    function = bound_function(sensor(), {M: [3.0, 4.0]})
    assert function.name == "z"
    assert_array_equal(function.angles, [False, True])
    assert_array_equal(function.input_angles, [False, False, True])
    both = bound_function(sensor(given=(M, X)))
    assert_array_equal(both.input_angles, [False, False, False, False, True])


def test_residuals_wrap_angles_alone():
    function = bound_function(sensor(), {M: [3.0, 4.0]})
    found = function.residual(np.array([[7.0, 3.0], [7.0, 0.1]]), np.array([0.0, -3.0]))
    assert_allclose(found, [[7.0, 6.0 - 2 * np.pi], [7.0, 3.1]])


def test_evidence_is_bound_by_place_whatever_the_order():
    x, m = np.array([1.0, 2.0, 0.3]), np.array([4.0, 6.0])
    expected = range_bearing(x, m)
    assert_allclose(bound_function(sensor(), {M: m})(x), expected)
    assert_allclose(bound_function(sensor(), {X: x})(m), expected)
    swapped = sensor(lambda m, x: range_bearing(x, m), given=(M, X))
    assert_allclose(bound_function(swapped, {M: m})(x), expected)
    assert_allclose(bound_function(swapped)(np.concatenate([m, x])), expected)


@pytest.mark.parametrize("extra", [(), (7,), (7, 2)])
@pytest.mark.parametrize("lead", [(), (5,), (3, 5)])
def test_evidence_is_expanded_over_extra_axes(lead, extra):
    rng = np.random.default_rng(0)
    x, m = rng.normal(size=(*lead, *extra, 3)), rng.normal(size=(*lead, 2)) + 5.0
    shapes = []

    def record(x, m):
        shapes.append((x.shape, m.shape))
        return range_bearing(x, m)

    function = bound_function(sensor(record), {M: m}, lead=len(lead))
    wide = np.broadcast_to(m.reshape(*lead, *(1 for _ in extra), 2), (*lead, *extra, 2))
    assert_allclose(function(x), range_bearing(x, wide))
    assert shapes == [((*lead, *extra, 3), (*lead, *extra, 2))]
    by_hand = bound_function(sensor(jacobian={X: by_state}), {M: m}, lead=len(lead)).jacobian(x)
    numerical = function.jacobian(x)
    assert by_hand.shape == (*lead, *extra, 2, 3)
    assert_allclose(numerical, by_hand, atol=1e-8)
    assert_allclose(by_hand, by_state(x, wide))


def test_evidence_of_one_run_serves_all():
    x, m = np.random.default_rng(0).normal(size=(6, 5, 3)), np.array([[3.0, 4.0]])
    found = bound_function(sensor(), {M: m}, lead=1)(x)
    assert_allclose(found, range_bearing(x, np.broadcast_to(m[0], (6, 5, 2))))


@pytest.mark.parametrize(
    "function",
    [
        lambda x, m: range_bearing(x, m)[..., 0],
        lambda x, m: range_bearing(x, m)[..., None],
        lambda x, m: range_bearing(x, m)[..., :1],
        lambda x, m: np.zeros(2),
        lambda x, m: range_bearing(x, m)[:3],
    ],
)
def test_wrong_shapes_are_refused(function):
    with pytest.raises(pgm.ModelError, match="returned shape") as caught:
        bound_function(sensor(function), {M: np.ones((4, 2))}, lead=1)(np.zeros((4, 3)))
    assert caught.value.variable == Z
    assert "z" in str(caught.value)


def test_jacobians_of_wrong_shape_are_refused():
    cpd = sensor(jacobian={X: lambda x, m: by_state(x, m)[..., :2]})
    with pytest.raises(pgm.ModelError, match=r"jacobian by x .*returned shape"):
        bound_function(cpd, {M: np.ones((4, 2))}, lead=1).jacobian(np.zeros((4, 3)))


def test_a_bound_function_is_frozen():
    function = bound_function(sensor(), {M: [3.0, 4.0]}, step=3)
    assert function.step == 3
    with pytest.raises(AttributeError):
        function.step = 4


def localisation(**sensor_options):
    """The design's first program, its landmarks known."""
    u = pgm.Variable("u", components=("v", "omega"))

    def drive(x, u):
        step = np.stack(
            [u[..., 0] * np.cos(x[..., 2]), u[..., 0] * np.sin(x[..., 2]), u[..., 1]], axis=-1
        )
        return x + step

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, mean=[0, 0, 0], cov=0.01 * np.eye(3))],
        transition=[pgm.NonlinearGaussianCPD(X, (X.previous, u), drive, 0.01 * np.eye(3))],
        observation=[sensor(**sensor_options)],
    )
    evidence = {
        u: np.tile([1.0, 0.2], (2, 4, 1)),
        Z: pgm.sightings(
            [[5.0, 0.4], [6.0, -0.3], [4.0, 0.5]],
            step=[0, 2, 2],
            given={M: [[4.0, 2.0], [7.0, -1.0], [5.0, 3.0]]},
        ),
    }
    return model, evidence


def expand(function, at):
    """A lineariser is a bare function: here, a first-order expansion written out."""
    value, slope = function(at.mean), function.jacobian(at.mean)
    offset = value - np.einsum("...ij,...j->...i", slope, at.mean)
    return pgm.AffineGaussian(slope, offset, np.zeros((value.shape[-1],) * 2))


def assert_same_beliefs(found, expected):
    assert_allclose(found[X].mean, expected[X].mean, atol=1e-7)
    assert_allclose(found[X].cov, expected[X].cov, atol=1e-8)
    assert_allclose(found.log_evidence, expected.log_evidence, atol=1e-6)


@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
def test_a_bare_function_is_a_lineariser(run):
    model, evidence = localisation()
    assert_same_beliefs(run(model, evidence, lineariser=expand), run(model, evidence))


def test_what_the_engine_hands_over():
    model, evidence = localisation()
    calls = []

    def spy(function, at):
        lead = at.mean.shape[:-1]
        calls.append((function.name, np.broadcast_to(np.asarray(function.step), lead).copy()))
        assert at.scope == ((X.previous,) if function.name == "x" else (X,))
        assert at.cov.shape == (*lead, 3, 3)
        assert function(at.mean).shape == (*lead, 3 if function.name == "x" else 2)
        points = np.repeat(at.mean[..., None, :], 5, axis=-2)
        assert_allclose(function(points)[..., 3, :], function(at.mean))
        assert function.jacobian(points).shape[: len(lead) + 1] == (*lead, 5)
        return expand(function, at)

    pgm.filter(model, evidence, lineariser=spy)
    assert {name for name, _ in calls} == {"x", "z"}
    assert {int(s) for name, step in calls if name == "x" for s in step.flat} == {1, 2, 3, 4}
    assert {int(s) for name, step in calls if name == "z" for s in step.flat} == {0, 2}


def test_the_cpds_own_lineariser_wins():
    def refuse(function, at):
        assert function.name == "x", "the sensor has a lineariser of its own"
        return expand(function, at)

    model, evidence = localisation(lineariser=pgm.Cubature())
    found = pgm.filter(model, evidence, lineariser=refuse)
    plain, _ = localisation()

    def choose(function, at):
        return (pgm.Cubature() if function.name == "z" else expand)(function, at)

    assert_same_beliefs(found, pgm.filter(plain, evidence, lineariser=choose))


@pytest.mark.parametrize(
    "lineariser",
    [lambda function, at: at, lambda function, at: pgm.AffineGaussian([[1.0]], [0.0], [[0.0]])],
)
def test_linearisers_that_return_something_else(lineariser):
    model, evidence = localisation()
    with pytest.raises(pgm.LinearisationError, match="returned") as caught:
        pgm.filter(model, evidence, lineariser=lineariser)
    assert caught.value.cpd in model.cpds
